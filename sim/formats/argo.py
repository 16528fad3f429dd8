"""The GraphRQI paper's Argoverse sequences as CSV: ``frame,id,x,y``, metres, 10 Hz assumed.

Coordinates move with the recording vehicle (offset by 1500 m); its motion is taken out, so that
parked cars stand. Labels, ``id,code``, are in ``..._labels.csv`` beside ``..._tracks.csv``. Codes
3, 4 and 5 are careful, timid and cautious. Codes 0, 1 and 2 are the aggressive classes, but the
release does not say which is which, so nothing but the style of such agents is known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import Behavior, Style
from sim.formats.common.label_file import DriverLabel
from sim.formats.common.recording import CARS_ASSUMED, Recording, recorded, with_motion
from sim.formats.common.tables import read_columns, read_table, rows_of, words_in
from sim.frames import FloatArray, Tracks
from sim.input_files import beside, plain_name, stem

FRAME_RATE_HZ: Final = 10.0
"""Frames per second that are assumed (Argoverse's tracking data has 10)."""

CODES: Final[dict[int, DriverLabel]] = {
    **{code: DriverLabel(Style.AGGRESSIVE) for code in (0, 1, 2)},
    3: DriverLabel(Style.CONSERVATIVE, Behavior.CAREFUL),
    4: DriverLabel(Style.CONSERVATIVE, Behavior.TIMID),
    5: DriverLabel(Style.CONSERVATIVE, Behavior.CAUTIOUS),
}
"""The label of each code."""

ROUNDS: Final = 10
"""Fits per pair of frames (the kept agents stop changing after a few)."""

MIN_AGENTS: Final = 3
"""Agents needed for a fit; with fewer, the last motion is assumed to go on."""


def read(path: Path) -> Iterator[Recording]:
    """The recording of one file, with the labels beside it."""
    columns = {"id": "id", "t": "frame", "x": "x", "y": "y"}
    rows = rows_of(read_columns(path, columns), columns)
    rows["t"] /= FRAME_RATE_HZ
    notes = [
        "the recording vehicle's motion was estimated from those that stand, and taken out",
        CARS_ASSUMED,
    ]
    recording = recorded(stem(path), rows, notes)
    recording = replace(recording, tracks=remove_ego_motion(recording.tracks))
    file = beside(path, plain_name(path).replace("_tracks", "_labels"))
    if file is not None:
        labels = read_labels(file)
        known = [labels.get(name) for name in recording.tracks.names]
        vague = sum(label is not None and label.behavior is None for label in known)
        note = f"{vague} agents are aggressive, but of which class is not known: a style alone"
        recording = replace(recording, notes=(*notes, note)).labelled(known)
    yield recording


def read_labels(path: Path) -> dict[str, DriverLabel]:
    """Labels by the source's own agent ids, from ``argo<k>_labels.csv``."""
    table = read_table(path, ("code",), ("id",))
    found: dict[str, DriverLabel] = {}
    for name, code in zip(words_in(table["id"]), table["code"].tolist(), strict=True):
        if name is None or name in found or code not in CODES:
            raise InputError(
                f"{path}: agent {name}: found code {code:g}, expected 0 to 5 and each agent once"
            )
        found[name] = CODES[int(code)]
    return found


def _rigid_motion(before: FloatArray, after: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rotation and shift that most of (n, 2) points follow from one frame to the next.

    ``after @ rotation.T + shift`` is near ``before`` for at least half of the points.
    """
    rotation = np.eye(2)
    shift = np.median(before - after, axis=0)
    for _ in range(ROUNDS):
        missed = np.hypot(*(after @ rotation.T + shift - before).T)
        kept = missed <= np.median(missed) + 1e-9
        source, target = after[kept], before[kept]
        middle, aim = source.mean(axis=0), target.mean(axis=0)
        u, _, vt = np.linalg.svd((source - middle).T @ (target - aim))
        flip = np.diag([1.0, np.sign(np.linalg.det(vt.T @ u.T))])
        rotation = vt.T @ flip @ u.T
        shift = aim - rotation @ middle
    return rotation, shift


def remove_ego_motion(tracks: Tracks) -> Tracks:
    """Bring tracks seen from a moving vehicle into the frame of the first instant.

    Headings and speeds are computed from the motion.
    """
    agent, seen, xy = tracks.index.agent, tracks.row_xy, tracks.row_xy.copy()
    rotation, shift = np.eye(2), np.zeros(2)
    turn, step = np.eye(2), np.zeros(2)
    for t in range(1, tracks.time_s.size):
        before, here = tracks.index.at(t - 1), tracks.index.at(t)
        _, one, other = np.intersect1d(agent[before], agent[here], return_indices=True)
        if one.size >= MIN_AGENTS:
            turn, step = _rigid_motion(seen[before[one]], seen[here[other]])
        shift = rotation @ step + shift
        rotation = rotation @ turn
        xy[here] = seen[here] @ rotation.T + shift
    return with_motion(replace(tracks, row_xy=xy))
