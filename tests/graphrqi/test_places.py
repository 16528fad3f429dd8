"""The drivers of a place, and the network that sees each among the others."""

import numpy as np
import pytest

from graphrqi.places.network import (
    FULL_WEIGHT_S,
    LEAST_WEIGHT_S,
    PlaceDrivers,
    PlaceNetwork,
    beside_others,
)
from graphrqi.places.training import NetworkOptions, train_place_network
from graphrqi.posterior import AGGRESSIVE
from graphrqi.samples import Samples

SMALL = NetworkOptions(members=1, own=24, shown=8, joint=16, dropout=0.0, passes=50)


def place_of(values, seconds=20.0):
    numbers = np.asarray(values, dtype=float).reshape(len(values), -1)
    found = PlaceDrivers(numbers.shape[1])
    found.observe(0.0, np.arange(len(numbers)), numbers, np.full(len(numbers), seconds))
    return found


def test_a_driver_counts_once_with_its_last_numbers():
    place = place_of([5.0, 5.0])
    place.observe(1.0, np.array([1, 2]), np.array([[-1.0], [-2.0]]), np.array([40.0, 0.0]))
    assert sorted(place.values.ravel().tolist()) == [-2.0, -1.0, 5.0]
    assert sorted(place.weights.tolist()) == [LEAST_WEIGHT_S, FULL_WEIGHT_S, FULL_WEIGHT_S]


def test_the_level_of_few_drivers_is_held_near_what_is_usual():
    odds = np.array([3.0, 4.0])
    beside = beside_others(odds, np.full(2, 20.0), place_of(odds))
    assert (beside > 0.0).all()
    assert (beside < 1.0).all()


@pytest.mark.parametrize("drivers", [3, 11, 100, 400])
def test_alike_drivers_are_not_told_apart(drivers):
    odds = np.linspace(3.0, 3.1, drivers)
    beside = beside_others(odds, np.full(drivers, 20.0), place_of(odds))
    assert np.ptp(beside) < 0.25
    assert np.abs(beside).max() < 1.0


def offset_places(count, seed, drivers=24):
    """Places whose drivers' single number is their class, and an offset of the whole place."""
    rng = np.random.default_rng(seed)
    codes = rng.integers(0, 6, (count, drivers)).astype(np.int8)
    numbers = codes + rng.normal(0.0, 6.0, (count, 1)) + rng.normal(0.0, 0.2, codes.shape)
    features = np.stack([numbers.ravel(), np.zeros(codes.size)], axis=1).astype(np.float32)
    n = codes.size
    return Samples(
        features=features, codes=codes.ravel(), episode=np.repeat(np.arange(count), drivers),
        agent=np.tile(np.arange(drivers), count), time_s=np.full(n, 9.0), seconds=np.full(n, 9.0),
        window_s=np.full(n, np.inf), moving=np.ones(n, dtype=bool),
    )  # fmt: skip


@pytest.fixture(scope="module")
def network():
    return train_place_network(offset_places(120, 0), options=SMALL)


def styles_right(network, samples):
    right = []
    for number in np.unique(samples.episode):
        here = samples.where(samples.episode == number)
        described = network.described(here.features.astype(float))
        place = PlaceDrivers(network.width)
        place.observe(9.0, here.agent, network.shown(described), here.seconds)
        answer = network.among(described, place)
        assert np.allclose(answer.sum(axis=1), 1.0)
        right.append((answer[:, AGGRESSIVE].sum(axis=1) > 0.5) == AGGRESSIVE[here.codes])
    return float(np.concatenate(right).mean())


def test_the_level_of_a_place_is_told_from_its_drivers(network):
    """One by one nobody could: the offset is twice as large as what classes differ by."""
    unseen = offset_places(40, 2)
    alone = network.alone(network.described(unseen.features.astype(float)))
    one_by_one = (alone[:, AGGRESSIVE].sum(axis=1) > 0.5) == AGGRESSIVE[unseen.codes]
    among = styles_right(network, unseen)
    assert among > 0.9
    assert among > one_by_one.mean() + 0.15


def test_what_is_saved_answers_as_before(network):
    again = PlaceNetwork.restored(network.arrays(), 2, 6)
    features = offset_places(3, 4).features.astype(float)
    answers = [n.alone(n.described(features)) for n in (again, network)]
    assert np.allclose(*answers, atol=1e-6)
