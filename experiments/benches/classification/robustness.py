"""How far each disturbance, a long-tailed mix and wrong labels hurt."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from behaviors.labels import BEHAVIORS
from experiments.benches.classification.recordings import MAIN_S, Disturbed, Recordings
from experiments.benches.classification.rows import keys_of, posterior, score_rows
from experiments.benches.statistics import majority_of
from experiments.data.disturbances import DISTURBANCES
from experiments.score.rows import Row
from graphrqi.methods import Model, train
from graphrqi.samples import WINDOWS_S, Samples

LONG_TAIL: Final = (53, 13, 52, 266, 2, 6)
"""Agents of each behaviour in the annotated TRAF videos, in the order of ``BEHAVIORS``."""


TRAINED_WITH: Final = ("position noise",)
"""Disturbances that are also trained with: what every sensor has."""


WRONG_LABELS: Final = (0.1, 0.3)
"""Shares of training drivers whose label is replaced by another one."""


def long_tailed(samples: Samples, seed: int) -> Samples:
    """As many drivers of each behaviour as in TRAF, in proportion."""
    rng = np.random.default_rng(seed)
    driver = samples.episode * 10**9 + samples.agent
    drivers, first = np.unique(driver, return_index=True)
    codes = samples.codes[first]
    count = np.bincount(codes, minlength=len(BEHAVIORS))
    share = np.array(LONG_TAIL) / sum(LONG_TAIL)
    wanted = np.maximum(np.floor(share * (count / share).min()), 1).astype(np.int64)
    if wanted.sum() < 60:  # the rarest class decides; keep the most frequent one whole instead
        wanted = np.maximum(np.round(share / share.max() * count.max()), 1).astype(np.int64)
    kept = [
        rng.permutation(drivers[codes == code])[: wanted[code]] for code in range(len(BEHAVIORS))
    ]
    return samples.where(np.isin(driver, np.concatenate(kept)))


def mislabelled(samples: Samples, share: float, seed: int) -> Samples:
    """A share of the drivers gets another label."""
    rng = np.random.default_rng(seed)
    driver = samples.episode * 10**9 + samples.agent
    drivers, inverse = np.unique(driver, return_inverse=True)
    shift = np.where(
        rng.random(drivers.size) < share, rng.integers(1, len(BEHAVIORS), drivers.size), 0
    )
    codes = (samples.codes + shift[inverse]) % len(BEHAVIORS)
    return dataclasses.replace(samples, codes=codes.astype(np.int8))


def robustness(
    recordings: Recordings, methods: Sequence[str], levels: int | None = None
) -> list[Row]:
    """Each disturbance at each level, unknown and known in training; long tails; wrong labels."""
    rows: list[Row] = []

    def add(model: Model, majority: int, samples: Samples, variation: str) -> None:
        for scenario in recordings.dataset.scenarios:
            here = recordings.of(scenario, samples)
            if len(here):
                keys = keys_of("robustness", scenario, model.method.name, MAIN_S, variation)
                rows.extend(score_rows(here, posterior(model, here), majority, keys))

    for name, (_, every_level, _) in DISTURBANCES.items():
        for level in every_level[:levels]:
            disturbed = Disturbed(name, level)
            longest = min(level, MAIN_S) if name == "cut tracks" else MAIN_S
            window_s = max((w for w in WINDOWS_S if w < longest), default=1.0)
            windows_s = (window_s if longest < MAIN_S else MAIN_S,)
            for method in methods:
                clean, majority = recordings.fitted(method)
                test = recordings.scored(method, windows_s, disturbed)
                about = str(disturbed)
                if windows_s != (MAIN_S,):
                    about += f", windows of {windows_s[0]:g} s"
                add(clean, majority, test, about)
                if name not in TRAINED_WITH:
                    continue
                known, majority = recordings.fitted(method, disturbed=disturbed)
                add(known, majority, test, f"{about}, trained with it")
    for method in methods:
        training, test = recordings.training(method), recordings.scored(method)
        validation = recordings.validation(method)
        clean, _ = recordings.fitted(method)
        tailed = long_tailed(test, 0)
        add(clean, majority_of(training), tailed, "long-tailed mix")
        rare = long_tailed(training, 1)
        add(
            train(method, rare, validation),
            majority_of(rare),
            tailed,
            "long-tailed mix, trained so",
        )
        for share in WRONG_LABELS[:levels]:
            wrong = mislabelled(training, share, 2)
            add(train(method, wrong, validation), majority_of(wrong), test,
                f"{share:g} of training drivers mislabelled")  # fmt: skip
    return rows
