"""How a model answers in traffic unlike that which it was trained on.

A classifier that is trained on one simulator is right at home and surely wrong elsewhere: it takes
another law of driving, another limit or a noisy sensor for another behaviour. `Elsewhere` holds two
more classifiers, on features that are relative to the scene and smoothed: one for home traffic that
is seen badly (with noise, at other frame rates, with gaps), and one for foreign traffic, trained on
many random worlds. A gate tells from the numbers of the whole scene how likely each of the three
is. The answer is the average of the three classifiers with the gate's probabilities as weights.
Where a scene lies outside everything that was trained on, the answer goes towards equal chances.

References:
    Jacobs, Jordan, Nowlan, Hinton (1991), Adaptive mixtures of local experts, Neural Computation 3,
    79: the gate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.classify import Classifier, make_classifier, restore_classifier
from graphrqi.classify.checks import part_of, saved
from graphrqi.classify.contract import CodeArray
from graphrqi.features.relative.observer import SCENE_NAMES, RelativeObserver
from graphrqi.samples import Samples

FloatArray = NDArray[np.float64]

NETWORK: Final[dict[str, Any]] = {
    "hidden": (192, 96), "dropout": 0.3, "epochs": 14, "weight_decay": 1e-2,
}  # fmt: skip
"""Options of the perceptrons."""

OPTIONS: Final[dict[str, Any]] = {
    "trees": {"rounds": 300, "max_leaves": 15, "max_depth": 6, "feature_share": 0.15},
    "network": NETWORK,
}
"""Options of the classifier of foreign traffic. Its trees are smaller than at home: these hold
better in worlds that are not trained on."""

SEEN_BADLY_OPTIONS: Final[dict[str, Any]] = {
    "trees": {"rounds": 300, "max_leaves": 31, "max_depth": 7, "feature_share": 0.15},
    "network": NETWORK,
}
"""Options of the classifier of home traffic that is seen badly."""

HOME, SEEN_BADLY, FOREIGN = range(3)
"""Kinds of traffic, in the order of the gate's answers."""

GATE_OPTIONS: Final[dict[str, Any]] = {
    "rounds": 60,
    "max_leaves": 8,
    "max_depth": 4,
    "feature_share": 0.5,
    "learning_rate": 0.1,
}
"""Options of the gate's classifier: few numbers, a few thousand scenes."""

SURE: Final = 0.05
"""A kind of traffic that is less likely than this is left out, so that mostly one classifier
answers."""

RANGE: Final = 0.002
"""Share of the training scenes beyond each end of a number's range."""

FARTHEST: Final = 0.5
"""Distance outside the range, in lengths of the range, at which nothing is known."""

_SCENE: Final = slice(-1 - len(SCENE_NAMES), -1)
"""Columns of the scene's numbers among the relative features."""


@dataclass(frozen=True, slots=True)
class Elsewhere:
    """Classifiers for traffic that is not as at home, and what tells it from home.

    Attributes:
        seen_badly: answers on relative features (n, F) of home traffic that is seen badly.
        foreign: answers on those of foreign traffic.
        gate: answers on scenes (n, S) which kind of traffic they show.
        low: (S,) lower ends of the range of the numbers of scenes in training.
        high: (S,) upper ends.
        card: training data and scores, as JSON values.
    """

    seen_badly: Classifier
    foreign: Classifier
    gate: Classifier
    low: FloatArray
    high: FloatArray
    card: Mapping[str, Any]

    def kinds(self, relative: FloatArray) -> FloatArray:
        """(n, 3) probability that the traffic is home's, home's seen badly, or foreign.

        Args:
            relative: (n, F) relative features. Drivers of one scene have the same scene's numbers.
        """
        if not len(relative):
            return np.zeros((0, 3))
        scenes = relative[:, _SCENE]
        back = np.zeros(len(relative), dtype=np.int64)
        if (scenes == scenes[0]).all():  # the drivers of one scene, as in a stream
            scenes = scenes[:1]
        else:
            scenes, back = np.unique(scenes, axis=0, return_inverse=True)
        found = self.gate.posterior(np.ascontiguousarray(scenes))
        found = np.where(found < SURE, 0.0, found)
        novelty = self._novelty(scenes)[:, None]
        found = (1.0 - novelty) * found / found.sum(axis=1, keepdims=True)
        found[:, FOREIGN] += novelty[:, 0]
        return np.asarray(np.clip(found, 0.0, 1.0)[back.ravel()])

    def _novelty(self, scenes: FloatArray) -> FloatArray:
        """(n,) how far scenes lie outside the training's range: 0 within, 1 far beyond."""
        length = self.high - self.low
        outside = np.maximum(np.maximum(self.low - scenes, scenes - self.high), 0.0)
        far = (outside / np.where(length > 0.0, length, 1.0)).max(axis=1, initial=0.0)
        return np.asarray(np.minimum(far / FARTHEST, 1.0))

    def answers(self, relative: FloatArray, kinds: FloatArray) -> FloatArray:
        """(n, 6) the sum of both classifiers' probabilities, each times that of its kind.

        Args:
            relative: (n, F) relative features.
            kinds: (n, 3) as from `kinds`; rows of the answer sum to one minus the first column.
        """
        out = np.zeros((len(relative), len(BEHAVIORS)))
        for kind, classifier in ((SEEN_BADLY, self.seen_badly), (FOREIGN, self.foreign)):
            asked = kinds[:, kind] > 0.0
            if asked.any():
                inputs = np.ascontiguousarray(relative[asked])
                known = classifier.posterior(inputs)
                far = self._novelty(inputs[:, _SCENE])[:, None]
                known = (1.0 - far) * known + far / len(BEHAVIORS)
                out[asked] += kinds[asked, kind, None] * known
        return out

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What was learned, to be saved."""
        parts = {"seen_badly": self.seen_badly, "foreign": self.foreign, "gate": self.gate}
        learned = {
            f"{part}.{name}": value
            for part, classifier in parts.items()
            for name, value in classifier.arrays().items()
        }
        return {"low": self.low, "high": self.high, **learned}

    @classmethod
    def restored(cls, arrays: dict[str, NDArray[Any]], card: Mapping[str, Any]) -> Elsewhere:
        """From what was saved.

        Raises:
            InputError: if the arrays are not those of `arrays`.
        """
        low, high = (saved(arrays, name, (len(SCENE_NAMES),)) for name in ("low", "high"))
        if not (low <= high).all():
            raise InputError("low, high: found ends in the wrong order, expected low <= high")
        features, behaviors = len(RelativeObserver.feature_names), len(BEHAVIORS)
        parts = (
            ("seen_badly", "averaged", behaviors, features, SEEN_BADLY_OPTIONS),
            ("foreign", "averaged", behaviors, features, OPTIONS),
            ("gate", "boosted", 3, len(SCENE_NAMES), GATE_OPTIONS),
        )
        seen_badly, foreign, gate = (
            restore_classifier(kind, classes, inputs, options, part_of(arrays, name))
            for name, kind, classes, inputs, options in parts
        )
        return cls(seen_badly, foreign, gate, low, high, card)


def train_elsewhere(
    training: Samples,
    validation: Samples | None,
    kinds: tuple[CodeArray, CodeArray | None],
    seed: int = 0,
    card: Mapping[str, Any] | None = None,
) -> Elsewhere:
    """Learn from samples of home, of home seen badly, and of many worlds.

    The classifier of foreign traffic learns from all of them, that of home seen badly from home.

    Args:
        training: with the features of `RelativeObserver`.
        validation: the same of other episodes, for early stopping and calibration.
        kinds: the kind of traffic of each training and of each validation sample; every kind must
            occur in training.
        seed: the same seed and samples give the same answers.
        card: training data and scores.

    Returns:
        The classifiers and the gate.

    Raises:
        InputError: if a kind of traffic is missing.
    """
    found = set(kinds[0].tolist())
    if found != {HOME, SEEN_BADLY, FOREIGN}:
        raise InputError(f"kinds: found {sorted(found)}, expected samples of each of 0, 1, 2")
    learned = []
    for options, taught in (
        (SEEN_BADLY_OPTIONS, (HOME, SEEN_BADLY)),
        (OPTIONS, (HOME, SEEN_BADLY, FOREIGN)),
    ):
        held = None
        if validation is not None and kinds[1] is not None and np.isin(kinds[1], taught).any():
            part = validation.where(np.isin(kinds[1], taught))
            held = (part.features.astype(np.float64), part.codes)
        part = training.where(np.isin(kinds[0], taught))
        classifier = make_classifier("averaged", len(BEHAVIORS), **options)
        classifier.fit(part.features.astype(np.float64), part.codes, held, seed)
        learned.append(classifier)
    scenes, shown = _balanced_scenes(training, kinds[0], seed)
    gate = make_classifier("boosted", 3, **GATE_OPTIONS)
    gate.fit(scenes, shown, None, seed)
    low, high = np.quantile(scenes, [RANGE, 1.0 - RANGE], axis=0)
    low[SCENE_NAMES.index("seconds")] = 0.0  # windows end some seconds after the first frame
    return Elsewhere(learned[0], learned[1], gate, low, high, dict(card or {}))


def _balanced_scenes(
    training: Samples, kinds: CodeArray, seed: int
) -> tuple[FloatArray, CodeArray]:
    """One row per scene and moment, as many of each kind."""
    moments = np.stack([training.episode, np.round(training.time_s * 100.0).astype(np.int64)])
    _, first = np.unique(moments, axis=1, return_index=True)
    rng = np.random.default_rng(seed)
    parts = [first[kinds[first] == kind] for kind in (HOME, SEEN_BADLY, FOREIGN)]
    most = max(part.size for part in parts)
    rows = np.concatenate([part if part.size == most else rng.choice(part, most) for part in parts])
    return training.features[rows][:, _SCENE].astype(np.float64), kinds[rows].astype(np.int8)
