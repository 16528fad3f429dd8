"""Whose answers are right, under protocols without leaks.

- ``shipped``: the model that ships, as its stream answers, on episodes that nothing was trained on:
  usual traffic, other flows, mixes, limits and roads, and the other engine.
- ``inductive``: every method is trained on episodes and scored on unseen ones (other seeds), at
  every length of observation.
- ``across-scenarios``: trained on one scenario, scored on the others.
- ``across-traffic``: trained on usual traffic, scored on other flows, mixes, limits and roads.
- ``across-engines``: trained on one simulator's drivers, scored on another's.
- ``noise``: usual traffic seen by the model that ships with noise, at other frame rates, and with
  lost frames.
- ``leak-probe``: a forest that sees an agent's number and the time and nothing else; it has to stay
  at chance, and its interval has to hold chance.

Whole tracks are also scored by the plain rival ``nine-numbers`` (`experiments.rival`), trained on
the same drivers. Under ``inductive`` the ``ceiling`` is a forest that sees the drivers' true
parameters. Training and test data share no episode. Intervals are by bootstrap over episodes.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.errors import lookup
from behaviors.labels import BEHAVIORS
from behaviors.profiles import PROFILE_FIELDS
from experiments.benchmarks.classified import (
    AGES_S,
    Disturbance,
    Recordings,
    drivers,
    keys_of,
    majority_of,
)
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.rival import PlainRival, whole_track_samples
from experiments.score.answers import Answers, score_answers, scores_table
from experiments.score.rows import Cell, Row
from experiments.training.classifier import TRAINING_LIMITS_MPS
from graphrqi.classify import CLASSIFIERS, Classifier
from graphrqi.methods import METHODS, Model, train
from graphrqi.model_files import load_model
from graphrqi.samples import Samples
from sim.store.dataset import open_dataset
from sim.store.schema import Split

OURS, RIVAL = "graphrqi-plus", "nine-numbers"
"""The method that others are compared with, and the plain rival."""

SCENARIOS: Final = ("straight_road", "four_way_intersection")

TRAFFIC: Final[dict[str, dict[str, Any]]] = {
    "light flow": {"flow": "light"},
    "dense flow": {"flow": "dense"},
    "mostly careful": {"mix": {"careful": 0.6, "cautious": 0.2, "impatient": 0.1, "reckless": 0.04,
                               "threatening": 0.03, "timid": 0.03}},
    "limits of 40 and 60 km/h": {"limits_mps": (11.11, 16.67)},
    "other roads": {"scenarios": ("two_way_road", "priority_intersection")},
}  # fmt: skip
"""Options of `GenerateConfig` for traffic outside the training data, each with its baseline."""

WINDOWS_S: Final = (1.0, 3.0, 10.0, float("inf"))
"""Lengths of observation that are scored, s; the last is a whole track."""

MAIN_S: Final = (10.0, float("inf"))
"""Those at which everything but the length is compared."""

NOISE: Final = (
    *(("position noise", level) for level in (0.03, 0.1, 0.25, 0.5)),
    *(("correlated noise", level) for level in (0.03, 0.1, 0.25, 0.5)),
    *(("dropped frames", level) for level in (0.05, 0.15, 0.3)),
    *(("frame rate", level) for level in (25.0, 5.0, 2.5)),
)  # fmt: skip
"""Deviations in m, shares of frames, and Hz."""

CEILING_DRIVERS: Final = 600
"""Most training drivers of the ceiling, so that ceilings of datasets of other sizes can be
compared."""


@dataclasses.dataclass(frozen=True)
class Data:
    """The datasets, each made when first asked for.

    Attributes:
        folder: where datasets are made, and used again.
        methods: compared with one another, `OURS` first.
        episodes: of each scenario that are learned from; others are made in proportion.
        duration_s: of each, s.
        jobs: processes; None for one per core.
    """

    folder: Path
    methods: tuple[str, ...]
    episodes: int
    duration_s: float
    jobs: int | None

    def _made(self, name: str, share: float = 0.8, **options: Any) -> Recordings:
        where = self.folder / name.replace(" ", "-").replace("/", "")
        made = {"scenarios": SCENARIOS, "duration_s": self.duration_s, **options}
        config = GenerateConfig(episodes=max(3, round(share * self.episodes)), **made)
        generate(config, where, self.jobs, True)
        return Recordings(open_dataset(where), self.jobs)

    @cached_property
    def base(self) -> Recordings:
        """Training data, and the unseen episodes beside it."""
        return self._made("base", 1.0, seed=11, limits_mps=TRAINING_LIMITS_MPS)

    @cached_property
    def usual(self) -> Recordings:
        """Usual traffic that nothing was ever trained on."""
        return self._made("usual", 0.4, seed=14)

    @cached_property
    def many(self) -> Recordings:
        """Usual traffic for the leak probe, whose interval needs episodes."""
        return self._made("many", 2.7, seed=15)

    @cached_property
    def traffic(self) -> dict[str, Recordings]:
        """Traffic of other kinds."""
        return {name: self._made(name, seed=12, **options) for name, options in TRAFFIC.items()}

    @cached_property
    def engines(self) -> dict[str, Recordings]:
        """Drivers of other engines and laws."""
        return {
            name: self._made(name, seed=13 + number, engine=name)
            for number, name in enumerate(("highway", "highway-krauss", "sumo-idm"))
        }


def _answered(model: Model | Classifier | PlainRival, samples: Samples) -> Answers:
    """The answers to samples, with the truth."""
    classifier = model.classifier if isinstance(model, Model) else model
    probability = classifier.posterior(samples.features.astype(np.float64))
    return Answers.known(probability, samples.codes, samples.episode)


def _scored(answers: Answers, majority: int, keys: Mapping[str, Cell]) -> list[Row]:
    """The rows of answers; none if no driver was asked about."""
    return score_answers(answers, keys, majority, breakdown=False) if answers.truth.size else []


def _rival_rows(
    rival: PlainRival, data: Recordings, asked: Samples, keys: tuple[str, str, str], majority: int
) -> list[Row]:
    """The rival's rows on these drivers, whose whole tracks are scored."""
    same = data.all_tracks.where(np.isin(drivers(data.all_tracks), drivers(asked)))
    protocol, scenario, variation = keys
    named = keys_of(protocol, scenario, RIVAL, float("inf"), variation)
    return _scored(_answered(rival, same), majority, named)


def _model_rows(
    model: Model, majority: int, rival: PlainRival, data: Recordings, everything: bool,
    protocol: str, variation: str, scenarios: Sequence[str] = (),
) -> list[Row]:  # fmt: skip
    """Rows of a trained method at `MAIN_S`, and of the rival beside it, in each scenario."""
    rows: list[Row] = []
    samples = data.scored(model.method.name, MAIN_S, everything)
    for scenario in scenarios or data.dataset.scenarios:
        here = data.of(scenario, samples)
        for window_s in MAIN_S:
            part = here.where(here.window_s == window_s)
            keys = keys_of(protocol, scenario, model.method.name, window_s, variation)
            rows += _scored(_answered(model, part), majority, keys)
        whole = here.where(np.isinf(here.window_s))
        rows += _rival_rows(rival, data, whole, (protocol, scenario, variation), majority)
    return rows


def shipped(data: Data) -> Iterator[list[Row]]:
    """The model that ships, on traffic of every kind."""
    model = load_model(OURS)
    rival = PlainRival(data.base.training_tracks)
    others = {"": data.usual, **data.traffic, "highway engine": data.engines["highway"]}
    for name, recordings in others.items():
        yield _streamed_rows(recordings, model, rival, "shipped", name)


def _streamed_rows(
    data: Recordings, model: Model, rival: PlainRival | None, protocol: str, variation: str,
    disturbance: Disturbance = None,
) -> list[Row]:  # fmt: skip
    """Rows of a stream's answers at each age, in each scenario."""
    samples, probability = data.streamed(model, disturbance)
    answers = Answers.known(probability, samples.codes, samples.episode)
    rows: list[Row] = []
    for scenario in data.dataset.scenarios:
        chosen = data.scenario[samples.episode] == scenario
        for age_s in AGES_S:
            here = chosen & (samples.window_s == age_s)
            if here.any():
                keys = keys_of(protocol, scenario, model.method.name, age_s, variation)
                rows += _scored(answers.where(here), majority_of(samples.where(here)), keys)
        whole = data.of(scenario, samples.where(np.isinf(samples.window_s)))
        if rival is not None and len(whole):
            keyed = (protocol, scenario, variation)
            rows += _rival_rows(rival, data, whole, keyed, majority_of(whole))
    return rows


def inductive(data: Data) -> Iterator[list[Row]]:
    """Every method at every length of observation; rival and ceiling."""
    base = data.base
    rival = PlainRival(base.training_tracks)
    for method in data.methods:
        model, majority = base.fitted(method)
        samples = base.scored(method, WINDOWS_S)
        rows: list[Row] = []
        for scenario in base.dataset.scenarios:
            here = base.of(scenario, samples)
            for window_s in WINDOWS_S:
                part = here.where(here.window_s == window_s)
                if len(part):
                    keys = keys_of("inductive", scenario, method, window_s)
                    rows += _scored(_answered(model, part), majority, keys)
            whole = here.where(np.isinf(here.window_s))
            if method == data.methods[0] and len(whole):
                place = ("inductive", scenario, "")
                rows += _rival_rows(rival, base, whole, place, majority)
        yield rows
    yield ceiling(base)


def ceiling(data: Recordings) -> list[Row]:
    """A forest on the numbers that drivers were made from; an upper bound for every method.

    Desired speed, headway, gap, acceleration and braking; rates and probabilities are left out
    because they name the class directly.
    """
    known, asked = _profiles(data, "train"), _profiles(data, "test")
    chosen = np.random.default_rng(0).permutation(len(known))[:CEILING_DRIVERS]
    known = known.where(np.isin(np.arange(len(known)), chosen))
    forest = CLASSIFIERS["forest"](len(BEHAVIORS), trees=200, min_leaf=3, feature_share=0.4)
    forest.fit(known.features.astype(np.float64), known.codes, None, 0)
    rows: list[Row] = []
    for scenario in data.dataset.scenarios:
        answers = _answered(forest, data.of(scenario, asked))
        keys = keys_of("inductive", scenario, "ceiling", float("inf"))
        rows += _scored(answers, majority_of(known), keys)
    return rows


def _profiles(data: Recordings, split: Split) -> Samples:
    """Realised profile numbers of every driver of a split."""
    found = [
        ([getattr(a.profile, name) for name in PROFILE_FIELDS[:5]], a.behavior.code, number)
        for number, e in enumerate(data.dataset.manifest.episodes)
        if e.split == split
        for a in data.dataset.read(e).agents
        if a.behavior is not None and a.profile is not None
    ]
    numbers, codes, episode = (np.array(column) for column in zip(*found, strict=True))
    return whole_track_samples(numbers, codes, episode, np.arange(len(found)))


def across_scenarios(data: Data) -> Iterator[list[Row]]:
    """Trained on each scenario alone, scored on every other one."""
    base = data.base
    for trained_on in base.dataset.scenarios:
        others = [name for name in base.dataset.scenarios if name != trained_on]
        model, majority = base.fitted(data.methods[0], trained_on)
        rival = PlainRival(base.of(trained_on, base.training_tracks))
        about = f"trained on {trained_on}"
        yield _model_rows(model, majority, rival, base, False, "across-scenarios", about, others)


def across_traffic(data: Data) -> Iterator[list[Row]]:
    """Trained on usual traffic, scored on other traffic."""
    model, majority = data.base.fitted(data.methods[0])
    rival = PlainRival(data.base.training_tracks)
    for name, other in {"as usual": data.usual, **data.traffic}.items():
        yield _model_rows(model, majority, rival, other, True, "across-traffic", name)


def across_engines(data: Data) -> Iterator[list[Row]]:
    """Trained on one simulator's drivers, of one law or both, scored on another's."""
    sumo, highway = data.base, data.engines["highway"]
    ways: Mapping[str, tuple[list[Recordings], Recordings]] = {
        "sumo, scored on highway": ([sumo], highway),
        "sumo with both laws, scored on highway": ([sumo, data.engines["sumo-idm"]], highway),
        "highway, scored on sumo": ([highway], data.usual),
        "highway with both laws, scored on sumo": (
            [highway, data.engines["highway-krauss"]], data.usual,
        ),
    }  # fmt: skip
    method = data.methods[0]
    for name, (sources, other) in ways.items():
        training = Samples.join([source.training(method) for source in sources])
        held = [part for source in sources if (part := source.validation(method)) is not None]
        model = train(method, training, Samples.join(held) if held else None)
        rival = PlainRival(Samples.join([source.training_tracks for source in sources]))
        majority, about = majority_of(training), f"trained on {name}"
        yield _model_rows(model, majority, rival, other, True, "across-engines", about)


def noise(data: Data) -> Iterator[list[Row]]:
    """Usual traffic seen by worse sensors, by what ships."""
    model = load_model(OURS)
    for disturbance in (None, *NOISE):
        about = "undisturbed" if disturbance is None else f"{disturbance[0]} {disturbance[1]:g}"
        yield _streamed_rows(data.usual, model, None, "noise", about, disturbance)


def leak_probe(data: Data) -> Iterator[list[Row]]:
    """A forest on agent numbers and times: on all windows, and on each driver's first.

    A number and a time together give the time in sight, and slow drivers stay longer. When its
    first window ends, each has been in sight for as long.
    """
    many = data.many
    known, asked = (
        dataclasses.replace(part, features=np.stack([part.agent, part.time_s], 1).astype("f4"))
        for part in (many.training("majority"), many.scored("majority", MAIN_S[:1]))
    )
    forest = CLASSIFIERS["forest"](len(BEHAVIORS), feature_share=1.0)
    forest.fit(known.features.astype(np.float64), known.codes, None, 0)
    for scenario in many.dataset.scenarios:
        here = many.of(scenario, asked)
        first = np.zeros(len(here), dtype=bool)
        first[np.unique(drivers(here), return_index=True)[1]] = True  # they are in order of time
        for variation, part in (("", here), ("first window", here.where(first))):
            keys = keys_of("leak-probe", scenario, "leak-probe", MAIN_S[0], variation)
            yield _scored(_answered(forest, part), majority_of(known), keys)


PROTOCOLS: Final[dict[str, Callable[[Data], Iterator[list[Row]]]]] = {
    "shipped": shipped,
    "inductive": inductive,
    "leak-probe": leak_probe,
    "across-scenarios": across_scenarios,
    "across-traffic": across_traffic,
    "across-engines": across_engines,
    "noise": noise,
}
"""Measurements by name."""


def measure(
    protocols: Sequence[str] = (),
    methods: Sequence[str] = (),
    episodes: int = 15,
    duration_s: float = 150.0,
    jobs: int | None = None,
    out: Path | None = None,
) -> Iterator[list[Row]]:
    """Measure protocol after protocol.

    Args:
        protocols: keys of `PROTOCOLS`; () for all.
        methods: keys of ``METHODS`` that are compared; () for all. Under all protocols but
            ``inductive`` the first one alone is measured.
        episodes: of each scenario that are learned from; others are made in proportion.
        duration_s: of each episode, s.
        jobs: processes; None for one per core.
        out: where datasets are made, and used again; None for a temporary folder.

    Yields:
        Rows with the keys ``protocol, scenario, method, window_s, variation``.

    Raises:
        InputError: if a name is not known.
    """
    wanted = [lookup(PROTOCOLS, name, "protocol") for name in protocols or PROTOCOLS]
    for method in methods:
        lookup(METHODS, method, "method")
    names = tuple(methods) or (OURS, *(name for name in METHODS if name != OURS))
    with tempfile.TemporaryDirectory() as scratch:
        data = Data(out or Path(scratch), names, episodes, duration_s, jobs)
        for protocol in wanted:
            yield from protocol(data)


def table(rows: Sequence[Row]) -> list[Row]:
    """The scores for people: a line for each method, scenario, length of observation, variation."""
    return scores_table(rows, ("protocol", "scenario", "method", "window_s", "variation"))
