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
from sim.road.lane_graph import DIRECTIONS

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
    from graphrqi.predict.learned.describe import describe

    history, graph, states, paths = scene.history, scene.graph, scene.states, scene.paths
    when = history.time_s[-1] - np.array((0.0, *PAST_S))
    columns = np.searchsorted(history.time_s, when - 1e-6)
    seen = history.valid[:, columns] & (history.time_s[0] <= when + 1e-6)
    shown = np.minimum(np.round(np.array(AHEAD_S) / STEP_S).astype(np.int64), scene.steps)
    out = np.zeros((scene.ids.size, FEATURES))
    describe(
        (seen, history.speed[:, columns], history.heading[:, columns], history.length.copy()),
        (scene.on_path, scene.lane, scene.s, scene.offset, scene.lateral_speed, scene.accel),
        (states.free_factor, states.least_factor, states.on_lane),
        (states.leader, states.gap, states.follower, states.adjacent, states.adjacent_gap),
        (graph.left, graph.right, graph.internal, graph.length, limits(graph)),
        (scene.path, paths.limit, paths.start, paths.turn, paths.stop_x, paths.stop_row),
        scene.stop_state[:, shown], (PAST.start, AROUND.start, AROUND.stop), STOPS, out,
    )  # fmt: skip
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
