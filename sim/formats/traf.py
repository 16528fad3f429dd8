"""TRAF tracks: one line per video frame, ``frame, n, (x, y, w, h, id) * n``, whole PIXELS.

x and y are the top-left corner of a box in a 640 x 480 image with y down, seen by a camera that
stands still. Neither the frame rate nor a scale is part of the format: positions stay in pixels,
and the frame rate is assumed. Some ids name two boxes in one frame: the box that continues
the track keeps the name, the other gets a name of its own. Labels come from the annotators' sheets
that lie beside the tracks (`sim.formats.traf_sheets`), if any.

References:
    Chandra et al. (2019), TraPHic, CVPR.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from sim.formats.common.packed import lines_of, opened, stem
from sim.formats.common.recording import MAX_ROWS, Recording, Rows, check_size, recordings
from sim.formats.traf_sheets import Sheet, defects, labels, sheets_beside
from sim.track_rows import MAX_CELLS
from sim.written_numbers import whole

FRAME_RATE_HZ: Final = 25.0
"""Frames per second that are assumed (the usual rate of such video; not stated anywhere)."""

HEIGHT_PX: Final = 480
"""Height of the image, pixels."""

MAX_LINE_BYTES: Final = 2**20
"""Longest line (some 40 000 boxes)."""


MAX_NUMBER: Final = 10**6
"""Largest absolute value of a place, a size or an id."""


MAX_TWINS: Final = 32
"""Most boxes of one id in a frame (the data have up to two): each is compared with each of the
frame before."""


MAX_FRAME: Final = 10**9
"""Largest number of a frame (a year of video)."""


@dataclass(frozen=True, slots=True)
class _Box:
    frame: int
    x: int
    y: int
    width: int
    height: int

    @property
    def centre(self) -> tuple[float, float]:
        return self.x + 0.5 * self.width, HEIGHT_PX - (self.y + 0.5 * self.height)


def _frames(path: Path) -> Iterator[dict[int, list[_Box]]]:
    """The boxes of each id, frame by frame."""
    last = None
    total = 0
    with opened(path) as file:
        for number, line in lines_of(path, file, MAX_LINE_BYTES):
            if not line.strip():
                continue
            where = f"{path}: line {number}"
            try:
                fields = [whole(field) for field in line.split(b",")]
            except ValueError:
                raise InputError(f"{where}: found {line[:40]!r}, expected whole numbers") from None
            if len(fields) < 2 or fields[1] < 0 or len(fields) != 2 + 5 * fields[1]:
                raise InputError(
                    f"{where}: found {len(fields)} fields, expected 2 and 5 for each box"
                )
            if not 0 <= fields[0] <= MAX_FRAME:
                raise InputError(f"{where}: found frame {fields[0]}, expected 0 to {MAX_FRAME}")
            if last is not None and fields[0] <= last:
                raise InputError(f"{where}: found frame {fields[0]}, expected one after {last}")
            last = fields[0]
            total += fields[1]
            if total > MAX_ROWS:
                raise InputError(f"{where}: found more than {MAX_ROWS} boxes")
            boxes: dict[int, list[_Box]] = {}
            for at in range(2, len(fields), 5):
                x, y, width, height, identity = fields[at : at + 5]
                if width <= 0 or height <= 0 or max(map(abs, fields[at : at + 5])) > MAX_NUMBER:
                    raise InputError(f"{where}: found box {fields[at : at + 4]}, expected pixels")
                named = boxes.setdefault(identity, [])
                named.append(_Box(last, x, y, width, height))
                if len(named) > MAX_TWINS:
                    raise InputError(
                        f"{where}: found more than {MAX_TWINS} boxes of id {identity}, expected one"
                    )
            yield boxes


def _continue(own: list[list[_Box]], boxes: list[_Box]) -> None:
    """Append each box to the nearest track of its id; a box without a track begins a new one."""
    pairs = sorted(
        (math.dist(track[-1].centre, box.centre), i, j)
        for i, track in enumerate(own)
        for j, box in enumerate(boxes)
    )
    tracks, placed = set[int](), set[int]()
    for _, i, j in pairs:
        if i not in tracks and j not in placed:
            own[i].append(boxes[j])
            tracks.add(i)
            placed.add(j)
    own.extend([box] for j, box in enumerate(boxes) if j not in placed)


def read(path: Path, frame_rate_hz: float = FRAME_RATE_HZ) -> Iterator[Recording]:
    """Read one file.

    Args:
        path: ``..._gt.txt``.
        frame_rate_hz: frames per second of the video; 1 makes times frame numbers.

    Yields:
        One recording, in pixels, y up. An agent's length and width are the median sides of its
        box in the image. Annotators who disagree are resolved the ``lenient`` way.

    Raises:
        InputError: if the file is broken; the message names file and line.
    """
    check_size(path)
    if not 0 < frame_rate_hz <= 1000:
        raise InputError(f"frame_rate_hz: found {frame_rate_hz}, expected up to 1000")
    tracks: dict[int, list[list[_Box]]] = {}
    for boxes in _frames(path):
        for identity, found in boxes.items():
            _continue(tracks.setdefault(identity, []), found)
    if not tracks:
        raise InputError(f"{path}: found no boxes, expected some")
    named = {
        (str(identity) if i == 0 else f"{identity}-{i + 1}"): boxes
        for identity, own in sorted(tracks.items())
        for i, boxes in enumerate(own)
    }
    every = [box for boxes in named.values() for box in boxes]
    centres = np.array([box.centre for box in every])
    sides = [np.median([[b.width, b.height] for b in boxes], axis=0) for boxes in named.values()]
    unknown = np.full(len(every), np.nan)
    rows = Rows(
        agent=np.repeat(np.arange(len(named)), [len(boxes) for boxes in named.values()]),
        names=tuple(named),
        time_s=np.array([box.frame for box in every]) / frame_rate_hz,
        x=centres[:, 0],
        y=centres[:, 1],
        heading=unknown,
        speed=unknown,
        length=np.array([s[0] for s in sides]),
        width=np.array([s[1] for s in sides]),
        kind=np.zeros(len(named), dtype=np.int8),
    )
    twins = sum(len(own) - 1 for own in tracks.values())
    notes = [
        "lengths are pixels and speeds pixels per second: the format has no scale",
        f"{frame_rate_hz:g} frames per second are assumed; kinds are not in this format",
    ]
    if twins:
        notes.append(f"{twins} boxes had an id that was in use at the time: they got their own")
    sheets = sheets_beside(path)
    for one in recordings(path, stem(path), rows, notes, max_cells=MAX_CELLS):
        yield _labelled(one, sheets) if sheets else one


def _labelled(recording: Recording, sheets: tuple[Sheet, ...]) -> Recording:
    """A recording with the labels that its annotators' traits resolve to."""
    codes = labels(recording.tracks, sheets, "lenient")
    told = ", ".join(f"{sheet.annotator}{sheet.video}.xlsx" for sheet in sheets)
    notes = (
        f"{int((codes >= 0).sum())} labels are resolved from the traits in {told}",
        *defects(recording.tracks, sheets),
    )
    tracks = recording.tracks.with_behavior(codes)
    return replace(recording, tracks=tracks, notes=(*recording.notes, *notes))
