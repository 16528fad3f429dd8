"""Predictors that drive everyone on by a car-following law: blind, and knowing who drives how."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.posterior import Posterior
from graphrqi.predict.drivers import RUNS_RED, YIELDS, DriverTable, default_table
from graphrqi.predict.paths import PathTable
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.rollout import places, roll
from graphrqi.predict.route import on_likely_paths
from graphrqi.predict.scene import Scene
from sim.frames import PEDESTRIAN
from sim.lane_graph import LaneGraph

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

FREE_WEIGHT: Final = 0.1
"""Weight of what a driver's behaviour says of its wished speed against seeing it drive freely (our
choice: within a behaviour wishes differ by 15 %, a driver's own by little)."""


def blind(scene: Scene, posterior: Posterior) -> Prediction:
    """Everyone drives as the average driver does."""
    return blind_with(scene, default_table())


def aware(scene: Scene, posterior: Posterior) -> Prediction:
    """Everyone drives by the numbers expected of its behaviour.

    The numbers are the posterior's expectation over the behaviours' calibrated ones, not those of
    the most likely behaviour alone: with a classifier that is often wrong, the latter loses what
    knowing the behaviour gains. Who is unknown yet drives as the mean of all behaviours.
    """
    return aware_with(scene, posterior.of(scene.ids), default_table())


def blind_with(scene: Scene, table: DriverTable) -> Prediction:
    """`blind` with the given numbers."""
    driver = np.broadcast_to(table.average, (scene.ids.size, table.average.size))
    return _driven(scene, personal(scene, driver), None, table.average_decay_s)


def aware_with(scene: Scene, probability: FloatArray, table: DriverTable) -> Prediction:
    """`aware` with the given numbers and (n, 6) beliefs."""
    driver = personal(scene, table.expected(probability))
    return _driven(scene, driver, ignored_gates(scene, probability), table.decay_s)


def _driven(
    scene: Scene, driver: FloatArray, ignores: BoolArray | None, decay_s: float
) -> Prediction:
    """Everyone driven on along its most likely way."""
    routed = on_likely_paths(scene, driver, ignores)
    return scene.predicted(places(routed, roll(routed, driver, ignores, decay_s)))


def ignored_gates(scene: Scene, probability: FloatArray) -> BoolArray:
    """(n, R) gates that each driver more likely runs than respects, under (n, 6) beliefs."""
    groups = PathTable.of(scene.road).groups
    crossings = groups + LaneGraph.of(scene.road).cross_lane.size
    ignores = np.zeros((scene.ids.size, scene.closed.shape[0]), dtype=np.bool_)
    ignores[:, :groups] = (probability @ RUNS_RED > 0.5)[:, None]
    ignores[:, groups:crossings] = (probability @ YIELDS < 0.5)[:, None]
    return ignores


def personal(scene: Scene, driver: FloatArray) -> FloatArray:
    """Driver numbers with each one's wished speed corrected by what it was seen to drive."""
    wished = np.log(driver[:, 0])
    seen = ~np.isnan(scene.free_factor)
    wished[seen] = (
        FREE_WEIGHT * wished[seen] + np.log(np.maximum(scene.free_factor[seen], 0.1))
    ) / (1.0 + FREE_WEIGHT)
    out = driver.copy()
    out[:, 0] = np.maximum(np.exp(wished), scene.least_factor)
    return out


def oracle(scene: Scene, posterior: Posterior) -> Prediction:
    """`aware` knowing every driver's true behaviour: what perfect classification would give.

    Raises:
        InputError: if the history carries no labels.
    """
    return aware_with(scene, true_behavior(scene), default_table())


def true_behavior(scene: Scene) -> FloatArray:
    """(n, 6) beliefs of one who knows the true behaviours; uniform for those that have none.

    Raises:
        InputError: if the history carries no labels.
    """
    behavior = scene.history.behavior
    if behavior is None:
        raise InputError("oracle: found a history without behaviours, expected labelled tracks")
    code = behavior.astype(np.int64)
    sure = np.full((code.size, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))
    sure[code >= 0] = np.eye(len(BEHAVIORS))[code[code >= 0]]
    return sure


def shuffled(scene: Scene, posterior: Posterior) -> Prediction:
    """`aware` with the beliefs dealt out to the wrong drivers: what wrong labels cost."""
    return aware(scene, shuffled_posterior(scene, posterior))


def shuffled_posterior(scene: Scene, posterior: Posterior) -> Posterior:
    """The beliefs about the drivers of a scene, each given to another one.

    Who gets whose is the same whenever the same agents are present.
    """
    drives = np.flatnonzero(scene.history.kind != PEDESTRIAN)
    probability = posterior.of(scene.ids)
    rng = np.random.default_rng([int(i) & 0xFFFFFFFF for i in scene.ids[drives]])
    probability[drives] = probability[drives][rng.permutation(drives.size)]
    return Posterior(scene.ids, probability)
