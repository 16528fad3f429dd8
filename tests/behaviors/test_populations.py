"""Populations: drivers drawn from one look like it, files are read whole or refused in one line."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, PROFILES, Behavior
from behaviors.populations import (
    POPULATION_FIELDS,
    POPULATIONS,
    Around,
    Population,
    read_population,
)
from behaviors.profiles import PROFILE_FIELDS

CORRELATION = np.array(
    [
        [1.0, 0.1, 0.0, 0.2, 0.0],
        [0.1, 1.0, 0.3, -0.4, 0.0],
        [0.0, 0.3, 1.0, -0.2, 0.1],
        [0.2, -0.4, -0.2, 1.0, 0.3],
        [0.0, 0.0, 0.1, 0.3, 1.0],
    ]
)
PEOPLE = Population(
    "road", "an example", "idm", 60, np.array([30.0, 1.6, 2.9, 1.4, 2.0]),
    np.array([0.12, 0.35, 0.4, 0.3, 0.25]), CORRELATION,
)  # fmt: skip
DRIVERS = 3000


def told_logs(population: Population, behavior: Behavior, count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng((seed, BEHAVIORS.index(behavior)))
    drawn = [population.draw(behavior, rng, 0.15) for _ in range(count)]
    return np.log([[getattr(one, name) for name in POPULATION_FIELDS] for one in drawn])


def test_all_behaviours_together_have_the_populations_medians_and_spreads() -> None:
    logs = np.concatenate([told_logs(PEOPLE, b, DRIVERS // 6, 0) for b in BEHAVIORS])
    np.testing.assert_allclose(logs.std(axis=0), PEOPLE.log_spread, rtol=0.06)
    np.testing.assert_allclose(logs.mean(axis=0)[1:], np.log(PEOPLE.median)[1:], atol=0.03)
    usual = np.mean(np.log([PROFILES[b].speed_factor for b in BEHAVIORS]))
    assert logs[:, 0].mean() == pytest.approx(usual, abs=0.02)


@pytest.mark.parametrize("around", Around)
def test_drivers_of_one_behaviour_correlate_as_the_population_says(around: Around) -> None:
    population = dataclasses.replace(PEOPLE, around=around)
    logs = told_logs(population, Behavior.CAREFUL, DRIVERS, 1)
    np.testing.assert_allclose(np.corrcoef(logs.T), CORRELATION, atol=0.06)
    if around is Around.PROFILES:
        median = [getattr(PROFILES[Behavior.CAREFUL], name) for name in POPULATION_FIELDS]
        np.testing.assert_allclose(np.exp(np.median(logs, axis=0)), median, rtol=0.04)
        np.testing.assert_allclose(logs.std(axis=0), PEOPLE.log_spread, rtol=0.06)


def test_the_behaviours_keep_their_order_in_a_population() -> None:
    drawn = {b: PEOPLE.draw(b, np.random.default_rng(0), spread=0.0) for b in BEHAVIORS}
    for name in POPULATION_FIELDS:
        for one, other in itertools.combinations(BEHAVIORS, 2):
            before = getattr(PROFILES[one], name) - getattr(PROFILES[other], name)
            assert before * (getattr(drawn[one], name) - getattr(drawn[other], name)) > 0
    for behavior, name in itertools.product(BEHAVIORS, PROFILE_FIELDS):
        if name not in POPULATION_FIELDS:
            assert getattr(drawn[behavior], name) == getattr(PROFILES[behavior], name)


def test_a_file_holds_a_population_whole(tmp_path: Path) -> None:
    path = tmp_path / "people.toml"
    path.write_text(PEOPLE.to_toml())
    read = read_population(path)
    assert read.table() == PEOPLE.table() == tomllib.loads(PEOPLE.to_toml())
    assert read_population(read.table()).to_toml() == PEOPLE.to_toml()
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    assert read.option == PEOPLE.option == {"name": "road", "sha256": sha256}


@pytest.mark.parametrize("name", POPULATIONS)
def test_what_ships_is_written_as_it_would_be_again(name: str) -> None:
    population = read_population(name)
    assert population.name == name
    assert population.to_toml() == POPULATIONS[name].read_text()
    for behavior in BEHAVIORS:
        population.draw(behavior, np.random.default_rng(0), 0.15)


def _changed(**change: Any) -> dict[str, Any]:
    return {**PEOPLE.table(), **change}


def _number(**change: Any) -> dict[str, Any]:
    table = PEOPLE.table()
    table["numbers"]["min_gap_m"] |= change
    return table


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (_changed(schema_version=2), "schema_version: found 2, expected 1"),
        (_changed(colour="red"), "unknown key 'colour'"),
        (_changed(around="nobody"), "around: found 'nobody', expected population or profiles"),
        (_changed(numbers={}), "numbers.desired_speed_mps: found none"),
        (_number(median=0.0), "min_gap_m.median: found 0, expected 0.1 to 20"),
        (_number(median=float("nan")), "median: found numbers that are not finite"),
        (_number(log_spread=-0.1), "log_spread: found"),
        (_number(correlation=[1.0]), "correlation: found [1.0], expected 5 numbers"),
        (_number(correlation=[0.9, 0.3, 1.0, 0, 0]), "correlation: found not a correlation matrix"),
    ],
)
def test_a_broken_table_is_refused_by_its_key(table: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as caught:
        read_population(table)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
