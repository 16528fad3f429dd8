"""TRAF tracks: one line per video frame, ``frame, n, (x, y, w, h, id) * n``, whole PIXELS.

x and y are the top-left corner of a box in a 640 x 480 image with y down, seen by a camera that
stands still. Neither the frame rate nor a scale is part of the format: positions stay in pixels,
and the frame rate is assumed. Some ids name two boxes in one frame: the box that continues
the track keeps the name, the other gets a name of its own.

Labels come from the annotators' sheets beside the tracks, ``c8.xlsx``: the annotator's letter and
the video's number. Columns, without a header: agent id, agent type, an aggressive flag, the number
of traits, then their codes. Rows without a number of traits are agents that nobody annotated.

References:
    Chandra et al. (2019), TraPHic, CVPR.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labelling import Resolution, resolve
from behaviors.labels import Trait
from sim.formats.common.recording import Recording, recorded
from sim.frames import IntArray, Tracks
from sim.input_files import broken_as_one_line, opened, stem

FRAME_RATE_HZ: Final = 25.0
"""Frames per second that are assumed (the usual rate of such video; not stated anywhere)."""

HEIGHT_PX: Final = 480
"""Height of the image, pixels."""

MAX_TWINS: Final = 32
"""Most boxes of one id in a frame (the data have up to two): each is compared with each of the
frame before."""

TRAIT_CODES: Final[dict[int, Trait]] = {
    100: Trait.OVERTAKING, 101: Trait.OVER_SPEEDING, 102: Trait.TAILGATING, 103: Trait.WEAVING,
    104: Trait.CUTTING_IN, 105: Trait.DRIVING_CLOSE, 106: Trait.WRONG_DIRECTION,
    107: Trait.JAYWALKING, 108: Trait.BREAKING_RULES, 0: Trait.KEEPING_NEIGHBORS,
    1: Trait.UNIFORM_SPEED, 2: Trait.FOLLOWING_RULES, 3: Trait.NOT_MOVING, 4: Trait.SLOWING,
    5: Trait.WAITING,
}  # fmt: skip
"""The sheets' codes; where the data do not identify one, it follows the paper's trait table."""


def read(path: Path) -> Iterator[Recording]:
    """The recording of one ``..._gt.txt``, in pixels, y up.

    An agent's length and width are the median sides of its box in the image. Annotators who
    disagree are resolved the ``lenient`` way.
    """
    boxes = _boxes(path)
    parts = []
    ids = np.unique(boxes[:, 5]).tolist()
    for identity in ids:
        for k, own in enumerate(_tracks_of(boxes[boxes[:, 5] == identity])):
            rows = pandas.DataFrame(_centres(own), columns=["x", "y"])
            rows["id"] = f"{identity}-{k + 1}" if k else str(identity)
            rows["t"] = own[:, 0] / FRAME_RATE_HZ
            rows["length"], rows["width"] = np.median(own[:, 3:5], axis=0)
            parts.append(rows)
    notes = [
        "lengths are pixels and speeds pixels per second: the format has no scale",
        f"{FRAME_RATE_HZ:g} frames per second are assumed; kinds are not in this format",
    ]
    if twins := len(parts) - len(ids):
        notes.append(f"{twins} boxes had an id that was in use at the time: they got their own")
    recording = recorded(stem(path), pandas.concat(parts), in_metres=False)
    if sheets := sheets_beside(path):
        codes = labels(recording.tracks, sheets, "lenient")
        files = ", ".join(f"{sheet.annotator}{sheet.video}.xlsx" for sheet in sheets)
        known = int((codes >= 0).sum())
        notes.append(f"{known} labels are resolved from the traits in {files}")
        recording = replace(recording, tracks=replace(recording.tracks, behavior=codes))
    yield replace(recording, notes=tuple(notes))


def _boxes(path: Path) -> IntArray:
    """(k, 6) frame, x, y, width, height and id of every box, in order of the frames."""
    parts: list[IntArray] = []
    last = -math.inf
    with opened(path) as file:
        for number, line in enumerate(file, 1):
            if not line.strip():
                continue
            try:
                frame, count, *fields = map(int, line.split(b","))
                found = np.array(fields, dtype=np.int64).reshape(count, 5)
                parts.append(np.insert(found, 0, frame, axis=1))
            except (ValueError, OverflowError):
                raise InputError(
                    f"{path}: line {number}: found {line[:40]!r}, expected whole numbers: a frame, "
                    "a count, and five for each box"
                ) from None
            if frame <= last:
                raise InputError(
                    f"{path}: line {number}: found frame {frame}, expected one after {last}"
                )
            last = frame
    if not any(map(len, parts)):
        raise InputError(f"{path}: found no boxes, expected some")
    return np.concatenate(parts)


def _centres(boxes: IntArray) -> NDArray[np.float64]:
    """(k, 2) centres of boxes, pixels, y up."""
    corner, sides = boxes[:, 1:3], boxes[:, 3:5]
    return (corner + 0.5 * sides) * (1, -1) + (0, HEIGHT_PX)


def _tracks_of(boxes: IntArray) -> list[IntArray]:
    """The boxes of one id as tracks with one box in a frame.

    Each box continues the nearest track; a box without a track begins a new one.
    """
    _, counts = np.unique(boxes[:, 0], return_counts=True)
    if counts.max() == 1:
        return [boxes]
    if counts.max() > MAX_TWINS:
        raise InputError(f"found {counts.max()} boxes of id {boxes[0, 5]} in a frame, expected one")
    centres = _centres(boxes)
    tracks: list[list[int]] = []
    for here in np.split(np.arange(len(boxes)), np.cumsum(counts)[:-1]):
        pairs = sorted(
            (math.dist(centres[track[-1]], centres[box]), i, box)
            for i, track in enumerate(tracks)
            for box in here.tolist()
        )
        placed: dict[int, int] = {}
        for _, i, box in pairs:
            if box not in placed and i not in placed.values():
                placed[box] = i
        for box in here.tolist():
            if box in placed:
                tracks[placed[box]].append(box)
            else:
                tracks.append([box])
    return [boxes[track] for track in tracks]


# --- annotators' sheets -------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Sheet:
    """What one annotator noted on one video: traits by agent id, of annotated agents only.

    The letter and the number of the sheet's name are ``annotator`` and ``video``.
    """

    annotator: str
    video: int
    traits: Mapping[int, tuple[Trait, ...]]


def read_sheet(path: Path) -> Sheet:
    """One annotator's sheet, ``<letter><video>.xlsx``."""
    name = re.fullmatch(r"([a-z])(\d+)", path.stem)
    if name is None or not path.is_file():
        raise InputError(f"{path}: found no sheet, expected <letter><video>.xlsx")
    with broken_as_one_line(path, "an .xlsx sheet"):
        table = pandas.read_excel(path, header=None, engine="openpyxl").dropna(how="all")
    traits: dict[int, tuple[Trait, ...]] = {}
    for number, cells in zip(table.index + 1, table.to_numpy(object).tolist(), strict=True):
        try:
            agent, said = int(float(cells[0])), float(cells[3]) if len(cells) > 3 else math.nan
            count = 0 if math.isnan(said) else int(said)  # rows of agents that nobody annotated
            noted = tuple(TRAIT_CODES[int(cell)] for cell in map(float, cells[4 : 4 + count]))
        except (ValueError, KeyError, OverflowError):
            noted, agent, count = (), 0, 1
        if len(noted) != count or agent in traits:
            raise InputError(
                f"{path}: row {number}: found {cells!r:.80}, expected an agent that is not above, "
                "a type, a flag, a number of traits and their codes"
            )
        traits[agent] = noted
    return Sheet(name[1], int(name[2]), {agent: noted for agent, noted in traits.items() if noted})


def sheets_of(folder: Path, video: int | None) -> tuple[Sheet, ...]:
    """All annotators' sheets on one video, in alphabetical order; empty if there are none."""
    return tuple(read_sheet(path) for path in sorted(folder.glob(f"[a-z]{video}.xlsx")))


def video_number(path: Path) -> int | None:
    """The number by which sheets name a video: the last one in the name, ``TRAF53_8_gt.txt``."""
    found = re.search(r"(\d+)_gt$", stem(path))
    return int(found[1]) if found else None


def sheets_beside(path: Path) -> tuple[Sheet, ...]:
    """The sheets of a video: beside its tracks, or in a folder ``annotations`` there or nearby."""
    folder = path.resolve().parent
    places = (folder, folder / "annotations", folder.parent / "annotations")
    every = (sheets_of(place, video_number(path)) for place in places)
    return next((found for found in every if found), ())


def labels(tracks: Tracks, sheets: tuple[Sheet, ...], rule: Resolution) -> NDArray[np.int8]:
    """(N,) codes into ``BEHAVIORS``, -1 where nobody annotated or the rule leaves a conflict."""
    out = np.full(tracks.ids.size, -1, dtype=np.int8)
    for row, name in enumerate(tracks.names):
        noted = [s.traits[int(name)] for s in sheets if name.isdecimal() and int(name) in s.traits]
        behavior = resolve(noted, rule) if noted else None
        if behavior is not None:
            out[row] = behavior.code
    return out
