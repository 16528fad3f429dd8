"""Writes the numbers of recorded scenes: ``python -m experiments.recorded_scenes FOLDER``.

The gate learns from them (`experiments.training.recorded_scenes`).
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from experiments.data.admission import admitted
from experiments.data.parallel import all_in_parallel
from experiments.generate.worlds.sensor import seen_badly
from experiments.training.recorded_scenes import OPEN_DATA, SCENES, scene_rows
from graphrqi.features.relative.observer import SCENE_NAMES
from sim.files import whole_file
from sim.formats import FORMATS, formats_in, read_recordings, recording_files
from sim.formats.common.recording import Recording

MOST_RECORDINGS: Final = 55
"""Recordings of a place that are used."""

SENSORS: Final = 8
"""Sensors that are drawn for each recording: with one alone, nearly all noisy recordings of places
that nothing was learned from pass for simulations, with three a half, with eight a third."""

MOST_ROWS: Final = 1000
"""Rows that a place has at most, spread over its recordings and sensors."""

DIGITS: Final = 5
"""Significant digits that are kept."""


def write_scenes(
    folder: Path, places: Sequence[str], path: Path = SCENES, jobs: int | None = None
) -> int:
    """Write the scenes of recordings, as they are and through sensors that are drawn at random.

    Args:
        folder: holds a folder of recordings for each place.
        places: their names.
        path: file to write.
        jobs: processes; None for one per core.

    Returns:
        How many rows were written.

    Raises:
        InputError: if a place has no recordings.
    """
    rows: list[list[str]] = []
    for place in places:
        found = islice(recordings_of(folder / place), MOST_RECORDINGS)
        arguments = [(recording, unit, n) for n, (recording, unit) in enumerate(found)]
        scenes = np.concatenate(all_in_parallel(seen_scenes, arguments, jobs, place, False))
        most = min(len(scenes), MOST_ROWS)
        kept = scenes[np.linspace(0, len(scenes), most, endpoint=False).astype(int)]
        rows += [[place, *(f"{v:.{DIGITS}g}" for v in scene)] for scene in kept]
    with whole_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["place", *SCENE_NAMES])
        writer.writerows(rows)
    return len(rows)


def recordings_of(folder: Path) -> Iterator[tuple[Recording, str]]:
    """Every recording of a folder that can be read, with its format's unit.

    Raises:
        InputError: if there is no file of any format.
    """
    for name in formats_in(folder):
        for file in recording_files(folder, name)[0]:
            with suppress(InputError):  # such as the map of nobody
                for recording in read_recordings(file, name):
                    yield recording, FORMATS[name].unit


def seen_scenes(recording: Recording, unit: str, number: int) -> NDArray[np.float64]:
    """(k, S) numbers of a recording's scenes, first as it is, then sensor by sensor.

    Args:
        recording: as read.
        unit: of its format.
        number: of the recording; the seed of its sensors.
    """
    tracks = admitted(recording, unit)[0].tracks
    rng = np.random.default_rng(number)
    seen = (tracks, *(seen_badly(tracks, rng) for _ in range(SENSORS)))
    return np.concatenate([scene_rows(one) for one in seen])


if __name__ == "__main__":
    print(write_scenes(Path(sys.argv[1]), OPEN_DATA), "rows")
