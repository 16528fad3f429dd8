"""The drivers of a place, and the network that sees each among the others."""

import numpy as np
import pytest

from behaviors.errors import InputError
from graphrqi.places.drivers import FULL_WEIGHT_S, LEAST_WEIGHT_S, MEMORY_S, PlaceDrivers
from graphrqi.places.network import PlaceNetwork
from graphrqi.places.people import beside_others
from graphrqi.places.training import Examples, NetworkOptions, train_place_network
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


def test_drivers_are_forgotten():
    place = place_of([5.0, 5.0])
    place.observe(MEMORY_S + 1.0, np.array([7]), np.array([[0.0]]), np.array([1.0]))
    assert place.values.tolist() == [[0.0]]


@pytest.mark.parametrize("level", [-2.0, 3.0])
def test_the_level_of_a_place_with_many_drivers_hardly_matters(level):
    odds = np.linspace(-5.0, 5.0, 201)
    seconds = np.full(odds.size, 20.0)
    beside = beside_others(odds + level, seconds, place_of(odds + level))
    np.testing.assert_allclose(beside, beside_others(odds, seconds, place_of(odds)), atol=0.1)
    assert (np.diff(beside) > 0.0).all()
    assert abs(beside[100]) < 0.1


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


def test_neither_order_nor_number_of_the_others_must_fit(network):
    here = offset_places(1, 3)
    described = network.described(here.features.astype(float))
    shown, order = network.shown(described), np.random.default_rng(0).permutation(len(here))
    answers = []
    for rows in (np.arange(len(here)), order, np.tile(order, 3)):
        place = PlaceDrivers(network.width)
        place.observe(0.0, np.arange(rows.size), shown[rows], np.full(rows.size, 9.0))
        answers.append(network.among(described, place))
    assert np.allclose(answers[0], answers[1], atol=1e-6)
    assert np.abs(answers[0] - answers[2]).mean() < 0.1


def test_the_same_seed_trains_the_same_network(network):
    again = train_place_network(offset_places(120, 0), options=SMALL).arrays()
    assert all(np.array_equal(again[name], value) for name, value in network.arrays().items())


def test_what_is_saved_answers_as_before(network):
    again = PlaceNetwork.restored(network.arrays(), 2, 6)
    features = offset_places(3, 4).features.astype(float)
    answers = [n.alone(n.described(features)) for n in (again, network)]
    assert np.allclose(*answers, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("member0.own.weight", np.zeros((3, 24), np.float32), "own.weight: found shape"),
        ("member0.joint.bias", None, "joint.bias: found no such array"),
        ("member0.answer.bias", np.full(6, np.nan, np.float32), "expected finite numbers"),
        ("scale", np.zeros(2, np.float32), "scale: found 0"),
    ],
)
def test_arrays_that_are_no_network_are_refused(network, name, value, said):
    arrays = {**network.arrays(), name: value}
    if value is None:
        del arrays[name]
    with pytest.raises(InputError, match=said):
        PlaceNetwork.restored(arrays, 2, 6)


def test_an_example_has_the_last_that_is_known_of_each_driver():
    samples = Samples(
        features=np.arange(5, dtype=np.float32)[:, None], codes=np.zeros(5, np.int8),
        episode=np.zeros(5, np.int64), agent=np.array([1, 1, 2, 2, 3]),
        time_s=np.array([0.0, 6.0, 0.0, 12.0, 12.0]), seconds=np.ones(5),
        window_s=np.full(5, np.inf), moving=np.ones(5, dtype=bool),
    )  # fmt: skip
    examples = Examples(samples)
    (place,) = examples.places
    assert examples.moments(place).tolist() == [0.0, 6.0, 12.0]
    assert [examples.latest(place, t).tolist() for t in (0.0, 6.0, 12.0)] == [
        [0, 2], [1, 2], [1, 3, 4],
    ]  # fmt: skip
