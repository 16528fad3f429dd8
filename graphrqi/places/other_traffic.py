"""How a model answers in traffic unlike that of its own classifier's training.

A classifier that is trained on one simulator is right in that simulator's traffic. In other traffic
it is surely wrong: it takes another law of driving, another limit or a noisy sensor for another
behaviour. `OtherTraffic` holds two networks that see each driver among all drivers of its place, on
features that are smoothed and relative to the scene. One learned from the simulators' traffic seen
with noise, the other one from many random worlds, too. Where traffic comes from is said by whoever
opens the stream (`TRAFFIC`). Among recorded people only differences between drivers count, since
nobody knows the level of their place. Where a scene lies outside everything that was trained on,
the answer goes towards equal chances.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.classify.checks import part_of, saved
from graphrqi.features.drivers import LEFT_OVER, SCENE_NAMES, UNKNOWN_SCENE, DriverObserver
from graphrqi.features.observer import Observation
from graphrqi.features.smoothed_quantities import LEAST_LEFT_OVER_M
from graphrqi.places.drivers import PlaceDrivers
from graphrqi.places.network import PlaceNetwork, SingleArray
from graphrqi.places.people import beside_others, level_shown, log_odds_of, restyled
from graphrqi.posterior import AGGRESSIVE, aggressive_share

FloatArray = NDArray[np.float64]

Traffic = Literal["simulated", "recorded", "other"]
"""Where traffic comes from: from the engines of this project, from recordings of people, or from
other simulators."""

TRAFFIC: Final[tuple[Traffic, ...]] = get_args(Traffic)

FEATURES: Final = DriverObserver("smoothed").feature_names
"""Columns of the features that the networks see."""

MOST_DRIVERS: Final = 40.0
"""Drivers at once beyond which their number does not count: a city is no other kind of traffic."""

GLIMPSED_S, WATCHED_S = 1.0, 2.0
"""Time for which a scene was watched, s, up to which nothing is known of it, and from which answers
count fully (our choice)."""

FARTHEST: Final = 0.5
"""Distance outside the range, in lengths of the range, at which nothing is known (our choice)."""

CLOSE: Final = ("headway", "law's headway", "standstill gap", "gap while starting")
"""Quantities, compared within a scene, of which aggressive drivers have less by the meaning of the
behaviours."""

FAST: Final = ("speed over pace", "speed over place", "speed over neighbours")
"""The same of which they have more."""

COMPARISON_LOG_ODDS: Final = 2.0
"""Log-odds for a mean deviation of one in either (our choice)."""

BESIDE_S, BEHIND_S = 0.4, 0.7
"""Mean time headways of a scene, s, up to which nobody follows whoever is ahead, and from which
everybody does (our choice). Headways say nothing about two-wheelers that share no lanes."""

FINEST_S: Final = 0.09
"""Time between frames below which the classifier's answers do not hold, s: it learned from frames
.1 s apart, and how a simulated driver dawdles depends on the step."""

_OF_PEOPLE: Final = (
    "noise", "mean weaving", "mean unrest", "deviation of weaving", "deviation of unrest",
    *(f"{name} over noise" for name in LEFT_OVER),
)  # fmt: skip
"""Numbers of a scene that tell recorded people from simulations."""

_LEARNED: Final = ("noisy", "other")
"""Attributes of `OtherTraffic` that have arrays."""

_COLUMN: Final = {name: column for column, name in enumerate(FEATURES)}
_SCENE: Final = [_COLUMN[f"scene: {name}"] for name in SCENE_NAMES]
_IN_SCENE: Final = {name: column for column, name in enumerate(SCENE_NAMES)}


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
class KnownPlace:
    """The drivers of a place so far.

    Attributes:
        drivers: what the network shows of each to the others.
        people: how unlike the scene each is: log-odds of the aggressive style.
    """

    drivers: PlaceDrivers
    people: PlaceDrivers


@dataclass(frozen=True, slots=True)
class OtherTraffic:
    """Answers where the model's own classifier does not hold.

    Attributes:
        noisy: answers in simulated traffic that is seen with noise.
        other: answers in all other traffic.
        low: (S,) lower ends of the range of the numbers of scenes in training.
        high: (S,) upper ends.
    """

    noisy: PlaceNetwork
    other: PlaceNetwork
    low: FloatArray
    high: FloatArray

    def network(self, traffic: Traffic) -> PlaceNetwork:
        """The network that answers in a kind of traffic."""
        return self.noisy if traffic == "simulated" else self.other

    def empty_place(self, traffic: Traffic) -> KnownPlace:
        """A place of which nothing is known yet."""
        return KnownPlace(PlaceDrivers(self.network(traffic).width), PlaceDrivers(1))

    def among(
        self,
        features: FloatArray,
        traffic: Traffic,
        seen: Observation,
        time_s: float,
        place: KnownPlace,
    ) -> FloatArray:
        """Answers about all drivers of one scene, each seen among the others.

        Args:
            features: (n, F) of a `DriverObserver` of smoothed motion.
            traffic: where they come from.
            seen: the same drivers, and for how long each was watched.
            time_s: not earlier than at the call before.
            place: the drivers of the place so far; these are added.

        Returns:
            (n, 6) probabilities.
        """
        if not len(features):
            return np.zeros((0, len(BEHAVIORS)))
        network, scene = self.network(traffic), scene_of(features[:1])
        described = network.described(features)
        place.drivers.observe(time_s, seen.ids, network.shown(described), seen.seconds)
        found = network.among(described, place.drivers)
        compared = _share_compared(scene, traffic)
        if compared > 0.0:
            beside = self._beside_others(described, features, seen, time_s, place)
            style = (1.0 - compared) * aggressive_share(found) + compared * beside
            found = restyled(found, style, AGGRESSIVE)
        watched = _ramp(float(np.expm1(scene[0, _IN_SCENE["seconds"]])), GLIMPSED_S, WATCHED_S)
        known = watched * (1.0 - self._novelty(scene[0], traffic))
        return np.asarray(known * found + (1.0 - known) / len(BEHAVIORS))

    def _beside_others(
        self,
        described: list[SingleArray],
        features: FloatArray,
        seen: Observation,
        time_s: float,
        place: KnownPlace,
    ) -> FloatArray:
        """(n,) probability of the aggressive style from differences between drivers alone."""
        alone = log_odds_of(aggressive_share(self.other.alone(described)))
        # Two drivers that are compared with each other only differ by the same number.
        known = level_shown(len(place.drivers.values)) ** 2
        follow = _share_following(scene_of(features[:1]))
        deviation = _compared(features, FAST) - follow * _compared(features, CLOSE)
        unlike = follow * alone + known * COMPARISON_LOG_ODDS * deviation
        place.people.observe(time_s, seen.ids, unlike[:, None], seen.seconds)
        return np.asarray(1.0 / (1.0 + np.exp(-beside_others(unlike, seen.seconds, place.people))))

    def _novelty(self, scene: FloatArray, traffic: Traffic) -> float:
        """How far a scene (S,) lies outside the training's range: 0 within, 1 far beyond.

        Noise and restlessness, in which people differ from simulations, do not count for them.
        """
        length = self.high - self.low
        outside = np.maximum(np.maximum(self.low - scene, scene - self.high), 0.0)
        if traffic == "recorded":
            outside[[_IN_SCENE[name] for name in _OF_PEOPLE]] = 0.0
        far = float((outside / np.where(length > 0.0, length, 1.0)).max())
        return min(far / FARTHEST, 1.0)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What was learned, to be saved."""
        learned = {
            f"{part}.{name}": value
            for part in _LEARNED
            for name, value in getattr(self, part).arrays().items()
        }
        return {"low": self.low, "high": self.high, **learned}

    @classmethod
    def restored(cls, arrays: Mapping[str, NDArray[Any]]) -> OtherTraffic:
        """From what was saved.

        Raises:
            InputError: if the arrays are not those of `arrays`.
        """
        low, high = (saved(dict(arrays), name, (len(SCENE_NAMES),)) for name in ("low", "high"))
        if not (low <= high).all():
            raise InputError("low, high: found ends in the wrong order, expected low <= high")
        noisy, other = (
            PlaceNetwork.restored(part_of(arrays, name), len(FEATURES), len(BEHAVIORS))
            for name in _LEARNED
        )
        return cls(noisy, other, low, high)


def scene_of(features: NDArray[np.floating]) -> FloatArray:
    """(n, S) numbers of scenes among features (n, F); a city counts as a crossing."""
    out = features[:, _SCENE].astype(np.float64)
    drivers = _IN_SCENE["drivers"]
    out[:, drivers] = np.minimum(out[:, drivers], MOST_DRIVERS)
    return out


def _share_compared(scene: FloatArray, traffic: Traffic) -> float:
    """How far drivers of a scene (1, S) are only compared with one another, 0 to 1.

    Recorded people are, except where recordings give distances along a lane. Drivers of other
    simulators are where nobody follows.
    """
    if traffic == "simulated":
        return 0.0
    weaving = scene[0, _IN_SCENE["mean weaving"]]
    on_a_line = UNKNOWN_SCENE < weaving <= np.log(LEAST_LEFT_OVER_M) + 1e-6
    if traffic == "recorded" and not on_a_line:
        return 1.0
    return 1.0 - _share_following(scene)


def _share_following(scene: FloatArray) -> float:
    """How far the drivers of a scene (1, S) follow those ahead, 0 to 1; 1 without any headway."""
    log_headway = float(scene[0, _IN_SCENE["mean headway"]])
    if log_headway == UNKNOWN_SCENE:
        return 1.0
    return _ramp(log_headway, float(np.log(BESIDE_S)), float(np.log(BEHIND_S)))


def _ramp(value: float, none: float, whole: float) -> float:
    """0 up to one value, 1 from another one on, and a straight line in between."""
    return min(max((value - none) / (whole - none), 0.0), 1.0)


def _compared(features: FloatArray, names: Sequence[str]) -> FloatArray:
    """(n,) mean of a driver's known quantities in deviations of the scene; 0 where none is."""
    mean, evidence = (
        features[:, [_COLUMN[f"{name}, compared:{part}"] for name in names]]
        for part in ("mean", "evidence")
    )
    known = evidence > 0.0
    return np.asarray(np.where(known, mean, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1))
