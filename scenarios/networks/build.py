"""Builds SUMO nets with netconvert and netgenerate (``pip install graphrqi[networks]``).

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
from scenarios.networks.geometries import (
    CONTROLS,
    TWO_WAY_LENGTH_M,
    FourWayGeometry,
    Geometry,
    MotorwayGeometry,
    RoundaboutGeometry,
    StraightGeometry,
)
from sim.files import temporary_folder, user_cache, write_whole

FOLDER: Final = Path(__file__).resolve().parent
"""Where the shipped nets lie: ``<name>/road.net.xml`` beside its sources."""

NET: Final = "road.net.xml"

SHIPPED_BLOCKS: Final = 3
"""The grid that ships: 3 x 3 junctions, 276 lanes."""

MOST_BLOCKS: Final = 100
"""Largest grid: some 280,000 lanes (netgenerate takes ten seconds for it)."""

GRID_OPTIONS: Final = (
    "--grid.length", "150", "--grid.attach-length", "150", "--default.lanenumber", "2",
    "--default-junction-type", "traffic_light", "--tls.default-type", "static",
    "--no-turnarounds", "true", "--offset.disable-normalization", "true",
)  # fmt: skip
"""Blocks of 150 m, two lanes in each direction, roads that lead out on every side, and fixed-time
signals (common sizes of blocks in towns)."""

LIMITS_MPS: Final = (8.33, 11.11, 16.67, 19.44)
"""Other speed limits, km/h, whose nets are shipped for the two main roads."""

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


def has_program(name: str) -> bool:
    """Whether a program is there."""
    try:
        find_program(name)
    except InputError:
        return False
    return True


def cache_folder() -> Path:
    """The folder of nets that were built on the fly, in the user's cache."""
    return user_cache() / "networks"


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
    return folder / NET if (folder / NET).is_file() else build(geometry, folder)


def build(geometry: Geometry, folder: Path) -> Path:
    """Write the sources of a geometry into a folder, made if absent, and the net beside them.

    Returns:
        The net's path. The file appears whole or not at all.

    Raises:
        InputError: if netconvert is missing or refuses the sources.
    """
    program, net = find_program("netconvert"), folder / NET
    folder.mkdir(parents=True, exist_ok=True)
    sources = geometry.sources()
    for name, text in sources.items():
        (folder / name).write_text(text, encoding="utf-8")
    settings = next(name for name in sources if name.endswith(".netccfg"))
    run_program([program, "--configuration-file", settings], folder, net)
    return net


def grid_net(blocks: int) -> Path:
    """The net of a grid of city blocks with signals at every junction, shipped or built now.

    Args:
        blocks: junctions along each side.

    Raises:
        InputError: if the number is out of range, or netgenerate is needed and missing.

    Examples:
        >>> grid_net(3).parent.name
        'grid_3'
    """
    if not 2 <= blocks <= MOST_BLOCKS:
        raise InputError(f"blocks: found {blocks}, expected 2 to {MOST_BLOCKS}")
    folder = (FOLDER if blocks == SHIPPED_BLOCKS else cache_folder()) / f"grid_{blocks}"
    if not (folder / NET).is_file():
        command = [find_program("netgenerate"), "--grid", "--grid.number", str(blocks)]
        folder.mkdir(parents=True, exist_ok=True)
        run_program([*command, *GRID_OPTIONS], folder, folder / NET)
    return folder / NET


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
        Warnings of the program.

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
    """A net without the comment that records when, where and by what it was built."""
    begin, end = text.find("<!--"), text.find("-->")
    if begin < 0 or end < 0:
        return text
    return text[:begin] + text[end + len("-->") :].lstrip()


def main() -> int:
    """Rebuild every shipped net; 2 if that cannot be done."""
    try:
        for name, geometry in SHIPPED.items():
            build(geometry, FOLDER / name)
            sys.stdout.write(f"built {name}\n")
    except InputError as error:
        sys.stderr.write(f"scenarios.networks.build: error: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
