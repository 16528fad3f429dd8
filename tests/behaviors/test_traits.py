import dataclasses

import numpy as np
import pytest

from behaviors.labelling import THRESHOLDS, characteristic_traits, label_from_traits
from behaviors.labels import TRAITS, Behavior, Trait
from behaviors.row_index import RowIndex
from behaviors.traits import (
    DETECTORS,
    DetectorInputs,
    RuleEncounter,
    ShownTrait,
    detect,
    lane_changes,
)

T = 600
STEP_S = 0.1


def scene(agents: int = 2) -> DetectorInputs:
    """Everybody drives at 10 m/s, alone, in the middle of an endless lane; the limit is 14 m/s."""
    shape = (agents * T,)
    far, none = np.full(shape, np.inf), np.full(shape, -1)
    return DetectorInputs(
        row_index=RowIndex.of(np.ones((agents, T), dtype=bool)),
        time_s=np.arange(1, T + 1) * STEP_S,
        drives=np.ones(agents, dtype=bool),
        length=np.full(agents, 4.5),
        width=np.full(agents, 1.8),
        speed=np.full(shape, 10.0),
        limit=np.full(shape, 14.0),
        edge=np.zeros(shape, dtype=np.int64),
        lane=np.zeros(shape, dtype=np.int64),
        offset=np.zeros(shape),
        lane_width=np.full(shape, 3.2),
        lane_heading=np.zeros(shape),
        leader=none.copy(),
        follower=none.copy(),
        gap=far.copy(),
        closing=np.zeros(shape),
        stop_distance=far.copy(),
        stop_ahead=np.zeros(shape, dtype=bool),
        crossing_distance=far.copy(),
        crossing_used=np.zeros(shape, dtype=bool),
        off_crossing=np.zeros(shape, dtype=bool),
        on_red=np.zeros(shape, dtype=bool),
    )


def of(agent: int, begin: int = 0, end: int = T) -> slice:
    """The rows of an agent in a scene."""
    return slice(agent * T + begin, agent * T + end)


def follow(
    inputs: DetectorInputs, leader: int, follower: int, begin: int, end: int, gap: float
) -> None:
    """Let one agent be the other's leader for some time."""
    ahead, behind = of(leader, begin, end), of(follower, begin, end)
    inputs.leader[behind], inputs.gap[behind] = np.arange(ahead.start, ahead.stop), gap
    inputs.follower[ahead] = np.arange(behind.start, behind.stop)


def traits_of(inputs: DetectorInputs, agent: int = 0) -> set[Trait]:
    return {e.trait for e in detect(inputs) if e.agent == agent}


def test_there_is_a_detector_and_an_amount_for_every_row_of_the_table():
    assert set(DETECTORS) == set(TRAITS) == set(THRESHOLDS)


def test_driving_along_shows_an_even_speed_and_nothing_else():
    assert traits_of(scene()) == {Trait.UNIFORM_SPEED}


def test_over_speeding():
    inputs = scene()
    inputs.speed[of(0, 100, 150)] = 16.0
    found = DETECTORS[Trait.OVER_SPEEDING](inputs)
    assert [(e.agent, round(e.begin_s, 1), round(e.end_s, 1)) for e in found] == [(0, 10.1, 15.0)]
    assert found[0].value == pytest.approx(16 / 14)
    inputs.speed[of(0, 100, 150)] = 15.0  # inside the tolerance
    assert not DETECTORS[Trait.OVER_SPEEDING](inputs)


@pytest.mark.parametrize(
    ("gap", "trait"), [(8.0, Trait.TAILGATING), (5.0, Trait.DRIVING_CLOSE), (20.0, None)]
)
def test_headways(gap, trait):
    inputs = scene()
    follow(inputs, 1, 0, 0, T, gap)
    close = traits_of(inputs) & {Trait.TAILGATING, Trait.DRIVING_CLOSE}
    assert close == ({trait} if trait else set())


def change(inputs: DetectorInputs, agent: int, column: int) -> None:
    """From the lane 0 to the lane 1 on the left, the centre being there at ``column``."""
    inputs.lane[of(agent, column)] = 1
    drift = np.linspace(0.0, 1.6, 12, endpoint=False)
    inputs.offset[of(agent, column - 12, column)] = drift
    inputs.offset[of(agent, column, column + 12)] = drift - 1.6


def test_one_lane_change_is_no_weaving_two_are():
    inputs = scene()
    change(inputs, 0, 200)
    assert Trait.WEAVING not in traits_of(inputs)
    inputs.lane[of(0, 300)] = 2
    assert Trait.WEAVING in traits_of(inputs)
    inputs.edge[of(0, 300)] = 1  # onto the next road: no lane change
    assert Trait.WEAVING not in traits_of(inputs)


@pytest.mark.parametrize(("gap", "found"), [(6.0, True), (14.0, False)])
def test_cutting_in_is_told_by_the_headway_left_when_the_box_touches_the_lane(gap, found):
    inputs = scene()
    change(inputs, 0, 200)
    inputs.lane[of(1)] = 1
    follow(inputs, 0, 1, 200, T, gap)
    shown = DETECTORS[Trait.CUTTING_IN](inputs)
    assert bool(shown) is found
    if found:
        assert shown[0].value == pytest.approx(0.6)
        assert shown[0].other == 1
        assert shown[0].begin_s < 20.0 < shown[0].end_s + 0.2


def test_a_gap_that_opened_during_the_change_counts_as_it_was_at_the_touch():
    inputs = scene()
    change(inputs, 0, 200)
    inputs.lane[of(1)] = 1
    follow(inputs, 0, 1, 200, T, 11.0)
    inputs.speed[of(0, 150, 200)] = 18.0  # 8 m/s faster, about 0.6 s from touching to the centre
    shown = DETECTORS[Trait.CUTTING_IN](inputs)
    assert shown
    assert shown[0].value < 0.8


def test_overtaking_means_passing_the_former_leader():
    inputs = scene()
    follow(inputs, 1, 0, 0, 200, 15.0)
    change(inputs, 0, 200)
    assert Trait.OVERTAKING not in traits_of(inputs)
    inputs.speed[of(0, 200)] = 14.0  # 4 m/s faster: 24 m are made up in 6 s
    found = DETECTORS[Trait.OVERTAKING](inputs)
    assert [(e.agent, e.other) for e in found] == [(0, 1)]
    assert found[0].end_s - found[0].begin_s == pytest.approx(6.0, abs=0.3)


def test_wrong_direction_measures_metres():
    inputs = scene()
    inputs.lane_heading[of(0, 100, 200)] = np.pi
    found = DETECTORS[Trait.WRONG_DIRECTION](inputs)
    assert [(e.agent, round(e.value)) for e in found] == [(0, 100)]


@pytest.mark.parametrize("flag", ["off_crossing", "on_red"])
def test_only_pedestrians_jaywalk(flag):
    inputs = scene()
    getattr(inputs, flag)[of(0, 100, 150)] = True
    assert not DETECTORS[Trait.JAYWALKING](inputs)
    inputs.drives[0] = False
    assert DETECTORS[Trait.JAYWALKING](inputs)[0].value == pytest.approx(5.0)


def test_rules_kept_and_broken():
    kept, broken = RuleEncounter(0, 5.0, True), RuleEncounter(0, 9.0, False)
    good = dataclasses.replace(scene(), encounters=(kept,))
    bad = dataclasses.replace(scene(), encounters=(kept, broken))
    assert Trait.FOLLOWING_RULES in traits_of(good)
    assert traits_of(bad) & {Trait.FOLLOWING_RULES, Trait.BREAKING_RULES} == {Trait.BREAKING_RULES}


def test_stopping_needs_to_be_unprovoked():
    inputs = scene()
    inputs.speed[of(0, 200, 260)] = 0.0
    assert {Trait.NOT_MOVING, Trait.SLOWING} <= traits_of(inputs)
    for name, value in (("gap", 10.0), ("stop_distance", 20.0)):
        reason = scene()
        reason.speed[of(0, 200, 260)] = 0.0
        getattr(reason, name)[of(0)] = value
        assert not traits_of(reason) & {Trait.NOT_MOVING, Trait.SLOWING}


def test_waiting_at_a_crossing():
    inputs = scene()
    inputs.speed[of(0, 200, 260)] = 0.0
    inputs.crossing_distance[of(0)], inputs.crossing_used[of(0)] = 3.0, True
    found = DETECTORS[Trait.WAITING](inputs)
    assert [round(e.value, 1) for e in found] == [6.0]
    assert Trait.NOT_MOVING not in traits_of(inputs)


def test_keeping_the_leader():
    inputs = scene()
    follow(inputs, 1, 0, 0, T, 25.0)
    assert Trait.KEEPING_NEIGHBORS in traits_of(inputs)
    inputs.leader[:T:100] = -1
    assert Trait.KEEPING_NEIGHBORS not in traits_of(inputs)


def test_runs_find_stretches_at_both_ends_and_end_with_an_agent_or_a_gap():
    inputs = RowIndex.of(np.array([[1, 1, 1, 1], [1, 1, 0, 1]], dtype=bool))
    flags = np.array([1, 1, 0, 1, 1, 1, 1], dtype=bool)
    assert [(run.start, run.stop) for run in inputs.runs(flags)] == [(0, 2), (3, 4), (4, 6), (6, 7)]
    assert [(run.start, run.stop) for run in inputs.runs(flags, 2)] == [(0, 2), (4, 6)]
    assert list(inputs.runs(np.zeros(7, dtype=bool))) == []
    assert [run.start for run in inputs.runs(np.arange(7) == 2)] == [2]  # not where a track begins


def test_what_lies_in_a_gap_is_no_lane_change_and_no_cutting_in():
    whole = scene()
    change(whole, 0, 200)
    whole.lane[of(1)] = 1
    follow(whole, 0, 1, 200, T, 6.0)
    assert lane_changes(whole).tolist() == [200]
    assert DETECTORS[Trait.CUTTING_IN](whole)
    for agent, changes in ((0, 0), (1, 1)):  # who is not inputs just before
        valid = np.ones((2, T), dtype=bool)
        valid[agent, 199] = False
        kept = valid.reshape(-1)
        number = np.where(kept, np.cumsum(kept) - 1, -1)
        inputs = dataclasses.replace(
            whole,
            row_index=RowIndex.of(valid),
            **{
                name: getattr(whole, name)[kept]
                for name in DetectorInputs.__dataclass_fields__
                if getattr(getattr(whole, name), "shape", ()) == (2 * T,)
            },
        )
        for rows in (inputs.leader, inputs.follower):
            rows[:] = np.where(rows >= 0, number[rows], -1)
        assert lane_changes(inputs).size == changes
        assert not DETECTORS[Trait.CUTTING_IN](inputs)


def test_shown_traits_come_in_order_of_time():
    inputs = scene()
    inputs.speed[of(0, 300, 400)], inputs.speed[of(1, 100, 200)] = 17.0, 17.0
    begins = [e.begin_s for e in detect(inputs)]
    assert begins == sorted(begins)


def test_shown_label_takes_the_majority_inside_one_parent_class():
    def many(trait, count, seconds=0.0):
        return [ShownTrait(trait, 0, 0.0, seconds, 1.0)] * count

    impatient = many(Trait.OVERTAKING, 3) + many(Trait.WEAVING, 2) + many(Trait.CUTTING_IN, 1)
    assert label_from_traits(impatient) is Behavior.IMPATIENT
    assert label_from_traits(many(Trait.WAITING, 1)) is Behavior.CAUTIOUS
    assert label_from_traits(many(Trait.WAITING, 1) + many(Trait.CUTTING_IN, 1)) is None
    assert characteristic_traits(many(Trait.OVERTAKING, 2)) == ()
