"""Whose answers are right, under protocols without leaks.

- ``shipped``: the model that ships, as its stream answers, on episodes that nothing was trained on:
  usual traffic, other flows, mixes, limits and roads, and the other engine.
- ``inductive``: every method is trained on episodes and scored on unseen ones (other seeds), at
  every length of observation.
- ``across-scenarios``: trained on one scenario, scored on the others.
- ``across-engines``: trained on one simulator's drivers, scored on another's.
- ``noise``: usual traffic seen by the model that ships with noise, at other frame rates, and with
  lost frames.
- ``leak-probe``: a forest that sees the numbers of episode and agent, the time and nothing else;
  it has to stay at chance, and its interval has to hold chance, but on rows split at random.

Whole tracks are also scored by the plain rival ``nine-numbers`` (`experiments.rival`), trained on
the same drivers. Under ``inductive`` the ``ceiling`` is a forest that sees the drivers' true
parameters. Training and test data share no episode. Intervals are by bootstrap over episodes.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from behaviors.errors import lookup
from behaviors.labels import BEHAVIORS
from behaviors.profiles import PROFILE_FIELDS
from experiments.data import disturbances
from experiments.data.parallel import in_parallel
from experiments.data.windows import gather, measured
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.rival import PlainRival, whole_track_samples, whole_tracks
from experiments.score.answers import known_answers, score_answers, scores_table
from experiments.score.labels import beliefs
from experiments.score.predictions import spaced
from experiments.score.rows import Cell, Row
from experiments.training.classifier import (
    TRAINING_EVERY_S,
    TRAINING_LIMITS_MPS,
    TRAINING_PER_MOMENT,
)
from graphrqi.classify import CLASSIFIERS
from graphrqi.methods import METHODS, Model, train
from graphrqi.model_files import load_model
from graphrqi.samples import WINDOWS_S as TRAINING_WINDOWS_S
from graphrqi.samples import Samples
from sim.frames import FloatArray
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import EpisodeEntry, Split

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
"""Options of `GenerateConfig` for traffic outside the training data."""

DATASETS: Final[dict[str, tuple[float, dict[str, Any]]]] = {
    "base": (1.0, {"seed": 11, "limits_mps": TRAINING_LIMITS_MPS}),
    "usual": (0.4, {"seed": 14}),
    "many": (2.7, {"seed": 15}),
    "highway": (0.8, {"seed": 13, "engine": "highway"}),
    "highway-krauss": (0.8, {"seed": 14, "engine": "highway-krauss"}),
    "sumo-idm": (0.8, {"seed": 15, "engine": "sumo-idm"}),
    **{name: (0.8, {"seed": 12, **options}) for name, options in TRAFFIC.items()},
}
"""Share of the episodes that are asked for, and options of each dataset: what is learned from with
unseen episodes beside it, usual traffic, much of it for the leak probe, and others."""

WHOLE: Final = float("inf")
"""The length of observation that is a driver's whole track."""

WINDOWS_S, MAIN_S = (1.0, 3.0, 10.0, WHOLE), (10.0, WHOLE)
"""Lengths of observation that are scored, s, and those at which all else is compared."""

AGES_S: Final = (3.0, 10.0, WHOLE)
"""Ages at which a stream is asked about every driver, s."""

SCORED_EVERY_S, ASKED_EVERY_S = 2.0, 1.0
"""Time between the ends of scored windows of one driver, and between questions to a stream, s."""

NOISE: Final[dict[str, tuple[disturbances.Disturbance, tuple[float, ...]]]] = {
    "position noise": (disturbances.position_noise, (0.03, 0.1, 0.25, 0.5)),
    "correlated noise": (disturbances.correlated_noise, (0.03, 0.1, 0.25, 0.5)),
    "dropped frames": (disturbances.dropped_frames, (0.05, 0.15, 0.3)),
    "frame rate": (disturbances.frame_rate, (25.0, 5.0, 2.5)),
}
"""Disturbances with their levels: deviations in m, shares of frames, and Hz."""

CEILING_DRIVERS: Final = 600
"""Most training drivers of the ceiling, so that datasets of other sizes can be compared."""


class Recordings:
    """A dataset as this benchmark sees it: windows, whole tracks, and streams' answers."""

    def __init__(self, dataset: Dataset, jobs: int | None = None) -> None:
        self.dataset, self._jobs = dataset, jobs
        self.scenario = np.array([e.scenario for e in dataset.manifest.episodes])
        self._gathered, self.fitted = cache(self._gather), cache(self._fit)

    def _gather(self, split: Split, method: str, windows_s: tuple[float, ...]) -> Samples:
        """Windows of a split for training, or of other lengths for scoring."""
        trained = windows_s == TRAINING_WINDOWS_S
        samples = gather(
            [self.dataset], split, method, windows_s=windows_s, jobs=self._jobs,
            every_s=TRAINING_EVERY_S if trained else SCORED_EVERY_S,
            per_moment=TRAINING_PER_MOMENT if trained else None,
        )  # fmt: skip
        if trained:
            return samples
        chosen = np.isfinite(samples.window_s)  # of whole tracks only the last look at each driver
        whole = np.flatnonzero(~chosen)[::-1]
        chosen[whole[np.unique(drivers(samples)[whole], return_index=True)[1]]] = True
        return samples.where(chosen)

    def training(self, method: str) -> Samples:
        """Windows of all lengths of the training episodes."""
        return self._gathered("train", method, tuple(TRAINING_WINDOWS_S))

    def validation(self, method: str) -> Samples | None:
        """The same of the validation episodes; None if there are none."""
        if not self.dataset.episodes("validation"):
            return None
        return self._gathered("validation", method, tuple(TRAINING_WINDOWS_S))

    def scored(self, method: str, windows_s: Sequence[float], everything: bool = False) -> Samples:
        """Windows of the test episodes, or of all."""
        splits: list[Split] = ["train", "validation", "test"] if everything else ["test"]
        there = [split for split in splits if self.dataset.episodes(split)]
        return Samples.join([self._gathered(s, method, tuple(windows_s)) for s in there])

    @cached_property
    def all_tracks(self) -> Samples:
        """The rival's nine numbers of every driver, in order of `drivers`."""
        return whole_tracks(self.dataset, None, self._jobs)

    @property
    def training_tracks(self) -> Samples:
        """Those of the drivers of the training episodes."""
        split = np.array([e.split for e in self.dataset.manifest.episodes])
        return self.all_tracks.where(split[self.all_tracks.episode] == "train")

    def of(self, scenario: str, samples: Samples) -> Samples:
        """The samples of one scenario, driver by driver."""
        here = samples.where(self.scenario[samples.episode] == scenario)
        order = np.argsort(drivers(here), kind="stable")
        return dataclasses.replace(
            here, **{f.name: getattr(here, f.name)[order] for f in dataclasses.fields(here)}
        )

    def _fit(self, method: str, scenario: str | None = None) -> tuple[Model, int]:
        """A method trained on the training episodes (of one scenario), and their majority class."""
        training, validation = self.training(method), self.validation(method)
        if scenario is not None:
            training = self.of(scenario, training)
            validation = validation and self.of(scenario, validation)
        return train(method, training, validation), _majority_of(training)

    def answers(self, probability: FloatArray, samples: Samples) -> pd.DataFrame:
        """Answers (n, 6) to samples with the truth, scenario, driver and length of observation."""
        return known_answers(probability, samples.codes, samples.episode).assign(
            scenario=self.scenario[samples.episode], window_s=samples.window_s,
            driver=drivers(samples),
        )  # fmt: skip

    def answered(
        self, model: Model, windows_s: Sequence[float] = MAIN_S, everything: bool = False
    ) -> pd.DataFrame:
        """A trained method's answers to windows of the test episodes, or of all."""
        samples = self.scored(model.method.name, windows_s, everything)
        return self.answers(model.classifier.posterior(samples.features.astype("f8")), samples)

    def streamed(self, model: Model, given: tuple[str, float] | None = None) -> pd.DataFrame:
        """A stream's answers about all drivers, who are seen with a disturbance of a level."""
        entries = self.dataset.manifest.episodes
        calls = [(self.dataset.path, e, i, model, given) for i, e in enumerate(entries)]
        samples, answers = zip(*in_parallel(_streamed, calls, self._jobs), strict=True)
        return self.answers(np.concatenate(answers), Samples.join(list(samples)))


class Data(dict[str, Recordings]):
    """The datasets by name, each made in a folder when first asked for, and the methods.

    Of each scenario, so many ``episodes`` are learned from; others are made in proportion.
    """

    def __init__(
        self, folder: Path, methods: tuple[str, ...], episodes: int, duration_s: float,
        jobs: int | None,
    ) -> None:  # fmt: skip
        self._folder, self.methods, self._episodes = folder, methods, episodes
        self._duration_s, self._jobs = duration_s, jobs

    def __missing__(self, name: str) -> Recordings:
        """Make the dataset of that name."""
        where = self._folder / name.replace(" ", "-").replace("/", "")
        share, options = DATASETS[name]
        made = {"scenarios": SCENARIOS, "duration_s": self._duration_s, **options}
        config = GenerateConfig(episodes=max(3, round(share * self._episodes)), **made)
        generate(config, where, self._jobs, True)
        self[name] = Recordings(open_dataset(where), self._jobs)
        return self[name]


def drivers(samples: Samples) -> FloatArray:
    """(n,) a number for each driver, which differs between episodes, too."""
    return np.asarray(samples.episode * 1e9 + samples.agent)


def _majority_of(samples: Samples) -> int:
    """The most frequent class among samples (of the training episodes, to be a fair rival)."""
    return int(np.bincount(samples.codes, minlength=len(BEHAVIORS)).argmax())


def _rows(
    data: Recordings, answers: pd.DataFrame, protocol: str, variation: str, method: str,
    majority: int | None = None, rival: PlainRival | None = None,
) -> list[Row]:  # fmt: skip
    """Rows of a method's answers in each scenario after each observation.

    The majority class is that of the scored drivers, if it is not given. The rival answers about
    the same drivers, whose whole tracks are scored.
    """
    rows: list[Row] = []
    for (scenario, window_s), some in answers.groupby(["scenario", "window_s"]):
        whole = window_s == WHOLE
        keys: dict[str, Cell] = {
            "protocol": protocol, "scenario": scenario, "method": method,
            "window_s": None if whole else window_s,
            "variation": ", ".join(filter(None, ("whole track" if whole else "", variation))),
        }  # fmt: skip
        usual = pd.Categorical(some["truth"], [*map(str, BEHAVIORS)]).codes
        given = int(np.bincount(usual).argmax()) if majority is None else majority
        rows += score_answers(some, keys, given, breakdown=False)
    if rival is not None:
        asked = answers["driver"][answers["window_s"] == WHOLE]
        same = data.all_tracks.where(np.isin(drivers(data.all_tracks), asked))
        theirs = data.answers(rival.posterior(same.features), same)
        rows += _rows(data, theirs, protocol, variation, RIVAL, majority)
    return rows


def _streamed(
    folder: Path, entry: EpisodeEntry, number: int, model: Model, given: tuple[str, float] | None
) -> tuple[Samples, FloatArray]:
    """A stream's answers on one episode, seen with a disturbance, and samples without features.

    There is one for each labelled driver and each of `AGES_S` that it reaches.
    """
    tracks = measured(open_dataset(folder).read(entry))
    if given is not None:
        tracks = NOISE[given[0]][0](tracks, given[1], np.random.default_rng(number))
    stops = list(spaced(tracks.time_s, 0.0, ASKED_EVERY_S))
    asked = beliefs(tracks, model, stops).values()
    probability = np.concatenate([one.probability for one in asked])
    row = np.searchsorted(tracks.ids, np.concatenate([one.ids for one in asked]))
    at_s = np.repeat(tracks.time_s[np.array(stops) - 1], [one.ids.size for one in asked])
    age_s = at_s - tracks.time_s[tracks.valid.argmax(axis=1)][row]
    codes = np.full(tracks.ids.size, -1) if tracks.behavior is None else tracks.behavior
    chosen = []
    for wanted_s in AGES_S:  # the first answer at an age, and the last one of all
        due = np.flatnonzero((age_s >= wanted_s - 1e-6) & (codes[row] >= 0))
        if wanted_s == WHOLE:
            due = np.flatnonzero((age_s >= AGES_S[0] - 1e-6) & (codes[row] >= 0))[::-1]
        chosen.append(due[np.unique(row[due], return_index=True)[1]])
    at = np.concatenate(chosen)
    window_s = np.repeat(AGES_S, [each.size for each in chosen])
    samples = Samples(
        np.empty((at.size, 0), dtype=np.float32), codes[row[at]].astype(np.int8),
        np.full(at.size, number), tracks.ids[row[at]], at_s[at], window_s, window_s,
        np.ones(at.size, dtype=bool),
    )  # fmt: skip
    return samples, probability[at]


def shipped(data: Data) -> Iterator[list[Row]]:
    """The model that ships, on traffic of every kind."""
    model = load_model(OURS)
    rival = PlainRival(data["base"].training_tracks)
    named = [("", "usual"), *((name, name) for name in TRAFFIC), ("highway engine", "highway")]
    for name, seen in ((name, data[made]) for name, made in named):
        yield _rows(seen, seen.streamed(model), "shipped", name, OURS, rival=rival)


def inductive(data: Data) -> Iterator[list[Row]]:
    """Every method at every length of observation; rival and ceiling."""
    base = data["base"]
    rival: PlainRival | None = PlainRival(base.training_tracks)
    for method in data.methods:
        model, majority = base.fitted(method)
        answers = base.answered(model, WINDOWS_S)
        yield _rows(base, answers, "inductive", "", method, majority, rival)
        rival = None
    yield ceiling(base)


def ceiling(data: Recordings) -> list[Row]:
    """A forest on the numbers that drivers were made from; an upper bound for every method.

    Desired speed, headway, gap, acceleration and braking; rates and probabilities are left out
    because they name the class directly.
    """
    known, asked = _profiles(data, "train"), _profiles(data, "test")
    chosen = np.random.default_rng(0).permutation(len(known))[:CEILING_DRIVERS]
    known = known.where(np.isin(np.arange(len(known)), chosen))
    answers = _forest_answers(data, known, asked, trees=200, min_leaf=3, feature_share=0.4)
    return _rows(data, answers, "inductive", "", "ceiling", _majority_of(known))


def _forest_answers(
    data: Recordings, known: Samples, asked: Samples, **options: Any
) -> pd.DataFrame:
    forest = CLASSIFIERS["forest"](len(BEHAVIORS), **options)
    forest.fit(known.features.astype(np.float64), known.codes, None, 0)
    return data.answers(forest.posterior(asked.features.astype(np.float64)), asked)


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
    base, method = data["base"], data.methods[0]
    for source in base.dataset.scenarios:
        model, majority = base.fitted(method, source)
        rival, about = PlainRival(base.of(source, base.training_tracks)), f"trained on {source}"
        answers = base.answered(model)
        others = answers[answers["scenario"] != source]
        yield _rows(base, others, "across-scenarios", about, method, majority, rival)


def across_engines(data: Data) -> Iterator[list[Row]]:
    """Trained on one simulator's drivers, of one law or both, scored on another's."""
    sumo, highway = data["base"], data["highway"]
    ways: Mapping[str, tuple[list[Recordings], Recordings]] = {
        "sumo, scored on highway": ([sumo], highway),
        "sumo with both laws, scored on highway": ([sumo, data["sumo-idm"]], highway),
        "highway, scored on sumo": ([highway], data["usual"]),
        "highway with both laws, scored on sumo": (
            [highway, data["highway-krauss"]], data["usual"],
        ),
    }  # fmt: skip
    method = data.methods[0]
    for name, (sources, other) in ways.items():
        training = Samples.join([source.training(method) for source in sources])
        held = [part for source in sources if (part := source.validation(method)) is not None]
        model = train(method, training, Samples.join(held) if held else None)
        rival = PlainRival(Samples.join([source.training_tracks for source in sources]))
        majority, about = _majority_of(training), f"trained on {name}"
        answers = other.answered(model, everything=True)
        yield _rows(other, answers, "across-engines", about, method, majority, rival)


def noise(data: Data) -> Iterator[list[Row]]:
    """Usual traffic seen by worse sensors, by what ships."""
    model = load_model(OURS)
    levels = ((name, level) for name, (_, levels) in NOISE.items() for level in levels)
    for given in (None, *levels):
        about = "undisturbed" if given is None else f"{given[0]} {given[1]:g}"
        yield _rows(data["usual"], data["usual"].streamed(model, given), "noise", about, OURS)


def leak_probe(data: Data) -> Iterator[list[Row]]:
    """A forest on who and when: all windows, each driver's first, and rows split at random.

    Agent and time together give the time in sight, and slow drivers stay longer. When its first
    window ends, each has been in sight for as long. Random rows are what papers score: drivers that
    it learned from are scored, too.
    """
    many = data["many"]
    known, asked = (
        dataclasses.replace(
            part, features=np.stack([part.episode, part.agent, part.time_s], 1).astype("f4")
        )
        for part in (many.training("majority"), many.scored("majority", MAIN_S[:1]))
    )
    answers = _forest_answers(many, known, asked, feature_share=1.0)
    _, first = np.unique(answers["driver"], return_index=True)  # windows are in order of time
    half = np.random.default_rng(0).random(len(asked)) < 0.5
    learned, scored = asked.where(half), asked.where(~half)
    mixed = _forest_answers(many, learned, scored, feature_share=1.0, min_leaf=1)
    for variation, some in (
        ("", answers), ("first window", answers.iloc[first]), ("random rows", mixed),
    ):  # fmt: skip
        yield _rows(many, some, "leak-probe", variation, "leak-probe", _majority_of(known))


PROTOCOLS: Final[dict[str, Callable[[Data], Iterator[list[Row]]]]] = {
    "shipped": shipped,
    "inductive": inductive,
    "leak-probe": leak_probe,
    "across-scenarios": across_scenarios,
    "across-engines": across_engines,
    "noise": noise,
}
"""Measurements by name."""


def measure(
    protocols: Sequence[str] = (), methods: Sequence[str] = (), episodes: int = 15,
    duration_s: float = 150.0, jobs: int | None = None, out: Path | None = None,
) -> Iterator[list[Row]]:  # fmt: skip
    """Rows of protocol after protocol, by ``protocol, scenario, method, window_s, variation``.

    Keys of `PROTOCOLS` and ``METHODS`` are chosen; () for all. Under all protocols but
    ``inductive`` the first method alone is measured. Datasets of so many episodes of each scenario
    are made in the folder ``out``, and used again.
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
