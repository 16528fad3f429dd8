"""Numbers of recorded scenes, from which the gate learns to tell people from simulations.

They are few enough to be kept beside the code, so that models are trained without the recordings;
`experiments.recorded_scenes` writes them anew, from the recordings that `OPEN_DATA` names. No
recording and no driver can be found in them: they are averages over everyone in a scene
(`graphrqi.features.relative.observer.SCENE_NAMES`).
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.features.relative.observer import SCENE_NAMES, UNKNOWN_SCENE, RelativeObserver
from sim.frames import Tracks

FloatArray = NDArray[np.float64]

OPEN_DATA: Final = ("ngsim_us101", "ngsim_lankershim", "ngsim_peachtree", "sind_tianjin")
"""Recordings whose licence lets weights be shipped: NGSIM (US government, open) and SinD (CC0)."""

SCENES: Final = Path(__file__).with_name("recorded_scenes.csv")
"""File of the scenes: a row per scene and moment, with its place."""

FIRST_S, EVERY_S, LONGEST_S = 3.0, 4.0, 240.0
"""Time of a recording's first row, between rows, and of the last one, s."""


def scenes_of(tracks: Tracks) -> Iterator[FloatArray]:
    """Numbers (S,) of the scene of a recording, at one moment after another."""
    observer, due_s = RelativeObserver(), FIRST_S
    for frame in tracks.frames():
        since_s = frame.time_s - float(tracks.time_s[0])
        if since_s > LONGEST_S:
            return
        observer.update(frame.time_s, frame.ids, frame.xy, frame.driving)
        if since_s >= due_s - 1e-6 and frame.driving.any():
            due_s = since_s + EVERY_S
            yield np.nan_to_num(observer.scene(), nan=UNKNOWN_SCENE)


def scene_rows(tracks: Tracks) -> FloatArray:
    """(k, S) what `scenes_of` gives, one row a moment; there may be none."""
    return np.array(list(scenes_of(tracks))).reshape(-1, len(SCENE_NAMES))


def read_scenes(path: Path = SCENES) -> FloatArray:
    """Numbers of recorded scenes, as many of each place.

    Args:
        path: file as from `experiments.recorded_scenes.write_scenes`.

    Returns:
        (r, S) rows; those of places with few rows are repeated.

    Raises:
        InputError: if the columns are not those of this version.
    """
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    if header != ["place", *SCENE_NAMES]:
        raise InputError(f"{path}: found columns {header}, expected place and {SCENE_NAMES}")
    place = np.array([row[0] for row in rows])
    numbers = np.array([row[1:] for row in rows], dtype=np.float64)
    parts = [numbers[place == name] for name in np.unique(place)]
    most = max(len(part) for part in parts)
    return np.concatenate([np.resize(part, (most, numbers.shape[1])) for part in parts])
