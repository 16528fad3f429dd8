"""Builds SUMO nets with netconvert and netgenerate (``pip install graphrqi[networks]``).

The nets that ship lie beside their sources and are known by the hash of these.
``build(straight_sources(lanes=4), FOLDER / "one_way_4")`` makes one of them again.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import os
import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from scenarios.networks.geometries import SOURCE_FILES, Sources
from sim.files import temporary_folder, user_cache, write_whole

FOLDER: Final = Path(__file__).resolve().parent
"""Where the shipped nets lie: ``<name>/road.net.xml`` beside its sources."""

NET: Final = "road.net.xml"

SHIPPED_BLOCKS: Final = 3
"""The grid that ships: 3 x 3 junctions, 276 lanes."""

MOST_BLOCKS: Final = 100
"""Largest grid: some 280,000 lanes (netgenerate takes ten seconds for it)."""

LONGEST_S: Final = 600.0
"""A program may take this long, s (netconvert takes seconds for a district)."""

GRID_OPTIONS: Final = (
    "--grid.length", "150", "--grid.attach-length", "150", "--default.lanenumber", "2",
    "--default-junction-type", "traffic_light", "--tls.default-type", "static",
    "--no-turnarounds", "true", "--offset.disable-normalization", "true",
)  # fmt: skip
"""Blocks of 150 m, two lanes in each direction, roads that lead out on every side, and fixed-time
signals (common sizes of blocks in towns)."""


def program_path(name: str) -> str | None:
    """Where a program of the ``networks`` extra is, else the one on the path, if any."""
    spec = importlib.util.find_spec("sumo")
    packages = (spec.submodule_search_locations if spec else None) or []
    folders = [*(str(Path(one) / "bin") for one in packages), os.environ.get("PATH", "")]
    return shutil.which(name, path=os.pathsep.join(folders))


def find_program(name: str) -> str:
    """As `program_path`, where the program is needed."""
    found = program_path(name)
    if found is None:
        raise InputError(f"{name}: not found, expected on the path: pip install graphrqi[networks]")
    return found


def cache_folder() -> Path:
    """The folder of nets that were built on the fly, in the user's cache."""
    return user_cache() / "networks"


def _digest(texts: Iterable[str]) -> str:
    return hashlib.sha256("".join(texts).encode()).hexdigest()[:16]


@functools.cache
def _shipped() -> dict[str, Path]:
    """The folders of the nets that ship, by the hash of their sources."""
    folders = [settings.parent for settings in FOLDER.glob(f"*/{SOURCE_FILES[-1]}")]
    return {
        _digest((folder / name).read_text(encoding="utf-8") for name in SOURCE_FILES): folder
        for folder in folders
    }


def net_of(sources: Sources) -> Path:
    """The net of a road's sources: a shipped one, or one built now and kept for the next time."""
    digest = _digest(sources.values())
    folder = _shipped().get(digest) or cache_folder() / digest
    return folder / NET if (folder / NET).is_file() else build(sources, folder)


def build(sources: Sources, folder: Path) -> Path:
    """Write the sources of a road into a folder, made if absent, and the net beside them."""
    program = find_program("netconvert")
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in sources.items():
        (folder / name).write_text(text, encoding="utf-8")
    run_program([program, "--configuration-file", SOURCE_FILES[-1]], folder, folder / NET)
    return folder / NET


def grid_net(blocks: int) -> Path:
    """The net of a grid with so many junctions along each side, shipped or built now."""
    if not 2 <= blocks <= MOST_BLOCKS:
        raise InputError(f"blocks: found {blocks}, expected 2 to {MOST_BLOCKS}")
    folder = (FOLDER if blocks == SHIPPED_BLOCKS else cache_folder()) / f"grid_{blocks}"
    if not (folder / NET).is_file():
        command = [find_program("netgenerate"), "--grid", "--grid.number", str(blocks)]
        folder.mkdir(parents=True, exist_ok=True)
        run_program([*command, *GRID_OPTIONS], folder, folder / NET)
    return folder / NET


def run_program(command: list[str], folder: Path, net: Path, what: str = "") -> list[str]:
    """Run netconvert or netgenerate in a folder, and return its warnings.

    The net appears whole or not at all, without the comment on when, where and by what it was made.
    Messages call the sources ``what``, or by the name of the folder.
    """
    what, name = what or folder.name, Path(command[0]).stem
    with temporary_folder("net") as scratch:
        made = scratch / net.name
        try:
            done = subprocess.run(
                [*command, "--output-file", str(made)],
                cwd=folder, capture_output=True, text=True, errors="replace", check=False,
                timeout=LONGEST_S,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise InputError(f"{what}: {name} took more than {LONGEST_S:g} s") from None
        lines = [" ".join(line.split()) for line in done.stderr.splitlines() if line.strip()]
        if done.returncode != 0 or not made.is_file():
            errors = [line for line in lines if line.startswith("Error")]
            reason = (errors or lines or ["no reason given"])[0][:300]
            raise InputError(f"{what}: {name} refused the sources: {reason}")
        begin, comment, rest = made.read_text(encoding="utf-8").partition("<!--")
        text = begin + (rest.partition("-->")[2].lstrip() if comment else "")
        write_whole(net, text.encode("utf-8"))
    warnings = [line for line in done.stderr.splitlines() if line.startswith("Warning: ")]
    return [line[len("Warning: ") :] for line in warnings if "SUMO_HOME" not in line]
