"""Navigation: near misses are counted, steering leads onto the line, labels reach the planner."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from behaviors.labels import BEHAVIORS, Behavior
from experiments.benches.navigation import ARMS, METRICS, compare, near_misses, steering
from graphrqi.predict.planner import Plan, plan, risks
from graphrqi.predict.rollout.driver_table import default_table
from graphrqi.predict.scene.scene import make_scene
from scenarios import SCENARIOS
from sim.frames import Frame, Tracks


@pytest.fixture(scope="module")
def road():
    return SCENARIOS["straight_road"]().road


def lane_y(road, lane):
    return next(x.centerline[0, 1] for x in road.lanes if x.id == lane)


def traffic(road, drivers, seconds=1.0, step_s=0.1) -> Tracks:
    """Vehicles at constant speed along x: (x now, lane, speed) each."""
    frames = []
    for t in np.arange(0.0, seconds + 1e-9, step_s):
        xy = [[x + v * (t - seconds), lane_y(road, lane)] for x, lane, v in drivers]
        n = len(drivers)
        frames.append(
            Frame(
                time_s=t, ids=np.arange(n), xy=np.array(xy), heading=np.zeros(n),
                speed=np.array([v for _, _, v in drivers]), length=np.full(n, 5.0),
                width=np.full(n, 2.0), kind=np.zeros(n),
            )
        )  # fmt: skip
    return Tracks.from_frames(frames)


def told(*behaviors: Behavior | None) -> np.ndarray:
    unknown = np.full(len(BEHAVIORS), 1.0 / len(BEHAVIORS))
    return np.array([unknown if b is None else np.eye(len(BEHAVIORS))[b.code] for b in behaviors])


def test_near_misses_ahead_and_behind_are_told_apart(road):
    lane = "east_in_1"
    ahead = traffic(road, [(100.0, lane, 10.0), (112.0, lane, 4.0)])  # 7 m at 6 m/s: 1.2 s
    assert near_misses(ahead, road, 0) == (1, 0)
    assert near_misses(ahead, road, 1) == (0, 1)
    calm = traffic(road, [(100.0, lane, 10.0), (140.0, lane, 4.0)])
    assert near_misses(calm, road, 0) == (0, 0)


def test_steering_turns_towards_the_line():
    line = np.column_stack([np.arange(60.0), np.full(60, 3.0)])
    ahead = Plan(0.0, line, 0)
    assert steering(ahead, np.array([0.0, 0.0]), 0.0, 8.0, 5.0) > 0.01
    assert steering(ahead, np.array([0.0, 6.0]), 0.0, 8.0, 5.0) < -0.01
    assert steering(ahead, np.array([0.0, 3.0]), 0.0, 8.0, 5.0) == pytest.approx(0.0)


def test_a_free_road_is_driven_at_the_limit(road):
    scene = make_scene(traffic(road, [(100.0, "east_in_1", 8.0)]), road)
    chosen = plan(scene, 0, told(None), default_table())
    assert chosen.accel > 1.0
    assert chosen.side == 0


def test_a_standing_vehicle_is_not_driven_into(road):
    drivers = [(100.0, "east_in_1", 12.0)]
    drivers += [(130.0, lane, 0.0) for lane in ("east_in_0", "east_in_1", "east_in_2")]
    scene = make_scene(traffic(road, drivers), road)
    scene = dataclasses.replace(scene, accel=np.zeros(4))
    chosen = plan(scene, 0, told(None, *[Behavior.TIMID] * 3), default_table())
    assert chosen.accel < -1.0


def test_neighbours_who_cut_in_are_feared_and_others_not(road):
    drivers = [(100.0, "east_in_1", 10.0), (111.0, "east_in_2", 10.0)]
    scene = make_scene(traffic(road, drivers), road)
    steps = np.arange(1, 6)[None, :, None] * np.array([2.0, 0.0])
    xy = scene.xy[:, None] + steps
    surprise = {
        b: risks(xy, scene, np.arange(2), 0, told(None, b))[2]
        for b in (Behavior.THREATENING, Behavior.CAREFUL)
    }
    assert surprise[Behavior.THREATENING] > 0.0
    assert surprise[Behavior.CAREFUL] == 0.0


def test_rows_compare_by_seed():
    table = np.ones((4, len(ARMS), len(METRICS)))
    table[:, 0, METRICS.index("near_misses")] = [1.0, 2.0, 3.0, 2.0]
    rows = compare("here", table)
    value = {(row["arm"], row["metric"]): row["value"] for row in rows}
    assert value["blind", "near_misses"] == 2.0
    assert value["true", "near_misses_minus_blind"] == -1.0
    assert value["true", "near_misses_over_blind"] == 0.5
    assert ("blind", "near_misses_over_blind") not in value


def test_nothing_to_divide_by_gives_no_row():
    rows = compare("here", np.zeros((3, len(ARMS), len(METRICS))))
    assert not [row for row in rows if row["metric"] == "near_misses_over_blind"]
    assert all(np.isfinite(row["value"]) for row in rows)
