"""Prior shift: shares of classes are estimated from answers alone, and no driver counts twice."""

from __future__ import annotations

import numpy as np
import pytest

from graphrqi.places.prior_shift import PRIOR_DRIVERS, PriorShift

EQUAL = np.full(3, 1.0 / 3.0)


def drivers(n: int, mix: tuple[float, ...], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Codes drawn from a mix, and the exact posteriors of one noisy number under an equal mix."""
    rng = np.random.default_rng(seed)
    codes = rng.choice(3, n, p=mix)
    seen = codes + rng.normal(0.0, 0.7, n)
    likelihood = np.exp(-0.5 * ((seen[:, None] - np.arange(3)) / 0.7) ** 2)
    return codes, likelihood / likelihood.sum(axis=1, keepdims=True)


def shares(shift: PriorShift) -> np.ndarray:
    """The answer for a driver about whom nothing is known: the estimated shares."""
    return shift.corrected(EQUAL[None])[0]


def test_an_odd_mix_is_found_and_answers_gain_by_it():
    codes, answers = drivers(4000, (0.8, 0.15, 0.05), 0)
    shift = PriorShift(EQUAL)
    shift.observe(0.0, np.arange(4000), answers)
    np.testing.assert_allclose(shares(shift), (0.8, 0.15, 0.05), atol=0.03)
    right = [(p.argmax(axis=1) == codes).mean() for p in (answers, shift.corrected(answers))]
    assert right[1] > right[0] + 0.05


def test_few_drivers_change_little_and_the_usual_mix_nothing():
    few = PriorShift(EQUAL)
    few.observe(0.0, np.arange(3), drivers(3, (1.0, 0.0, 0.0), 1)[1])
    assert np.abs(shares(few) - EQUAL).max() <= 3.0 / PRIOR_DRIVERS
    usual = PriorShift(EQUAL)
    usual.observe(0.0, np.arange(3000), drivers(3000, tuple(EQUAL), 2)[1])
    np.testing.assert_allclose(shares(usual), EQUAL, atol=0.03)


def test_a_driver_counts_once_however_often_it_is_lost_and_after_it_left():
    _, answers = drivers(40, (0.9, 0.05, 0.05), 3)
    once, often = PriorShift(EQUAL), PriorShift(EQUAL)
    ids = np.arange(40)
    once.observe(0.0, ids, answers)
    for moment in range(20):
        here = (ids + moment) % 4 > 0  # a quarter is missing at every moment
        often.observe(float(moment), ids[here], answers[here])
    np.testing.assert_allclose(shares(often), shares(once), atol=2e-3)
    often.observe(1000.0, ids[:0], answers[:0])
    np.testing.assert_allclose(shares(often), shares(once), atol=2e-3)


def test_a_class_that_training_never_showed_stays_impossible():
    shift = PriorShift(np.array([0.5, 0.5, 0.0]))
    answers = np.array([[0.7, 0.3, 0.0], [0.4, 0.6, 0.0]])
    shift.observe(0.0, np.arange(2), answers)
    corrected = shift.corrected(answers)
    assert corrected[:, 2].tolist() == [0.0, 0.0]
    assert corrected.sum(axis=1) == pytest.approx([1.0, 1.0])
