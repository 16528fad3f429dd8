"""Builds SUMO nets from geometries with netconvert (``pip install graphrqi[networks]``).

Run ``python -m scenarios.networks.build`` to rebuild every shipped net from its sources.
"""

from __future__ import annotations

import hashlib
import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from scenarios.networks.geometry import (
    CONTROLS,
    TWO_WAY_LENGTH_M,
    FourWayGeometry,
    Geometry,
    StraightGeometry,
)
from scenarios.networks.motorway_and_roundabout import MotorwayGeometry, RoundaboutGeometry
from sim.store.atomic import temporary_folder, write_whole
from sim.store.places import user_cache

FOLDER: Final = Path(__file__).resolve().parent
"""Where the shipped nets lie: ``<name>/road.net.xml`` beside its sources."""

NET: Final = "road.net.xml"
SETTINGS: Final = "road.netccfg"

LIMITS_MPS: Final = (8.33, 11.11, 16.67, 19.44)
"""Other speed limits whose nets are shipped for the two main roads: 30, 40, 60 and 70 km/h."""

SHIPPED: Final[dict[str, Geometry]] = {
    "straight_road": StraightGeometry(),
    **{
        f"one_way_{lanes}{'' if crossing else '_plain'}": StraightGeometry(
            lanes=lanes, crossing=crossing
        )
        for lanes in (2, 3, 4, 5)
        for crossing in (True, False)
        if (lanes, crossing) != (3, True)
    },
    **{
        f"two_way_{lanes}{'' if crossing else '_plain'}": StraightGeometry(
            lanes=lanes, two_way=True, crossing=crossing, length_m=TWO_WAY_LENGTH_M
        )
        for lanes in (1, 2)
        for crossing in (True, False)
    },
    "four_way_intersection": FourWayGeometry(),
    **{
        f"four_way_{control}": FourWayGeometry(control=control, lanes=1)
        for control in CONTROLS
        if control != "traffic_light"
    },
    "four_way_1": FourWayGeometry(lanes=1),
    "four_way_3": FourWayGeometry(lanes=3),
    "four_way_priority_2": FourWayGeometry(control="priority", lanes=2),
    "four_way_right_before_left_2": FourWayGeometry(control="right_before_left", lanes=2),
    "motorway": MotorwayGeometry(),
    "motorway_ramps": MotorwayGeometry(ramps=True),
    "roundabout": RoundaboutGeometry(),
    **{f"straight_road_{limit:g}_mps": StraightGeometry(limit_mps=limit) for limit in LIMITS_MPS},
    **{f"four_way_{limit:g}_mps": FourWayGeometry(limit_mps=limit) for limit in LIMITS_MPS},
}
"""The geometries whose nets are shipped, by folder name."""


def find_program(name: str) -> str:
    """A program of the ``networks`` extra, such as netconvert, else the one on the path.

    Raises:
        InputError: if there is none.
    """
    spec = importlib.util.find_spec("sumo")
    if spec is not None and spec.submodule_search_locations:
        for file in (name, f"{name}.exe"):
            program = Path(next(iter(spec.submodule_search_locations))) / "bin" / file
            if program.is_file():
                return str(program)
    found = shutil.which(name)
    if found is None:
        raise InputError(f"{name}: not found, expected on the path: pip install graphrqi[networks]")
    return found


def net_of(geometry: Geometry) -> Path:
    """The net of a geometry: a shipped one, or one built now and kept for the next time.

    Args:
        geometry: what the road looks like.

    Returns:
        The path of its net.

    Raises:
        InputError: if it is not shipped and netconvert is missing.
        OSError: if the built net cannot be kept.
    """
    for name, shipped in SHIPPED.items():
        if shipped == geometry:
            return FOLDER / name / NET
    text = "".join(geometry.sources().values())
    folder = cache_folder() / hashlib.sha256(text.encode()).hexdigest()[:16]
    if not (folder / NET).is_file():
        find_program("netconvert")
        write_sources(geometry, folder)
        build(folder)
    return folder / NET


def cache_folder() -> Path:
    """Where nets built on the fly are kept: in the user's cache folder."""
    return user_cache() / "networks"


def write_sources(geometry: Geometry, folder: Path) -> None:
    """Write the plain XML of a geometry into a folder, made if absent."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in geometry.sources().items():
        (folder / name).write_text(text, encoding="utf-8")


def build(folder: Path) -> Path:
    """Turn the sources in a folder into ``road.net.xml`` beside them.

    Args:
        folder: holds what `write_sources` writes.

    Returns:
        The net's path. The file appears whole or not at all.

    Raises:
        InputError: if netconvert is missing or refuses the sources.
    """
    program = find_program("netconvert")
    net = folder / NET
    run_program([program, "--configuration-file", SETTINGS], folder, net)
    return net


def run_program(
    command: list[str],
    folder: Path,
    net: Path,
    *,
    what: str | None = None,
    within_s: float | None = None,
) -> list[str]:
    """Run netconvert or netgenerate in a folder; the net appears whole or not at all.

    Args:
        command: the program and its options, without the output file.
        folder: where it runs.
        net: the net that it is to make.
        what: what messages call the sources; None for the folder's name.
        within_s: it is stopped after this time, s; None for never.

    Returns:
        What the program warned of.

    Raises:
        InputError: if the program refuses, or takes too long.
    """
    what, name = what or folder.name, Path(command[0]).stem
    with temporary_folder("net") as scratch:
        made = scratch / net.name
        try:
            done = subprocess.run(
                [*command, "--output-file", str(made)],
                cwd=folder, capture_output=True, text=True, errors="replace", check=False,
                timeout=within_s,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise InputError(f"{what}: {name} took more than {within_s:g} s") from None
        if done.returncode != 0 or not made.is_file():
            raise InputError(f"{what}: {name} refused the sources: {_reason(done.stderr)}")
        text = _without_header(made.read_text(encoding="utf-8"))
        write_whole(net, text.encode("utf-8"))
    warnings = [line for line in done.stderr.splitlines() if line.startswith("Warning: ")]
    return [line[len("Warning: ") :] for line in warnings if "SUMO_HOME" not in line]


def _reason(stderr: str) -> str:
    """The first error that a program printed, in one line."""
    lines = [line.strip() for line in stderr.splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith("Error")]
    return " ".join((errors or lines or ["no reason given"])[0].split())[:300]


def _without_header(text: str) -> str:
    """A net without the comment that tells when, where and by what it was built."""
    begin, end = text.find("<!--"), text.find("-->")
    if begin < 0 or end < 0:
        return text
    return text[:begin] + text[end + len("-->") :].lstrip()


def main() -> int:
    """Rebuild every shipped net; 2 if that cannot be done."""
    try:
        for name, geometry in SHIPPED.items():
            write_sources(geometry, FOLDER / name)
            build(FOLDER / name)
            sys.stdout.write(f"built {name}\n")
    except InputError as error:
        sys.stderr.write(f"scenarios.networks.build: error: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
