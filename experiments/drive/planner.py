"""Drives one vehicle among others by rolling out what they are believed to do.

Each manoeuvre keeps the lane or moves to one beside, at one of a few wished speeds. It is rolled
out jointly with everybody else, who react to it as they are believed to drive. The manoeuvre that
gets farthest at least risk is begun, and half a second later all are compared again.

Risk is how soon one would collide with somebody if both kept their speeds (time to collision),
summed over the next seconds. A leader that stops without a reason and a neighbour that cuts in are
risks, too, as often as those around are believed to do it.

References:
    Hayward (1972), "Near-miss determination through use of a scale of danger", HRR 384 (time to
    collision).
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from behaviors.labels import BEHAVIORS, PROFILES
from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.rollout.car_following import Rollout
from graphrqi.predict.rollout.driver_table import DriverParameters, DriverTable, expected_parameters
from graphrqi.predict.rollout.rollout import centre_ahead, on_lane_beside, positions, roll
from graphrqi.predict.scene.scene import Scene
from sim.frames import FloatArray

WISHES: Final = ((0.0, 1.0), (0.5, 1.0), (1.0, 0.8), (1.0, 1.4), (1.0, 2.2))
"""Wished speeds, as shares of the limit, and time headways, s, that are tried."""

EGO_FOLLOWING: Final = (2.0, 2.5, 4.0)
"""The planned vehicle's own standstill gap m, acceleration and deceleration m/s2 (an attentive
average driver)."""

STOP_MARGIN_M: Final = 1.5
"""The planned vehicle is driven as if it were this much longer at either end, so that it stops
before lines, not on them."""

NEAR_S: Final = 3.0
"""Times to collision below this count as risk, the more the shorter (twice what is called a near
miss)."""

EVERY: Final = 2
"""Steps between the instants at which risk is computed."""

MARGIN_M: Final = 0.3
"""An agent that passes this near to the side is in the way, m."""

RISK_WEIGHT, OVERLAP_WEIGHT, CHANGE_WEIGHT, SURPRISE_WEIGHT = 1.5, 20.0, 0.05, 1.0
"""Costs of a second with no time to collision, of a second of overlap, of a lane change and of an
expected near miss. Their unit is the distance that the limit allows (chosen on other seeds than are
reported)."""

CUT_IN_GAP_M: Final = (2.0, 15.0)
"""A driver may cut in front of a vehicle that is this far behind it, least and most, m (closer is a
collision, and farther disturbs no driver)."""

CUT_IN_SIDE_M: Final = (1.5, 5.0)
"""Distance between the two to the side, least and most, m: they drive on neighbouring lanes."""

CUT_IN_SEVERITY: Final = 0.2
"""A cut-in counts as at least this share of a near miss, also at equal speeds."""

CALM_HEADWAY_S: Final = 2.5
"""A leader that stops without a reason is no danger from this headway on, s (a second to react, and
braking as hard as the leader)."""

CUTS_IN: Final = np.array([PROFILES[b].cut_in_rate_per_min / 60.0 for b in BEHAVIORS])
STOPS: Final = np.array([PROFILES[b].stop_rate_per_min / 60.0 for b in BEHAVIORS])
"""(6,) how often drivers of each behaviour cut in and stop without a reason, 1/s."""

ACT_S: Final = 0.5
"""Time between two decisions, s."""


def plan(
    scene: Scene, ego: int, probability: FloatArray, table: DriverTable
) -> tuple[float, FloatArray]:
    """The best manoeuvre of the vehicle in row ``ego`` until the next decision.

    Beliefs (n, 6) are about the drivers' behaviours; the table has the numbers of these. Returned
    are an acceleration, m/s2, and the centre line (H, 2) to steer along from here on, m.
    """
    drivers = expected_parameters(scene, probability, table)
    following, ignores = drivers.following.copy(), drivers.ignores.copy()
    ignores[ego] = False
    length = scene.history.length.copy()
    length[ego] += 2.0 * STOP_MARGIN_M
    scene = dataclasses.replace(scene, history=dataclasses.replace(scene.history, length=length))
    own = np.arange(scene.ids.size) == ego
    tried: list[tuple[float, Scene, Rollout]] = []
    for side in (0, 1, -1):
        moved = scene
        if side:
            other, there = on_lane_beside(scene, side, other_ways=False)
            if not there[ego]:
                continue
            changed = {
                name: np.where(own, getattr(other, name), getattr(scene, name))
                for name in ("lane", "path", "offset", "lateral_speed")
            }
            moved = dataclasses.replace(scene, **changed)
        for wish, headway_s in WISHES:
            following[ego] = (max(wish, 1e-3), headway_s, *EGO_FOLLOWING)
            driven = DriverParameters(following, ignores)
            rollout = roll(moved, driven, table.decay_s, planned=ego)
            worth = _worth(moved, rollout, ego, probability) - CHANGE_WEIGHT * abs(side)
            tried.append((worth, moved, rollout))
    _, moved, rollout = max(tried, key=lambda one: one[0])
    speed = float(max(scene.speed[ego], 0.0))
    accel = (rollout.speed[ego, round(ACT_S / STEP_S) - 1] - speed) / ACT_S
    return float(accel), centre_ahead(moved, ego)


def _worth(scene: Scene, rollout: Rollout, ego: int, probability: FloatArray) -> float:
    """Distance driven over the distance that the limit allows, less the cost of the risk.

    The risk is summed over instants, `EVERY` steps apart: nearness of collision, overlap, and near
    misses expected from stops and cut-ins without a reason. Who is far away does not count.
    """
    limit = float(scene.states.limit[ego])
    limit = max(limit, 1.0) if np.isfinite(limit) else 10.0
    progress = float(rollout.travelled[ego, -1]) / (limit * scene.steps * STEP_S)
    near = np.hypot(*(scene.xy - scene.xy[ego]).T) < 100.0
    near[ego] = True
    rows = np.flatnonzero(near)
    me, probability = int(np.searchsorted(rows, ego)), probability[rows]
    xy = positions(scene, rollout)[rows, EVERY - 1 :: EVERY]
    span = EVERY * STEP_S
    before = np.concatenate([scene.xy[rows][:, None], xy[:, :-1]], axis=1)
    velocity = (xy - before) / span
    facing = np.stack([np.cos(scene.heading[rows]), np.sin(scene.heading[rows])], axis=1)
    moving = np.hypot(velocity[me, :, 0], velocity[me, :, 1])[:, None]
    forward = np.where(moving > 0.5, velocity[me] / np.maximum(moving, 1e-6), facing[me])
    apart = xy - xy[me]
    along = (apart * forward).sum(axis=2)
    across = forward[:, 0] * apart[..., 1] - forward[:, 1] * apart[..., 0]
    turned = np.abs(facing @ facing[me])[:, None]
    long, wide = scene.history.length[rows], scene.history.width[rows]
    half_long = (long * turned[:, 0] + wide * (1 - turned[:, 0]) + long[me])[:, None] / 2
    half_wide = (wide * turned[:, 0] + long * (1 - turned[:, 0]) + wide[me])[:, None] / 2
    gap = np.abs(along) - half_long
    closing = -np.sign(along) * ((velocity - velocity[me]) * forward).sum(axis=2)
    in_way = np.abs(across) < half_wide + MARGIN_M
    in_way[me] = False
    overlap = in_way & (gap < 0.0)
    time = np.where(closing > 0.1, np.maximum(gap, 0.0) / np.maximum(closing, 0.1), np.inf)
    near = np.clip(1.0 - time / NEAR_S, 0.0, 1.0) ** 2
    danger = np.where(in_way, near, 0.0).max(axis=0, initial=0.0)
    ahead = (along > 0.0) & (facing @ facing[me] > 0.5)[:, None]
    headway = np.maximum(gap, 0.0) / np.maximum(moving[:, 0], 1.0)
    follows = in_way & ahead & (moving[:, 0] > 1.0)
    tight = np.where(follows, np.clip(1.0 - headway / CALM_HEADWAY_S, 0.0, 1.0) ** 2, 0.0)
    aside = (np.abs(across) > CUT_IN_SIDE_M[0]) & (np.abs(across) < CUT_IN_SIDE_M[1])
    offered = ahead & aside & (gap > CUT_IN_GAP_M[0]) & (gap < CUT_IN_GAP_M[1])
    cut = np.where(offered, CUT_IN_SEVERITY + near, 0.0)
    surprise = (
        tight * (probability @ STOPS)[:, None] + cut * (probability @ CUTS_IN)[:, None]
    ).sum()
    cost = RISK_WEIGHT * float(danger.sum()) + OVERLAP_WEIGHT * float(overlap.any(axis=0).sum())
    return progress - (cost + SURPRISE_WEIGHT * float(surprise)) * EVERY * STEP_S
