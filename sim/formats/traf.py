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
from sim.formats.common.recording import Recording, Rows, recorded
from sim.formats.traf_sheets import labels, sheets_beside
from sim.input_files import opened, stem

FRAME_RATE_HZ: Final = 25.0
"""Frames per second that are assumed (the usual rate of such video; not stated anywhere)."""

HEIGHT_PX: Final = 480
"""Height of the image, pixels."""

MAX_TWINS: Final = 32
"""Most boxes of one id in a frame (the data have up to two): each is compared with each of the
frame before."""


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
    last = -1
    with opened(path) as file:
        for number, line in enumerate(file, 1):
            if not line.strip():
                continue
            where = f"{path}: line {number}"
            try:
                frame, count, *fields = map(int, line.split(b","))
            except ValueError:
                raise InputError(f"{where}: found {line[:40]!r}, expected whole numbers") from None
            if len(fields) != 5 * count:
                raise InputError(
                    f"{where}: found {len(fields)} fields of {count} boxes, expected 5 for each"
                )
            if frame <= last:
                raise InputError(f"{where}: found frame {frame}, expected one after {last}")
            last = frame
            boxes: dict[int, list[_Box]] = {}
            for at in range(0, len(fields), 5):
                x, y, width, height, identity = fields[at : at + 5]
                named = boxes.setdefault(identity, [])
                named.append(_Box(frame, x, y, width, height))
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
    rows = Rows(
        np.repeat(np.arange(len(named)), [len(boxes) for boxes in named.values()]),
        tuple(named),
        np.array([box.frame for box in every]) / frame_rate_hz,
        np.array([box.centre for box in every]),
        sizes=np.array(
            [np.median([[b.width, b.height] for b in boxes], axis=0) for boxes in named.values()]
        ),
        in_metres=False,
    )
    twins = sum(len(own) - 1 for own in tracks.values())
    notes = [
        "lengths are pixels and speeds pixels per second: the format has no scale",
        f"{frame_rate_hz:g} frames per second are assumed; kinds are not in this format",
    ]
    if twins:
        notes.append(f"{twins} boxes had an id that was in use at the time: they got their own")
    recording = recorded(path, stem(path), rows)
    sheets = sheets_beside(path)
    if sheets:
        codes = labels(recording.tracks, sheets, "lenient")
        files = ", ".join(f"{sheet.annotator}{sheet.video}.xlsx" for sheet in sheets)
        known = int((codes >= 0).sum())
        notes.append(f"{known} labels are resolved from the traits in {files}")
        recording = replace(recording, tracks=recording.tracks.with_behavior(codes))
    yield replace(recording, notes=tuple(notes))
