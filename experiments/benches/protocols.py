"""Classification under protocols that cannot leak, and how far each disturbance hurts.

Every row says the protocol it was measured under:

- ``inductive``: trained on training episodes, scored on episodes that were never seen.
- ``shipped``: the model that ships with the package, on episodes of which it saw none, corrected
  for the mix of each episode as it streams; everything else looks at each window by itself.
- ``leak-probe``: as ``inductive``, on many more episodes, seeing only who and when.
- ``random-rows``: what not to do: rows of the same drivers are learned and scored.
- ``transductive``: half the drivers of an episode are labelled, the other half are scored.
- ``across-scenarios``: trained on one scenario's episodes, scored on another's.
- ``across-traffic``: scored on flows, mixes and scenarios that were never trained on.
- ``across-engines``: trained on one simulator's drivers, scored on another's.
- ``ablation``: ours without one kind of feature, and what that kind adds.
- ``robustness``: windows, noise, lost frames, switches, cuts, long-tailed mixes, wrong labels.

The ``leak-probe`` sees an agent's number and the time and nothing else; it has to stay at chance,
and its interval has to hold chance.
The ``ceiling`` sees the numbers that the drivers were made from. Intervals are by bootstrap over
episodes; differences are of paired bootstraps.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS, Style
from behaviors.profiles import PROFILE_FIELDS
from experiments.data.disturbances import DISTURBANCES
from experiments.data.parallel import in_parallel
from experiments.rows import Cell, Row, tidy_row
from experiments.scoring.metrics import (
    METRICS,
    Statistic,
    bootstrap,
    calibration_error,
    confusion,
    recall_of,
    reliability,
    weighted_accuracy,
)
from experiments.scoring.models import majority_of
from experiments.training.classifier import TRAINING_EVERY_S, TRAINING_PER_MOMENT
from graphrqi.classify import Classifier, make_classifier
from graphrqi.features.baseline import FREE_FLOW, GRAPH_SIGNALS, LAW_HEADWAYS
from graphrqi.methods import METHODS, Model, load_model, train
from graphrqi.prior_shift import PriorShift
from graphrqi.samples import WINDOWS_S, Samples, collect
from graphrqi.stream import BehaviorStream
from sim.frames import Tracks
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import EpisodeEntry, Split

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

OURS: Final = "graphrqi-plus"
"""The method that the others are compared with."""

RIVALS: Final = ("forest", "boosted", "cheung", "dane", "graphrqi", "graphrqi-invariant")
"""Methods whose paired difference to ours is given."""

SCORED_S: Final = (1.0, 2.0, 3.0, 5.0, 10.0, 15.0, float("inf"))
"""Lengths of observation scored; the last is a driver's whole life."""

MAIN_S: Final = 10.0
"""Length of observation at which everything but the window is compared."""

SCORED_EVERY_S: Final = 2.0
"""Time between the ends of scored windows of one driver (our choice)."""

LONG_TAIL: Final = (53, 13, 52, 266, 2, 6)
"""Agents of each behaviour in the annotated TRAF videos, in the order of ``BEHAVIORS``."""

CEILING_DRIVERS: Final = 600
"""Training drivers that the ceiling learns from at most (our choice, about those of one scenario in
the bench's own data): the more it sees, the nearer it comes to where draws are cut off, so ceilings
of datasets of other sizes could not be compared."""

TRAINED_WITH: Final = ("position noise",)
"""Disturbances that are also trained with: what every sensor has."""

CROWDS: Final = (100, 1000)
"""Numbers of agents that the time per frame is given for."""

WRONG_LABELS: Final = (0.1, 0.3)
"""Shares of training drivers whose label is replaced by another one."""


@dataclasses.dataclass(frozen=True, slots=True)
class Disturbed:
    """A disturbance at a level; the empty name leaves recordings as they are."""

    name: str = ""
    level: float = 0.0

    def __str__(self) -> str:
        """For the ``variation`` column."""
        return f"{self.name} {self.level:g} {DISTURBANCES[self.name][2]}" if self.name else ""

    def applied(self, tracks: Tracks, seed: int) -> Tracks:
        """The tracks as a sensor would see them."""
        if not self.name:
            return tracks
        return DISTURBANCES[self.name][0](tracks, self.level, np.random.default_rng(seed))


UNDISTURBED: Final = Disturbed()


def disturbed_samples(
    folder: Path,
    entry: EpisodeEntry,
    number: int,
    method: str,
    disturbed: Disturbed,
    windows_s: Sequence[float],
    every_s: float,
    per_moment: int | None,
) -> Samples:
    """Samples of one episode; of lives that are scored only the last look at each driver.

    Args:
        folder: of the dataset.
        entry: which episode.
        number: to put on the samples, and the seed of what is drawn.
        method: whose observer looks.
        disturbed: what happens to the recording.
        windows_s: lengths of observation.
        every_s: time between the ends of windows.
        per_moment: how many lengths to draw per driver and moment; None for all.

    Returns:
        The samples.
    """
    tracks = disturbed.applied(open_dataset(folder).read(entry).tracks, number)
    observer = METHODS[method].observer("graphrqi")
    if per_moment is not None:
        return collect(tracks, observer, number, windows_s, every_s, per_moment, number)
    samples = collect(tracks, observer, number, windows_s, every_s, None, number)
    chosen = np.isfinite(samples.window_s)
    lives = np.flatnonzero(~chosen)[::-1]  # latest first
    chosen[lives[np.unique(samples.agent[lives], return_index=True)[1]]] = True
    return samples.where(chosen)


class Recordings:
    """Samples of a dataset's episodes, made once for all methods that look alike.

    Args:
        dataset: where from.
        jobs: processes; None for one per core.
    """

    def __init__(self, dataset: Dataset, jobs: int | None = None) -> None:
        self.dataset = dataset
        self._jobs = jobs
        self._number = {e.id: i for i, e in enumerate(dataset.manifest.episodes)}
        self.scenario = np.array([e.scenario for e in dataset.manifest.episodes])
        self._kept: dict[
            tuple[tuple[object, ...], tuple[float, ...], tuple[str, ...]], Samples
        ] = {}
        self._fitted: dict[tuple[str, str | None, Disturbed], tuple[Model, int]] = {}

    def _gather(
        self,
        split: Split | None,
        method: str,
        disturbed: Disturbed,
        windows_s: Sequence[float],
        every_s: float,
        per_moment: int | None,
    ) -> Samples:
        names = METHODS[method].observer("graphrqi").feature_names
        what = (split, disturbed, every_s, per_moment)
        for (looked, lengths, found), samples in self._kept.items():
            enough = lengths == tuple(windows_s) or (
                per_moment is None and set(windows_s) <= set(lengths)
            )
            if looked == what and enough and set(names) <= set(found):
                # A column of one name is the same, and so is a window of one length.
                wanted = samples.where(np.isin(samples.window_s, windows_s))
                columns = [found.index(name) for name in names]
                return dataclasses.replace(wanted, features=wanted.features[:, columns])
        arguments = [
            (self.dataset.path, entry, self._number[entry.id], method, disturbed,
             tuple(windows_s), every_s, per_moment)
            for entry in self.dataset.episodes(split)
        ]  # fmt: skip
        samples = Samples.join(list(in_parallel(disturbed_samples, arguments, self._jobs)))
        self._kept[what, tuple(windows_s), names] = samples
        return samples

    def training(self, method: str, disturbed: Disturbed = UNDISTURBED) -> Samples:
        """Windows of all lengths of the training episodes."""
        return self._gather(
            "train", method, disturbed, WINDOWS_S, TRAINING_EVERY_S, TRAINING_PER_MOMENT
        )

    def validation(self, method: str, disturbed: Disturbed = UNDISTURBED) -> Samples | None:
        """The same of the validation episodes; None if there are none."""
        if not self.dataset.episodes("validation"):
            return None
        return self._gather(
            "validation", method, disturbed, WINDOWS_S, TRAINING_EVERY_S, TRAINING_PER_MOMENT
        )

    def scored(
        self,
        method: str,
        windows_s: Sequence[float] = (MAIN_S,),
        disturbed: Disturbed = UNDISTURBED,
        split: Split | None = "test",
    ) -> Samples:
        """Windows of the test episodes (or of all, where ``split`` is None)."""
        return self._gather(split, method, disturbed, windows_s, SCORED_EVERY_S, None)

    def of(self, scenario: str, samples: Samples) -> Samples:
        """The samples of one scenario."""
        return samples.where(self.scenario[samples.episode] == scenario)

    def fitted(
        self, method: str, scenario: str | None = None, disturbed: Disturbed = UNDISTURBED
    ) -> tuple[Model, int]:
        """A method trained on the training episodes (of one scenario), and their majority class."""
        key = (method, scenario, disturbed)
        if key not in self._fitted:
            training = self.training(method, disturbed)
            validation = self.validation(method, disturbed)
            if scenario is not None:
                training = self.of(scenario, training)
                validation = None if validation is None else self.of(scenario, validation)
            self._fitted[key] = train(method, training, validation), majority_of(training)
        return self._fitted[key]


def fitted_together(sources: Sequence[Recordings], method: str) -> tuple[Model, int]:
    """A method trained on the training episodes of all datasets, and their majority class."""
    if len(sources) == 1:
        return sources[0].fitted(method)
    training = Samples.join([source.training(method) for source in sources])
    held = [samples for source in sources if (samples := source.validation(method)) is not None]
    return train(method, training, Samples.join(held) if held else None), majority_of(training)


# --- rows ---------------------------------------------------------------------------------------


def score_rows(
    samples: Samples, probability: FloatArray, majority: int, keys: Mapping[str, Cell]
) -> list[Row]:
    """Rows of every metric of one method's answers."""
    matrices = {
        name: confusion(samples.codes, answer(probability), samples.episode)
        for name, (answer, _) in METRICS.items()
    }
    constant = confusion(samples.codes, np.full(len(samples), majority), samples.episode)
    bins = reliability(samples.codes, probability, samples.episode)
    values = {name: bootstrap(metric, matrices[name]) for name, (_, metric) in METRICS.items()}
    values["majority_weighted_accuracy"] = bootstrap(weighted_accuracy, constant)
    values["ece"] = bootstrap(calibration_error, bins)
    for code in np.unique(samples.codes):
        values[f"recall_{BEHAVIORS[code].value}"] = bootstrap(recall_of(code), matrices["macro_f1"])
    return [tidy_row(keys, metric, *value, len(samples)) for metric, value in values.items()]


def reliability_rows(
    samples: Samples, probability: FloatArray, keys: Mapping[str, Cell]
) -> list[Row]:
    """How often answers given with each confidence are right."""
    bins = reliability(samples.codes, probability, samples.episode)
    edges = np.linspace(0.0, 1.0, bins.shape[1] + 1)
    rows = []
    for number in np.flatnonzero(bins[..., 0].sum(axis=0)):
        value = bootstrap(_share_right, bins[:, number])
        about = f"confidence {edges[number]:.2f} to {edges[number + 1]:.2f}"
        n = int(bins[:, number, 0].sum())
        rows.append(tidy_row({**keys, "variation": about}, "share_right", *value, n))
    return rows


def _share_right(counts: FloatArray) -> FloatArray:
    """(...) of answers, confidences and right answers (..., 3); NaN where there is no answer."""
    with np.errstate(invalid="ignore"):
        return np.asarray(counts[..., 2] / counts[..., 0])


def _keys(
    protocol: str, scenario: str, method: str, window_s: float | None, variation: str = ""
) -> dict[str, Cell]:
    if window_s is not None and not np.isfinite(window_s):
        window_s, variation = None, ", ".join(filter(None, ("whole life", variation)))
    return {
        "protocol": protocol,
        "scenario": scenario,
        "method": method,
        "window_s": window_s,
        "variation": variation,
    }


def _posterior(model: Model | Classifier, samples: Samples) -> FloatArray:
    return model.posterior(samples.features.astype(np.float64))


def _as_long_as(samples: Samples, window_s: float) -> NDArray[np.bool_]:
    """Which samples were observed for this long."""
    return np.asarray(samples.window_s == window_s)


def difference_rows(
    samples: Samples, ours: FloatArray, theirs: FloatArray, keys: Mapping[str, Cell]
) -> list[Row]:
    """How much better ours is, on the same windows, with a paired interval."""
    rows = []
    for name in ("macro_f1", "style_balanced_accuracy"):
        answer, metric = METRICS[name]
        pair = np.stack(
            [confusion(samples.codes, answer(p), samples.episode) for p in (ours, theirs)], axis=1
        )

        def statistic(counts: FloatArray, metric: Statistic = metric) -> FloatArray:
            both = metric(counts)
            return np.asarray(both[..., 0] - both[..., 1])

        value = bootstrap(statistic, pair)
        rows.append(tidy_row(keys, f"{name}_difference", *value, len(samples)))
    return rows


# --- protocols ----------------------------------------------------------------------------------


def inductive(
    recordings: Recordings, methods: Sequence[str], windows_s: Sequence[float]
) -> list[Row]:
    """Unseen episodes, every method, every length of observation; ours against each rival."""
    rows: list[Row] = []
    answers: dict[tuple[str, str], FloatArray] = {}
    for method in methods:
        model, majority = recordings.fitted(method)
        everything = recordings.scored(method, windows_s)
        for scenario in recordings.dataset.scenarios:
            here = recordings.of(scenario, everything)
            for window_s in windows_s:
                samples = here.where(_as_long_as(here, window_s))
                if not len(samples):
                    continue
                probability = _posterior(model, samples)
                keys = _keys("inductive", scenario, method, window_s)
                rows += score_rows(samples, probability, majority, keys)
                if window_s == MAIN_S:
                    answers[scenario, method] = probability
                    if method == OURS:
                        rows += reliability_rows(samples, probability, keys)
                    moving = samples.where(samples.moving)
                    if len(moving):
                        keys = _keys("inductive", scenario, method, window_s, "moving")
                        rows += score_rows(moving, _posterior(model, moving), majority, keys)
            rival = answers.get((scenario, OURS))
            if rival is not None and method in RIVALS and (scenario, method) in answers:
                samples = here.where(_as_long_as(here, MAIN_S))
                keys = _keys("inductive", scenario, OURS, MAIN_S, f"minus {method}")
                rows += difference_rows(samples, rival, answers[scenario, method], keys)
    return rows


def shipped(
    recordings: Recordings, windows_s: Sequence[float] = SCORED_S, traffic: str = ""
) -> list[Row]:
    """The model that ships with the package, on all episodes of a dataset that it never saw.

    As its stream answers, corrected for the mix of the scene; and each driver by itself.
    """
    model = load_model(OURS)
    everything = recordings.scored(OURS, windows_s, split=None)
    rows: list[Row] = []
    for scenario in recordings.dataset.scenarios:
        here = recordings.of(scenario, everything)
        for window_s in windows_s:
            samples = here.where(_as_long_as(here, window_s))
            if not len(samples):
                continue
            alone = _posterior(model, samples)
            streamed = in_scenes(model, samples, alone)
            whole = np.ones(len(samples), dtype=bool)
            looks = [("", streamed, whole), ("by itself", alone, whole)]
            if np.isfinite(window_s) and samples.moving.any():
                looks.append(("moving", streamed, samples.moving))
            for about, probability, chosen in looks:
                part = samples.where(chosen)
                variation = ", ".join(filter(None, (traffic, about)))
                keys = _keys("shipped", scenario, OURS, window_s, variation)
                rows += score_rows(part, probability[chosen], majority_of(part), keys)
                if window_s == MAIN_S and not variation:
                    rows += reliability_rows(part, probability[chosen], keys)
    return rows


def in_scenes(model: Model, samples: Samples, probability: FloatArray) -> FloatArray:
    """Answers corrected for the mix of each episode, moment by moment.

    Args:
        model: whose answers they are.
        samples: n, one of a driver and moment at most.
        probability: (n, 6) the answers, each driver's by itself.

    Returns:
        (n, 6) what a stream would answer that observed no longer than the samples.
    """
    corrected = np.empty_like(probability)
    for episode in np.unique(samples.episode):
        mix = PriorShift(np.array(model.shares))
        here = np.flatnonzero(samples.episode == episode)
        for moment in np.unique(samples.time_s[here]):
            now = here[samples.time_s[here] == moment]
            mix.observe(float(moment), samples.agent[now], probability[now])
            corrected[now] = mix.corrected(probability[now])
    return corrected


def random_rows(recordings: Recordings, methods: Sequence[str]) -> list[Row]:
    """Half of all windows learned and the other half scored, drivers and all: a leak, measured."""
    rows: list[Row] = []
    for method in (*methods, "leak-probe"):
        samples = recordings.scored("majority" if method == "leak-probe" else method)
        learned = np.random.default_rng(0).random(len(samples)) < 0.5
        training, asked = samples.where(learned), samples.where(~learned)
        if method == "leak-probe":
            training, asked = _who_and_when(training), _who_and_when(asked)
            probe = make_classifier("forest", len(BEHAVIORS), feature_share=1.0)
            probe.fit(training.features.astype(np.float64), training.codes, None, 0)
            probability = _posterior(probe, asked)
        else:
            probability = _posterior(train(method, training), asked)
        for scenario in recordings.dataset.scenarios:
            chosen = recordings.scenario[asked.episode] == scenario
            keys = _keys("random-rows", scenario, method, MAIN_S)
            majority = majority_of(training)
            rows += score_rows(asked.where(chosen), probability[chosen], majority, keys)
    return rows


def _who_and_when(samples: Samples) -> Samples:
    features = np.stack([samples.episode, samples.agent, samples.time_s], axis=1)
    return dataclasses.replace(samples, features=features.astype(np.float32))


KINDS_OF_FEATURES: Final[dict[str, tuple[str, ...]]] = {
    "spectrum": ("spectrum_",),
    "graph signals": tuple(f"{name}:" for name in GRAPH_SIGNALS),
    "inferred driver": ("steady:", "held up:", *(f"{name}:" for name in LAW_HEADWAYS)),
    "pace": tuple(f"{name}:" for name in FREE_FLOW),
}
"""What the names of each kind of feature begin with."""


def ablation(recordings: Recordings) -> list[Row]:
    """Ours without each kind of feature, on the same windows, and the paired difference."""
    method = METHODS[OURS]
    names = method.observer("graphrqi").feature_names
    training, validation = recordings.training(OURS), recordings.validation(OURS)
    samples = recordings.scored(OURS)
    whole = _posterior(recordings.fitted(OURS)[0], samples)
    rows: list[Row] = []
    for kind, beginnings in KINDS_OF_FEATURES.items():
        kept = np.flatnonzero([not name.startswith(beginnings) for name in names])
        learner = make_classifier(method.classifier, len(BEHAVIORS), **method.options)
        parts = [
            (part.features[:, kept].astype(np.float64), part.codes)
            for part in (training, validation)
            if part is not None
        ]
        learner.fit(*parts[0], parts[1] if len(parts) > 1 else None, seed=0)
        without = learner.posterior(samples.features[:, kept].astype(np.float64))
        for scenario in recordings.dataset.scenarios:
            chosen = recordings.scenario[samples.episode] == scenario
            here = samples.where(chosen)
            keys = _keys("ablation", scenario, OURS, MAIN_S, f"without {kind}")
            rows += score_rows(here, without[chosen], majority_of(training), keys)
            keys = _keys("ablation", scenario, OURS, MAIN_S, f"minus without {kind}")
            rows += difference_rows(here, whole[chosen], without[chosen], keys)
    return rows


def leak_probe(recordings: Recordings) -> list[Row]:
    """A forest that sees who and when: on everyone's windows, and on each driver's first.

    A number and a time together tell how long a driver has been in sight, and slow ones stay
    longer. When its first window ends, each has been in sight for as long.
    """
    parts = [
        dataclasses.replace(
            samples, features=np.stack([samples.agent, samples.time_s], axis=1).astype(np.float32)
        )
        for samples in (recordings.training("majority"), recordings.scored("majority"))
    ]
    forest = make_classifier("forest", len(BEHAVIORS), feature_share=1.0)
    forest.fit(parts[0].features.astype(np.float64), parts[0].codes, None, 0)
    rows: list[Row] = []
    for scenario in recordings.dataset.scenarios:
        here = recordings.of(scenario, parts[1])
        driver = here.episode * 10**9 + here.agent
        first = np.zeros(len(here), dtype=bool)
        first[np.unique(driver, return_index=True)[1]] = True  # of an episode's, in order of time
        for variation, samples in (("", here), ("first window", here.where(first))):
            keys = _keys("leak-probe", scenario, "leak-probe", MAIN_S, variation)
            rows += score_rows(samples, _posterior(forest, samples), majority_of(parts[0]), keys)
    return rows


def _drivers(dataset: Dataset, split: Split) -> tuple[FloatArray, NDArray[np.int8], IntArray]:
    """Realised profile numbers, codes and episode of every driver of a split."""
    numbers, codes, episodes = [], [], []
    index = {e.id: i for i, e in enumerate(dataset.manifest.episodes)}
    for entry in dataset.episodes(split):
        for agent in dataset.read(entry).agents:
            if agent.behavior is not None and agent.profile is not None:
                numbers.append([getattr(agent.profile, name) for name in PROFILE_FIELDS[:5]])
                codes.append(agent.behavior.code)
                episodes.append(index[entry.id])
    return np.array(numbers), np.array(codes, dtype=np.int8), np.array(episodes)


def ceiling(recordings: Recordings) -> list[Row]:
    """A forest on the numbers that drivers were made from: nobody can do much better.

    Desired speed, headway, gap, acceleration and braking; not the rates and probabilities, which
    tell the class at once and show in hardly any window.
    """
    numbers, codes, _ = _drivers(recordings.dataset, "train")
    chosen = np.random.default_rng(0).permutation(codes.size)[:CEILING_DRIVERS]
    numbers, codes = numbers[chosen], codes[chosen]
    forest = make_classifier("forest", len(BEHAVIORS), trees=200, min_leaf=3, feature_share=0.4)
    forest.fit(numbers, codes, None, 0)
    numbers, truth, episode = _drivers(recordings.dataset, "test")
    nothing, whole = np.zeros(truth.size), np.full(truth.size, np.inf)
    samples = Samples(
        numbers.astype(np.float32), truth, episode, np.arange(truth.size), nothing, whole, whole,
        np.ones(truth.size, dtype=bool),
    )  # fmt: skip
    rows: list[Row] = []
    for scenario in recordings.dataset.scenarios:
        here = recordings.of(scenario, samples)
        keys = _keys("inductive", scenario, "ceiling", float("inf"))
        majority = int(np.bincount(codes).argmax())
        rows += score_rows(here, _posterior(forest, here), majority, keys)
    return rows


def transductive(recordings: Recordings, methods: Sequence[str]) -> list[Row]:
    """Half the drivers of each test episode are labelled, the others are scored."""
    rows: list[Row] = []
    for method in methods:
        samples = recordings.scored(method)
        rng = np.random.default_rng(0)
        scored: dict[str, list[tuple[Samples, FloatArray]]] = {}
        for episode in np.unique(samples.episode):
            here = samples.where(samples.episode == episode)
            agents = rng.permutation(np.unique(here.agent))
            known = np.isin(here.agent, agents[: agents.size // 2])
            labelled, asked = here.where(known), here.where(~known)
            if np.unique(labelled.codes).size < 2 or not len(asked):
                continue
            model = train(method, labelled)
            scenario = str(recordings.scenario[episode])
            scored.setdefault(scenario, []).append((asked, _posterior(model, asked)))
        for scenario, parts in scored.items():
            together = Samples.join([part for part, _ in parts])
            probability = np.concatenate([p for _, p in parts])
            keys = _keys("transductive", scenario, method, MAIN_S)
            rows += score_rows(together, probability, majority_of(samples), keys)
    return rows


def across_scenarios(recordings: Recordings, methods: Sequence[str]) -> list[Row]:
    """Trained on each scenario alone, scored on every other one."""
    rows: list[Row] = []
    for method in methods:
        test = recordings.scored(method)
        for trained_on in recordings.dataset.scenarios:
            model, majority = recordings.fitted(method, trained_on)
            for scenario in recordings.dataset.scenarios:
                if scenario == trained_on:
                    continue
                here = recordings.of(scenario, test)
                for variation, samples in (("", here), (", moving", here.where(here.moving))):
                    about = f"trained on {trained_on}{variation}"
                    keys = _keys("across-scenarios", scenario, method, MAIN_S, about)
                    rows += score_rows(samples, _posterior(model, samples), majority, keys)
    return rows


def across_datasets(
    sources: Sequence[Recordings],
    others: Mapping[str, Recordings],
    methods: Sequence[str],
    protocol: str,
) -> list[Row]:
    """Trained on datasets together, scored on all of others, named by what differs."""
    rows: list[Row] = []
    for method in methods:
        model, majority = fitted_together(sources, method)
        for variation, other in others.items():
            everything = other.scored(method, split=None)
            for scenario in other.dataset.scenarios:
                here = other.of(scenario, everything)
                keys = _keys(protocol, scenario, method, MAIN_S, variation)
                rows += score_rows(here, _posterior(model, here), majority, keys)
    return rows


def _long_tailed(samples: Samples, seed: int) -> Samples:
    """As many drivers of each behaviour as in TRAF, in proportion."""
    rng = np.random.default_rng(seed)
    driver = samples.episode * 10**9 + samples.agent
    drivers, first = np.unique(driver, return_index=True)
    codes = samples.codes[first]
    count = np.bincount(codes, minlength=len(BEHAVIORS))
    share = np.array(LONG_TAIL) / sum(LONG_TAIL)
    wanted = np.maximum(np.floor(share * (count / share).min()), 1).astype(np.int64)
    if wanted.sum() < 60:  # the rarest class decides; keep the most frequent one whole instead
        wanted = np.maximum(np.round(share / share.max() * count.max()), 1).astype(np.int64)
    kept = [
        rng.permutation(drivers[codes == code])[: wanted[code]] for code in range(len(BEHAVIORS))
    ]
    return samples.where(np.isin(driver, np.concatenate(kept)))


def _mislabelled(samples: Samples, share: float, seed: int) -> Samples:
    """A share of the drivers gets another label."""
    rng = np.random.default_rng(seed)
    driver = samples.episode * 10**9 + samples.agent
    drivers, inverse = np.unique(driver, return_inverse=True)
    shift = np.where(
        rng.random(drivers.size) < share, rng.integers(1, len(BEHAVIORS), drivers.size), 0
    )
    codes = (samples.codes + shift[inverse]) % len(BEHAVIORS)
    return dataclasses.replace(samples, codes=codes.astype(np.int8))


def robustness(
    recordings: Recordings, methods: Sequence[str], levels: int | None = None
) -> list[Row]:
    """Each disturbance at each level, unknown and known in training; long tails; wrong labels."""
    rows: list[Row] = []

    def add(model: Model, majority: int, samples: Samples, variation: str) -> None:
        for scenario in recordings.dataset.scenarios:
            here = recordings.of(scenario, samples)
            if len(here):
                keys = _keys("robustness", scenario, model.method.name, MAIN_S, variation)
                rows.extend(score_rows(here, _posterior(model, here), majority, keys))

    for name, (_, every_level, _) in DISTURBANCES.items():
        for level in every_level[:levels]:
            disturbed = Disturbed(name, level)
            longest = min(level, MAIN_S) if name == "cut tracks" else MAIN_S
            window_s = max((w for w in WINDOWS_S if w < longest), default=1.0)
            windows_s = (window_s if longest < MAIN_S else MAIN_S,)
            for method in methods:
                clean, majority = recordings.fitted(method)
                test = recordings.scored(method, windows_s, disturbed)
                about = str(disturbed)
                if windows_s != (MAIN_S,):
                    about += f", windows of {windows_s[0]:g} s"
                add(clean, majority, test, about)
                if name not in TRAINED_WITH:
                    continue
                known, majority = recordings.fitted(method, disturbed=disturbed)
                add(known, majority, test, f"{about}, trained with it")
    for method in methods:
        training, test = recordings.training(method), recordings.scored(method)
        validation = recordings.validation(method)
        clean, _ = recordings.fitted(method)
        tailed = _long_tailed(test, 0)
        add(clean, majority_of(training), tailed, "long-tailed mix")
        rare = _long_tailed(training, 1)
        add(
            train(method, rare, validation),
            majority_of(rare),
            tailed,
            "long-tailed mix, trained so",
        )
        for share in WRONG_LABELS[:levels]:
            wrong = _mislabelled(training, share, 2)
            add(train(method, wrong, validation), majority_of(wrong), test,
                f"{share:g} of training drivers mislabelled")  # fmt: skip
    return rows


def interpretability(recordings: Recordings) -> list[Row]:
    """AUC of |w_j|, w = L u of the largest eigenvector, for aggressive against conservative.

    The paper reads a large entry as an aggressive driver. L u = lambda u, so |w_j| orders the
    drivers of one graph as |u_j| does; only drivers of the same graph are compared.
    """
    samples = recordings.scored("graphrqi")
    size = np.abs(samples.features[:, 0].astype(np.float64))
    aggressive = np.array([b.style is Style.AGGRESSIVE for b in BEHAVIORS])[samples.codes]
    rows: list[Row] = []
    for scenario in recordings.dataset.scenarios:
        chosen = np.flatnonzero(recordings.scenario[samples.episode] == scenario)
        counts = []
        for episode in np.unique(samples.episode[chosen]):
            won = pairs = 0.0
            here = chosen[samples.episode[chosen] == episode]
            for moment in np.unique(samples.time_s[here]):
                now = here[samples.time_s[here] == moment]
                up, down = size[now][aggressive[now]], size[now][~aggressive[now]]
                beats = (up[:, None] > down).sum() + 0.5 * (up[:, None] == down).sum()
                won, pairs = won + float(beats), pairs + up.size * down.size
            counts.append([won, pairs])
        value = bootstrap(lambda c: np.asarray(c[..., 0] / c[..., 1]), np.array(counts))
        keys = _keys("inductive", scenario, "largest-eigenvector", None)
        rows.append(tidy_row(keys, "auc", *value, int(chosen.size)))
    return rows


def _crowd(tracks: Tracks, agents: int) -> Tracks:
    """Copies of a recording far from one another: so many are there half-way through it."""
    present = int(tracks.valid[:, tracks.time_s.size // 2].sum())
    copies = -(-agents // max(present, 1))
    stride = int(tracks.ids.max()) + 1
    shift = np.array([10_000.0, 0.0])
    whole = {
        name: np.concatenate([getattr(tracks, name)] * copies)
        for name in ("kind", "length", "width", "heading", "speed", "valid")
    }
    everyone = dataclasses.replace(
        tracks,
        ids=np.concatenate([tracks.ids + c * stride for c in range(copies)]),
        names=tuple(f"{c}/{name}" for c in range(copies) for name in tracks.names),
        xy=np.concatenate([tracks.xy + c * shift for c in range(copies)]),
        behavior=None,
        events=(),
        **whole,
    )
    there = np.flatnonzero(everyone.valid[:, tracks.time_s.size // 2])
    return everyone.part(there[:agents], slice(None))


def speed_rows(
    recordings: Recordings,
    methods: Sequence[str],
    crowds: Sequence[int] = CROWDS,
    frames: int = 100,
) -> list[Row]:
    """Time from a frame to everyone's posterior, features included, ms (median)."""
    rows: list[Row] = []
    for method in methods:
        model, _ = recordings.fitted(method)
        for scenario in recordings.dataset.scenarios:
            entry = recordings.dataset.episodes("test", scenario)[0]
            tracks = recordings.dataset.read(entry).tracks
            for agents in crowds:
                crowd = _crowd(tracks, agents)
                stream, spent = BehaviorStream(model), []
                middle = crowd.time_s.size // 2
                first = max(0, middle - frames)
                for step in range(first, min(middle + frames // 2, crowd.time_s.size)):
                    frame = crowd.frame(step)
                    begin = time.perf_counter()
                    stream.update(frame)
                    spent.append(1000.0 * (time.perf_counter() - begin))
                measured = spent[len(spent) // 2 :]  # the first half warms up
                low, value, high = np.quantile(measured, [0.025, 0.5, 0.975])
                keys = _keys("speed", scenario, method, None, f"{agents} agents")
                rows.append(tidy_row(keys, "ms_per_frame", value, low, high, len(measured)))
    return rows
