"""Prediction on a grid of streets: the same answers as if everything were worked out at once."""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter

import numpy as np
import pytest

from graphrqi.predict.scene.paths import priority_of
from graphrqi.predict.scene.scene import make_scene
from scenarios import SCENARIOS
from scenarios.city import city_agents
from sim.engines import get_engine
from sim.episode.live import FrameBuffer
from sim.frames import Tracks
from sim.road import Road, SignalPlan
from sim.road.lane_graph import LaneGraph


@pytest.fixture(scope="module")
def city() -> tuple[Road, Tracks]:
    scenario = SCENARIOS["city"](duration_s=30.0)
    buffer = FrameBuffer(50)
    for frame in get_engine("sumo")(scenario, city_agents(scenario, 60, 0, within_s=20.0), 0):
        buffer.push(frame)
    return scenario.road, buffer.tracks()


def meets(line: np.ndarray, other: np.ndarray) -> float | None:
    """Distance along a line at which another crosses it, by solving for every two pieces."""
    before = 0.0
    for a, b in itertools.pairwise(line):
        for c, d in itertools.pairwise(other):
            sides = np.stack([b - a, c - d], axis=1)
            if abs(np.linalg.det(sides)) > 1e-9:
                t, u = np.linalg.solve(sides, c - a)
                if -1e-12 <= t <= 1 + 1e-12 and -1e-12 <= u <= 1 + 1e-12:
                    return before + float(t * np.hypot(*(b - a)))
        before += float(np.hypot(*(b - a)))
    return None


def all_conflicts(road: Road) -> set[tuple[int, int]]:
    """Yielding lanes and lanes with priority over them, from all pairs of junction paths."""
    ways = {}
    for link in road.connections:
        turns = link.direction != "straight"
        for name in link.via:
            yields = turns if link.signal >= 0 else link.must_yield
            ways[road.lane_index[name]] = (link, yields)
    found = set()
    for lane, (link, yields) in ways.items():
        for other, (rival, also) in ways.items():
            right_first = rival.direction == "right" and link.direction == "left"
            if not yields or (also and not right_first) or rival.from_lane == link.from_lane:
                continue
            crosses = meets(road.lanes[other].centerline, road.lanes[lane].centerline) is not None
            if crosses or rival.to_lane == link.to_lane:
                found.add((lane, other))
    return found


@pytest.mark.parametrize("name", ["grid", "priority_intersection", "right_before_left"])
def test_conflicts_found_nearby_are_those_of_all_pairs(name, city) -> None:
    road = city[0] if name == "grid" else SCENARIOS[name]().road
    if name == "grid":  # one junction and its neighbours: all pairs of all are too many for a test
        names = {link.via[0] for link in road.connections if link.via[0].startswith((":A", ":B0"))}
        links = tuple(link for link in road.connections if link.via[0] in names)
        road = Road(road.name, road.lanes, links, (), road.signal_groups, road.source)
    priority = priority_of(road, LaneGraph.of(road))
    foe = np.repeat(np.arange(len(road.lanes)), np.diff(priority.foe_first))
    pairs = set(zip(priority.lane[priority.foe_place].tolist(), foe.tolist(), strict=True))
    assert pairs == all_conflicts(road)
    assert len(pairs) > 3


def test_signals_on_the_way_follow_their_programme(city) -> None:
    road, history = city
    scene = make_scene(history, road)
    met = scene.paths.stop_row[scene.paths.options_of(scene.lane[scene.on_path])[1], 0].tolist()
    plans_met = [n for n, plan in enumerate(road.signal_plans) if set(plan.groups) & set(met[:50])]
    assert plans_met
    now = float(history.time_s[-1])
    stop_of = {0: 2, 1: 1, 2: 0, 3: 0}
    for number in plans_met:
        plan = road.signal_plans[number]
        for h in (0, 30, scene.steps):
            states = {lag: plan.state_at(now - lag + 0.1 * h) for lag in (0.0, 0.1)}
            found = tuple(scene.stop_state[list(plan.groups), h].tolist())
            assert found in {tuple(stop_of[code] for code in each) for each in states.values()}


def test_looking_a_road_up_does_not_cost_more_on_a_larger_one(city) -> None:
    road, _ = city
    longer = dataclasses.replace(road, lanes=road.lanes + road.lanes[:1])
    same = dataclasses.replace(road)
    assert {road: 1}[same] == 1
    assert road != longer
    counted = Counter[str]()

    class Plan(SignalPlan):
        def __hash__(self) -> int:
            counted["hashed"] += 1
            return 0

    plans = tuple(
        Plan(*(getattr(p, f.name) for f in dataclasses.fields(p))) for p in road.signal_plans
    )
    assert hash(dataclasses.replace(road, signal_plans=plans)) == hash(road)
    assert not counted
