"""One function scores predictions: how far they are from what drivers did next.

Predictions are made at regular instants of an episode, from what was observed until then and the
classifier's beliefs at that moment, and compared with what happened. Errors are summed per episode,
so that intervals resample episodes.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Final, get_args

import numpy as np
import pandas as pd

from behaviors.errors import InputError, lookup
from behaviors.labels import BEHAVIORS
from experiments.console.notices import LOGGER
from experiments.data.parallel import in_parallel
from experiments.data.scene_check import is_scene
from experiments.data.windows import measured, traffic_of
from experiments.score.labels import ALL, beliefs
from experiments.score.metrics import ratio, root_ratio, row_of
from experiments.score.rows import Cell, Row, pivoted
from experiments.score.tables import PREDICTIONS, predictions_table, table_file
from graphrqi.methods import Model
from graphrqi.model_files import load_model
from graphrqi.posterior import Posterior
from graphrqi.predict import check_map, chosen_predictor, metrics, predict
from graphrqi.predict.learned.predictors import with_weights
from graphrqi.predict.metrics import METRICS, SAMPLE_S
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.recorded.network import trained_network
from graphrqi.predict.scene.scene import LEARNED_S, LONGEST_S, make_scene
from graphrqi.stream import DEFAULT_MODEL
from sim.frames import PEDESTRIAN, BoolArray, FloatArray, IntArray, Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import EpisodeEntry, Split

HORIZONS_S: Final = (1.0, 3.0, 5.0)
"""Horizons reported, s."""

MOST_SPAN_S: Final = 1.5
"""Where agents were between two frames farther apart is not known, s (more than one of the slowest
recordings' seconds)."""

HISTORY_S, LEAST_SEEN_S = 5.0, 1.0
"""Predictors are given at most this much of the past, s, which a stream remembers. Agents observed
for less than the second are not scored, s."""

EVERY_S, WARM_UP_S = 2.0, 5.0
"""Time between the instants of prediction, s, the first of which is when an episode is this old;
`instants` says what holds for shorter horizons and episodes."""

MEASURES: Final = (*METRICS, "coverage_90", "nll", "collisions", "off_road")
"""Measures of each agent. Beside displacement metrics: coverage of the predicted 90 % set,
negative log density, overlap with another's likeliest future, and ending off every lane."""

LANE_MARGIN_M: Final = 0.5
"""A place this far outside a lane is off it."""

GROUPS: Final = ("all", *map(str, BEHAVIORS), "pedestrian")
"""Groups of agents: all that drive, those of each true behaviour, those that walk."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of one predictor in one episode, summed over agents and instants.

    ``total`` are (group, horizon, metric) sums, in the order of `GROUPS`, the horizons and
    `MEASURES`; NaN where a predictor does not predict it. ``count`` (group,) is of agents times
    instants.
    """

    total: FloatArray
    count: FloatArray


def instants(tracks: Tracks, horizon_s: float, every_s: float = EVERY_S) -> Iterator[int]:
    """Indices one past the present, at which predictions are made, ``every_s`` apart.

    The first is after `WARM_UP_S`, or after a shorter horizon's time. An episode that is too short
    for that is predicted once, as late as the horizon allows, from `LEAST_SEEN_S` on. There are
    none in an episode that is shorter still.
    """
    known = tracks.time_s[tracks.time_s + horizon_s <= tracks.time_s[-1:] + 1e-6]
    if not known.size:
        return
    longest_s = max(LEAST_SEEN_S, known[-1] - known[0])
    yield from spaced(known, min(WARM_UP_S, horizon_s, longest_s), every_s)


def spaced(
    time_s: FloatArray, after_s: float, every_s: float, slack_s: float = 1e-6
) -> Iterator[int]:
    """Indices one past each time that is due, the first one ``after_s`` after the beginning."""
    due_s = -np.inf if not time_s.size else time_s[0] + after_s
    for stop, now_s in enumerate(time_s, start=1):
        if now_s >= due_s - slack_s:
            yield stop
            due_s = now_s + every_s


def future(tracks: Tracks, rows: IntArray, stop: int, time_s: FloatArray) -> FloatArray:
    """(n, H, 2) where agents of some rows went, at times (H,) after an index one past the present.

    Places are on the straight line between frames, m; NaN where one is missing or too far away.
    """
    at = tracks.time_s[stop - 1] + time_s
    after = np.clip(np.searchsorted(tracks.time_s, at - 1e-6), 1, tracks.time_s.size - 1)
    span = tracks.time_s[after] - tracks.time_s[after - 1]
    share = np.clip((at - tracks.time_s[after - 1]) / span, 0.0, 1.0)[None, :, None]
    share = np.where(share > 1.0 - 1e-4, 1.0, share)
    begin, end = (tracks.positions(rows[:, None], step) for step in (after - 1, after))
    out = np.where(share == 1.0, end, begin + share * (end - begin))
    out[:, (at > tracks.time_s[-1] + 1e-3) | (span > MOST_SPAN_S)] = np.nan
    return np.asarray(out)


def score_episode(
    tracks: Tracks, posteriors: Mapping[int, Posterior], road: Road | None,
    predictors: Sequence[str], horizons_s: Sequence[float] = HORIZONS_S,
    on_prediction: Callable[[str, Tracks, Prediction], None] | None = None,
    weights: Path | None = None,
) -> dict[str, Errors]:  # fmt: skip
    """Errors of predictors, by name, in one episode, whose labels only sort them.

    Beliefs are given at each instant of prediction, by the index one past the present. Horizons
    ascend, s. ``on_prediction`` is called with each predictor's name, the history it was given and
    its futures. Weights are a folder of the network that ``graphrqi-predict`` uses on recordings.
    """
    longest = float(max(horizons_s))
    sample = np.arange(1, round(longest / SAMPLE_S) + 1, dtype=np.float64) * SAMPLE_S
    steps = max(1, round(HISTORY_S / tracks.step_s))
    functions = {name: chosen_predictor(name) for name in predictors}
    for name in functions:
        check_map(name, road)
    if weights is not None and "graphrqi-predict" in functions:
        functions["graphrqi-predict"] = with_weights(weights)
    ahead_s = max(longest, LEARNED_S)
    total = {
        name: np.zeros((len(GROUPS), len(horizons_s), len(MEASURES))) for name in predictors
    }  # fmt: skip
    count = np.zeros(len(GROUPS))
    for stop, posterior in posteriors.items():
        history = tracks.window(stop, steps)
        rows = np.searchsorted(tracks.ids, history.ids)
        truth = future(tracks, rows, stop, sample)
        seen_s = history.valid.sum(axis=1) * tracks.step_s
        scored = np.flatnonzero(
            np.isfinite(truth).all(axis=(1, 2)) & (seen_s > LEAST_SEEN_S - 1e-6)
        )
        if not scored.size:
            continue
        scene = None if road is None else make_scene(history, road, ahead_s)
        member = _membership(history, scored)
        count += member.sum(axis=0)
        for name, function in functions.items():
            if scene is None:
                prediction = predict(history, posterior, None, ahead_s, name, weights)
            else:
                prediction = function(scene, posterior)
            at = np.searchsorted(prediction.time_s, sample - 1e-6)
            if not (
                np.array_equal(prediction.ids, history.ids)
                and prediction.time_s.size > at[-1]
                and np.allclose(prediction.time_s[at], sample)
            ):
                raise InputError(
                    f"predictor {name}: found a {prediction!r}, expected all {history.ids.size} "
                    f"agents of the scene, every {SAMPLE_S:g} s up to {longest:g} s"
                )
            if on_prediction is not None:
                on_prediction(name, history, prediction)
            gap = metrics.distances(prediction.xy[scored][:, :, at], truth[scored])
            probability = prediction.probability[scored]
            hit = _hits(history, prediction.best[:, at])[scored]
            for h, horizon_s in enumerate(horizons_s):
                last = round(horizon_s / SAMPLE_S)
                values = [*metrics.displacement_errors(gap[:, :, :last], probability).values()]
                values += _set_measures(prediction, scored, at[last - 1], truth[scored, last - 1])
                values.append(np.asarray(hit[:, :last].any(axis=1), dtype=np.float64))
                values.append(_off_road(road, prediction, scored, at[last - 1]))
                total[name][:, h] += member.T @ np.stack(values, axis=1)
    return {name: Errors(total[name], count) for name in predictors}


def _hits(history: Tracks, xy: FloatArray) -> BoolArray:
    """(n, H) whether each agent's predicted outline overlaps another's at each time."""
    moved = np.diff(xy, axis=1, prepend=history.xy[:, -1:])
    turned = np.arctan2(moved[..., 1], moved[..., 0])
    still = np.hypot(moved[..., 0], moved[..., 1]) < 0.2
    heading = np.where(still, history.heading[:, -1:], turned)
    drives = history.kind != PEDESTRIAN
    out = np.zeros(xy.shape[:2], dtype=bool)
    for h in range(xy.shape[1]):
        out[drives, h] = metrics.overlap(
            xy[drives, h], heading[drives, h], history.length[drives], history.width[drives]
        )
    return out


def _set_measures(
    prediction: Prediction, rows: IntArray, at: int, truth: FloatArray
) -> list[FloatArray]:
    """Whether each agent ended in its 90 % set, and minus the log density; NaN without a spread."""
    if prediction.spread is None:
        return [np.full(rows.size, np.nan)] * 2
    xy, spread = prediction.xy[rows, :, at], prediction.spread[rows, :, at]
    probability = prediction.probability[rows]
    inside = metrics.covered(xy, spread, probability, truth).astype(np.float64)
    return [inside, -metrics.log_density(truth[:, None], xy, spread, probability)[:, 0]]


def _off_road(road: Road | None, prediction: Prediction, rows: IntArray, at: int) -> FloatArray:
    """(m,) 1 where the likeliest future is off every lane at a time; NaN without a map."""
    if road is None:
        return np.full(rows.size, np.nan)
    best = prediction.best[rows]
    moved = best[:, at] - best[:, max(at - 5, 0)]
    place = LaneGraph.of(road).project(best[:, at], np.arctan2(moved[:, 1], moved[:, 0]))
    width = LaneGraph.of(road).width[place.lane]
    return np.asarray(np.abs(place.offset) > width / 2 + LANE_MARGIN_M, dtype=np.float64)


def _membership(history: Tracks, scored: IntArray) -> FloatArray:
    """(m, group) 1 where an agent belongs to a group."""
    walks = history.kind[scored] == PEDESTRIAN
    member = np.zeros((scored.size, len(GROUPS)))
    member[:, 0], member[:, -1] = ~walks, walks
    if history.behavior is not None:
        code = np.where(walks, -1, history.behavior[scored])
        member[code >= 0, code[code >= 0] + 1] = 1.0
    return member


def score_predictions(
    episodes: Sequence[Mapping[str, Errors]], keys: Mapping[str, Cell],
    horizons_s: Sequence[float] = HORIZONS_S,
) -> list[Row]:  # fmt: skip
    """Rows over episodes, with intervals, from the errors by predictor of each.

    ``behavior`` is "all" for all that drive. A row whose metric is ``ade_m_minus_NAME`` is the mean
    difference to predictor NAME in the same episodes.
    """
    rows: list[Row] = []
    names = list(episodes[0]) if episodes else []
    total = {name: np.stack([one[name].total for one in episodes]) for name in names}
    for g, group in enumerate(GROUPS):
        count = np.array([one[names[0]].count[g] for one in episodes])
        for name, h in itertools.product(names if count.sum() else (), range(len(horizons_s))):
            row: dict[str, Cell] = {
                **keys, "predictor": name, "horizon_s": horizons_s[h], "behavior": group
            }  # fmt: skip
            for m, metric in enumerate(MEASURES):
                mine = total[name][:, g, h, m]
                if not np.isfinite(mine).all():
                    continue
                figures = {metric: mine}
                for other in names[: names.index(name)] if metric in ("ade_m", "fde_m") else ():
                    figures[f"{metric}_minus_{other}"] = mine - total[other][:, g, h, m]
                mean = root_ratio if metric == "rmse_m" else ratio
                for what, sums in figures.items():
                    per_episode = np.stack([sums, count], axis=1)
                    rows.append(row_of(row, what, mean, per_episode, int(count.sum())))
    return rows


def _evaluate_episode(
    folder: Path, entry: EpisodeEntry, predictors: Sequence[str], horizons_s: Sequence[float],
    model: Model, keep: bool, weights: Path | None, traffic: str | None,
) -> tuple[dict[str, Errors], list[pd.DataFrame], float]:  # fmt: skip
    """Errors by predictor (none of a short episode), futures to keep, and its length, s."""
    dataset = open_dataset(folder)
    tracks, road = measured(dataset.read(entry)), dataset.road(entry)
    stops = list(instants(tracks, max(horizons_s)))
    tables: list[pd.DataFrame] = []
    length_s = float(tracks.time_s[-1] - tracks.time_s[0]) if tracks.time_s.size else 0.0
    if not stops:
        return {}, tables, length_s

    def keep_futures(name: str, history: Tracks, prediction: Prediction) -> None:
        tables.append(predictions_table(prediction, history, name, entry, max(horizons_s)))

    posteriors = beliefs(tracks, model, stops, is_scene(entry), traffic_of(entry, traffic))
    errors = score_episode(
        tracks, posteriors, road, predictors, horizons_s, keep_futures if keep else None, weights
    )
    return errors, tables, length_s


def _entries(dataset: Dataset, split: str | None) -> list[tuple[str, str, EpisodeEntry]]:
    """Scenario and split, as rows say them, of each episode that is scored."""
    if split is None:
        recorded = all(entry.recording is not None for entry in dataset.episodes())
        split = ALL if recorded else "test"
    wanted = lookup({**dict.fromkeys(get_args(Split), True), ALL: False}, split, "split")
    found = []
    for scenario in dataset.scenarios:
        every = dataset.episodes(None, scenario)
        some = [entry for entry in every if not wanted or entry.split == split]
        said = split if some else ALL
        found += [(scenario, said, e) for e in (some or (every if split == "test" else ()))]
    if not found:
        raise InputError(f"{dataset.path}: found no {split} episode, expected at least 1")
    return found


def predict_dataset(
    source: Path, predictors: Sequence[str], horizon_s: float = 5.0, model: str = DEFAULT_MODEL,
    *, out: Path | None = None, weights: Path | None = None, traffic: str | None = None,
    split: str | None = None, jobs: int | None = None, quiet: bool = False,
) -> list[Row]:  # fmt: skip
    """Implement ``graphrqi predict``: rows of `score_predictions` for each scenario.

    Episodes that are too short are left out, each in a line on stderr. Futures are written into the
    file ``out``. The model is the classifier whose beliefs are used; weights and traffic are as
    `score_episode` and `label_episode` take them. The split is "test" by default, and "all" of
    recordings. Of "test", all of a scenario is predicted that has none.
    """
    samples = horizon_s / SAMPLE_S
    if not SAMPLE_S <= horizon_s <= LONGEST_S or abs(samples - round(samples)) > 1e-6:
        raise InputError(
            f"horizon_s: found {horizon_s}, expected {SAMPLE_S} s or a multiple of it up to "
            f"{LONGEST_S:g} s"
        )
    if not predictors:
        raise InputError("predictors: found none, expected at least one name")
    for name in predictors:
        chosen_predictor(name)
    if weights is not None:
        trained_network(weights)
    classifier, entries = load_model(model), _entries(open_dataset(source), split)
    horizons_s = sorted({h for h in HORIZONS_S if h < horizon_s} | {horizon_s})
    found: dict[tuple[str, str], list[Mapping[str, Errors]]] = {}
    short: list[tuple[EpisodeEntry, float]] = []
    least_s = horizon_s + min(LEAST_SEEN_S, horizon_s)
    same = (predictors, horizons_s, classifier, out is not None, weights, traffic)
    arguments = [(source, entry, *same) for *_, entry in entries]
    with nullcontext() if out is None else table_file(out, PREDICTIONS) as write:
        answers = in_parallel(_evaluate_episode, arguments, jobs, "predicting episodes", quiet)
        for (name, said, entry), (errors, futures, length_s) in zip(entries, answers, strict=True):
            if errors:
                found.setdefault((name, said), []).append(errors)
            else:
                short.append((entry, length_s))
            if write is not None and futures:
                write(pd.concat(futures))
        if not found:
            raise InputError(
                f"{source}: found {len(short)} episodes of at most "
                f"{max(length_s for _, length_s in short):g} s, expected one of {least_s:g} s or "
                f"longer to predict {horizon_s:g} s ahead: ask for a shorter horizon"
            )
        if not any(errors[predictors[0]].count.any() for one in found.values() for errors in one):
            raise InputError(
                f"{source}: found no agent seen for {LEAST_SEEN_S:g} s and then for another "
                f"{horizon_s:g} s, expected at least one agent"
            )
    for entry, length_s in short:
        LOGGER.warning(
            "skipped episode %s (%s): found %g s, expected at least %g s to predict %g s ahead",
            entry.id, entry.name, length_s, least_s, horizon_s,
        )  # fmt: skip
    rows: list[Row] = []
    for (scenario, said), episodes in found.items():
        rows += score_predictions(episodes, {"scenario": scenario, "split": said}, horizons_s)
    return rows


def errors_table(rows: Sequence[Row]) -> list[dict[str, Cell]]:
    """One line per scenario and predictor: ADE and FDE of all drivers at each horizon."""
    return pivoted(
        (r for r in rows if r["behavior"] == "all" and r["metric"] in ("ade_m", "fde_m")),
        ("scenario", "split", "predictor"),
        lambda row: f"{row['metric']} {row['horizon_s']:g}s",
        lambda row: round(float(row["value"] or 0.0), 3),
    )
