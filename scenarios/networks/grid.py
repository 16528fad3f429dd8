"""Grids of city blocks with signals at every junction, built by netgenerate."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from scenarios.networks.build import FOLDER, NET, cache_folder, find_program, run_program

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


def grid_net(blocks: int) -> Path:
    """The net of a grid: the shipped one, or one built now and kept for the next time.

    Args:
        blocks: junctions along each side.

    Returns:
        The path of its net.

    Raises:
        InputError: if the number is out of range, or netgenerate is needed and missing.

    Examples:
        >>> grid_net(3).parent.name
        'grid_3'
    """
    if not 2 <= blocks <= MOST_BLOCKS:
        raise InputError(f"blocks: found {blocks}, expected 2 to {MOST_BLOCKS}")
    shipped = blocks == SHIPPED_BLOCKS
    folder = (FOLDER if shipped else cache_folder()) / f"grid_{blocks}"
    if not (folder / NET).is_file():
        program = find_program("netgenerate")
        folder.mkdir(parents=True, exist_ok=True)
        run_program(
            [program, "--grid", "--grid.number", str(blocks), *GRID_OPTIONS], folder, folder / NET
        )
    return folder / NET
