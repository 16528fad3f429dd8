"""The inputs of the learned predictors: features and anchor trajectories, in each driver's frame.

The anchor trajectories are rollouts with one step from knot to knot.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from graphrqi.arrays import FloatArray
from graphrqi.predict.extrapolation import inertial_distance
from graphrqi.predict.learned.features import features
from graphrqi.predict.networks.futures import ANCHORS, KNOT_S, KNOTS, TIME_S, PredictorInputs
from graphrqi.predict.rollout.agreement import agreement
from graphrqi.predict.rollout.driver_table import (
    DriverTable,
    expected_parameters,
    parameters_of_each,
)
from graphrqi.predict.rollout.rollout import (
    Rollout,
    in_own_frame,
    on_lane_beside,
    roll,
    roll_each,
    steady,
)
from graphrqi.predict.rollout.route import candidates, path_probability
from graphrqi.predict.scene.scene import Scene

_COMPARED: Final = [0, 1, 4]
"""The anchor trajectories that networks are given as features too: the two paths and inertia."""


def predictor_inputs(scene: Scene, probability: FloatArray, table: DriverTable) -> PredictorInputs:
    """Inputs for beliefs (n, 6) about the drivers' behaviours.

    The anchor trajectories are rollouts along the likeliest path, the second likeliest one, to the
    lanes on the left and on the right, and inertia.

    Args:
        scene: the present.
        probability: (n, 6) beliefs; uniform rows for unknown drivers.
        table: calibrated driver parameters.

    Returns:
        The inputs of every agent of the scene; rows of pedestrians are not valid.
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
    following, ignores = parameters_of_each(scene, table)
    each = roll_each(
        first,
        [moving for moving, _ in beside] + [first] * len(following),
        np.concatenate([drivers.following[None], drivers.following[None], following]),
        np.concatenate([drivers.ignores[None], drivers.ignores[None], ignores]),
        table.decay_s,
        main,
    )
    for way, (_, there) in enumerate(beside):
        seen = in_own_frame(first, each.lane[way], each.s[way], each.offset[way], 1, KNOT_S)
        anchors[:, 2 + way] = np.where(there[:, None, None], seen, anchors[:, 0])
    _inertia(scene, anchors[:, 4])
    half = KNOTS // 2 - 1
    ahead = each.travelled[2:, :, [half, -1]] - main.travelled[:, [half, -1]]
    ahead = np.where(scene.on_path[:, None], ahead, 0.0) / (5.0, 10.0)
    inputs = np.concatenate(
        [
            features(first),
            _relative(scene, anchors),
            likeliest[:, None],
            second_likely[:, None],
            probability,
            ahead.transpose(1, 0, 2).reshape(row.size, 2 * len(following)),
            agreement(scene, probability, each.asked[2:], table),
        ],
        axis=1,
    )
    return PredictorInputs(inputs, anchors)


def unlabelled_inputs(scene: Scene) -> PredictorInputs:
    """Inputs for a predictor that has neither beliefs nor a driver model.

    The anchor trajectories are the road itself, driven at constant speed: the likeliest path
    (straight on where several are open), the next one, the lanes beside and inertia.

    Args:
        scene: the present.

    Returns:
        The same features of road, past, neighbours, signals and pedestrians as `predictor_inputs`.
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
    inputs = np.concatenate([features(scene), _relative(scene, anchors)], axis=1)
    return PredictorInputs(inputs, anchors)


def _at_knots(scene: Scene, rollout: Rollout) -> FloatArray:
    """(n, KNOTS, 2) a rollout's positions at the knots, in the drivers' frames, m."""
    every = round(KNOT_S / rollout.step_s)
    knots = in_own_frame(scene, rollout.lane, rollout.s, rollout.offset, every, rollout.step_s)
    return knots[:, :KNOTS]


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
