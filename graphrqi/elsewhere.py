"""How a model answers in traffic unlike that which it was trained on.

A classifier that is trained on one simulator is right at home and surely wrong elsewhere: it takes
another law of driving, another limit or a noisy sensor for another behaviour. `Elsewhere` holds two
more classifiers, on features that are relative to the scene and smoothed: one for home traffic that
is seen badly (with noise, at other frame rates, with gaps), and one for foreign traffic, trained on
many random worlds. A gate tells from the numbers of the whole scene how likely each of the three
is, and whether the scene is simulated at all. The answer is the average of the classifiers with the
gate's probabilities as weights. In foreign simulations the answer about a driver is corrected by
what is said of all others there; among recorded people only their differences count
(`graphrqi.place_level`). Where a scene lies outside everything that was trained on, the answer goes
towards equal chances.

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
from graphrqi.features.observer import Observation
from graphrqi.features.relative.observer import SCENE_NAMES, RelativeObserver
from graphrqi.place_level import LEVEL_INPUTS, PlaceDrivers, level_inputs, log_odds_of, restyled
from graphrqi.posterior import AGGRESSIVE, aggressive_share
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

HOME, SEEN_BADLY, FOREIGN, RECORDED = range(4)
"""Kinds of traffic: as at home, home's seen badly, simulated by others, and recorded."""

GATE_OPTIONS: Final[dict[str, Any]] = {
    "rounds": 150,
    "max_leaves": 15,
    "max_depth": 6,
    "feature_share": 0.5,
    "learning_rate": 0.1,
}
"""Options of the classifier of the first three kinds: few numbers, some thousand scenes."""

RECORDED_OPTIONS: Final[dict[str, Any]] = {
    "rounds": 80, "max_leaves": 6, "min_leaf": 20, "feature_share": 0.4,
}  # fmt: skip
"""Options of the classifier that tells recorded scenes from simulated ones. It is small: places
that it was not trained on are then told from simulations, too."""

LEVEL_OPTIONS: Final[dict[str, Any]] = {
    "rounds": 120, "learning_rate": 0.05, "max_leaves": 8, "min_leaf": 100, "ridge": 10.0,
    "feature_share": 0.5,
}  # fmt: skip
"""Options of the classifier of styles from log-odds and the place's numbers: some 200 worlds."""

LEVEL_ROWS: Final = 20_000
"""Drivers and moments that it learns from, drawn so that crowded worlds do not outweigh others."""

SCENES_OF_A_KIND: Final = 6000
"""Most scenes of each kind that the gate learns from."""

MOST_DRIVERS: Final = 40.0
"""Drivers at once beyond which their number does not count for the gate: a city is no other kind of
traffic than a crossing."""

SURE: Final = 0.05
"""A kind of traffic that is less likely than this is left out, so that mostly one classifier
answers."""

RANGE: Final = 0.002
"""Share of the training scenes beyond each end of a number's range."""

FARTHEST: Final = 0.5
"""Distance outside the range, in lengths of the range, at which nothing is known."""

_SCENE: Final = slice(-1 - len(SCENE_NAMES), -1)
"""Columns of the scene's numbers among the relative features."""

BRISK: Final[dict[str, float]] = {
    "headway": -1.0, "law's headway": -1.0, "speed over pace": 1.0, "speed over place": 1.0,
    "speed over neighbours": 1.0, "acceleration": 1.0, "braking": 1.0, "standstill gap": -1.0,
    "gap while starting": -1.0,
}  # fmt: skip
"""Whether aggressive drivers have more or less of what is compared within a scene, by the meaning
of the behaviours."""

DEVIATIONS_WORTH: Final = 2.0
"""Log-odds for a mean deviation of one (our choice: the classifier's own log-odds still count for
more). Among people, what aggressive means in words counts beside what simulated drivers taught."""

_COMPARED_AT: Final = [
    RelativeObserver.feature_names.index(f"{name}, compared:mean") for name in BRISK
]
_EVIDENCE_AT: Final = [
    RelativeObserver.feature_names.index(f"{name}, compared:evidence") for name in BRISK
]

_DRIVERS: Final = SCENE_NAMES.index("drivers")

_OF_PEOPLE: Final = [
    column
    for column, name in enumerate(SCENE_NAMES)
    if name not in ("frame interval", "drivers", "seconds")
]
"""Numbers of a scene that tell recorded from simulated traffic; the others are those of cameras."""


@dataclass(frozen=True, slots=True)
class Elsewhere:
    """Classifiers for traffic that is not as at home, and what tells it from home.

    Attributes:
        seen_badly: answers on relative features (n, F) of home traffic that is seen badly.
        foreign: answers on those of foreign traffic.
        gate: answers on scenes (n, S) which of the first three kinds of traffic they show.
        recorded: answers on scenes whether they are simulated or recorded.
        level: gives the style from `graphrqi.place_level.level_inputs`; None if it was not learned.
        low: (S,) lower ends of the range of the numbers of scenes in training.
        high: (S,) upper ends.
        card: training data and scores, as JSON values.
    """

    seen_badly: Classifier
    foreign: Classifier
    gate: Classifier
    recorded: Classifier
    level: Classifier | None
    low: FloatArray
    high: FloatArray
    card: Mapping[str, Any]

    def kinds(self, relative: FloatArray) -> FloatArray:
        """(n, 4) probability of each kind of traffic.

        Args:
            relative: (n, F) relative features. Drivers of one scene have the same scene's numbers.
        """
        if not len(relative):
            return np.zeros((0, 4))
        scenes = _scene_of(relative)
        people = self.recorded.posterior(np.ascontiguousarray(scenes[:, _OF_PEOPLE]))[:, 1:]
        simulated = (1.0 - people) * self.gate.posterior(scenes)
        found = np.concatenate([simulated, people], axis=1)
        found = np.where(found < SURE, 0.0, found)
        novelty = self._novelty(scenes)[:, None]
        found = (1.0 - novelty) * found / found.sum(axis=1, keepdims=True)
        found[:, FOREIGN] += novelty[:, 0]
        return np.asarray(np.clip(found, 0.0, 1.0))

    def _novelty(self, scenes: FloatArray) -> FloatArray:
        """(n,) how far scenes lie outside the training's range: 0 within, 1 far beyond."""
        length = self.high - self.low
        outside = np.maximum(np.maximum(self.low - scenes, scenes - self.high), 0.0)
        far = (outside / np.where(length > 0.0, length, 1.0)).max(axis=1, initial=0.0)
        return np.asarray(np.minimum(far / FARTHEST, 1.0))

    def answers(self, relative: FloatArray, kinds: FloatArray) -> FloatArray:
        """(n, 6) the sum of the classifiers' probabilities, each times that of its kind.

        Of drivers one by one: what the others of their place are like is not used.

        Args:
            relative: (n, F) relative features.
            kinds: (n, 4) as from `kinds`; rows of the answer sum to one minus the first column.
        """
        out = np.zeros((len(relative), len(BEHAVIORS)))
        away = kinds[:, FOREIGN] + kinds[:, RECORDED]
        for share, classifier in ((kinds[:, SEEN_BADLY], self.seen_badly), (away, self.foreign)):
            asked = share > 0.0
            if asked.any():
                inputs = np.ascontiguousarray(relative[asked])
                out[asked] += share[asked, None] * self._held_back(
                    classifier.posterior(inputs), inputs
                )
        return out

    def answers_among(
        self,
        relative: FloatArray,
        kinds: FloatArray,
        seen: Observation,
        time_s: float,
        place: PlaceDrivers,
        people: PlaceDrivers,
    ) -> FloatArray:
        """(n, 6) as `answers`, of all drivers of one scene, each seen among the others.

        Args:
            relative: (n, F) relative features.
            kinds: (4,) probability of each kind of traffic.
            seen: the same drivers, and for how long each was watched.
            time_s: not earlier than at the call before.
            place: the drivers of the place so far by the classifier alone; these are added.
            people: the same by the classifier and by their deviations from the scene.
        """
        out = np.zeros((len(relative), len(BEHAVIORS)))
        if not len(relative):
            return out
        if kinds[SEEN_BADLY] > 0.0:
            out += kinds[SEEN_BADLY] * self.seen_badly.posterior(relative)
        away = float(kinds[FOREIGN] + kinds[RECORDED])
        if away > 0.0:
            found = self.foreign.posterior(relative)
            odds = log_odds_of(aggressive_share(found))
            place.observe(time_s, seen.ids, odds, seen.seconds)
            style = kinds[FOREIGN] * self._leveled(odds, seen.seconds, place)
            unlike = odds + DEVIATIONS_WORTH * _deviation(relative)
            people.observe(time_s, seen.ids, unlike, seen.seconds)
            beside = people.beside_others(unlike, seen.seconds)
            style += kinds[RECORDED] / (1.0 + np.exp(-beside))
            out += away * restyled(found, style / away, AGGRESSIVE)
        total = out.sum(axis=1, keepdims=True)
        held = self._held_back(out / np.where(total > 0.0, total, 1.0), relative)
        return np.asarray(held * total)

    def _leveled(self, odds: FloatArray, seconds: FloatArray, place: PlaceDrivers) -> FloatArray:
        """(n,) probability of the aggressive style in simulated traffic."""
        if self.level is None:
            return np.asarray(1.0 / (1.0 + np.exp(-odds)))
        return self.level.posterior(level_inputs(odds, seconds, place.numbers()))[:, 1]

    def _held_back(self, found: FloatArray, relative: FloatArray) -> FloatArray:
        """(n, 6) probabilities that go towards equal chances outside the training's range."""
        far = self._novelty(_scene_of(relative))[:, None]
        return np.asarray((1.0 - far) * found + far / len(BEHAVIORS))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What was learned, to be saved."""
        parts = {
            name: getattr(self, name) for name in ("seen_badly", "foreign", "gate", "recorded")
        }
        if self.level is not None:
            parts["level"] = self.level
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
            ("recorded", "boosted", 2, len(_OF_PEOPLE), RECORDED_OPTIONS),
            ("level", "boosted", 2, LEVEL_INPUTS, LEVEL_OPTIONS),
        )
        found = {
            name: restore_classifier(kind, classes, inputs, options, part_of(arrays, name))
            for name, kind, classes, inputs, options in parts
            if name != "level" or part_of(arrays, name)
        }
        level = found.pop("level", None)
        return cls(**found, level=level, low=low, high=high, card=card)


@dataclass(frozen=True, slots=True)
class Lessons:
    """What there is to learn from.

    Attributes:
        training: samples with the features of `RelativeObserver`.
        kinds: (n,) the kind of traffic of each; each of the first three must occur.
        validation: the same of other episodes, for early stopping and calibration.
        validation_kinds: theirs.
        lives: samples of drivers of worlds that are in none of these, each seen since it appeared;
            the level of places is learned from them.
        sensed: (k, S) numbers of further scenes of home seen badly.
        recorded: (r, S) numbers of recorded scenes, as many of each place.
    """

    training: Samples
    kinds: CodeArray
    validation: Samples | None
    validation_kinds: CodeArray | None
    lives: Samples | None
    sensed: FloatArray
    recorded: FloatArray


def train_elsewhere(
    lessons: Lessons, seed: int = 0, card: Mapping[str, Any] | None = None
) -> Elsewhere:
    """Learn from samples of home, of home seen badly, of many worlds, and of recorded scenes.

    The classifier of foreign traffic learns from all samples, that of home seen badly from home.

    Args:
        lessons: what there is to learn from.
        seed: the same seed and samples give the same answers.
        card: training data and scores.

    Returns:
        The classifiers and the gate.

    Raises:
        InputError: if a kind of traffic is missing.
    """
    training, kinds = lessons.training, lessons.kinds
    found = set(kinds.tolist())
    if found != {HOME, SEEN_BADLY, FOREIGN}:
        raise InputError(f"kinds: found {sorted(found)}, expected samples of each of 0, 1, 2")
    learned = []
    for options, taught in (
        (SEEN_BADLY_OPTIONS, (HOME, SEEN_BADLY)),
        (OPTIONS, (HOME, SEEN_BADLY, FOREIGN)),
    ):
        held = None
        validation, held_kinds = lessons.validation, lessons.validation_kinds
        if validation is not None and held_kinds is not None and np.isin(held_kinds, taught).any():
            part = validation.where(np.isin(held_kinds, taught))
            held = (part.features.astype(np.float64), part.codes)
        part = training.where(np.isin(kinds, taught))
        classifier = make_classifier("averaged", len(BEHAVIORS), **options)
        classifier.fit(part.features.astype(np.float64), part.codes, held, seed)
        learned.append(classifier)
    scenes, shown = _scenes(lessons, seed)
    gate = make_classifier("boosted", 3, **GATE_OPTIONS)
    gate.fit(scenes, shown, None, seed)
    people = np.repeat(lessons.recorded, -(-len(scenes) // len(lessons.recorded)), axis=0)
    recorded = make_classifier("boosted", 2, **RECORDED_OPTIONS)
    both = np.concatenate([scenes, _capped(people)])
    is_recorded = np.repeat(np.array([0, 1], dtype=np.int8), [len(scenes), len(people)])
    recorded.fit(both[:, _OF_PEOPLE], is_recorded, None, seed)
    low, high = np.quantile(both, [RANGE, 1.0 - RANGE], axis=0)
    low[SCENE_NAMES.index("seconds")] = 0.0  # windows end some seconds after the first frame
    level = None if lessons.lives is None else _learned_level(learned[1], lessons.lives, seed)
    seen_badly, foreign = learned
    return Elsewhere(seen_badly, foreign, gate, recorded, level, low, high, dict(card or {}))


def _scenes(lessons: Lessons, seed: int) -> tuple[FloatArray, CodeArray]:
    """Numbers of scenes, one row per scene and moment, as many of each kind, and their kinds."""
    training = lessons.training
    moments = np.stack([training.episode, np.round(training.time_s * 100.0).astype(np.int64)])
    _, first = np.unique(moments, axis=1, return_index=True)
    known = _scene_of(training.features[first].astype(np.float64))
    parts = [known[lessons.kinds[first] == kind] for kind in (HOME, SEEN_BADLY, FOREIGN)]
    parts[SEEN_BADLY] = np.concatenate([parts[SEEN_BADLY], _capped(lessons.sensed)])
    most = min(max(len(part) for part in parts), SCENES_OF_A_KIND)
    rng = np.random.default_rng(seed)
    drawn = [part[rng.choice(len(part), most, replace=len(part) < most)] for part in parts]
    return np.concatenate(drawn), np.repeat(np.arange(3, dtype=np.int8), most)


def _deviation(relative: FloatArray) -> FloatArray:
    """(n,) how much more aggressive than the scene's mean drivers are, in standard deviations."""
    known = relative[:, _EVIDENCE_AT] > 0.0
    return np.asarray(
        np.where(known, relative[:, _COMPARED_AT] * list(BRISK.values()), 0.0).mean(axis=1)
    )


def _scene_of(relative: FloatArray) -> FloatArray:
    """(n, S) numbers of scenes among relative features (n, F), as the gate sees them."""
    return _capped(relative[:, _SCENE])


def _capped(scenes: FloatArray) -> FloatArray:
    """(n, S) numbers of scenes in which a city has no more drivers than a crossing."""
    out = np.array(scenes)
    out[:, _DRIVERS] = np.minimum(out[:, _DRIVERS], MOST_DRIVERS)
    return out


def _learned_level(foreign: Classifier, lives: Samples, seed: int) -> Classifier | None:
    """The classifier of styles from log-odds and the place's numbers; None for one style."""
    odds = log_odds_of(aggressive_share(foreign.posterior(lives.features.astype(np.float64))))
    inputs = np.zeros((len(lives), LEVEL_INPUTS))
    for episode in np.unique(lives.episode):
        rows, place = np.flatnonzero(lives.episode == episode), PlaceDrivers()
        moments = np.round(lives.time_s[rows], 2)
        for moment in np.unique(moments):
            here = rows[moments == moment]
            here = here[np.argsort(lives.agent[here], kind="stable")]
            place.observe(float(moment), lives.agent[here], odds[here], lives.seconds[here])
            inputs[here] = level_inputs(odds[here], lives.seconds[here], place.numbers())
    style = AGGRESSIVE[lives.codes].astype(np.int8)
    if np.unique(style).size < 2:
        return None
    _, world, count = np.unique(lives.episode, return_inverse=True, return_counts=True)
    share = 1.0 / np.sqrt(count[world])
    drawn = np.random.default_rng(seed).choice(len(lives), LEVEL_ROWS, p=share / share.sum())
    level = make_classifier("boosted", 2, **LEVEL_OPTIONS)
    level.fit(inputs[drawn], style[drawn], None, seed)
    return level
