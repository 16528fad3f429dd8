"""Writes the numbers of recorded scenes: ``python -m experiments.recorded_scenes FOLDER``.

The gate learns from them (`experiments.training.recorded_scenes`).
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from experiments.benches.classification.recorded import recordings_of
from experiments.data.admission import admitted
from experiments.data.worlds.sensor import seen_badly
from experiments.training.recorded_scenes import OPEN_DATA, SCENES, scenes_of
from graphrqi.features.relative.observer import SCENE_NAMES
from sim.store.atomic import whole_file

MOST_RECORDINGS: Final = 55
"""Recordings of a place that are used."""

DIGITS: Final = 5
"""Significant digits that are kept."""


def write_scenes(folder: Path, places: Sequence[str], path: Path = SCENES) -> int:
    """Write the scenes of recordings, as they are and through a sensor that is drawn at random.

    Args:
        folder: holds a folder of recordings for each place.
        places: their names.
        path: file to write.

    Returns:
        How many rows were written.

    Raises:
        InputError: if a place has no recordings.
    """
    rng = np.random.default_rng(0)
    rows: list[list[str]] = []
    for place in places:
        found = islice(recordings_of(folder / place, lambda said: None), MOST_RECORDINGS)
        for recording, unit in found:
            tracks = admitted(recording, unit)[0].tracks
            for seen in (tracks, seen_badly(tracks, rng)):
                rows += [[place, *(f"{v:.{DIGITS}g}" for v in scene)] for scene in scenes_of(seen)]
    with whole_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["place", *SCENE_NAMES])
        writer.writerows(rows)
    return len(rows)


if __name__ == "__main__":
    print(write_scenes(Path(sys.argv[1]), OPEN_DATA), "rows")
