"""What the learned predictors know of each driver, as numbers.

The same sources as the rollouts use: the driver's own past, its lane and limit, leaders and
followers on its lane and beside it, signals, crossings and yielding places ahead. Whatever depends
on who drives how (beliefs, rollouts with their numbers) is kept apart, so that a predictor can do
without it.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.learned import features_kernel
from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.scene.paths import limits
from graphrqi.predict.scene.scene import Scene
from sim.road.lane_graph import DIRECTIONS

FloatArray = NDArray[np.float64]

PAST_S: Final = tuple(0.5 * i for i in range(1, 10))
"""How long ago the own past is looked at, s."""

AHEAD_S: Final = (0.0, 1.0, 2.0, 3.0, 5.0)
"""When the gates ahead are looked at, s."""

GATES: Final = 3
"""How many gates ahead are looked at."""

NEIGHBORS: Final = 7
"""How many neighbours are looked at: leader, its leader, follower, and those ahead and behind on
the left and on the right."""

PER_NEIGHBOR: Final = 4
"""Numbers per neighbour: present, nearness, relative speed and acceleration."""

STATE: Final = 13
"""Numbers of the own state."""

PAST: Final = slice(STATE, STATE + 3 * len(PAST_S))
AROUND: Final = slice(PAST.stop, PAST.stop + NEIGHBORS * PER_NEIGHBOR)
"""Where the own past and the neighbours stand among the features."""

FEATURES: Final = AROUND.stop + GATES * (1 + 2 * len(AHEAD_S)) + 2 + len(DIRECTIONS)
"""How many there are."""


def features(scene: Scene) -> FloatArray:
    """(n, FEATURES) everything that can be known of each driver without knowing how it drives.

    In this order: speed, acceleration, limit, place on the lane, lanes beside, wishes seen so far;
    at each time of `PAST_S` whether it was seen, speed then less now, turned since; the neighbours;
    nearness and states to come of the next gates on the path; nearness and size of the next lower
    limit, and which way the path turns.
    """
    history, seen, paths, graph = scene.history, scene.seen, scene.paths, scene.graph
    when = history.time_s[-1] - np.array(PAST_S)
    past = np.searchsorted(history.time_s, when - 1e-6)
    past[history.time_s[0] > when + 1e-6] = -1
    shown = np.minimum(np.round(np.array(AHEAD_S) / STEP_S).astype(np.int64), scene.steps)
    valid, speed, heading = (
        np.ascontiguousarray(x) for x in (history.valid, history.speed, history.heading)
    )
    length = history.length.copy()  # what is read-only only sometimes is compiled for twice
    out = np.zeros((scene.ids.size, FEATURES))
    features_kernel.describe(
        valid, speed, heading, length,
        past, scene.on_path,
        scene.lane, scene.s, scene.offset, scene.sideways, scene.accel, seen.free_factor,
        seen.least_factor, seen.place, seen.leader, seen.gap, seen.follower, seen.beside,
        seen.beside_gap, scene.path, scene.closed, shown, GATES, paths.gate_x, paths.gate_row,
        paths.limit, paths.start, paths.turn, limits(graph), graph.length, graph.internal,
        graph.left, graph.right, out,
    )  # fmt: skip
    return out
