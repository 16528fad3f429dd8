import dataclasses
import hashlib
import itertools
import math

import numpy as np
import pytest

from behaviors.labels import PROFILES, Behavior, Style
from behaviors.traits import cutting_in
from scenarios import SCENARIOS, get_scenario
from sim.episode.annotate import incidents
from sim.episode.observables import detector_inputs, observe
from sim.frames import PEDESTRIAN, AgentKind, EventKind, Frame, Tracks
from sim.road.lane_graph import LaneGraph
from sim.road.net import signal_code
from sim.scenario import AgentSpec, sample_agents
from sim.sumo.engine import SumoError, run


def drive(scenario, seed=0) -> list[Frame]:
    return list(run(scenario, sample_agents(scenario, seed), seed))


def digest(frames) -> str:
    total = hashlib.sha256()
    for frame in frames:
        for name in ("ids", "xy", "heading", "speed", "length", "kind", "signals"):
            total.update(np.ascontiguousarray(getattr(frame, name)).tobytes())
        total.update(repr((frame.time_s, frame.events)).encode())
    return total.hexdigest()


def short(name="straight_road", **options):
    return get_scenario(name)(**{"duration_s": 40.0, "flow": "dense", **options})


@pytest.mark.parametrize("name", SCENARIOS)
def test_conventions(name):
    walkers = {"pedestrians_per_h": 600.0} if "pedestrians_per_h" in SCENARIOS[name].options else {}
    scenario = short(name, **walkers)
    frames = drive(scenario)
    assert [f.time_s for f in frames] == pytest.approx(np.arange(1, 401) * 0.1)
    west, south, east, north = scenario.road.bounds
    for frame in frames[::20]:
        assert (np.diff(frame.ids) > 0).all()
        assert (frame.heading > -math.pi).all()
        assert (frame.heading <= math.pi).all()
        assert frame.signals.size == len(scenario.road.signal_groups)
        inside = (frame.xy >= [west - 15, south - 15]) & (frame.xy <= [east + 15, north + 15])
        assert inside.all()
    assert any(len(f) for f in frames)


def test_same_seed_same_frames_with_every_controller_on():
    for name in ("straight_road", "two_way_road", "four_way_intersection"):
        scenario = short(name, duration_s=60.0, jaywalk_share=0.5, pedestrians_per_h=400.0)
        assert digest(drive(scenario, 1)) == digest(drive(scenario, 1))
    assert digest(drive(scenario, 1)) != digest(drive(scenario, 2))


def lone(scenario, **changes) -> AgentSpec:
    agent = AgentSpec(
        id=7,
        kind=AgentKind.CAR,
        behavior=Behavior.CAREFUL,
        profile=PROFILES[Behavior.CAREFUL],
        route=scenario.flows[0].route,
        depart_s=1.0,
        length_m=5.0,
        width_m=1.9,
    )
    return dataclasses.replace(agent, **changes)


def test_positions_are_box_centres_and_headings_point_along_the_road():
    scenario = short("straight_road", duration_s=10.0)
    frames = list(run(scenario, [lone(scenario)], 0))
    seen = [f for f in frames if len(f)]
    first, last = seen[0], seen[-1]
    assert first.ids.tolist() == [7]
    assert first.length[0] == 5.0
    assert first.heading[0] == pytest.approx(0.0)
    lane = LaneGraph.of(scenario.road).project(last.xy, last.heading)
    assert abs(lane.offset[0]) < 1e-6
    travelled = sum(float(f.speed[0]) * 0.1 for f in seen[1:])
    assert last.xy[0, 0] - first.xy[0, 0] == pytest.approx(travelled, abs=0.01)
    assert -0.1 <= first.xy[0, 0] - 2.5 <= 1.5  # the rear bumper begins where the road does


@pytest.mark.parametrize("kind", ["static", "actuated"])
def test_signals_are_those_that_sumo_shows(kind, tmp_path):
    from libsumo import trafficlight

    net = get_scenario("four_way_intersection")().road.source.read_text()
    phase = '<phase duration="19"'
    assert net.count(phase) == 2
    assert 'type="static"' in net
    net = net.replace('type="static"', f'type="{kind}"')
    net = net.replace(phase, f'{phase} minDur="5" maxDur="40"')
    (tmp_path / "road.net.xml").write_text(net)
    scenario = get_scenario(str(tmp_path / "road.net.xml"))(duration_s=90.0, flow=900.0)
    (plan,) = scenario.road.signal_plans
    switches = []
    for frame in run(scenario, sample_agents(scenario, 0), 0):
        letters = trafficlight.getRedYellowGreenState(plan.id)
        shown = [signal_code(letters[link]) for link in plan.links]
        assert frame.signals[list(plan.groups)].tolist() == shown
        if shown != (switches[-1][1] if switches else None):
            switches.append((frame.time_s, shown))
    assert len(switches) > 5
    on_time = all(frame_signals == list(plan.state_at(t - 0.1)) for t, frame_signals in switches)
    assert on_time == (kind == "static")


def test_a_timid_driver_keeps_a_longer_headway_than_a_threatening_one():
    headway = {}
    for behavior in (Behavior.TIMID, Behavior.THREATENING):
        scenario = short(mix=f"{behavior}=1", duration_s=90.0, flow=2400.0, pedestrians_per_h=0.0)
        tracks = Tracks.from_frames(run(scenario, sample_agents(scenario, 0), 0))
        seen, speed = observe(tracks, scenario.road), tracks.speed[tracks.valid]
        time_headway = seen.gap / np.maximum(speed, 1.0)
        follows = (np.abs(seen.closing) < 1.0) & (speed > 4.0) & (time_headway < 8.0)
        headway[behavior] = float(np.median(time_headway[follows]))
    assert headway[Behavior.TIMID] > 2.5 * headway[Behavior.THREATENING]


def test_red_lights_are_run_by_the_reckless_only():
    runs = {}
    for mix in ("reckless=1", "careful=.4,cautious=.3,timid=.3"):
        scenario = get_scenario("four_way_intersection")(mix=mix, duration_s=120.0)
        tracks = Tracks.from_frames(run(scenario, sample_agents(scenario, 0), 0))
        events = incidents(tracks, scenario.road)
        runs[mix] = sum(e.kind is EventKind.RED_RUN for e in events)
        if mix.startswith("careful"):
            assert not any(e.kind is EventKind.COLLISION for e in events)
    red, none = runs.values()
    assert red > 5
    assert none == 0


def test_only_the_reckless_drive_on_the_wrong_side():
    metres = {}
    for behavior in (Behavior.RECKLESS, Behavior.IMPATIENT):
        mix = f"{behavior}=.5,timid=.5"
        scenario = get_scenario("two_way_road")(mix=mix, duration_s=200.0, flow=400.0)
        tracks = Tracks.from_frames(run(scenario, sample_agents(scenario, 2), 2))
        steps = tracks
        seen = observe(steps, scenario.road)
        wrong = np.abs(np.nan_to_num(seen.lane_heading)) > math.pi / 2
        metres[behavior] = float(steps.row_speed[wrong].sum()) * 0.1
    assert metres[Behavior.RECKLESS] > 50.0
    assert metres[Behavior.IMPATIENT] == 0.0


def test_threatening_drivers_cut_in_and_the_careful_do_not():
    scenario = short(mix="threatening=.5,careful=.5", duration_s=150.0, flow=2400.0)
    agents = sample_agents(scenario, 0)
    tracks = Tracks.from_frames(run(scenario, agents, 0))
    cuts = cutting_in(detector_inputs(tracks, scenario.road))
    behavior = {a.id: a.behavior for a in agents}
    who = [behavior[int(tracks.ids[cut.agent])] for cut in cuts]
    assert who.count(Behavior.THREATENING) > 20
    assert who.count(Behavior.CAREFUL) < who.count(Behavior.THREATENING) / 20


def test_the_conservative_cause_no_collision_with_a_vehicle():
    # Seed 9: a timid driver would stop unprovoked half way between two lanes.
    scenario = get_scenario("straight_road")(duration_s=620.0)
    agents = sample_agents(scenario, 9)
    tracks = Tracks.from_frames(run(scenario, agents, 9))
    style = {a.id: None if a.behavior is None else a.behavior.style for a in agents}
    assert not [
        e
        for e in incidents(tracks, scenario.road)
        if e.kind is EventKind.COLLISION and style[e.agent] is Style.CONSERVATIVE
    ]


@pytest.mark.parametrize(("lets", "at_once"), [(1.0, False), (0.0, True)])
def test_who_lets_others_finish_stays_before_the_line_until_the_junction_is_clear(lets, at_once):
    scenario = get_scenario("all_way_stop")(duration_s=40.0)
    careful = dataclasses.replace(PROFILES[Behavior.CAREFUL], yield_probability=lets)
    turning = lone(
        scenario, id=0, kind=AgentKind.TRUCK, route=("north_in", "east_out"), length_m=12.0,
        behavior=Behavior.TIMID, profile=PROFILES[Behavior.TIMID], depart_s=0.0,
    )  # fmt: skip
    crossing = lone(scenario, id=1, route=("east_in", "west_out"), profile=careful, depart_s=7.0)
    tracks = Tracks.from_frames(run(scenario, [turning, crossing], 0))
    inside = np.zeros(tracks.valid.shape, dtype=bool)
    inside[tracks.valid] = observe(tracks, scenario.road).stop_distance < 0
    assert inside.any(axis=1).all()
    assert inside.all(axis=0).any() == at_once


def test_cars_neither_slide_nor_spin_on_the_spot():
    scenario = short(duration_s=120.0)
    tracks = Tracks.from_frames(run(scenario, sample_agents(scenario, 0), 0))
    drives = tracks.kind != PEDESTRIAN
    turned = np.abs(np.diff(tracks.heading[drives], axis=1))
    moved = np.hypot(*np.moveaxis(np.diff(tracks.xy[drives], axis=1), 2, 0))
    assert np.nanmax(turned) < 0.2
    assert np.nanmax(turned[moved < 0.01], initial=0.0) < 0.01
    assert np.nanmax(np.abs(tracks.heading[drives])) < 0.5


def test_jaywalkers_cross_away_from_any_crossing_and_the_simulation_closes():
    scenario = short(
        flow=300.0, pedestrians_per_h=400.0, jaywalk_share=1.0, crossing=False, duration_s=300.0
    )
    crossed = 0
    for _ in range(2):  # a second one after walkers were led by hand
        tracks = Tracks.from_frames(run(scenario, sample_agents(scenario, 0), 0))
        walkers = tracks.kind == PEDESTRIAN
        y = tracks.xy[walkers, :, 1]
        crossed += int(((np.nanmax(y, axis=1) > 0.0) & (np.nanmin(y, axis=1) < -9.6)).sum())
        assert float(np.nanmax(tracks.speed[walkers])) < 3.0
    assert crossed >= 2


def test_a_second_simulation_is_refused_and_the_first_goes_on():
    scenario = short(duration_s=5.0)
    agents = sample_agents(scenario, 0)
    first = run(scenario, agents, 0)
    next(first)
    with pytest.raises(SumoError, match="found a simulation running in this process"):
        next(run(scenario, agents, 0))
    assert len(list(first)) == 49
    assert len(drive(scenario)) == 50


def test_leaving_early_closes_the_simulation():
    scenario = short(duration_s=5.0)
    for _ in range(3):
        frames = run(scenario, sample_agents(scenario, 0), 0)
        assert len(list(itertools.islice(frames, 7))) == 7
        frames.close()


def test_every_kind_drives_with_its_own_size():
    scenario = short(
        kinds="car=.4,bus=.15,truck=.15,motorcycle=.15,bicycle=.15", duration_s=120.0, flow=1800.0
    )
    frames = drive(scenario)
    assert {int(k) for f in frames for k in f.kind} >= {0, 1, 2, 3, 4}
    bicycles = [float(f.speed[f.kind == AgentKind.BICYCLE.code].max(initial=0)) for f in frames]
    assert 3.0 < max(bicycles) < 12.0
