"""The drivers of a place, and what they say of its level."""

import numpy as np
import pytest

from graphrqi.place_level import LEVEL_INPUTS, MEMORY_S, NUMBERS, PlaceDrivers, level_inputs


def place_of(log_odds, seconds=20.0):
    found = PlaceDrivers()
    odds = np.asarray(log_odds, dtype=float)
    found.observe(0.0, np.arange(odds.size), odds, np.full(odds.size, seconds))
    return found


def test_a_driver_counts_once_with_its_last_answer():
    place = place_of([5.0, 5.0])
    place.observe(1.0, np.array([1, 2]), np.array([-1.0, -1.0]), np.full(2, 20.0))
    assert sorted(place.log_odds.tolist()) == [-1.0, -1.0, 5.0]


def test_drivers_are_forgotten():
    place = place_of([5.0, 5.0])
    place.observe(MEMORY_S + 1.0, np.array([7]), np.array([0.0]), np.array([1.0]))
    assert place.log_odds.tolist() == [0.0]


@pytest.mark.parametrize("level", [-2.0, 0.0, 3.0])
def test_the_level_of_a_place_does_not_matter_beside_others(level):
    odds = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    beside = place_of(odds + level).beside_others(odds + level, np.full(5, 20.0))
    np.testing.assert_allclose(beside, place_of(odds).beside_others(odds, np.full(5, 20.0)))
    assert (np.diff(beside) > 0.0).all()
    assert beside[2] == 0.0


def test_alike_drivers_are_not_told_apart():
    odds = np.linspace(2.0, 2.1, 11)
    assert np.abs(place_of(odds).beside_others(odds, np.full(11, 20.0))).max() < 0.3


def test_two_groups_are_cut_between():
    numbers = dict(zip(NUMBERS, place_of([0.9, 1.0, 1.1, 4.9, 5.0, 5.1]).numbers(), strict=True))
    assert 1.1 < numbers["cut"] < 4.9
    assert numbers["separation"] > 0.95
    assert numbers["mean below cut"] == pytest.approx(1.0)
    assert numbers["share aggressive"] == pytest.approx(1.0)


@pytest.mark.parametrize("drivers", [1, 2, 3, 50])
def test_inputs_of_any_number_of_drivers_are_finite(drivers):
    odds = np.linspace(-9.2, 9.2, drivers)
    place = place_of(odds, seconds=0.0)
    inputs = level_inputs(odds, np.zeros(drivers), place.numbers())
    assert inputs.shape == (drivers, LEVEL_INPUTS)
    assert np.isfinite(inputs).all()
