"""The GraphRQI paper's Argoverse sequences as CSV: ``frame,id,x,y``, metres, 10 Hz assumed.

Coordinates move with the recording vehicle (offset by 1500 m); its motion is taken out, so that
parked cars stand. Labels are read from ``..._labels.csv`` beside ``..._tracks.csv``.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from sim.formats.argo_labels import read_labels
from sim.formats.common.csv_columns import read_columns
from sim.formats.common.ego_motion import remove_ego_motion
from sim.formats.common.packed import beside, plain_name, stem
from sim.formats.common.recording import CARS_ASSUMED, Recording, Rows, recordings
from sim.track_rows import MAX_CELLS

FRAME_RATE_HZ: Final = 10.0
"""Frames per second that are assumed (Argoverse's tracking data has 10)."""


def read(path: Path) -> Iterator[Recording]:
    """Read one file.

    Args:
        path: the CSV file.

    Yields:
        One recording.

    Raises:
        InputError: if the file is broken; the message names file and column or row.
    """
    columns = read_columns(path, ["frame", "x", "y"], ["id"])
    agent, names = columns.names("id")
    time_s = columns.numbers("frame") / FRAME_RATE_HZ
    rows = Rows.of_positions(agent, names, time_s, columns.numbers("x"), columns.numbers("y"))
    labels = beside(path, plain_name(path).replace("_tracks", "_labels"))
    for one in recordings(path, stem(path), rows, max_cells=MAX_CELLS // 2):
        tracks = remove_ego_motion(one.tracks)
        notes = [
            *one.notes,
            "the recording vehicle's motion was estimated from those that stand, and taken out",
            CARS_ASSUMED,
        ]
        if labels is not None:
            found = read_labels(labels)
            known = [found.get(name) for name in tracks.names]
            vague = sum(label is not None and label.behavior is None for label in known)
            notes.append(
                f"{vague} agents are aggressive, but of which class is not known: a style alone"
            )
            yield Recording(one.name, tracks, tuple(notes)).labelled(known)
        else:
            yield Recording(one.name, tracks, tuple(notes))
