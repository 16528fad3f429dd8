"""TRAF annotation sheets: the traits that annotators noted, from .xlsx files without a header.

Columns: agent id, agent type, an aggressive flag, the number of traits, then their codes. Rows
without a number of traits are agents that nobody annotated. A sheet's name is the annotator's
letter and the video's number: ``c8.xlsx``.
"""

from __future__ import annotations

import re
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labelling import Resolution, resolve
from behaviors.labels import Trait
from sim.formats.common.packed import stem
from sim.frames import Tracks

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

JUMP_SIDES: Final = 1.5
"""A track that jumps over a gap by more than this many of the box's sides is reported."""

MAX_XML_BYTES: Final = 2**24
"""Most bytes that a workbook may unpack to (16 MiB; real ones have 60 kB)."""

MAX_SHEET_ROWS: Final = 2**20
"""Most rows of a sheet, empty ones included (as many as Excel has)."""

MAX_TRAITS: Final = 20
MAX_COLUMNS: Final = 4 + MAX_TRAITS
"""Most traits of one agent, and the columns that they take (there are 15 traits)."""

_BROKEN: Final = (
    ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, OSError, RuntimeError,
    SyntaxError, TypeError, ValueError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What openpyxl and zipfile raise on a broken workbook."""

_NAME: Final = re.compile(r"([a-z])(\d+)")


@dataclass(frozen=True, slots=True)
class Sheet:
    """What one annotator noted on one video.

    Attributes:
        annotator: the letter of the sheet's name.
        video: the number of the sheet's name.
        traits: by agent id, in the annotator's order; annotated agents only.
        blank: ids of agents that are listed but not annotated.
        contradictions: ids whose aggressive flag contradicts their first trait.
    """

    annotator: str
    video: int
    traits: Mapping[int, tuple[Trait, ...]]
    blank: tuple[int, ...]
    contradictions: tuple[int, ...]


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Number and cells, as text, of each row of the first sheet that has any."""
    _check_parts(path)
    from openpyxl import load_workbook

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of styles and extensions, which nobody reads
        book = load_workbook(path, read_only=True, data_only=True)
        try:
            sheet = book.worksheets[0]
            sheet.reset_dimensions()  # the size that a file claims may be wrong
            for number, row in enumerate(sheet.iter_rows(max_col=MAX_COLUMNS, values_only=True), 1):
                if number > MAX_SHEET_ROWS:
                    raise InputError(f"{path}: found more than {MAX_SHEET_ROWS} rows")
                cells = ["" if value is None else str(value).strip() for value in row]
                if any(cells):
                    yield number, cells
        finally:
            book.close()


def _check_parts(path: Path) -> None:
    """Refuse workbooks that unpack to too much, and XML that declares entities."""
    with zipfile.ZipFile(path) as archive:
        size = sum(part.file_size for part in archive.infolist())
        if size > MAX_XML_BYTES:
            raise InputError(f"{path}: found {size} bytes inside, expected at most {MAX_XML_BYTES}")
        for part in archive.infolist():
            # without zeros, so that UTF-16 is seen through
            if b"<!DOCTYPE" in archive.read(part).replace(b"\0", b""):
                raise InputError(f"{path}: {part.filename}: found a document type, expected none")


def read_sheet(path: Path) -> Sheet:
    """Read one annotator's sheet.

    Args:
        path: ``<letter><video>.xlsx``.

    Returns:
        What it says.

    Raises:
        InputError: naming file and row, if the sheet is broken.
    """
    name = _NAME.fullmatch(path.stem)
    if name is None or not path.is_file():
        raise InputError(f"{path}: found no sheet, expected <letter><video>.xlsx")
    try:
        rows = list(_rows(path))
    except InputError:
        raise
    except _BROKEN as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: found no readable .xlsx sheet ({reason:.200})") from None
    traits: dict[int, tuple[Trait, ...]] = {}
    blank, contradictions = [], []
    for number, row in rows:
        where = f"{path}: row {number}"

        def whole(column: str, row: list[str] = row, where: str = where) -> int:
            text = row[ord(column) - ord("A")]
            if not re.fullmatch(r"-?[0-9]{1,9}(\.0+)?", text):
                raise InputError(f"{where}, column {column}: found {text!r:.60}, expected a number")
            return int(float(text))

        agent = whole("A")
        if agent in traits or agent in blank:
            raise InputError(f"{where}: found agent {agent} a second time, expected it once")
        count = whole("D") if row[3] else 0
        if not 0 <= count <= MAX_TRAITS:
            raise InputError(f"{where}, column D: found {count} traits, expected 0 to {MAX_TRAITS}")
        if count == 0:
            blank.append(agent)
            continue
        codes = [whole(chr(ord("E") + i)) for i in range(count)]
        unknown = [code for code in codes if code not in TRAIT_CODES]
        if unknown:
            raise InputError(f"{where}: found trait code {unknown[0]}, expected one of the table")
        traits[agent] = tuple(TRAIT_CODES[code] for code in codes)
        if row[2] and (whole("C") > 0) != (codes[0] >= 100):
            contradictions.append(agent)
    return Sheet(name[1], int(name[2]), traits, tuple(blank), tuple(contradictions))


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


def defects(tracks: Tracks, sheets: tuple[Sheet, ...]) -> tuple[str, ...]:
    """What is wrong with a video's tracks and sheets, one sentence each.

    Args:
        tracks: of the video.
        sheets: of the same video.

    Returns:
        Sentences on double ids, gaps, jumps, unlabelled agents, and contradictions.
    """
    found: list[str] = []
    twins = [name for name in tracks.names if "-" in name[1:]]
    if twins:
        found.append(
            f"ids that named two boxes at once: {', '.join(n.split('-')[0] for n in twins)}"
        )
    gaps, jumps = [], []
    for row, name in enumerate(tracks.names):
        seen = np.flatnonzero(tracks.valid[row])
        holes = np.flatnonzero(np.diff(seen) > 1)
        if not holes.size:
            continue
        longest = int(np.diff(seen).max()) - 1
        moved = np.hypot(*(tracks.xy[row, seen[holes + 1]] - tracks.xy[row, seen[holes]]).T)
        gaps.append(f"{name} ({longest} frames)")
        if moved.max() > JUMP_SIDES * max(tracks.length[row], tracks.width[row]):
            jumps.append(f"{name} ({moved.max():.0f} pixels)")
    if gaps:
        found.append(f"agents lost and found again: {', '.join(gaps)}")
    if jumps:
        found.append(f"agents that jumped meanwhile: {', '.join(jumps)}")
    step = np.diff(tracks.xy, axis=1)
    known = np.isfinite(step[..., 0])
    still = (step[known] == 0.0).all(axis=1).mean() if known.any() else 0.0
    found.append(f"{100 * still:.0f} % of the steps from frame to frame are exactly zero")
    names = {int(n) for n in tracks.names if n.isdecimal()}
    for sheet in sheets:
        who = f"{sheet.annotator}{sheet.video}"
        absent = sorted(set(sheet.traits) - names)
        if sheet.blank:
            found.append(f"{who}: listed but not annotated: {', '.join(map(str, sheet.blank))}")
        if absent:
            found.append(f"{who}: annotated but not tracked: {', '.join(map(str, absent))}")
        if sheet.contradictions:
            found.append(
                f"{who}: aggressive flag against the first trait: "
                f"{', '.join(map(str, sheet.contradictions))}"
            )
    return tuple(found)
