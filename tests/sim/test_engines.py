"""The contract of every engine, and the physics of the simulators."""

from __future__ import annotations

import math

import numpy as np
import pytest

from behaviors.labels import Behavior
from scenarios import SCENARIOS
from sim.engines import ENGINES, get_engine
from sim.episode.observables import observe
from sim.frames import PEDESTRIAN, SIGNALS, AgentKind, Tracks
from sim.scenario import sample_agents

SIMULATORS = ("highway", "highway-krauss", "sumo", "sumo-idm")


@pytest.fixture(scope="module", params=sorted(ENGINES))
def episode(request):
    scenario = SCENARIOS["four_way_intersection"](duration_s=25.0, flow="dense")
    agents = sample_agents(scenario, 1)
    return request.param, scenario, agents, list(get_engine(request.param)(scenario, agents, 1))


def test_frames_come_every_step_until_the_end(episode):
    _, scenario, _, frames = episode
    times = np.array([frame.time_s for frame in frames])
    np.testing.assert_allclose(times, 0.1 * np.arange(1, 251), atol=1e-9)
    groups = len(scenario.road.signal_groups)
    assert all(frame.signals.size in (0, groups) for frame in frames)  # 0: knows no signals
    assert all((frame.signals < len(SIGNALS)).all() for frame in frames)


def test_frames_keep_the_conventions(episode):
    _, _, agents, frames = episode
    for frame in frames:
        assert (np.diff(frame.ids) > 0).all()
        assert (np.abs(frame.heading) <= math.pi).all()
        assert (frame.speed >= 0).all()
    known = {agent.id: agent for agent in agents}
    last = frames[-1]
    assert len(last) > 5
    for i, length, kind in zip(last.ids, last.length, last.kind, strict=True):
        assert length == pytest.approx(known[int(i)].length_m)
        assert kind == known[int(i)].kind.code


@pytest.mark.parametrize("episode", SIMULATORS, indirect=True)
def test_traffic_keeps_to_the_right_and_moves_along_its_heading(episode):
    _, scenario, agents, frames = episode
    groups = len(scenario.road.signal_groups)
    assert groups
    assert all(frame.signals.size == groups for frame in frames)
    seen = Tracks.from_frames(frames, {agent.id: agent.behavior for agent in agents})
    north = [a.id for a in agents if a.route[0] == "south_in" and a.kind is AgentKind.CAR]
    rows = np.flatnonzero(np.isin(seen.ids, north))
    assert rows.size
    for row in rows:
        steps = np.flatnonzero(seen.valid[row])[:20]
        assert (seen.xy[row, steps, 0] > 0).all()  # the right half of the southern arm
        np.testing.assert_allclose(seen.heading[row, steps], math.pi / 2, atol=0.3)
    moved = np.diff(seen.xy, axis=1)
    both = seen.valid[:, 1:] & seen.valid[:, :-1]
    fast = both & (seen.speed[:, 1:] > 3.0) & (seen.kind != PEDESTRIAN)[:, None]
    way = moved[fast]
    np.testing.assert_allclose(np.hypot(*way.T) / 0.1, seen.speed[:, :-1][fast], atol=1.6)
    turned = np.arctan2(way[:, 1], way[:, 0]) - seen.heading[:, :-1][fast]
    assert np.median(np.abs(np.sin(turned))) < 0.01
    assert (np.cos(turned) > 0.7).all()  # in tight bends a body is at an angle to its way


def test_same_seed_same_frames_to_the_bit(episode):
    engine, scenario, agents, frames = episode
    for one, other in zip(frames, get_engine(engine)(scenario, agents, 1), strict=True):
        for name in ("ids", "xy", "heading", "speed", "signals"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
        assert one.events == other.events


def test_an_early_end_leaves_the_engine_usable(episode):
    engine, scenario, agents, frames = episode
    opened = get_engine(engine)(scenario, agents, 1)
    next(opened)
    opened.close()
    np.testing.assert_array_equal(next(get_engine(engine)(scenario, agents, 1)).xy, frames[0].xy)


@pytest.mark.parametrize("engine", SIMULATORS)
def test_timid_drivers_keep_a_longer_headway_than_threatening_ones(engine):
    scenario = SCENARIOS["straight_road"](
        duration_s=120.0, flow="dense", mix="timid=.5,threatening=.5"
    )
    agents = sample_agents(scenario, 0)
    seen = Tracks.from_frames(
        get_engine(engine)(scenario, agents, 0), {a.id: a.behavior for a in agents}
    )
    steps = seen
    facts = observe(steps, scenario.road)
    headway = {}
    for behavior in (Behavior.TIMID, Behavior.THREATENING):
        rows = (seen.behavior == behavior.code)[steps.index.agent]
        gap, speed = facts.gap[rows], steps.row_speed[rows]
        near = (facts.lane[rows] >= 0) & (gap < 8.0 * speed) & (speed > 2.0)
        headway[behavior] = float(np.median(gap[near] / speed[near]))
    assert headway[Behavior.TIMID] > 1.5 * headway[Behavior.THREATENING]
