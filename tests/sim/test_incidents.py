import dataclasses

import numpy as np
import pytest

from scenarios.networks.build import FOLDER, NET
from sim.episode.annotate import annotate, incidents
from sim.frames import AgentKind, Event, EventKind, Signal, Tracks
from sim.road.net import read_road

STEP_S = 0.1


@pytest.fixture(scope="module")
def four_way():
    return read_road(FOLDER / "four_way_intersection" / NET, "four_way")


@pytest.fixture(scope="module")
def all_way_stop():
    return read_road(FOLDER / "four_way_allway_stop" / NET, "all_way_stop")


@pytest.fixture(scope="module")
def straight():
    return read_road(FOLDER / "straight_road" / NET, "straight")


def tracks_of(road, paths, *, kinds=None, signal=Signal.GREEN, events=()):
    """Agents with ids 0, 1, ... along (T, 2) paths; speeds and headings follow from them."""
    xy = np.stack([np.asarray(p, dtype=float) for p in paths])
    step = np.gradient(xy, axis=1)
    moving = np.hypot(step[..., 0], step[..., 1]) / STEP_S
    heading = np.arctan2(step[..., 1], step[..., 0])
    n, t = xy.shape[:2]
    kind = np.zeros(n, dtype=np.int8)
    for i, k in (kinds or {}).items():
        kind[i] = k.code
    walks = kind == AgentKind.PEDESTRIAN.code
    return Tracks.of_dense(
        ids=np.arange(n),
        names=tuple(map(str, range(n))),
        kind=kind,
        length=np.where(walks, 0.3, 4.5),
        width=np.where(walks, 0.5, 1.8),
        time_s=np.arange(1, t + 1) * STEP_S,
        xy=xy,
        heading=np.where(moving > 0.05, heading, heading[:, :1]),
        speed=moving,
        valid=np.ones((n, t), dtype=bool),
        signals=np.full((len(road.signal_groups), t), signal.code),
        events=events,
    )


def line(begin, speed, steps=200):
    """A path from a point with a constant velocity, m/s."""
    return np.asarray(begin) + np.arange(steps)[:, None] * STEP_S * np.asarray(speed)


def kinds_of(events):
    return [e.kind for e in events]


def lane_xy(road, name):
    return road.lanes[road.lane_index[name]].centerline


def test_a_red_light_run_and_a_green_one_passed(four_way):
    x = lane_xy(four_way, "north_in_1")[0, 0]
    path = line((x, 80.0), (0.0, -10.0))
    assert kinds_of(incidents(tracks_of(four_way, [path], signal=Signal.RED), four_way)) == [
        EventKind.RED_RUN
    ]
    assert incidents(tracks_of(four_way, [path]), four_way) == ()


def test_standing_at_red_and_going_at_green_is_a_rule_kept(four_way):
    x, y = lane_xy(four_way, "north_in_1")[-1]
    coming = line((x, y + 50.0 + 3.0), (0.0, -10.0), 50)
    standing = np.repeat(coming[-1:], 60, axis=0)
    going = line(coming[-1], (0.0, -10.0), 90)
    tracks = tracks_of(four_way, [np.concatenate([coming, standing, going])], signal=Signal.RED)
    signals = tracks.signals.copy()
    signals[:, 100:] = Signal.GREEN.code
    tracks = dataclasses.replace(tracks, signals=signals)
    events = incidents(tracks, four_way)
    assert [(e.kind, e.rule) for e in events] == [(EventKind.STOPPED, "red light")]


def crossing_scene(straight, driver):
    """A pedestrian walks north over the zebra, which a driver comes to."""
    walker = line((400.0, -12.0), (0.0, 1.3))
    return tracks_of(straight, [driver, walker], kinds={1: AgentKind.PEDESTRIAN})


def test_driving_in_front_of_a_pedestrian_is_not_yielding(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    # the walker is on the crossing from 2.1 s on and reaches the middle lane's path after 4.6 s
    tracks = crossing_scene(straight, line((356.0, y), (10.0, 0.0)))
    found = [e for e in incidents(tracks, straight) if e.kind is EventKind.NOT_YIELDED]
    assert [(e.agent, e.other) for e in found] == [(0, 1)]


def test_slowing_until_the_pedestrian_has_passed_is_yielding(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    t = np.arange(200) * STEP_S
    speed = np.where(t < 2.5, 10.0, np.where(t < 8.0, 0.0, 8.0))
    x = 355.0 + np.cumsum(speed) * STEP_S
    tracks = crossing_scene(straight, np.stack([x, np.full(200, y)], axis=1))
    found = [
        e
        for e in incidents(tracks, straight)
        if e.kind in {EventKind.YIELDED, EventKind.NOT_YIELDED}
    ]
    assert [(e.kind, e.agent, e.other) for e in found] == [(EventKind.YIELDED, 0, 1)]


def test_passing_long_before_or_after_the_pedestrian_is_neither(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    for begin in (390.0, 260.0):
        tracks = crossing_scene(straight, line((begin, y), (10.0, 0.0)))
        assert not set(kinds_of(incidents(tracks, straight))) & {
            EventKind.YIELDED,
            EventKind.NOT_YIELDED,
        }


def test_the_wrong_way_is_measured(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    (event,) = incidents(tracks_of(straight, [line((300.0, y), (-10.0, 0.0), 100)]), straight)
    assert event.kind is EventKind.WRONG_WAY
    assert event.distance_m == pytest.approx(100.0, abs=2.0)


def test_a_near_miss_is_told_once(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    fast, slow = line((100.0, y), (15.0, 0.0), 24), line((130.0, y), (5.0, 0.0), 24)
    events = incidents(tracks_of(straight, [fast, slow]), straight)
    assert [(e.kind, e.agent, e.other) for e in events] == [(EventKind.NEAR_MISS, 0, 1)]


def follow(centerline, speed, steps=200):
    """A path along a lane."""
    step = np.hypot(*np.diff(centerline, axis=0).T)
    s = np.concatenate([[0.0], np.cumsum(step)])
    at = np.minimum(np.arange(steps) * STEP_S * speed, s[-1])
    return np.stack([np.interp(at, s, centerline[:, k]) for k in (0, 1)], axis=1)


def blamed(road, paths, **more):
    collision = Event(EventKind.COLLISION, more.pop("time_s", 10.0), 0, 1)
    tracks = tracks_of(road, paths, events=(collision,), **more)
    (event,) = (e for e in incidents(tracks, road) if e.kind is EventKind.COLLISION)
    return event.agent, event.other, event.rule


def test_a_rear_end_collision_is_the_followers_fault(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    ahead, behind = line((110.0, y), (5.0, 0.0)), line((100.0, y), (6.0, 0.0))
    assert blamed(straight, [ahead, behind]) == (1, 0, "followed too closely")


def test_a_collision_at_a_red_light_is_the_fault_of_who_ran_it(four_way):
    x = lane_xy(four_way, "north_in_1")[0, 0]
    runner = line((x, 80.0), (0.0, -8.0))
    y = lane_xy(four_way, "east_in_1")[0, 1]
    other = line((8.5, y), (-0.6, 0.0))
    agent, _, rule = blamed(four_way, [other, runner], signal=Signal.RED)
    assert (agent, rule) == (1, "ran a red light")


def test_a_left_turn_that_takes_priority_is_at_fault(four_way):
    turner = follow(lane_xy(four_way, ":centre_17_0"), 0.7)
    oncoming = follow(lane_xy(four_way, ":centre_9_0"), 0.9)
    agent, other, rule = blamed(four_way, [oncoming, turner])
    assert (agent, other, rule) == (1, 0, "took another's priority")


def test_where_each_yields_to_the_other_the_second_to_enter_is_at_fault(all_way_stop):
    road = all_way_stop
    left, straight_on = (
        next(
            link
            for link in road.connections
            if link.direction == direction and link.from_lane.startswith(edge)
        )
        for edge, direction in (("north_in", "left"), ("east_in", "straight"))
    )
    turner = follow(np.concatenate([lane_xy(road, name) for name in left.via]), 0.6)
    end = lane_xy(road, straight_on.from_lane)[-1]
    # its front is 1.5 m beyond the line when they touch, its centre still before it
    nosing = line((end[0] + 5.75, end[1]), (-0.5, 0.0))
    for paths, later in (([turner, nosing], 1), ([nosing, turner], 0)):
        agent, _, rule = blamed(road, paths)
        assert (agent, rule) == (later, "entered a junction not yet clear")


def test_priority_does_not_help_who_could_have_stopped_for_one_that_stood(four_way):
    through = lane_xy(four_way, ":centre_9_0")
    turner = np.tile(lane_xy(four_way, ":centre_17_0")[3], (200, 1))
    oncoming = line(through[0] - (0.0, 60.0), (0.0, 7.0))
    agent, other, rule = blamed(four_way, [oncoming, turner])
    assert (agent, other, rule) == (0, 1, "ran into somebody who stood")
    late = np.concatenate([follow(lane_xy(four_way, ":centre_17_0"), 0.7)[:95], turner[:105]])
    agent, _, rule = blamed(four_way, [oncoming, late])
    assert (agent, rule) == (1, "took another's priority")


def test_hitting_a_pedestrian_on_a_zebra_or_a_jaywalker(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    people = {1: AgentKind.PEDESTRIAN}
    driver = line((300.0, y), (10.0, 0.0))
    zebra = line((400.0, y - 13.0), (0.0, 1.3))
    assert blamed(straight, [driver, zebra], kinds=people)[::2] == (
        0,
        "did not yield to a pedestrian",
    )
    anywhere = line((300.0, y - 13.0), (0.0, 1.3))
    assert blamed(straight, [driver, anywhere], kinds=people)[::2] == (
        1,
        "walked where or when one may not",
    )


def test_events_make_rule_traits_and_ids_are_agents(four_way):
    x = lane_xy(four_way, "north_in_1")[0, 0]
    tracks = tracks_of(four_way, [line((x, 80.0), (0.0, -10.0))], signal=Signal.RED)
    found = annotate(tracks, four_way).shown_traits
    assert [e.agent for e in found if e.trait == "not following rules"] == [0]


def collisions(road, paths, **more):
    tracks = tracks_of(road, paths, **more)
    return [e for e in incidents(tracks, road) if e.kind is EventKind.COLLISION]


def test_a_collision_is_one_event_from_the_first_touch_to_the_last(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    fast, slow = line((100.0, y), (10.0, 0.0), 60), line((110.0, y), (5.0, 0.0), 60)
    events = collisions(straight, [fast, slow])
    assert [(e.agent, e.other, e.rule) for e in events] == [(0, 1, "followed too closely")]
    touch = np.flatnonzero(np.abs(fast[:, 0] - slow[:, 0]) < 4.5 - 0.1)
    assert [events[0].time_s, events[0].end_s] == pytest.approx((touch[[0, -1]] + 1) * STEP_S)


def test_recorded_boxes_tell_no_collision(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    fast, slow = line((100.0, y), (10.0, 0.0), 60), line((110.0, y), (5.0, 0.0), 60)
    events = incidents(tracks_of(straight, [fast, slow]), straight, recorded=True)
    assert EventKind.COLLISION not in kinds_of(events)


def test_who_stands_between_lanes_is_at_fault(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    between = np.tile([(150.0, y + 1.4)], (60, 1))
    driver = line((125.0, y), (10.0, 0.0), 60)
    events = collisions(straight, [between, driver])
    assert {(e.agent, e.other, e.rule) for e in events} == {(0, 1, "was between lanes")}


def test_running_into_who_has_stood_for_long(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    stands = np.tile([(150.0, y)], (60, 1))
    driver = line((110.0, y), (10.0, 0.0), 60)
    events = collisions(straight, [stands, driver])
    assert {(e.agent, e.other) for e in events} == {(1, 0)}


def test_pedestrians_near_a_box_are_hit_only_if_the_engine_says_so(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    driver = line((125.0, y), (10.0, 0.0), 60)
    walker = np.tile([(150.0, y + 0.5)], (60, 1))
    people = {1: AgentKind.PEDESTRIAN}
    assert collisions(straight, [driver, walker], kinds=people) == []
    told = (Event(EventKind.COLLISION, 2.5, 0, 1),)
    (hit,) = collisions(straight, [driver, walker], kinds=people, events=told)
    assert hit.end_s > hit.time_s


def yields_of(straight, driver, walker, others=()):
    paths = [driver, walker, *others]
    tracks = tracks_of(straight, paths, kinds={1: AgentKind.PEDESTRIAN})
    wanted = {EventKind.YIELDED, EventKind.NOT_YIELDED}
    return [e.kind for e in incidents(tracks, straight) if e.kind in wanted and e.agent == 0]


def test_who_could_not_have_stopped_did_not_meet_the_pedestrian(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    # the walker steps on the crossing after 2.1 s; then 12 m are too few to stop from 10 m/s
    walker = line((400.0, -12.0), (0.0, 1.3))
    assert yields_of(straight, line((363.0, y), (10.0, 0.0)), walker) == []
    assert yields_of(straight, line((356.0, y), (10.0, 0.0)), walker) == [EventKind.NOT_YIELDED]


def test_who_is_held_by_a_leader_does_not_yield(straight):
    y = lane_xy(straight, "east_in_2")[0, 1]
    t = np.arange(200) * STEP_S
    speed = np.where(t < 2.5, 10.0, np.where(t < 8.0, 0.0, 8.0))
    x = 355.0 + np.cumsum(speed) * STEP_S
    walker = line((400.0, -12.0), (0.0, 1.3))
    driver = np.stack([x, np.full(200, y)], axis=1)
    assert yields_of(straight, driver, walker) == [EventKind.YIELDED]
    leader = driver + np.array([5.5, 0.0])  # stands before the crossing, too
    assert yields_of(straight, driver, walker, [leader]) == []
