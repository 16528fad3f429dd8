"""How a model answers in traffic unlike that of its own classifier's training.

A classifier that is trained on one simulator mistakes another driver model, limit or noisy sensor
for another behaviour. `OtherTraffic` holds two networks that see each driver among all drivers of
its site. Their features are smoothed and relative to the scene. One network learned from noisy
simulated traffic, the other one also from many random simulations. The caller states the kind of
traffic (`TRAFFIC`). For recorded drivers only differences within a site count, since the average of
the site is unknown. Outside the range of training scenes, answers move towards equal probabilities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.arrays import FloatArray, SingleArray
from graphrqi.classify.contract import part_of, saved
from graphrqi.features.drivers import LEFT_OVER, SCENE_NAMES, UNKNOWN_SCENE, DriverObserver
from graphrqi.features.observer import Observation
from graphrqi.features.quantities import LEAST_LEFT_OVER_M
from graphrqi.places.network import (
    PlaceDrivers,
    PlaceNetwork,
    beside_others,
    level_shown,
    log_odds_of,
    restyled,
)
from graphrqi.posterior import AGGRESSIVE, aggressive_share

Traffic = Literal["simulated", "recorded", "other"]
"""Kinds of traffic: from the engines of this project, from recordings, or from other simulators."""

TRAFFIC: Final[tuple[Traffic, ...]] = get_args(Traffic)

FEATURES: Final = DriverObserver("smoothed").feature_names
"""Columns of the features that the networks see."""

MOST_DRIVERS: Final = 40.0
"""Drivers at once; larger numbers count as this one."""

GLIMPSED_S, WATCHED_S = 1.0, 2.0
"""Time a scene was watched, s: up to the first, answers do not count; from the second, they count
fully (our choice)."""

FARTHEST: Final = 0.5
"""Distance outside the range, in lengths of the range, at which nothing is known (our choice)."""

CLOSE: Final = ("headway", "law's headway", "standstill gap", "gap while starting")
"""Quantities, compared within a scene, that are smaller for aggressive drivers by definition."""

FAST: Final = ("speed over pace", "speed over place", "speed over neighbours")
"""Quantities that are larger for them."""

COMPARISON_LOG_ODDS: Final = 2.0
"""Log-odds for a mean deviation of one in either (our choice)."""

BESIDE_S, BEHIND_S = 0.4, 0.7
"""Mean time headways of a scene, s (our choice). Up to the first, no driver is taken to follow the
vehicle ahead, as among two-wheelers. From the second on, all are."""

FINEST_S: Final = 0.09
"""Shortest frame time at which the classifier's answers hold, s: simulated driver noise depends on
the step."""

_OF_PEOPLE: Final = (
    "noise", "mean weaving", "mean unrest", "deviation of weaving", "deviation of unrest",
    *(f"{name} over noise" for name in LEFT_OVER),
)  # fmt: skip
"""Numbers of a scene that distinguish recorded from simulated traffic."""

_LEARNED: Final = ("noisy", "other")
"""Attributes of `OtherTraffic` that have arrays."""

_COLUMN: Final = {name: column for column, name in enumerate(FEATURES)}
_SCENE: Final = [_COLUMN[f"scene: {name}"] for name in SCENE_NAMES]
_IN_SCENE: Final = {name: column for column, name in enumerate(SCENE_NAMES)}


def check_traffic(traffic: str) -> Traffic:
    """The kind of traffic of this name.

    Raises:
        InputError: if the name is unknown.

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
    """The drivers of a recording site so far.

    Attributes:
        drivers: the pooled numbers of each.
        people: each driver's deviation from the scene, as log-odds of the aggressive style.
    """

    drivers: PlaceDrivers
    people: PlaceDrivers


@dataclass(frozen=True, slots=True)
class OtherTraffic:
    """Answers in traffic for which the model's classifier was not trained.

    Attributes:
        noisy: for noisy simulated traffic.
        other: for all other traffic.
        low: (S,) least numbers within the range; unknown ones are.
        high: (S,) largest numbers of training scenes.
    """

    noisy: PlaceNetwork
    other: PlaceNetwork
    low: FloatArray
    high: FloatArray

    def network(self, traffic: Traffic) -> PlaceNetwork:
        """The network that answers in a kind of traffic."""
        return self.noisy if traffic == "simulated" else self.other

    def empty_place(self, traffic: Traffic) -> KnownPlace:
        """A site without drivers."""
        return KnownPlace(PlaceDrivers(self.network(traffic).width), PlaceDrivers(1))

    def among(
        self,
        features: FloatArray,
        traffic: Traffic,
        seen: Observation,
        time_s: float,
        place: KnownPlace,
    ) -> FloatArray:
        """(n, 6) probabilities of all drivers of one scene, each compared with the others.

        Args:
            features: (n, F) of smoothed motion.
            traffic: the kind of traffic.
            seen: the drivers and their time observed.
            time_s: not decreasing.
            place: the site's drivers; these are added.
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
        watched_s = np.expm1(scene[0, _IN_SCENE["seconds"]])
        watched = np.clip((watched_s - GLIMPSED_S) / (WATCHED_S - GLIMPSED_S), 0.0, 1.0)
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
        """How far a scene (S,) lies outside the training's range: 0 within, 1 far beyond."""
        length = self.high - self.low
        outside = np.maximum(np.maximum(self.low - scene, scene - self.high), 0.0)
        if traffic == "recorded":
            outside[[_IN_SCENE[name] for name in _OF_PEOPLE]] = 0.0
        far = float((outside / np.where(length > 0.0, length, 1.0)).max())
        return min(far / FARTHEST, 1.0)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The learned arrays, to be saved."""
        learned = {
            f"{part}.{name}": value
            for part in _LEARNED
            for name, value in getattr(self, part).arrays().items()
        }
        return {"low": self.low, "high": self.high, **learned}

    @classmethod
    def restored(cls, arrays: Mapping[str, NDArray[Any]]) -> OtherTraffic:
        """The networks from their saved arrays; `InputError` if they are not those of `arrays`."""
        low, high = (saved(dict(arrays), name, (len(SCENE_NAMES),)) for name in ("low", "high"))
        if not (low <= high).all():
            raise InputError("low, high: found ends in the wrong order, expected low <= high")
        noisy, other = (
            PlaceNetwork.restored(part_of(arrays, name), len(FEATURES), len(BEHAVIORS))
            for name in _LEARNED
        )
        return cls(noisy, other, low, high)


def scene_of(features: NDArray[np.floating]) -> FloatArray:
    """(n, S) numbers of scenes among features (n, F), driver counts limited to `MOST_DRIVERS`."""
    out = features[:, _SCENE].astype(np.float64)
    drivers = _IN_SCENE["drivers"]
    out[:, drivers] = np.minimum(out[:, drivers], MOST_DRIVERS)
    return out


def _share_compared(scene: FloatArray, traffic: Traffic) -> float:
    """How far drivers of a scene (1, S) are only compared with one another, 0 to 1."""
    if traffic == "simulated":
        return 0.0
    weaving = scene[0, _IN_SCENE["mean weaving"]]
    on_a_line = UNKNOWN_SCENE < weaving <= np.log(LEAST_LEFT_OVER_M) + 1e-6
    if traffic == "recorded" and not on_a_line:
        return 1.0
    return 1.0 - _share_following(scene)


def _share_following(scene: FloatArray) -> float:
    """How far the drivers of a scene (1, S) follow those ahead; full without any headway."""
    log_headway = float(scene[0, _IN_SCENE["mean headway"]])
    if log_headway == UNKNOWN_SCENE:
        return 1.0
    beside, behind = np.log(BESIDE_S), np.log(BEHIND_S)
    return float(np.clip((log_headway - beside) / (behind - beside), 0.0, 1.0))


def _compared(features: FloatArray, names: Sequence[str]) -> FloatArray:
    """(n,) mean of a driver's known quantities in deviations of the scene; 0 where none is."""
    mean, evidence = (
        features[:, [_COLUMN[f"{name}, compared:{part}"] for name in names]]
        for part in ("mean", "evidence")
    )
    known = evidence > 0.0
    return np.asarray(np.where(known, mean, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1))
