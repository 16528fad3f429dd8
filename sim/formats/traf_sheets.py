"""TRAF annotation sheets: the traits that annotators noted, from .xlsx files without a header.

Columns: agent id, agent type, an aggressive flag, the number of traits, then their codes. Rows
without a number of traits are agents that nobody annotated. A sheet's name is the annotator's
letter and the video's number: ``c8.xlsx``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labelling import Resolution, resolve
from behaviors.labels import Trait
from sim.frames import Tracks
from sim.input_files import broken_as_one_line, stem

TRAIT_CODES: Final[dict[int, Trait]] = {
    100: Trait.OVERTAKING,
    101: Trait.OVER_SPEEDING,
    102: Trait.TAILGATING,
    103: Trait.WEAVING,
    104: Trait.CUTTING_IN,
    105: Trait.DRIVING_CLOSE,
    106: Trait.WRONG_DIRECTION,
    107: Trait.JAYWALKING,
    108: Trait.BREAKING_RULES,
    0: Trait.KEEPING_NEIGHBORS,
    1: Trait.UNIFORM_SPEED,
    2: Trait.FOLLOWING_RULES,
    3: Trait.NOT_MOVING,
    4: Trait.SLOWING,
    5: Trait.WAITING,
}
"""The sheets' codes; where the data do not identify one, it follows the paper's trait table."""

_NAME: Final = re.compile(r"([a-z])(\d+)")


@dataclass(frozen=True, slots=True)
class Sheet:
    """What one annotator noted on one video.

    Attributes:
        annotator: the letter of the sheet's name.
        video: the number of the sheet's name.
        traits: by agent id, in the annotator's order; annotated agents only.
    """

    annotator: str
    video: int
    traits: Mapping[int, tuple[Trait, ...]]


def read_sheet(path: Path) -> Sheet:
    """Read one annotator's sheet.

    Args:
        path: ``<letter><video>.xlsx``.

    Returns:
        What it says.

    Raises:
        InputError: naming file and row, if the sheet is broken.
    """
    import pandas

    name = _NAME.fullmatch(path.stem)
    if name is None or not path.is_file():
        raise InputError(f"{path}: found no sheet, expected <letter><video>.xlsx")
    with broken_as_one_line(path, "an .xlsx sheet"):
        table = pandas.read_excel(path, header=None, engine="openpyxl")
    traits: dict[int, tuple[Trait, ...]] = {}
    agents = set[int]()
    for number, row in enumerate(table.itertuples(index=False), 1):
        cells = ["" if pandas.isna(cell) else str(cell).strip() for cell in row]
        if not any(cells):
            continue
        where = f"{path}: row {number}"
        agent = _whole(where, "A", cells)
        if agent in agents:
            raise InputError(f"{where}: found agent {agent} a second time, expected it once")
        agents.add(agent)
        count = _whole(where, "D", cells) if len(cells) > 3 and cells[3] else 0
        most = max(len(cells) - 4, 0)
        if not 0 <= count <= most:
            raise InputError(f"{where}, column D: found {count} traits, expected 0 to {most}")
        codes = [_whole(where, chr(ord("E") + i), cells) for i in range(count)]
        unknown = [code for code in codes if code not in TRAIT_CODES]
        if unknown:
            raise InputError(f"{where}: found trait code {unknown[0]}, expected one of the table")
        if codes:  # agents without a number of traits were not annotated
            traits[agent] = tuple(TRAIT_CODES[code] for code in codes)
    return Sheet(name[1], int(name[2]), traits)


def _whole(where: str, column: str, cells: list[str]) -> int:
    """A cell of a row as a whole number."""
    text = cells[ord(column) - ord("A")]
    if not re.fullmatch(r"-?[0-9]{1,9}(\.0+)?", text):
        raise InputError(f"{where}, column {column}: found {text!r:.60}, expected a number")
    return int(float(text))


def sheets_of(folder: Path, video: int) -> tuple[Sheet, ...]:
    """All annotators' sheets on one video, in alphabetical order.

    Args:
        folder: with the .xlsx files.
        video: number of the video.

    Returns:
        The sheets; empty if there are none.
    """
    paths = sorted(folder.glob(f"[a-z]{video}.xlsx"))
    return tuple(read_sheet(path) for path in paths)


def video_number(path: Path) -> int | None:
    """The number by which sheets name a video: the last one in the file's name.

    Examples:
        >>> video_number(Path("TRAF53_8_gt.txt"))
        8
    """
    found = re.search(r"(\d+)_gt$", stem(path))
    return int(found[1]) if found else None


def sheets_beside(path: Path) -> tuple[Sheet, ...]:
    """The sheets that lie beside a video's tracks.

    Args:
        path: its tracks, ``..._gt.txt``.

    Returns:
        All annotators' sheets on it in the tracks' folder, or else in a folder ``annotations``
        there or beside that folder; empty if there are none.

    Raises:
        InputError: if a sheet is broken.
    """
    number = video_number(path)
    folder = path.resolve().parent
    if number is None:
        return ()
    places = (folder, folder / "annotations", folder.parent / "annotations")
    return next((found for place in places if (found := sheets_of(place, number))), ())


def labels(tracks: Tracks, sheets: tuple[Sheet, ...], rule: Resolution) -> NDArray[np.int8]:
    """The resolved label of each agent of a video.

    Args:
        tracks: of the video; agents are found by their names.
        sheets: of the same video.
        rule: how conflicts are resolved.

    Returns:
        (N,) codes into ``BEHAVIORS``, -1 where nobody annotated or the conflict stays.
    """
    out = np.full(tracks.ids.size, -1, dtype=np.int8)
    for row, name in enumerate(tracks.names):
        if not name.isdecimal():
            continue
        noted = [sheet.traits[int(name)] for sheet in sheets if int(name) in sheet.traits]
        behavior = resolve(noted, rule) if noted else None
        if behavior is not None:
            out[row] = behavior.code
    return out
