"""How a model answers in traffic unlike that which it was trained on.

A classifier that is trained on one simulator is right at home and surely wrong elsewhere: it takes
another law of driving, another limit or a noisy sensor for another behaviour. `Elsewhere` holds two
networks that see each driver among all the drivers of its place (`graphrqi.places`), on features
that are smoothed and relative to the scene: one for home traffic that is seen badly (with noise, at
other frame rates, with gaps), and one for foreign traffic, trained on many random worlds. A gate
tells from the numbers of the whole scene how likely each of the three is, and whether the scene is
simulated at all. The answer is the average of home's classifier and the networks with the gate's
probabilities as weights; among recorded people only the differences between drivers count. Where a
scene lies outside everything that was trained on, the answer goes towards equal chances.

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
from graphrqi.classify import Classifier, restore_classifier
from graphrqi.classify.checks import part_of, saved
from graphrqi.features.observer import Observation
from graphrqi.features.relative.observer import (
    LEAST_LEFT_OVER_M,
    LEFT_OVER,
    SCENE_NAMES,
    UNKNOWN_SCENE,
    RelativeObserver,
)
from graphrqi.places.drivers import PlaceDrivers
from graphrqi.places.network import PlaceNetwork, SingleArray
from graphrqi.places.people import beside_others, level_shown, log_odds_of, restyled
from graphrqi.posterior import AGGRESSIVE, aggressive_share

FloatArray = NDArray[np.float64]

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
    "rounds": 120, "max_leaves": 8, "min_leaf": 20, "feature_share": 0.4,
}  # fmt: skip
"""Options of the classifier that tells recorded scenes from simulated ones. It is small: places
that it was not trained on are then told from simulations, too."""

DOUBTED, SURELY = 0.3, 0.7
"""Probabilities of home, seen badly, up to which a scene that is seen exactly counts as this, and
from which it counts as home (our choice). In between both ways of answering are averaged: an
average in which one has a small share would still let that one decide about whole places."""

HARDLY_PEOPLE, SURELY_PEOPLE = 0.5, 0.9
"""The same of recorded scenes (our choice): simulated up to the first, recorded from the second.
Noise hides the difference, and who is taken for people is told less than who is simulated."""

PEOPLE_AT_FIRST: Final = 2.0 / 3.0
"""Probability that a scene is recorded until courses are known (our choice): before that only the
noise could tell, and simulations are seen with noise, too. With a half, simulations still
decide about the few cars of short clips: .73 of those told at Karlsruhe were aggressive, with two
thirds .69."""

MOST_DRIVERS: Final = 40.0
"""Drivers at once beyond which their number does not count: a city is no other kind of traffic."""

UNSEEN: Final[FloatArray] = np.array([1.0, 0.0, 1.0, 1.0]) / 3.0
"""Probability of each kind of traffic before anything of it is known: as at home, as simulated by
others, or recorded (our choice). Where home had a half, 82 drivers of US-101 were told in the first
five seconds by home's classifier, 73 of them as aggressive."""

GLIMPSED_S, WATCHED_S = 1.0, 2.0
"""Time for which a scene was watched, s, up to which its kind is not known at all, and from which
the gate is believed (our choice). Its lessons are scenes of three seconds and more; at one second
it took all drivers of KITTI for those of home and all of US-101 for foreign simulations."""

SURE: Final = 0.05
"""A kind of traffic that is less likely is left out, so that mostly one classifier answers."""

FARTHEST: Final = 0.5
"""Distance outside the range, in lengths of the range, at which nothing is known."""

_SCENE: Final = slice(-1 - len(SCENE_NAMES), -1)
"""Columns of the scene's numbers among the relative features."""

CLOSE: Final = ("headway", "law's headway", "standstill gap", "gap while starting")
"""Quantities, compared within a scene, of which aggressive drivers have less by the meaning of the
behaviours."""

FAST: Final = ("speed over pace", "speed over place", "speed over neighbours")
"""The same of which they have more. Accelerations and braking are left out: among people, one half
of a track says nothing about them in the other."""

WORTH: Final = 2.0
"""Log-odds for a mean deviation of one in either (our choice: the classifier's own log-odds still
count for more). Among people, what aggressive means in words counts beside what simulated drivers
taught."""

_COMPARED_AT: Final[dict[tuple[str, ...], tuple[list[int], ...]]] = {
    names: tuple(
        [RelativeObserver.feature_names.index(f"{name}, compared:{part}") for name in names]
        for part in ("mean", "evidence")
    )
    for names in (CLOSE, FAST)
}
"""Columns of the means of these quantities, and of how much is known of them."""

BESIDE_S, BEHIND_S = 0.4, 0.7
"""Mean time headways of a scene, s, up to which nobody follows whoever is ahead, and from which
everybody does (our choice). Nobody keeps to half a second: all of 2,000 random worlds and of 402
recordings at eight places, but one drive of KITTI, have .7 s and more, and videos of two-wheelers
that share no lanes have .2 to .3 s. Who is ahead there is beside, and headways, on which the
network's answers rest, say nothing: such a scene is none of the simulations that it learned from,
and its drivers are compared with one another as people are."""

EXACT_M: Final = 0.001
"""Positions whose errors are smaller than this are exact, m: a tenth of the least noise that home
is seen through in training."""

FINEST_S: Final = 0.09
"""Time between frames below which exact home is no longer home's classifier's, s: it learned from
frames .1 s apart, and how a simulated driver dawdles from frame to frame depends on their step."""

OF_PEOPLE: Final = [
    SCENE_NAMES.index(name)
    for name in (
        "noise", "mean weaving", "mean unrest", "deviation of weaving", "deviation of unrest",
        *(f"{name} over noise" for name in LEFT_OVER),
    )
]  # fmt: skip
"""Numbers of a scene that tell recorded from simulated traffic: how restless its drivers are beside
the noise. Others, like the pace, tell only places that were trained on from simulations."""

_DRIVERS, _HEADWAY, _NOISE, _FRAME, SECONDS, COURSES = map(
    SCENE_NAMES.index,
    ("drivers", "mean headway", "noise", "frame interval", "seconds", "mean weaving"),
)

_LEARNED: Final = ("seen_badly", "foreign", "gate", "recorded")
"""Attributes of `Elsewhere` that have arrays."""


@dataclass(frozen=True, slots=True)
class Elsewhere:
    """What answers in traffic that is not as at home, and what tells it from home.

    Attributes:
        seen_badly: answers about drivers with relative features (n, F) among those of their place,
            in home traffic that is seen badly.
        foreign: the same in foreign traffic.
        gate: answers on scenes (n, S) which of the first three kinds of traffic they show.
        recorded: answers on scenes whether they are simulated or recorded.
        low: (S,) lower ends of the range of the numbers of scenes in training.
        high: (S,) upper ends.
        card: training data and scores, as JSON values.
    """

    seen_badly: PlaceNetwork
    foreign: PlaceNetwork
    gate: Classifier
    recorded: Classifier
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
        scenes = scene_of(relative)
        people = self.recorded.posterior(np.ascontiguousarray(scenes[:, OF_PEOPLE]))[:, 1]
        people = _ramp(people, HARDLY_PEOPLE, SURELY_PEOPLE)
        unseen = [scenes[:, COURSES] == UNKNOWN_SCENE, _on_a_line(scenes)]
        people = np.select(unseen, [PEOPLE_AT_FIRST, 0.0], people)
        people = np.maximum(people, 1.0 - _share_following(scenes))[:, None]
        simulated = _where_exact(self.gate.posterior(scenes), scenes)
        found = _kept_open(np.concatenate([(1.0 - people) * simulated, people], axis=1), scenes)
        found = np.where(found < SURE, 0.0, found)
        novelty = self._novelty(scenes)[:, None]
        found = (1.0 - novelty) * found / found.sum(axis=1, keepdims=True)
        found[:, [FOREIGN, RECORDED]] += novelty * np.concatenate([1.0 - people, people], axis=1)
        watched = _watched(scenes)[:, None]
        found = watched * found + (1.0 - watched) * UNSEEN
        return np.asarray(np.clip(found, 0.0, 1.0))

    def _novelty(self, scenes: FloatArray) -> FloatArray:
        """(n,) how far scenes lie outside the training's range: 0 within, 1 far beyond."""
        length = self.high - self.low
        outside = np.maximum(np.maximum(self.low - scenes, scenes - self.high), 0.0)
        far = (outside / np.where(length > 0.0, length, 1.0)).max(axis=1, initial=0.0)
        return np.asarray(np.minimum(far / FARTHEST, 1.0))

    def answers(self, relative: FloatArray, kinds: FloatArray) -> FloatArray:
        """(n, 6) the sum of the networks' probabilities, each times that of its kind of traffic.

        Of drivers one by one: what the others of their place are like is not used.

        Args:
            relative: (n, F) relative features.
            kinds: (n, 4) as from `kinds`; rows of the answer sum to one minus the first column.
        """
        out = np.zeros((len(relative), len(BEHAVIORS)))
        away = kinds[:, FOREIGN] + kinds[:, RECORDED]
        for share, network in ((kinds[:, SEEN_BADLY], self.seen_badly), (away, self.foreign)):
            asked = share > 0.0
            if asked.any():
                inputs = relative[asked]
                found = network.alone(network.described(inputs))
                out[asked] += share[asked, None] * self._held_back(found, inputs)
        return out

    def answers_among(
        self,
        relative: FloatArray,
        kinds: FloatArray,
        seen: Observation,
        time_s: float,
        place: KnownPlace,
    ) -> FloatArray:
        """(n, 6) as `answers`, of all drivers of one scene, each seen among the others.

        Args:
            relative: (n, F) relative features.
            kinds: (4,) probability of each kind of traffic.
            seen: the same drivers, and for how long each was watched.
            time_s: not earlier than at the call before.
            place: the drivers of the place so far; these are added.
        """
        out = np.zeros((len(relative), len(BEHAVIORS)))
        if not len(relative):
            return out
        if kinds[SEEN_BADLY] > 0.0:
            _, found = _seen_among(self.seen_badly, relative, seen, time_s, place.seen_badly)
            out += kinds[SEEN_BADLY] * found
        away = float(kinds[FOREIGN] + kinds[RECORDED])
        if away > 0.0:
            described, found = _seen_among(self.foreign, relative, seen, time_s, place.foreign)
            if kinds[RECORDED] > 0.0:
                # What the others would mean if they were simulated says nothing among people.
                alone = log_odds_of(aggressive_share(self.foreign.alone(described)))
                # Two drivers who are compared with each other only mirror one another.
                known = level_shown(len(place.foreign.values)) ** 2
                follow = _share_following(scene_of(relative[:1]))
                brisk = _compared(relative, FAST) - follow * _compared(relative, CLOSE)
                unlike = follow * alone + known * WORTH * brisk
                place.people.observe(time_s, seen.ids, unlike[:, None], seen.seconds)
                beside = 1.0 / (1.0 + np.exp(-beside_others(unlike, seen.seconds, place.people)))
                style = kinds[FOREIGN] * aggressive_share(found) + kinds[RECORDED] * beside
                found = restyled(found, style / away, AGGRESSIVE)
            out += away * found
        total = out.sum(axis=1, keepdims=True)
        held = self._held_back(out / np.where(total > 0.0, total, 1.0), relative)
        return np.asarray(held * total)

    def empty_place(self) -> KnownPlace:
        """A place of which nothing is known yet."""
        return KnownPlace(
            PlaceDrivers(self.seen_badly.width), PlaceDrivers(self.foreign.width), PlaceDrivers(1)
        )

    def _held_back(self, found: FloatArray, relative: FloatArray) -> FloatArray:
        """(n, 6) probabilities that go towards equal chances in scenes of which little is known.

        They lie outside the training's range, or were hardly watched.
        """
        scenes = scene_of(relative)
        known = ((1.0 - self._novelty(scenes)) * _watched(scenes))[:, None]
        return np.asarray(known * found + (1.0 - known) / len(BEHAVIORS))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What was learned, to be saved."""
        parts = {name: getattr(self, name) for name in _LEARNED}
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
        features = len(RelativeObserver.feature_names)
        seen_badly, foreign = (
            PlaceNetwork.restored(part_of(arrays, name), features, len(BEHAVIORS))
            for name in ("seen_badly", "foreign")
        )
        gate, recorded = (
            restore_classifier("boosted", classes, inputs, options, part_of(arrays, name))
            for name, classes, inputs, options in (
                ("gate", 3, len(SCENE_NAMES), GATE_OPTIONS),
                ("recorded", 2, len(OF_PEOPLE), RECORDED_OPTIONS),
            )
        )
        return cls(seen_badly, foreign, gate, recorded, low, high, card)


@dataclass(frozen=True, slots=True)
class KnownPlace:
    """The drivers of a place so far.

    Attributes:
        seen_badly: what that network shows of each to the others.
        foreign: the same of the network for foreign traffic.
        people: how unlike the scene each is: log-odds of the aggressive style.
    """

    seen_badly: PlaceDrivers
    foreign: PlaceDrivers
    people: PlaceDrivers


def _seen_among(
    network: PlaceNetwork,
    relative: FloatArray,
    seen: Observation,
    time_s: float,
    drivers: PlaceDrivers,
) -> tuple[list[SingleArray], FloatArray]:
    """A network's descriptions of drivers, and (n, 6) its answers about them among the others.

    The drivers seen are added to those of the place.
    """
    described = network.described(relative)
    drivers.observe(time_s, seen.ids, network.shown(described), seen.seconds)
    return described, network.among(described, drivers)


def _where_exact(kinds: FloatArray, scenes: FloatArray) -> FloatArray:
    """(n, 3) probabilities of kinds where home that is seen exactly is home.

    Lost frames and lower rates cost home's classifier little; noise and finer steps break it.

    Args:
        kinds: (n, 3) as from the gate.
        scenes: (n, S) their numbers.
    """
    badly, noise = kinds[:, SEEN_BADLY], scenes[:, _NOISE]
    exact = (noise >= 0.0) & (noise < EXACT_M) & (scenes[:, _FRAME] > FINEST_S)
    moved = badly * _ramp(badly, DOUBTED, SURELY) * exact
    return np.stack([kinds[:, HOME] + moved, badly - moved, kinds[:, FOREIGN]], axis=1)


def _on_a_line(scenes: FloatArray) -> NDArray[np.bool_]:
    """(n,) whether nobody in scenes (n, S) whose courses are known leaves a line.

    Simulated cars keep to lines, and so do recordings of distances along a lane.
    """
    return np.asarray(scenes[:, COURSES] <= np.log(LEAST_LEFT_OVER_M) + 1e-6)


def _watched(scenes: FloatArray) -> FloatArray:
    """(n,) how far scenes (n, S) were watched for long enough to tell their kind, from 0 to 1."""
    return _ramp(np.expm1(scenes[:, SECONDS]), GLIMPSED_S, WATCHED_S)


def _share_following(scenes: FloatArray) -> FloatArray:
    """(n,) how far drivers of scenes (n, S) follow those ahead, 0 to 1; 1 without any headway."""
    log_headway = scenes[:, _HEADWAY]
    following = _ramp(log_headway, np.log(BESIDE_S), np.log(BEHIND_S))
    return np.where(log_headway == UNKNOWN_SCENE, 1.0, following)


def _kept_open(kinds: FloatArray, scenes: FloatArray) -> FloatArray:
    """(n, 4) probabilities of kinds in which home is not likelier than at first, but people are.

    That is so until courses are known, after 20 s of driving by all drivers together: smooth
    recordings of few drivers look like home until then.

    Args:
        kinds: (n, 4) as found.
        scenes: (n, S) their numbers.
    """
    unknown = scenes[:, COURSES] == UNKNOWN_SCENE
    moved = unknown * np.maximum(kinds[:, HOME] - UNSEEN[HOME], 0.0)
    out = np.array(kinds)
    out[:, HOME] -= moved
    out[:, RECORDED] += moved
    return out


def _ramp(values: FloatArray, none: float, whole: float) -> FloatArray:
    """(...) 0 up to one value, 1 from another one on, and a straight line in between."""
    return np.asarray(np.clip((values - none) / (whole - none), 0.0, 1.0))


def _compared(relative: FloatArray, names: tuple[str, ...]) -> FloatArray:
    """(n,) mean of a driver's known quantities in deviations of the scene; 0 where none is."""
    mean, evidence = (relative[:, columns] for columns in _COMPARED_AT[names])
    known = evidence > 0.0
    return np.asarray(np.where(known, mean, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1))


def scene_of(relative: FloatArray) -> FloatArray:
    """(n, S) numbers of scenes among relative features (n, F), as the gate sees them."""
    return capped(relative[:, _SCENE])


def capped(scenes: FloatArray) -> FloatArray:
    """(n, S) numbers of scenes in which a city has no more drivers than a crossing."""
    out = np.array(scenes)
    out[:, _DRIVERS] = np.minimum(out[:, _DRIVERS], MOST_DRIVERS)
    return out
