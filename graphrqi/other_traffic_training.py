"""How a model learns to answer in traffic unlike that of its own classifier's training.

`graphrqi.other_traffic` says how it answers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from behaviors.errors import InputError
from graphrqi.classify.contract import CodeArray
from graphrqi.other_traffic import SECONDS, OtherTraffic, scene_of
from graphrqi.samples import Samples

EXACT, NOISY, OTHER = range(3)
"""Parts of the training: simulated traffic as it is, the same seen with noise, and worlds."""

RANGE: Final = 0.002
"""Share of the training scenes beyond each end of a number's range."""


def train_other_traffic(
    training: Samples,
    parts: CodeArray,
    seed: int = 0,
    card: Mapping[str, Any] | None = None,
    options: Mapping[str, Any] | None = None,
) -> OtherTraffic:
    """Learn from simulated traffic, from the same seen with noise, and from many worlds.

    Args:
        training: samples with the features of `RelativeObserver`, of drivers that are each seen
            since they appeared, several moments of each.
        parts: (n,) the part of the training of each sample; all three must occur.
        seed: the same seed and samples give the same answers.
        card: training data and scores.
        options: of the networks, see `graphrqi.places.training.NetworkOptions`.

    Returns:
        The networks, and the range of the scenes.

    Raises:
        InputError: if a part is missing.
    """
    from graphrqi.places.training import NetworkOptions, train_place_network

    found = set(parts.tolist())
    if found != {EXACT, NOISY, OTHER}:
        raise InputError(f"parts: found {sorted(found)}, expected samples of each of 0, 1, 2")
    asked = NetworkOptions(**(options or {}))
    noisy = train_place_network(training.where(parts != OTHER), seed, asked)
    other = train_place_network(training, seed, asked)
    scenes = scene_of(training.features.astype(np.float64))
    low, high = np.quantile(scenes, [RANGE, 1.0 - RANGE], axis=0)
    low[SECONDS] = 0.0  # windows end some seconds after the first frame
    return OtherTraffic(noisy, other, low, high, dict(card or {}))
