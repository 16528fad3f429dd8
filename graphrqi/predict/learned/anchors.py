"""The rollouts that learned predictors start from, seen from each driver's own place.

Everything is in the driver's frame: origin where it is, x along its heading, in metres, at the
knots 0.5, 1, ..., 5 s. The rollouts that networks correct take one step from knot to knot: on
simulated episodes they come as near to what happens as those with finer steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.constant import inertial_distance
from graphrqi.predict.learned import anchors_kernel
from graphrqi.predict.learned.features import features
from graphrqi.predict.rollout.agreement import agreement
from graphrqi.predict.rollout.driver_parameters import believed, if_each
from graphrqi.predict.rollout.driver_table import DriverTable
from graphrqi.predict.rollout.rollout import Rollout, beside, from_own_seat, roll, roll_each, steady
from graphrqi.predict.rollout.route import candidates, path_probability
from graphrqi.predict.scene.scene import Scene

FloatArray = NDArray[np.float64]

KNOT_S: Final = 0.5
"""Time between knots, s."""

KNOTS: Final = 10
"""How many: up to 5 s."""

BASES: Final = ("likeliest way", "second way", "lane to the left", "lane to the right", "inertia")
"""What each base is."""

TIME_S: Final[FloatArray] = np.arange(1, KNOTS + 1, dtype=np.float64) * KNOT_S
"""(KNOTS,) s."""


_COMPARED: Final = np.array([0, 1, 4])
"""The bases that networks see as numbers too: the two ways and inertia."""


@dataclass(frozen=True, slots=True, eq=False)
class PredictorInputs:
    """Inputs of a learned predictor.

    Attributes:
        inputs: (n, F) numbers.
        bases: (n, B, KNOTS, 2) rollouts in the driver's frame, m.
    """

    inputs: FloatArray
    bases: FloatArray


def to_own_frame(scene: Scene, xy: FloatArray) -> FloatArray:
    """Places (n, ..., 2) as seen by each driver, m."""
    extra = (1,) * (xy.ndim - 2)
    cos = np.cos(scene.heading).reshape(-1, *extra)
    sin = np.sin(scene.heading).reshape(-1, *extra)
    gone = xy - scene.xy.reshape(-1, *extra, 2)
    forward = gone[..., 0] * cos + gone[..., 1] * sin
    return np.stack([forward, gone[..., 1] * cos - gone[..., 0] * sin], axis=-1)


def known(scene: Scene, probability: FloatArray, table: DriverTable) -> PredictorInputs:
    """Inputs and bases for beliefs (n, 6) about who drives how.

    Args:
        scene: the present.
        probability: (n, 6) beliefs; uniform rows for drivers of whom nothing is known.
        table: calibrated driver numbers.

    Returns:
        The inputs of every agent of the scene; those of pedestrians mean nothing.
    """
    manners = believed(scene, probability, table)
    choice, likely = path_probability(scene, manners)
    order = np.argsort(-likely, axis=1, kind="stable")
    row = np.arange(len(choice))
    first = scene.with_path(choice[row, order[:, 0]])
    likeliest, second_likely = likely[row, order[:, 0]], np.zeros(row.size)
    bases = np.empty((row.size, len(BASES), KNOTS, 2))
    main = roll(first, manners, table.decay_s, None, KNOTS, KNOT_S)
    bases[:, :2] = _at_knots(first, main)[:, None]
    if choice.shape[1] > 1:
        second_likely = likely[row, order[:, 1]]
        open_to = second_likely > 1e-3
        second = scene.with_path(choice[row, order[:, 1]])
        driven = roll(second, manners, table.decay_s, None, KNOTS, KNOT_S)
        bases[open_to, 1] = _at_knots(second, driven)[open_to]
    ways = beside(first, 1), beside(first, -1)
    following, ignores = if_each(scene, table)
    path, offset, sideways = (
        np.concatenate([getattr(way, name)[None] for way in drives])
        for drives in ([moving for moving, _ in ways] + [first] * len(following),)
        for name in ("path", "offset", "sideways")
    )
    each = roll_each(
        first, path, offset, sideways,
        np.concatenate([manners.following[None], manners.following[None], following]),
        np.concatenate([manners.ignores[None], manners.ignores[None], ignores]),
        table.decay_s,
        main,
    )  # fmt: skip
    for way, (_, there) in enumerate(ways):
        seen = from_own_seat(first, each.lane[way], each.s[way], each.side[way], 1, KNOT_S)
        bases[:, 2 + way] = np.where(there[:, None, None], seen, bases[:, 0])
    _inertia(scene, bases[:, 4])
    half = KNOTS // 2 - 1
    ahead = each.gone[2:, :, [half, -1]] - main.gone[:, [half, -1]]
    ahead = np.where(scene.on_path[:, None], ahead, 0.0) / (5.0, 10.0)
    inputs = np.concatenate(
        [
            features(first),
            _relative(scene, bases),
            likeliest[:, None],
            second_likely[:, None],
            probability,
            ahead.transpose(1, 0, 2).reshape(row.size, 2 * len(following)),
            agreement(scene, probability, each.asked[2:], table),
        ],
        axis=1,
    )
    return PredictorInputs(inputs, bases)


def unlabelled(scene: Scene) -> PredictorInputs:
    """Inputs and bases for a predictor that has neither beliefs nor a driver model.

    The bases are the road itself, driven at constant speed: the likeliest way (straight on where
    several are open), the next one, the lanes beside and inertia.

    Args:
        scene: the present.

    Returns:
        The same features of road, past, neighbours, signals and pedestrians as `known` has.
    """
    choice, real = candidates(scene)
    table = scene.paths
    likely = np.where(real, table.probability[choice], 0.0)
    order = np.argsort(-likely, axis=1, kind="stable")
    row = np.arange(len(choice))
    bases = np.empty((row.size, len(BASES), KNOTS, 2))
    first, second = (
        scene.with_path(choice[row, order[:, rank]]) for rank in (0, min(1, choice.shape[1] - 1))
    )
    bases[:, 0], bases[:, 1] = (_at_knots(s, steady(s)) for s in (first, second))
    for way, side in enumerate((1, -1)):
        moving, there = beside(first, side)
        seen = _at_knots(moving, steady(moving))
        bases[:, 2 + way] = np.where(there[:, None, None], seen, bases[:, 0])
    _inertia(scene, bases[:, 4])
    inputs = np.concatenate([features(scene), _relative(scene, bases)], axis=1)
    return PredictorInputs(inputs, bases)


def _at_knots(scene: Scene, rollout: Rollout) -> FloatArray:
    """(n, KNOTS, 2) a rollout's places at the knots, in the drivers' frames, m."""
    every = round(KNOT_S / rollout.step_s)
    return from_own_seat(scene, rollout.lane, rollout.s, rollout.side, every, rollout.step_s)


def _inertia(scene: Scene, out: FloatArray) -> None:
    """Write (n, KNOTS, 2) everyone straight on at constant acceleration, m."""
    out[..., 0] = inertial_distance(scene.speed[:, None], scene.accel[:, None], TIME_S)
    out[..., 1] = 0.0


def _relative(scene: Scene, bases: FloatArray) -> FloatArray:
    """(n, 3 KNOTS 2) the two ways and inertia against constant velocity, tens of metres."""
    return np.asarray(anchors_kernel.relative(bases, _COMPARED, scene.speed, TIME_S, 10.0))
