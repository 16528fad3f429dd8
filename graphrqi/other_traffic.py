"""How a model answers in traffic unlike that of its own classifier's training.

A classifier that is trained on one simulator is right in that simulator's traffic. In other traffic
it is surely wrong: it takes another law of driving, another limit or a noisy sensor for another
behaviour. `OtherTraffic` holds two networks that see each driver among all drivers of its place
(`graphrqi.places`), on features that are smoothed and relative to the scene. One learned from the
simulators' traffic seen with noise, the other one from many random worlds, too. Where traffic comes
from is said by whoever opens the stream (`TRAFFIC`). Among recorded people only differences between
drivers count, since nobody knows the level of their place. Where a scene lies outside everything
that was trained on, the answer goes towards equal chances.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
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

Traffic = Literal["simulated", "recorded", "other"]
"""Where traffic comes from: from the engines of this project, from recordings of people, or from
other simulators."""

TRAFFIC: Final[tuple[Traffic, ...]] = get_args(Traffic)

MOST_DRIVERS: Final = 40.0
"""Drivers at once beyond which their number does not count: a city is no other kind of traffic."""

GLIMPSED_S, WATCHED_S = 1.0, 2.0
"""Time for which a scene was watched, s, up to which nothing is known of it, and from which answers
count fully (our choice)."""

FARTHEST: Final = 0.5
"""Distance outside the range, in lengths of the range, at which nothing is known (our choice)."""

_SCENE: Final = slice(-1 - len(SCENE_NAMES), -1)
"""Columns of the scene's numbers among the relative features."""

CLOSE: Final = ("headway", "law's headway", "standstill gap", "gap while starting")
"""Quantities, compared within a scene, of which aggressive drivers have less by the meaning of the
behaviours."""

FAST: Final = ("speed over pace", "speed over place", "speed over neighbours")
"""The same of which they have more."""

COMPARISON_LOG_ODDS: Final = 2.0
"""Log-odds for a mean deviation of one in either (our choice). Among people, what aggressive means
in words counts beside what simulated drivers taught."""

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
everybody does (our choice). Two-wheelers that share no lanes have .2 to .3 s: who is ahead there is
beside. Headways say nothing about such drivers, so they are compared with one another."""

FINEST_S: Final = 0.09
"""Time between frames below which the classifier's answers do not hold, s: it learned from frames
.1 s apart, and how a simulated driver dawdles depends on the step."""

_DRIVERS, _HEADWAY, SECONDS, COURSES = map(
    SCENE_NAMES.index, ("drivers", "mean headway", "seconds", "mean weaving")
)

_OF_PEOPLE: Final = [
    SCENE_NAMES.index(name)
    for name in (
        "noise", "mean weaving", "mean unrest", "deviation of weaving", "deviation of unrest",
        *(f"{name} over noise" for name in LEFT_OVER),
    )
]  # fmt: skip
"""Numbers of a scene that tell recorded people from simulations."""

_LEARNED: Final = ("noisy", "other")
"""Attributes of `OtherTraffic` that have arrays."""


def check_traffic(traffic: str) -> Traffic:
    """The kind of traffic of this name.

    Raises:
        InputError: if there is none.

    Examples:
        >>> check_traffic("recorded")
        'recorded'
    """
    for known in TRAFFIC:
        if traffic == known:
            return known
    raise InputError(f"traffic: found {traffic!r}, expected one of {', '.join(TRAFFIC)}")


@dataclass(frozen=True, slots=True)
class OtherTraffic:
    """Answers where the model's own classifier does not hold.

    Attributes:
        noisy: answers about drivers with relative features (n, F) among those of their place, in
            simulated traffic that is seen with noise.
        other: the same in all other traffic.
        low: (S,) lower ends of the range of the numbers of scenes in training.
        high: (S,) upper ends.
        card: training data and scores, as JSON values.
    """

    noisy: PlaceNetwork
    other: PlaceNetwork
    low: FloatArray
    high: FloatArray
    card: Mapping[str, Any]

    def network(self, traffic: Traffic) -> PlaceNetwork:
        """The network that answers in a kind of traffic."""
        return self.noisy if traffic == "simulated" else self.other

    def alone(self, relative: FloatArray, traffic: Traffic) -> FloatArray:
        """Answers about drivers one by one: what the others of their place do is not used.

        Args:
            relative: (n, F) features of `RelativeObserver`.
            traffic: where they come from.

        Returns:
            (n, 6) probabilities.
        """
        network = self.network(traffic)
        return self._held_back(network.alone(network.described(relative)), relative, traffic)

    def among(
        self,
        relative: FloatArray,
        traffic: Traffic,
        seen: Observation,
        time_s: float,
        place: KnownPlace,
    ) -> FloatArray:
        """Answers about all drivers of one scene, each seen among the others.

        Args:
            relative: (n, F) features of `RelativeObserver`.
            traffic: where they come from.
            seen: the same drivers, and for how long each was watched.
            time_s: not earlier than at the call before.
            place: the drivers of the place so far; these are added.

        Returns:
            (n, 6) probabilities.
        """
        if not len(relative):
            return np.zeros((0, len(BEHAVIORS)))
        network = self.network(traffic)
        described = network.described(relative)
        place.drivers.observe(time_s, seen.ids, network.shown(described), seen.seconds)
        found = network.among(described, place.drivers)
        compared = share_compared(scene_of(relative[:1]), traffic)
        if compared > 0.0:
            beside = self._beside_others(described, relative, seen, time_s, place)
            style = (1.0 - compared) * aggressive_share(found) + compared * beside
            found = restyled(found, style, AGGRESSIVE)
        return self._held_back(found, relative, traffic)

    def _beside_others(
        self,
        described: list[SingleArray],
        relative: FloatArray,
        seen: Observation,
        time_s: float,
        place: KnownPlace,
    ) -> FloatArray:
        """(n,) probability of the aggressive style from differences between drivers alone."""
        alone = log_odds_of(aggressive_share(self.other.alone(described)))
        # Two drivers that are compared with each other only differ by the same number.
        known = level_shown(len(place.drivers.values)) ** 2
        follow = share_following(scene_of(relative[:1]))
        deviation = _compared(relative, FAST) - follow * _compared(relative, CLOSE)
        unlike = follow * alone + known * COMPARISON_LOG_ODDS * deviation
        place.people.observe(time_s, seen.ids, unlike[:, None], seen.seconds)
        return np.asarray(1.0 / (1.0 + np.exp(-beside_others(unlike, seen.seconds, place.people))))

    def empty_place(self, traffic: Traffic) -> KnownPlace:
        """A place of which nothing is known yet."""
        return KnownPlace(PlaceDrivers(self.network(traffic).width), PlaceDrivers(1))

    def _novelty(self, scenes: FloatArray, traffic: Traffic) -> FloatArray:
        """(n,) how far scenes lie outside the training's range: 0 within, 1 far beyond.

        Noise and restlessness, in which people differ from simulations, do not count for them.
        """
        length = self.high - self.low
        outside = np.maximum(np.maximum(self.low - scenes, scenes - self.high), 0.0)
        if traffic == "recorded":
            outside[:, _OF_PEOPLE] = 0.0
        far = (outside / np.where(length > 0.0, length, 1.0)).max(axis=1, initial=0.0)
        return np.asarray(np.minimum(far / FARTHEST, 1.0))

    def _held_back(self, found: FloatArray, relative: FloatArray, traffic: Traffic) -> FloatArray:
        """(n, 6) probabilities that go towards equal chances in scenes of which little is known.

        They lie outside the training's range, or were hardly watched.
        """
        scenes = scene_of(relative)
        watched = _ramp(np.expm1(scenes[:, SECONDS]), GLIMPSED_S, WATCHED_S)
        known = ((1.0 - self._novelty(scenes, traffic)) * watched)[:, None]
        return np.asarray(known * found + (1.0 - known) / len(BEHAVIORS))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What was learned, to be saved."""
        learned = {
            f"{part}.{name}": value
            for part in _LEARNED
            for name, value in getattr(self, part).arrays().items()
        }
        return {"low": self.low, "high": self.high, **learned}

    @classmethod
    def restored(cls, arrays: dict[str, NDArray[Any]], card: Mapping[str, Any]) -> OtherTraffic:
        """From what was saved.

        Raises:
            InputError: if the arrays are not those of `arrays`.
        """
        low, high = (saved(arrays, name, (len(SCENE_NAMES),)) for name in ("low", "high"))
        if not (low <= high).all():
            raise InputError("low, high: found ends in the wrong order, expected low <= high")
        features = len(RelativeObserver.feature_names)
        noisy, other = (
            PlaceNetwork.restored(part_of(arrays, name), features, len(BEHAVIORS))
            for name in _LEARNED
        )
        return cls(noisy, other, low, high, card)


@dataclass(frozen=True, slots=True)
class KnownPlace:
    """The drivers of a place so far.

    Attributes:
        drivers: what the network shows of each to the others.
        people: how unlike the scene each is: log-odds of the aggressive style.
    """

    drivers: PlaceDrivers
    people: PlaceDrivers


def share_compared(scene: FloatArray, traffic: Traffic) -> float:
    """How far drivers are only compared with one another, 0 to 1.

    Recorded people are, except on a line, where recordings give distances along a lane. Drivers of
    other simulators are where nobody follows.

    Args:
        scene: (1, S) numbers of the scene.
        traffic: where it comes from.
    """
    if traffic == "simulated":
        return 0.0
    beside = 1.0 - share_following(scene)
    on_a_line = scene[0, COURSES] <= np.log(LEAST_LEFT_OVER_M) + 1e-6
    is_known = scene[0, COURSES] != UNKNOWN_SCENE
    if traffic == "recorded" and not (is_known and on_a_line):
        return 1.0
    return beside


def share_following(scene: FloatArray) -> float:
    """How far the drivers of a scene (1, S) follow those ahead, 0 to 1; 1 without any headway."""
    log_headway = scene[0, _HEADWAY]
    if log_headway == UNKNOWN_SCENE:
        return 1.0
    return float(_ramp(log_headway, np.log(BESIDE_S), np.log(BEHIND_S)))


def _ramp(values: Any, none: float, whole: float) -> FloatArray:
    """(...) 0 up to one value, 1 from another one on, and a straight line in between."""
    return np.asarray(np.clip((values - none) / (whole - none), 0.0, 1.0))


def _compared(relative: FloatArray, names: tuple[str, ...]) -> FloatArray:
    """(n,) mean of a driver's known quantities in deviations of the scene; 0 where none is."""
    mean, evidence = (relative[:, columns] for columns in _COMPARED_AT[names])
    known = evidence > 0.0
    return np.asarray(np.where(known, mean, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1))


def scene_of(relative: FloatArray) -> FloatArray:
    """(n, S) numbers of scenes among relative features (n, F); a city counts as a crossing."""
    out = np.array(relative[:, _SCENE])
    out[:, _DRIVERS] = np.minimum(out[:, _DRIVERS], MOST_DRIVERS)
    return out
