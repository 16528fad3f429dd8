"""The inputs of the learned predictors: numbers of each driver, and anchor trajectories.

The numbers describe the driver's past, its lane and limit, and leaders and followers on its lane
and beside it. They also describe signals, crossings and yielding points ahead. Inputs that depend
on behaviours are kept apart, so that a predictor can omit them. The anchor trajectories are
rollouts with one step from knot to knot, in each driver's frame.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from graphrqi.arrays import FloatArray
from graphrqi.predict.extrapolation import inertial_distance
from graphrqi.predict.networks import ANCHORS, KNOT_S, KNOTS, TIME_S, PredictorInputs
from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.rollout.car_following import Rollout
from graphrqi.predict.rollout.driver_table import (
    DriverParameters,
    DriverTable,
    expected_parameters,
    parameters_of_each,
)
from graphrqi.predict.rollout.following import agreement, candidates, path_probability
from graphrqi.predict.rollout.rollout import in_own_frame, on_lane_beside, roll, roll_each, steady
from graphrqi.predict.scene.paths import limits
from graphrqi.predict.scene.scene import Scene
from graphrqi.predict.scene.stop_constraints import STOP, STOP_IF_COMFORTABLE
from sim.road.lane_graph import DIRECTIONS

FAR_M = 100.0
"""Distances are cut off here and divided by it."""

PAST_S: Final = tuple(0.5 * i for i in range(1, 10))
"""Ages of the moments of the own past that are described, s."""

AHEAD_S: Final = (0.0, 1.0, 2.0, 3.0, 5.0)
"""Times at which the states of the stop constraints ahead are described, s."""

STOPS: Final = 3
"""Stop constraints ahead that are described."""

NEIGHBORS: Final = 7
"""Neighbours that are described: leader, its leader, follower, and those ahead and behind on the
left and on the right."""

PER_NEIGHBOR: Final = 4
"""Numbers per neighbour: present, nearness, relative speed and acceleration."""

STATE: Final = 13
"""Numbers of the own state."""

PAST: Final = slice(STATE, STATE + 3 * len(PAST_S))
AROUND: Final = slice(PAST.stop, PAST.stop + NEIGHBORS * PER_NEIGHBOR)
"""Places of the own past and of the neighbours among the features."""

FEATURES: Final = AROUND.stop + STOPS * (1 + 2 * len(AHEAD_S)) + 2 + len(DIRECTIONS)
"""Number of features."""


def features_of(scene: Scene) -> FloatArray:
    """(n, FEATURES) all known numbers of each driver but its behaviour."""
    parts = [_own_states(scene), _past(scene), _neighbors(scene), _stops(scene), _way(scene)]
    return np.concatenate(parts, axis=1)


def _own_states(scene: Scene) -> FloatArray:
    """(n, STATE) the driver and its lane."""
    graph, states, on = scene.graph, scene.states, scene.on_path
    speed, lane = scene.history.speed[:, -1], np.maximum(scene.lane, 0)
    limit = np.where(on, limits(graph)[lane], 0.0)
    left_m = np.clip(graph.length[lane] - scene.s, 0.0, FAR_M) / FAR_M
    outside = (states.on_lane < 0) | ~graph.internal[lane]
    columns = [
        speed / 10.0, scene.accel / 3.0, limit / 20.0, speed / np.maximum(limit, 1.0),
        scene.offset / 3.0, scene.lateral_speed, scene.history.length / 10.0, on,
        on & (graph.left[lane] >= 0), on & (graph.right[lane] >= 0),
        np.where(np.isfinite(states.free_factor), states.free_factor, 0.0), states.least_factor,
        np.where(outside, left_m, 0.0),
    ]  # fmt: skip
    return np.stack(columns, axis=1).astype(np.float64)


def _past(scene: Scene) -> FloatArray:
    """(n, 3 PAST_S) what was seen of the own past."""
    history = scene.history
    when = history.time_s[-1] - np.array(PAST_S)
    columns = np.searchsorted(history.time_s, when - 1e-6)
    seen = history.valid[:, columns] & (history.time_s[0] <= when + 1e-6)
    slower = (history.speed[:, columns] - history.speed[:, -1:]) / 5.0
    turned = np.sin(history.heading[:, -1:] - history.heading[:, columns])
    each = np.stack([seen, np.where(seen, slower, 0.0), np.where(seen, turned, 0.0)], axis=2)
    return each.reshape(len(seen), 3 * len(PAST_S))


def _neighbors(scene: Scene) -> FloatArray:
    """(n, NEIGHBORS PER_NEIGHBOR) the neighbours."""
    states, speed, length = scene.states, scene.history.speed[:, -1], scene.history.length
    leader, follower = states.leader, states.follower
    second = np.where(leader >= 0, leader[leader], -1)
    beyond = states.gap + states.gap[leader] + length[leader]
    who = np.column_stack([leader, second, follower, states.adjacent])
    far = np.column_stack([states.gap, beyond, states.gap[follower], states.adjacent_gap])
    near = 1.0 - np.clip(far, -5.0, FAR_M) / FAR_M
    faster = (speed[who] - speed[:, None]) / 10.0
    each = np.stack([np.ones_like(near), near, faster, scene.accel[who] / 3.0], axis=2)
    return np.where(who[..., None] >= 0, each, 0.0).reshape(len(who), NEIGHBORS * PER_NEIGHBOR)


def _stops(scene: Scene) -> FloatArray:
    """(n, STOPS (1 + 2 AHEAD_S)) the next stop constraints up to `FAR_M`, and their states."""
    paths, n = scene.paths, scene.ids.size
    shown = np.minimum(np.round(np.array(AHEAD_S) / STEP_S).astype(np.int64), scene.steps)
    front = scene.s + scene.history.length / 2
    room = paths.stop_x[scene.path] - front[:, None]
    counts = (room > -1.0) & (room < FAR_M) & scene.on_path[:, None]
    place = np.cumsum(counts, axis=1) - 1
    row, at = np.nonzero(counts & (place < STOPS))
    out = np.zeros((n, 1 + 2 * len(AHEAD_S), STOPS))
    out[row, 0, place[row, at]] = 1.0 - np.maximum(room[row, at], 0.0) / FAR_M
    state = scene.stop_state[paths.stop_row[scene.path[row], at]][:, shown]
    both = np.stack([state == STOP, state == STOP_IF_COMFORTABLE], axis=2)
    out[row, 1:, place[row, at]] = both.reshape(row.size, 2 * len(AHEAD_S))
    return out.reshape(n, STOPS * (1 + 2 * len(AHEAD_S)))


def _way(scene: Scene) -> FloatArray:
    """(n, 2 + DIRECTIONS) the next lower limit, and which way the path turns."""
    paths, n, on = scene.paths, scene.ids.size, scene.on_path
    limit, start = paths.limit[scene.path], paths.start[scene.path]
    lower = (limit < limit[:, :1] - 0.1) & np.isfinite(start) & on[:, None]
    row, first = np.arange(n), lower.argmax(axis=1)
    ahead = np.clip(start[row, first] - scene.s, 0.0, FAR_M)
    out = np.zeros((n, 2 + len(DIRECTIONS)))
    some = lower.any(axis=1)
    out[some, 0] = 1.0 - ahead[some] / FAR_M
    out[some, 1] = limit[row, first][some] / 20.0
    out[row[on], 2 + paths.turn[scene.path[on]]] = 1.0
    return out


_COMPARED: Final = [0, 1, 4]
"""The anchor trajectories that networks are given as features too: the two paths and inertia."""


def predictor_inputs(scene: Scene, probability: FloatArray, table: DriverTable) -> PredictorInputs:
    """Inputs for beliefs (n, 6) about the drivers' behaviours, uniform for unknown drivers.

    The anchor trajectories are rollouts along the likeliest path, the second likeliest one, to the
    lanes on the left and on the right, and inertia. Rows of pedestrians are not valid.
    """
    drivers = expected_parameters(scene, probability, table)
    choice, likely = path_probability(scene, drivers)
    order = np.argsort(-likely, axis=1, kind="stable")
    row = np.arange(len(choice))
    first = scene.with_path(choice[row, order[:, 0]])
    likeliest, second_likely = likely[row, order[:, 0]], np.zeros(row.size)
    anchors = np.empty((row.size, ANCHORS, KNOTS, 2))
    main = roll(first, drivers, table.decay_s, KNOTS, KNOT_S)
    anchors[:, :2] = _at_knots(first, main)[:, None]
    if choice.shape[1] > 1:
        second_likely = likely[row, order[:, 1]]
        open_to = second_likely > 1e-3
        second = scene.with_path(choice[row, order[:, 1]])
        driven = roll(second, drivers, table.decay_s, KNOTS, KNOT_S)
        anchors[open_to, 1] = _at_knots(second, driven)[open_to]
    beside = on_lane_beside(first, 1), on_lane_beside(first, -1)
    by_behavior = parameters_of_each(scene, table)
    variants = DriverParameters(
        np.concatenate([drivers.following[None], drivers.following[None], by_behavior.following]),
        np.concatenate([drivers.ignores[None], drivers.ignores[None], by_behavior.ignores]),
    )
    ways = [moving for moving, _ in beside] + [first] * len(by_behavior.following)
    each = roll_each(first, ways, variants, table.decay_s, main)
    seen = in_own_frame(first, each.lane[:2], each.s[:2], each.offset[:2], TIME_S)
    for way, (_, there) in enumerate(beside):
        anchors[:, 2 + way] = np.where(there[:, None, None], seen[way], anchors[:, 0])
    _inertia(scene, anchors[:, 4])
    half = KNOTS // 2 - 1
    ahead = each.travelled[2:, :, [half, -1]] - main.travelled[:, [half, -1]]
    ahead = np.where(scene.on_path[:, None], ahead, 0.0) / (5.0, 10.0)
    inputs = np.concatenate(
        [
            features_of(first),
            _relative(scene, anchors),
            likeliest[:, None],
            second_likely[:, None],
            probability,
            ahead.transpose(1, 0, 2).reshape(row.size, 2 * len(by_behavior.following)),
            agreement(scene, probability, each.asked[2:], table),
        ],
        axis=1,
    )
    return PredictorInputs(inputs, anchors)


def unlabelled_inputs(scene: Scene) -> PredictorInputs:
    """Inputs for a predictor that has neither beliefs nor a driver model.

    The anchor trajectories are the road itself, driven at constant speed: the likeliest path
    (straight on where several are open), the next one, the lanes beside and inertia.
    """
    choice, real = candidates(scene)
    likely = np.where(real, scene.paths.probability[choice], 0.0)
    order = np.argsort(-likely, axis=1, kind="stable")
    row = np.arange(len(choice))
    anchors = np.empty((row.size, ANCHORS, KNOTS, 2))
    first, second = (
        scene.with_path(choice[row, order[:, rank]]) for rank in (0, min(1, choice.shape[1] - 1))
    )
    anchors[:, 0], anchors[:, 1] = (_at_knots(s, steady(s)) for s in (first, second))
    for way, side in enumerate((1, -1)):
        moving, there = on_lane_beside(first, side)
        seen = _at_knots(moving, steady(moving))
        anchors[:, 2 + way] = np.where(there[:, None, None], seen, anchors[:, 0])
    _inertia(scene, anchors[:, 4])
    inputs = np.concatenate([features_of(scene), _relative(scene, anchors)], axis=1)
    return PredictorInputs(inputs, anchors)


def _at_knots(scene: Scene, rollout: Rollout) -> FloatArray:
    """(n, KNOTS, 2) a rollout's positions at the knots, in the drivers' frames, m."""
    every = round(KNOT_S / rollout.step_s)
    at = slice(every - 1, every * KNOTS, every)
    lane, s, offset = rollout.lane[:, at], rollout.s[:, at], rollout.offset[:, at]
    return in_own_frame(scene, lane, s, offset, TIME_S)


def _inertia(scene: Scene, out: FloatArray) -> None:
    """Write (n, KNOTS, 2) positions straight on at constant acceleration, m."""
    out[..., 0] = inertial_distance(scene.speed[:, None], scene.accel[:, None], TIME_S)
    out[..., 1] = 0.0


def _relative(scene: Scene, anchors: FloatArray) -> FloatArray:
    """(n, 3 KNOTS 2) the two paths and inertia against constant velocity, tens of metres."""
    out = anchors[:, _COMPARED]
    out[..., 0] -= scene.speed[:, None, None] * TIME_S
    out /= 10.0
    return out.reshape(len(out), 2 * KNOTS * len(_COMPARED))
