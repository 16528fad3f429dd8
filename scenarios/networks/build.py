"""Builds SUMO nets from geometries with netconvert (``pip install graphrqi[networks]``).

Run ``python -m scenarios.networks.build`` to rebuild every shipped net from its sources.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from behaviors.errors import InputError, lookup
from scenarios.networks.geometry import FourWayGeometry, Geometry, StraightGeometry

FOLDER: Final = Path(__file__).resolve().parent
"""Where the shipped nets lie: ``<name>/road.net.xml`` beside its sources."""

SHIPPED: Final[dict[str, Geometry]] = {
    "straight_road": StraightGeometry(),
    "four_way_intersection": FourWayGeometry(),
}
"""The geometries whose nets are shipped, by folder name."""

OPTIONS: Final[tuple[str, ...]] = (
    "--no-turnarounds", "true",
    "--opposites.guess.fix-lengths", "true",
    "--offset.disable-normalization", "true",
    "--junctions.limit-turn-speed", "5.5",
    "--tls.default-type", "static",
    "--tls.cycle.time", "60",
    "--tls.allred.time", "1",
    "--no-warnings", "true",
)  # fmt: skip
"""netconvert's options for every net."""


def find_netconvert() -> str:
    """The netconvert program of the ``networks`` extra, else the one on the path.

    Raises:
        InputError: if there is none.
    """
    spec = importlib.util.find_spec("sumo")
    if spec is not None and spec.submodule_search_locations:
        for name in ("netconvert", "netconvert.exe"):
            program = Path(next(iter(spec.submodule_search_locations))) / "bin" / name
            if program.is_file():
                return str(program)
    found = shutil.which("netconvert")
    if found is None:
        raise InputError(
            "netconvert: not found, expected on the path: pip install graphrqi[networks]"
        )
    return found


def shipped_net(name: str) -> Path:
    """The path of a shipped net.

    Args:
        name: a key of ``SHIPPED``.

    Raises:
        InputError: if there is no such net.
    """
    lookup(SHIPPED, name, "net")
    return FOLDER / name / "road.net.xml"


def write_sources(geometry: Geometry, folder: Path) -> None:
    """Write the plain XML of a geometry into a folder, made if absent."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in geometry.sources().items():
        (folder / name).write_text(text, encoding="utf-8")


def build(folder: Path) -> Path:
    """Turn the sources in a folder into ``road.net.xml`` beside them.

    Args:
        folder: holds ``road.nod.xml``, ``road.edg.xml`` and ``road.con.xml``.

    Returns:
        The net's path. The file appears whole or not at all.

    Raises:
        InputError: if netconvert is missing or refuses the sources.
    """
    program = find_netconvert()
    net = folder / "road.net.xml"
    with tempfile.TemporaryDirectory() as scratch:
        made = Path(scratch) / net.name
        command = [
            program,
            "--node-files", "road.nod.xml",
            "--edge-files", "road.edg.xml",
            "--connection-files", "road.con.xml",
            "--output-file", str(made),
            *OPTIONS,
        ]  # fmt: skip
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode != 0 or not made.is_file():
            reason = (done.stderr.strip() or "no reason given").splitlines()[0]
            raise InputError(f"{folder.name}: netconvert refused the sources: {reason}")
        partial = folder / f".{net.name}.partial"
        partial.write_text(_without_header(made.read_text(encoding="utf-8")), encoding="utf-8")
        partial.replace(net)
    return net


def _without_header(text: str) -> str:
    """A net without the comment that tells when, where and by what it was built."""
    begin, end = text.find("<!--"), text.find("-->")
    if begin < 0 or end < 0:
        return text
    return text[:begin] + text[end + len("-->") :].lstrip()


def main() -> None:
    """Rebuild every shipped net."""
    for name, geometry in SHIPPED.items():
        write_sources(geometry, FOLDER / name)
        sys.stdout.write(f"{build(FOLDER / name).name} of {name}\n")


if __name__ == "__main__":
    main()
