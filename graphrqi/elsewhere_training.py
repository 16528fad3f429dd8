"""How a model learns to answer in traffic unlike that which it was trained on.

`graphrqi.elsewhere` says what is learned and how it answers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.classify import make_classifier
from graphrqi.classify.contract import CodeArray
from graphrqi.elsewhere import (
    COURSES,
    FOREIGN,
    GATE_OPTIONS,
    HOME,
    OF_PEOPLE,
    RECORDED_OPTIONS,
    SECONDS,
    SEEN_BADLY,
    Elsewhere,
    capped,
    scene_of,
)
from graphrqi.features.relative.observer import UNKNOWN_SCENE
from graphrqi.places.network import PlaceNetwork
from graphrqi.samples import Samples

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SCENES_OF_A_KIND: Final = 6000
"""Most scenes of each kind that the gate learns from."""

RANGE: Final = 0.002
"""Share of the training scenes beyond each end of a number's range."""


@dataclass(frozen=True, slots=True)
class Lessons:
    """What there is to learn from.

    Attributes:
        training: samples with the features of `RelativeObserver`, of drivers that are each seen
            since they appeared, several moments of each.
        kinds: (n,) the kind of traffic of each; each of the first three must occur.
        roads: (h, S) numbers of scenes of home traffic on further roads.
        sensed: (k, S) numbers of further scenes of home seen badly.
        recorded: (r, S) numbers of recorded scenes, as many of each place.
    """

    training: Samples
    kinds: CodeArray
    roads: FloatArray
    sensed: FloatArray
    recorded: FloatArray

    def without(self, episodes: IntArray) -> Lessons:
        """The lessons without the samples of some episodes."""
        kept = ~np.isin(self.training.episode, episodes)
        return dataclasses.replace(self, training=self.training.where(kept), kinds=self.kinds[kept])


def train_elsewhere(
    lessons: Lessons,
    seed: int = 0,
    card: Mapping[str, Any] | None = None,
    options: Mapping[str, Any] | None = None,
    seen_badly: PlaceNetwork | None = None,
) -> Elsewhere:
    """Learn from samples of home, of home seen badly, of many worlds, and of recorded scenes.

    Args:
        lessons: what there is to learn from.
        seed: the same seed and samples give the same answers.
        card: training data and scores.
        options: of the networks, see `graphrqi.places.training.NetworkOptions`.
        seen_badly: the network for home traffic, if it has been trained on the same home traffic
            before: it learns nothing from worlds. None trains it.

    Returns:
        The networks and the gate.

    Raises:
        InputError: if a kind of traffic is missing.
    """
    from graphrqi.places.training import NetworkOptions, train_place_network

    found = set(lessons.kinds.tolist())
    if found != {HOME, SEEN_BADLY, FOREIGN}:
        raise InputError(f"kinds: found {sorted(found)}, expected samples of each of 0, 1, 2")
    asked = NetworkOptions(**(options or {}))
    if seen_badly is None:
        at_home = lessons.training.where(lessons.kinds != FOREIGN)
        seen_badly = train_place_network(at_home, seed, asked)
    foreign = train_place_network(lessons.training, seed, asked)
    scenes, shown = _scenes(lessons, seed)
    gate = make_classifier("boosted", 3, **GATE_OPTIONS)
    gate.fit(scenes, shown, None, seed)
    people = capped(lessons.recorded)
    recorded = make_classifier("boosted", 2, **RECORDED_OPTIONS)
    rng = np.random.default_rng(seed)
    parts = [_with_courses(part, len(scenes), rng)[:, OF_PEOPLE] for part in (scenes, people)]
    is_recorded = np.repeat(np.array([0, 1], dtype=np.int8), len(scenes))
    recorded.fit(np.concatenate(parts), is_recorded, None, seed)
    both = np.concatenate([scenes, people])
    low, high = np.quantile(both, [RANGE, 1.0 - RANGE], axis=0)
    low[SECONDS] = 0.0  # windows end some seconds after the first frame
    return Elsewhere(seen_badly, foreign, gate, recorded, low, high, dict(card or {}))


def _scenes(lessons: Lessons, seed: int) -> tuple[FloatArray, CodeArray]:
    """Numbers of scenes, one row per scene and moment, as many of each kind, and their kinds."""
    training = lessons.training
    moments = np.stack([training.episode, np.round(training.time_s * 100.0).astype(np.int64)])
    _, first = np.unique(moments, axis=1, return_index=True)
    known = scene_of(training.features[first].astype(np.float64))
    parts = [known[lessons.kinds[first] == kind] for kind in (HOME, SEEN_BADLY, FOREIGN)]
    parts[HOME] = np.concatenate([parts[HOME], capped(lessons.roads)])
    parts[SEEN_BADLY] = np.concatenate([parts[SEEN_BADLY], capped(lessons.sensed)])
    most = min(max(len(part) for part in parts), SCENES_OF_A_KIND)
    rng = np.random.default_rng(seed)
    drawn = [part[rng.choice(len(part), most, replace=len(part) < most)] for part in parts]
    return np.concatenate(drawn), np.repeat(np.arange(3, dtype=np.int8), most)


def _with_courses(scenes: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """(count, S) scenes in which courses are known, drawn with repetition."""
    known = scenes[scenes[:, COURSES] != UNKNOWN_SCENE]
    return np.asarray(known[rng.choice(len(known), count)])
