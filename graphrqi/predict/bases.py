"""The rollouts that learned predictors start from, seen from each driver's own place.

Everything is in the driver's frame: origin where it is, x along its heading, in metres, at the
knots 0.5, 1, ..., 5 s.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.constant import by_inertia
from graphrqi.predict.drivers import DriverTable
from graphrqi.predict.features import features
from graphrqi.predict.manners import Manners, believed
from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.rollout import Rollout, beside, places, roll, steady
from graphrqi.predict.route import candidates, path_probability
from graphrqi.predict.scene import Scene

FloatArray = NDArray[np.float64]

KNOT_S: Final = 0.5
"""Time between knots, s."""

KNOTS: Final = 10
"""How many: up to 5 s."""

COARSE_S, COARSE_STEPS = 0.25, 20
"""Step of the rollouts that networks correct, s, and how many: two to a knot (our choice: finer
ones take longer and are corrected to the same)."""

BASES: Final = ("likeliest way", "second way", "lane to the left", "lane to the right", "inertia")
"""What each base is."""


@dataclass(frozen=True, slots=True, eq=False)
class Known:
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


def at_knots(xy: FloatArray, step_s: float = STEP_S) -> FloatArray:
    """Places at every step as places at the knots; the last place stands in for missing ones."""
    every = round(KNOT_S / step_s)
    columns = np.minimum(np.arange(1, KNOTS + 1) * every - 1, xy.shape[-2] - 1)
    return np.asarray(xy[..., columns, :])


def known(scene: Scene, probability: FloatArray, table: DriverTable) -> Known:
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

    def drive(scene: Scene, manners: Manners = manners, others: Rollout | None = None) -> Rollout:
        return roll(scene, manners, table.decay_s, others, COARSE_STEPS, COARSE_S)

    rollout = drive(first)
    main = _seen(scene, first, rollout)
    bases = [main]
    second_likely = np.zeros(row.size)
    if choice.shape[1] > 1:
        second = scene.with_path(choice[row, order[:, 1]])
        second_likely = likely[row, order[:, 1]]
        bases.append(_seen(scene, second, drive(second)))
        bases[1] = np.where((second_likely > 1e-3)[:, None, None], bases[1], main)
    else:
        bases.append(main)
    kept = dataclasses.replace(manners, changing=np.empty((0, manners.changing.shape[1])))
    bases += _beside(first, main, lambda moving: drive(moving, kept, rollout))
    inertia = by_inertia(scene)
    bases.append(to_own_frame(scene, at_knots(inertia)))
    stack = np.stack(bases, axis=1)
    straight = scene.speed[:, None] * np.arange(1, KNOTS + 1) * KNOT_S
    relative = stack[:, [0, 1, 4]].copy()
    relative[..., 0] -= straight[:, None]
    inputs = np.concatenate(
        [
            features(first),
            relative.reshape(row.size, 3 * KNOTS * 2) / 10.0,
            np.stack([likely[row, order[:, 0]], second_likely], axis=1),
            probability,
            _by_behavior(first, rollout, table, drive),
        ],
        axis=1,
    )
    return Known(inputs, stack)


def unlabelled(scene: Scene) -> Known:
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
    first, second = (
        scene.with_path(choice[row, order[:, rank]]) for rank in (0, min(1, choice.shape[1] - 1))
    )
    bases = [_seen(scene, s, steady(s)) for s in (first, second)]
    bases += _beside(first, bases[0], steady)
    bases.append(to_own_frame(scene, at_knots(by_inertia(scene))))
    stack = np.stack(bases, axis=1)
    straight = scene.speed[:, None] * np.arange(1, KNOTS + 1) * KNOT_S
    relative = stack[:, [0, 1, 4]].copy()
    relative[..., 0] -= straight[:, None]
    inputs = np.concatenate(
        [features(scene), relative.reshape(row.size, 3 * KNOTS * 2) / 10.0], axis=1
    )
    return Known(inputs, stack)


def _beside(scene: Scene, main: FloatArray, drive: Callable[[Scene], Rollout]) -> list[FloatArray]:
    """Everyone driven on after moving to the lane on the left and on the right, where one is.

    Args:
        scene: everyone on its likeliest way.
        main: (n, KNOTS, 2) the rollout there, m: taken where there is no such lane.
        drive: drives a scene on.
    """
    found = []
    for side in (1, -1):
        moving, there = beside(scene, side)
        moved = _seen(scene, moving, drive(moving))
        found.append(np.where(there[:, None, None], moved, main))
    return found


def _seen(scene: Scene, driven: Scene, rollout: Rollout) -> FloatArray:
    """(n, KNOTS, 2) a rollout's places at the knots, in the drivers' frames, m."""
    return to_own_frame(scene, at_knots(places(driven, rollout), rollout.step_s))


def _by_behavior(
    scene: Scene, others: Rollout, table: DriverTable, drive: Callable[..., Rollout]
) -> FloatArray:
    """(n, 12) how far each behaviour would go in half and all of the time, beyond the expected."""
    half = COARSE_STEPS // 2 - 1
    parts = []
    for code in range(len(table.behavior)):
        probability = np.zeros((scene.ids.size, len(table.behavior)))
        probability[:, code] = 1.0
        result = drive(scene, believed(scene, probability, table), others)
        ahead = np.where(scene.on_path[:, None], result.gone - others.gone, 0.0)
        parts += [ahead[:, half] / 5.0, ahead[:, -1] / 10.0]
    return np.stack(parts, axis=1)
