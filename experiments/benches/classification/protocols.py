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
- ``worlds``: random worlds; one law, lane discipline, noise or road is left out of training.
- ``noise``: usual traffic seen with noise, at other frame rates, and with lost frames.

The ``leak-probe`` sees an agent's number and the time and nothing else; it has to stay at chance,
and its interval has to hold chance.
The ``ceiling`` sees the numbers that the drivers were made from. Intervals are by bootstrap over
episodes; differences are of paired bootstraps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from behaviors.labels import BEHAVIORS
from experiments.benches.classification.recordings import (
    MAIN_S,
    OURS,
    SCORED_S,
    FloatArray,
    Recordings,
    fitted_together,
)
from experiments.benches.classification.rows import (
    as_long_as,
    difference_rows,
    keys_of,
    posterior,
    reliability_rows,
    score_rows,
)
from experiments.benches.statistics import majority_of
from experiments.score.rows import Row
from graphrqi.classify import make_classifier
from graphrqi.features.baseline import FREE_FLOW, GRAPH_SIGNALS, LAW_HEADWAYS
from graphrqi.methods import METHODS, Model, train
from graphrqi.model_files import load_model
from graphrqi.prior_shift import PriorShift
from graphrqi.samples import Samples

RIVALS: Final = ("forest", "boosted", "cheung", "dane", "graphrqi", "graphrqi-invariant")
"""Methods whose paired difference to ours is given."""


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
                samples = here.where(as_long_as(here, window_s))
                if not len(samples):
                    continue
                probability = posterior(model, samples)
                keys = keys_of("inductive", scenario, method, window_s)
                rows += score_rows(samples, probability, majority, keys)
                if window_s == MAIN_S:
                    answers[scenario, method] = probability
                    if method == OURS:
                        rows += reliability_rows(samples, probability, keys)
                    moving = samples.where(samples.moving)
                    if len(moving):
                        keys = keys_of("inductive", scenario, method, window_s, "moving")
                        rows += score_rows(moving, posterior(model, moving), majority, keys)
            rival = answers.get((scenario, OURS))
            if rival is not None and method in RIVALS and (scenario, method) in answers:
                samples = here.where(as_long_as(here, MAIN_S))
                keys = keys_of("inductive", scenario, OURS, MAIN_S, f"minus {method}")
                rows += difference_rows(samples, rival, answers[scenario, method], keys)
    return rows


def shipped(
    recordings: Recordings, windows_s: Sequence[float] = SCORED_S, traffic: str = ""
) -> list[Row]:
    """The model that ships with the package, on all episodes of a dataset that it never saw.

    As its stream answers, corrected for the mix of the scene; and each driver by itself.
    """
    model = load_model(OURS)
    everything = recordings.windows_for(model, windows_s)
    rows: list[Row] = []
    for scenario in recordings.dataset.scenarios:
        here = recordings.of(scenario, everything)
        for window_s in windows_s:
            samples = here.where(as_long_as(here, window_s))
            if not len(samples):
                continue
            alone = posterior(model, samples)
            streamed = in_scenes(model, samples, alone)
            whole = np.ones(len(samples), dtype=bool)
            looks = [("", streamed, whole), ("by itself", alone, whole)]
            if np.isfinite(window_s) and samples.moving.any():
                looks.append(("moving", streamed, samples.moving))
            for about, probability, chosen in looks:
                part = samples.where(chosen)
                variation = ", ".join(filter(None, (traffic, about)))
                keys = keys_of("shipped", scenario, OURS, window_s, variation)
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
    whole = posterior(recordings.fitted(OURS)[0], samples)
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
            keys = keys_of("ablation", scenario, OURS, MAIN_S, f"without {kind}")
            rows += score_rows(here, without[chosen], majority_of(training), keys)
            keys = keys_of("ablation", scenario, OURS, MAIN_S, f"minus without {kind}")
            rows += difference_rows(here, whole[chosen], without[chosen], keys)
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
            scored.setdefault(scenario, []).append((asked, posterior(model, asked)))
        for scenario, parts in scored.items():
            together = Samples.join([part for part, _ in parts])
            probability = np.concatenate([p for _, p in parts])
            keys = keys_of("transductive", scenario, method, MAIN_S)
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
                    keys = keys_of("across-scenarios", scenario, method, MAIN_S, about)
                    rows += score_rows(samples, posterior(model, samples), majority, keys)
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
                keys = keys_of(protocol, scenario, method, MAIN_S, variation)
                rows += score_rows(here, posterior(model, here), majority, keys)
    return rows
