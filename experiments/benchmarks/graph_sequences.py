"""Sequences of traffic graphs to measure on: vehicles at constant speed, by a formula."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, cast

import numpy as np

from graphrqi.graph import TrafficGraph
from sim.frames import FloatArray

LAYOUTS: Final = ("road", "crossing")
"""Where the vehicles are."""

STEP_S: Final = 0.1
"""Time between observations, s."""


def graph_sequence(
    layout: str, kind: str, d: int, steps: int, skip: int = 0, seed: int = 0
) -> Iterator[TrafficGraph]:
    """Traffic graphs of d vehicles every 0.1 s, four neighbours, reset at 100.

    Args:
        layout: "road" (one way, three lanes, 20 m apart per lane on average, 25 m/s) or "crossing"
            (four arms of three lanes, 12 m apart, three in ten standing).
        kind: "instantaneous" or "accumulated".
        d: vehicles.
        steps: graphs wanted.
        skip: observations before the first of them.
        seed: of the places and speeds.

    Yields:
        The graphs.
    """
    graph = TrafficGraph.empty(neighbors=4, reset=100, kind=cast(Any, kind))
    for step, xy in enumerate(_positions(layout, d, skip + steps, seed)):
        graph = graph.observe(np.arange(d), xy)
        if step >= skip:
            yield graph


def _positions(layout: str, d: int, steps: int, seed: int) -> Iterator[FloatArray]:
    """(d, 2) positions of each step, m."""
    rng = np.random.default_rng(seed)
    lane = 3.5 * rng.integers(0, 3, d)
    if layout == "road":
        along, speed, turn = rng.random(d) * d / 3 * 20.0, rng.normal(25.0, 3.0, d), np.zeros(d)
    else:
        reach = d / 12 * 12.0 + 30.0
        along = rng.random(d) * 2 * reach - reach
        speed = rng.normal(10.0, 3.0, d) * (rng.random(d) < 0.7)
        turn = rng.integers(0, 4, d) * np.pi / 2
        lane += 1.75
    ahead = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    right = np.stack([np.sin(turn), -np.cos(turn)], axis=1)
    for _ in range(steps):
        xy = along[:, None] * ahead + lane[:, None] * right
        yield xy + rng.normal(0.0, 0.05, xy.shape)
        along = along + speed * STEP_S
