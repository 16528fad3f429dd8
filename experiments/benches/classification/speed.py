"""The time from a frame to everyone's posterior."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from typing import Final

import numpy as np

from experiments.benches.classification.recordings import Recordings
from experiments.benches.classification.rows import keys_of
from experiments.score.rows import Row, tidy_row
from graphrqi.stream import BehaviorStream
from sim.frames import Tracks

CROWDS: Final = (100, 1000)
"""Numbers of agents that the time per frame is given for."""


def _crowd(tracks: Tracks, agents: int) -> Tracks:
    """Copies of a recording far from one another: so many are there half-way through it."""
    present = int(tracks.valid[:, tracks.time_s.size // 2].sum())
    copies = -(-agents // max(present, 1))
    stride = int(tracks.ids.max()) + 1
    shift = np.array([10_000.0, 0.0])
    whole = {
        name: np.concatenate([getattr(tracks, name)] * copies)
        for name in ("kind", "length", "width", "heading", "speed", "valid")
    }
    everyone = dataclasses.replace(
        tracks,
        ids=np.concatenate([tracks.ids + c * stride for c in range(copies)]),
        names=tuple(f"{c}/{name}" for c in range(copies) for name in tracks.names),
        xy=np.concatenate([tracks.xy + c * shift for c in range(copies)]),
        behavior=None,
        events=(),
        **whole,
    )
    there = np.flatnonzero(everyone.valid[:, tracks.time_s.size // 2])
    return everyone.part(there[:agents], slice(None))


def speed_rows(
    recordings: Recordings,
    methods: Sequence[str],
    crowds: Sequence[int] = CROWDS,
    frames: int = 100,
) -> list[Row]:
    """Time from a frame to everyone's posterior, features included, ms (median)."""
    rows: list[Row] = []
    for method in methods:
        model, _ = recordings.fitted(method)
        for scenario in recordings.dataset.scenarios:
            entry = recordings.dataset.episodes("test", scenario)[0]
            tracks = recordings.dataset.read(entry).tracks
            for agents in crowds:
                crowd = _crowd(tracks, agents)
                stream, spent = BehaviorStream(model), []
                middle = crowd.time_s.size // 2
                first = max(0, middle - frames)
                for step in range(first, min(middle + frames // 2, crowd.time_s.size)):
                    frame = crowd.frame(step)
                    begin = time.perf_counter()
                    stream.update(frame)
                    spent.append(1000.0 * (time.perf_counter() - begin))
                measured = spent[len(spent) // 2 :]  # the first half warms up
                low, value, high = np.quantile(measured, [0.025, 0.5, 0.975])
                keys = keys_of("speed", scenario, method, None, f"{agents} agents")
                rows.append(tidy_row(keys, "ms_per_frame", value, low, high, len(measured)))
    return rows
