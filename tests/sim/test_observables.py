"""Observables on hand-made roads with known answers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sim.episode.observables import observe
from sim.frames import PEDESTRIAN, Frame, Signal, Tracks
from sim.road import Connection, Crossing, Lane, Road
from sim.road.lane_graph import DIRECTIONS, LaneGraph
from sim.road.lane_search import along, next_vehicle


def lane(name, points, edge=None, index=0, limit=10.0, internal=False, walking=False):
    return Lane(
        name, edge or name, index, np.array(points, dtype=float), 3.2, limit, walking, internal
    )


@pytest.fixture
def junction() -> Road:
    """Two lanes east into a junction: straight or left; a zebra 20 m beyond it."""
    lanes = (
        lane("in_0", [[0, 0], [100, 0]], "in", 0),
        lane("in_1", [[0, 3.2], [100, 3.2]], "in", 1),
        lane(":s", [[100, 0], [120, 0]], ":j", 0, internal=True),
        lane(":l", [[100, 0], [110, 2], [115, 12]], ":j", 1, limit=5.0, internal=True),
        lane("out", [[120, 0], [220, 0]], limit=15.0),
        lane("up", [[115, 12], [115, 112]]),
        lane("walk", [[0, -5], [220, -5]], walking=True),
    )
    connections = (
        Connection("in_0", "up", (":l",), "left", signal=1, must_yield=True),
        Connection("in_0", "out", (":s",), "straight", signal=0),
    )
    zebra = Crossing("zebra", np.array([[142.0, -4.0], [142.0, 4.0]]), 4.0, ("out",))
    return Road("junction", lanes, connections, (zebra,), ("s", "l"), Path("none"))


def frame(xy, speed, heading=None, length=4.0, kind=None, signals=(0, 2), time_s=0.0) -> Frame:
    n = len(xy)
    return Frame(
        time_s=time_s,
        ids=np.arange(n),
        xy=np.array(xy, dtype=float),
        heading=np.zeros(n) if heading is None else np.array(heading),
        speed=np.array(speed, dtype=float),
        length=np.full(n, length),
        width=np.full(n, 1.8),
        kind=np.zeros(n) if kind is None else np.array(kind),
        signals=np.array(signals),
    )


def test_lane_graph_orders_ways_on_from_straight_to_turning(junction):
    graph = LaneGraph.of(junction)
    at = junction.lane_index
    assert graph.successors[at["in_0"]].tolist() == [at[":s"], at[":l"]]
    assert graph.ahead[at["in_1"]] == -1
    assert graph.behind[at["up"]] == at[":l"]
    assert graph.left[at["in_0"]] == at["in_1"]
    assert graph.right[at["in_1"]] == at["in_0"]
    assert graph.left[at["in_1"]] == -1
    assert DIRECTIONS[graph.direction[at[":l"]]] == "left"
    assert graph.signal[[at[":s"], at[":l"], at["out"]]].tolist() == [0, 1, -1]


def test_position_inverts_project_and_goes_on_straight(junction):
    graph = LaneGraph.of(junction)
    lanes = np.array([0, 3, 3, 4])
    s = np.array([30.0, 5.0, 14.0, 140.0])
    xy, heading = graph.position(lanes, s, np.array([1.0, 0.0, 0.0, 0.0]))
    assert xy[0] == pytest.approx([30.0, 1.0])
    assert xy[3] == pytest.approx([260.0, 0.0])
    back = LaneGraph.of(junction).project(xy[:3], heading[:3])
    assert back.lane.tolist() == [0, 3, 3]
    assert back.s == pytest.approx(s[:3], abs=1e-9)
    assert back.offset == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)


def test_leader_on_the_lane_and_across_the_junction(junction):
    seen = observe(frame([[60, 0], [90, 0], [130, 0], [70, 3.2]], [10, 8, 2, 5]), junction)
    assert seen.leader.tolist() == [1, 2, -1, -1]
    assert seen.gap.tolist() == [26.0, 36.0, np.inf, np.inf]
    assert seen.closing.tolist() == [2.0, 6.0, 0.0, 0.0]
    assert seen.follower.tolist() == [-1, 0, 1, -1]
    assert seen.limit.tolist() == [10.0, 10.0, 15.0, 10.0]


def test_signal_and_distance_to_the_stop_line(junction):
    seen = observe(frame([[60, 0], [110, 0], [150, 0]], [10, 10, 10]), junction)
    assert seen.stop_distance.tolist() == [38.0, -12.0, np.inf]
    assert Signal.RED.code == seen.signal[0]
    assert seen.signal[1:].tolist() == [Signal.OFF.code] * 2


def test_crossing_ahead_occupied_and_waiting(junction):
    empty = observe(frame([[130, 0], [145, 0]], [10, 10]), junction)
    assert empty.crossing_distance == pytest.approx([8.0, np.inf])
    assert not empty.crossing_occupied.any()
    walker = frame([[130, 0], [142, 1.0]], [10, 1.3], [0.0, np.pi / 2], kind=[0, PEDESTRIAN])
    assert observe(walker, junction).crossing_occupied.tolist() == [True, False]
    waiting = frame([[130, 0], [142, -5.0]], [10, 0], [0.0, np.pi / 2], kind=[0, PEDESTRIAN])
    seen = observe(waiting, junction)
    assert seen.crossing_waiting.tolist() == [True, False]
    assert not seen.crossing_occupied.any()


def test_pedestrians_and_vehicles_off_the_road_have_no_lane(junction):
    seen = observe(
        frame([[60, 0], [70, 0], [80, 30]], [5, 1, 5], kind=[0, PEDESTRIAN, 0]), junction
    )
    assert (seen.lane >= 0).tolist() == [True, False, False]
    assert seen.lane.tolist() == [0, -1, -1]
    assert seen.leader.tolist() == [-1, -1, -1]


def test_wrong_way_driver_is_seen_as_such_and_follows_nobody(junction):
    seen = observe(frame([[60, 0], [90, 0]], [10, 10], [0.0, np.pi]), junction)
    assert abs(seen.lane_heading[1]) == pytest.approx(np.pi)
    assert seen.leader.tolist() == [1, -1]


def test_tracks_give_at_each_instant_what_each_frame_gives(junction):
    rng = np.random.default_rng(3)
    frames = []
    for step in range(12):
        xy = np.column_stack([rng.uniform(0, 220, 20), rng.uniform(-1, 4.5, 20)])
        frames.append(
            frame(xy, rng.uniform(0, 14, 20), rng.normal(0, 0.1, 20), time_s=0.1 * step,
                  kind=(np.arange(20) % 7 == 0) * PEDESTRIAN, signals=rng.integers(0, 3, 2))
        )  # fmt: skip
    steps = Tracks.from_frames(frames)
    together, agent = observe(steps, junction), steps.index.agent
    for step, one in enumerate(frames):
        alone = observe(one, junction)
        here = steps.index.step == step
        for name in ("gap", "lane", "signal", "crossing_occupied", "s"):
            assert np.array_equal(
                getattr(together, name)[here], getattr(alone, name), equal_nan=name == "s"
            ), name
        for name in ("leader", "follower"):
            rows = getattr(together, name)[here]
            assert np.where(rows >= 0, agent[rows], -1).tolist() == getattr(alone, name).tolist()


def test_leader_search_equals_brute_force():
    road = Road("long road", (lane("a", [[0, 0], [500, 0]]),), (), (), (), Path("none"))
    rng = np.random.default_rng(0)
    s = np.concatenate([rng.uniform(0, 500, 60), [100.0, 100.0]])
    seen = observe(frame(np.column_stack([s, 0 * s]), np.ones(s.size), length=0.0), road)
    for i, place in enumerate(s):
        ahead = s - place
        ahead[(ahead <= 0) | (ahead > 200.0)] = np.inf
        assert seen.leader[i] == (-1 if np.isinf(ahead).all() else ahead.argmin())
        assert seen.gap[i] == ahead.min()


def test_lanes_are_searched_backward_too():
    length, before = np.array([100.0, 50.0]), np.array([-1, 0])
    lanes, at = np.array([0, 0, 1]), np.array([20.0, 60.0, 10.0])
    assert [
        next_vehicle(lanes, at, 0, 3, lane, s, False, length, before)
        for lane, s in ((0, 60.0), (1, 10.0), (0, 20.0))
    ] == [(0, 40.0), (1, 50.0), (-1, np.inf)]


def test_along_equals_the_least_distance_to_any_piece():
    rng = np.random.default_rng(5)
    line = np.cumsum(rng.uniform(0.5, 9.0, (6, 2)) * rng.choice([-1.0, 1.0], (6, 2)), axis=0)
    xy = rng.uniform(line.min(axis=0) - 5, line.max(axis=0) + 5, (300, 2))
    step = np.diff(line, axis=0)
    size = np.hypot(*step.T)
    unit = step / size[:, None]
    relative = xy[:, None] - line[None, :-1]
    forward = (relative * unit).sum(axis=2)
    low, high = np.r_[-np.inf, np.zeros(4)], np.r_[size[:-1], np.inf]
    left = unit[:, 0] * relative[..., 1] - unit[:, 1] * relative[..., 0]
    best = np.hypot(left, forward - forward.clip(low, high)).argmin(axis=1)
    each = np.arange(300)
    u, aside, total = along(line, xy)
    assert u == pytest.approx((np.cumsum(size) - size + forward.clip(low, high))[each, best])
    assert aside == pytest.approx(left[each, best])
    assert total == pytest.approx(size.sum())
    assert along(line, xy[:0])[2] == total
