"""How well predictors foresee what drivers did next.

Predictions are made at regular instants of unseen episodes, from what was seen until then and the
classifier's beliefs at that moment, and compared with what happened. Errors are summed per
episode, so that intervals resample episodes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numpy as np
import pyarrow as pa

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.console.progress import Progress
from experiments.data.parallel import in_parallel
from experiments.rows import Cell, Row, of_bench, tidy_row
from experiments.scoring.metrics import Statistic, bootstrap, ratio
from experiments.scoring.prediction_file import PREDICTIONS, predictions_file, predictions_table
from graphrqi.methods import Model, load_model
from graphrqi.posterior import Posterior
from graphrqi.predict import get_predictor, predict
from graphrqi.predict.metrics import METRICS, SAMPLE_S, covered, distances, log_density, overlap
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.scene.scene import LEARNED_S, LONGEST_S, make_scene
from graphrqi.stream import DEFAULT_MODEL, BehaviorStream
from sim.frames import PEDESTRIAN, BoolArray, FloatArray, IntArray, Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph, project
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry, Split

T = TypeVar("T")

HORIZONS_S: Final = (1.0, 3.0, 5.0)
"""Horizons reported, s."""

HISTORY_S: Final = 5.0
"""What predictors see of the past at most, s: what a stream remembers."""

EVERY_S: Final = 2.0
"""Time between the instants of prediction, s (our choice)."""

WARM_UP_S: Final = 5.0
"""No prediction is made before an episode is this old, s (our choice); `instants` says when of
shorter horizons and episodes."""

LEAST_SEEN_S: Final = 1.0
"""Agents seen for less than this are not scored (our choice: nothing is known of them)."""

MEASURES: Final = (*METRICS, "coverage_90", "nll", "collisions", "off_road")
"""What is measured of each agent. Beside the displacement metrics: whether it ended in the
predicted 90 % set, minus the log density of where it ended, whether its likeliest future overlaps
another's by then, and whether that future ends off every lane."""

LANE_MARGIN_M: Final = 0.5
"""A place this far outside a lane is off it (our choice)."""

GROUPS: Final = ("all", *map(str, BEHAVIORS), "pedestrian")
"""Whose errors: all that drive, those of one true behaviour, those that walk."""


class NothingToScore(InputError):
    """No prediction of a dataset can be compared with what happened."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of one predictor in one episode, summed over agents and instants.

    Attributes:
        total: (group, horizon, metric) sums, in the order of `GROUPS`, the horizons and `MEASURES`;
            NaN where a predictor does not say it.
        count: (group,) agents times instants.
    """

    total: FloatArray
    count: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class EpisodePrediction:
    """What predictors said of one episode.

    Attributes:
        errors: by predictor; empty where the episode is too short to predict anything.
        futures: the futures as rows; none unless they were to be kept.
        length_s: from the episode's first frame to its last, s.
    """

    errors: Mapping[str, Errors]
    futures: pa.Table
    length_s: float


def shortest_s(horizon_s: float) -> float:
    """The shortest episode that anything is predicted of, s.

    Args:
        horizon_s: so much of the future has to be known.
    """
    return horizon_s + min(LEAST_SEEN_S, horizon_s)


def instants(tracks: Tracks, horizon_s: float, every_s: float = EVERY_S) -> Iterator[int]:
    """Indices one past the present, at which predictions are made.

    The first is after `WARM_UP_S`, or after a shorter horizon's time. An episode that is too short
    for that is predicted once, as late as the horizon allows, from `LEAST_SEEN_S` on.

    Args:
        tracks: an episode.
        horizon_s: so much of the future has to be known.
        every_s: time between them.

    Yields:
        Stops, ascending; none in an episode shorter than `shortest_s`.
    """
    known = tracks.time_s[tracks.time_s + horizon_s <= tracks.time_s[-1:] + 1e-6]
    if not known.size:
        return
    warm_up_s = min(WARM_UP_S, horizon_s, max(LEAST_SEEN_S, known[-1] - known[0]))
    due = known[0] + warm_up_s
    for column, time_s in enumerate(known):
        if time_s >= due - 1e-6:
            yield column + 1
            due = time_s + every_s


def future(tracks: Tracks, rows: IntArray, stop: int, time_s: FloatArray) -> FloatArray:
    """Where agents went, at given times after the present.

    Args:
        tracks: an episode.
        rows: (n,) whose.
        stop: one past the present's index.
        time_s: (H,) seconds from the present.

    Returns:
        (n, H, 2) m, between frames on the straight line; NaN where either frame is missing.
    """
    at = tracks.time_s[stop - 1] + time_s
    after = np.clip(np.searchsorted(tracks.time_s, at - 1e-6), 1, tracks.time_s.size - 1)
    span = tracks.time_s[after] - tracks.time_s[after - 1]
    share = np.clip((at - tracks.time_s[after - 1]) / span, 0.0, 1.0)[None, :, None]
    share = np.where(share > 1.0 - 1e-4, 1.0, share)
    begin, end = tracks.xy[rows][:, after - 1], tracks.xy[rows][:, after]
    out = np.where(share == 1.0, end, begin + share * (end - begin))
    out[:, at > tracks.time_s[-1] + 1e-3] = np.nan
    return np.asarray(out)


def evaluate(
    tracks: Tracks,
    posteriors: Mapping[int, Posterior],
    road: Road | None,
    predictors: Sequence[str],
    horizons_s: Sequence[float] = HORIZONS_S,
    tell: Callable[[str, Tracks, Prediction], None] | None = None,
) -> dict[str, Errors]:
    """Errors of predictors in one episode.

    Args:
        tracks: the episode; its labels only sort the errors.
        posteriors: beliefs at each instant of prediction, by the index one past the present.
        road: where it happened; None if there is no map.
        predictors: keys of ``PREDICTORS``.
        horizons_s: ascending, s.
        tell: called with each predictor's name, what it saw and what it foresees.

    Returns:
        Errors by predictor.
    """
    longest = float(max(horizons_s))
    sample = np.arange(1, round(longest / SAMPLE_S) + 1, dtype=np.float64) * SAMPLE_S
    steps = round(HISTORY_S / tracks.step_s)
    functions = {name: get_predictor(name) for name in predictors}
    ahead_s = max(longest, LEARNED_S)
    shape = (len(GROUPS), len(horizons_s), len(MEASURES))
    total = {name: np.zeros(shape) for name in predictors}
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
                prediction = predict(history, posterior, None, ahead_s, name)
            else:
                prediction = function(scene, posterior)
            if tell is not None:
                tell(name, history, prediction)
            at = np.searchsorted(prediction.time_s, sample - 1e-6)
            gap = distances(prediction.xy[scored][:, :, at], truth[scored])
            probability = prediction.probability[scored]
            hit = _hits(history, prediction.best[:, at])[scored]
            for h, horizon_s in enumerate(horizons_s):
                last = round(horizon_s / SAMPLE_S)
                values = [f(gap[:, :, :last], probability) for f in METRICS.values()]
                values += _set_measures(prediction, scored, at[last - 1], truth[scored, last - 1])
                values.append(np.asarray(hit[:, :last].any(axis=1), dtype=np.float64))
                values.append(_off_road(road, prediction, scored, at[last - 1]))
                total[name][:, h] += member.T @ np.stack(values, axis=1)
    return {name: Errors(total[name], count) for name in predictors}


def _hits(history: Tracks, xy: FloatArray) -> BoolArray:
    """(n, H) whether each agent's predicted box overlaps another's at each time."""
    before = np.concatenate([history.xy[:, -1:], xy[:, :-1]], axis=1)
    moved = xy - before
    turned = np.arctan2(moved[..., 1], moved[..., 0])
    still = np.hypot(moved[..., 0], moved[..., 1]) < 0.2
    heading = np.where(still, history.heading[:, -1:], turned)
    drives = history.kind != PEDESTRIAN
    out = np.zeros(xy.shape[:2], dtype=bool)
    for h in range(xy.shape[1]):
        out[drives, h] = overlap(
            xy[drives, h], heading[drives, h], history.length[drives], history.width[drives]
        )
    return out


def _set_measures(
    prediction: Prediction, rows: IntArray, at: int, truth: FloatArray
) -> list[FloatArray]:
    """Whether each agent ended in its 90 % set, and minus the log density there; NaN if unsaid."""
    if prediction.spread is None:
        return [np.full(rows.size, np.nan)] * 2
    xy, spread = prediction.xy[rows, :, at], prediction.spread[rows, :, at]
    probability = prediction.probability[rows]
    inside = covered(xy, spread, probability, truth).astype(np.float64)
    return [inside, -log_density(truth[:, None], xy, spread, probability)[:, 0]]


def _off_road(road: Road | None, prediction: Prediction, rows: IntArray, at: int) -> FloatArray:
    """(m,) 1 where the likeliest future is off every lane at a time; NaN without a map."""
    if road is None:
        return np.full(rows.size, np.nan)
    best = prediction.best[rows]
    moved = best[:, at] - best[:, max(at - 5, 0)]
    place = project(road, best[:, at], np.arctan2(moved[:, 1], moved[:, 0]))
    width = LaneGraph.of(road).width[place.lane]
    return np.asarray(np.abs(place.offset) > width / 2 + LANE_MARGIN_M, dtype=np.float64)


def _membership(history: Tracks, scored: IntArray) -> FloatArray:
    """(m, group) 1 where an agent belongs to a group."""
    walks = history.kind[scored] == PEDESTRIAN
    member = np.zeros((scored.size, len(GROUPS)))
    member[:, 0], member[:, -1] = ~walks, walks
    if history.behavior is not None:
        code = history.behavior[scored].astype(np.int64)
        known = np.flatnonzero((code >= 0) & ~walks)
        member[known, code[known] + 1] = 1.0
    return member


def summarize(
    episodes: Sequence[Mapping[str, Errors]],
    scenario: str,
    split: str,
    horizons_s: Sequence[float] = HORIZONS_S,
) -> list[Row]:
    """Rows over episodes, with intervals, and each predictor's paired difference to the first.

    Args:
        episodes: errors by predictor, one mapping per episode.
        scenario: its name, for the rows.
        split: which part of the data, for the rows.
        horizons_s: as given to `evaluate`.

    Returns:
        Flat rows ``scenario predictor horizon_s behavior split metric value low high n``. A row
        whose metric is ``ade_m_minus_NAME`` is the mean difference to predictor NAME in the same
        episodes.
    """
    rows: list[Row] = []
    if not episodes:
        return rows
    names = list(episodes[0])
    for g, group in enumerate(GROUPS):
        count = np.array([e[names[0]].count[g] for e in episodes])
        if not count.sum():
            continue
        for name in names:
            for h, horizon_s in enumerate(horizons_s):
                keys = prediction_keys(scenario, name, horizon_s, split, group)
                for m, metric in enumerate(MEASURES):
                    mine = np.array([e[name].total[g, h, m] for e in episodes])
                    if not np.isfinite(mine).all():
                        continue
                    mean = root_ratio if metric == "rmse_m" else ratio
                    rows.append(_mean_row(keys, metric, mean, mine, count))
                    if metric in ("ade_m", "fde_m"):
                        for other in names[: names.index(name)]:
                            theirs = np.array([e[other].total[g, h, m] for e in episodes])
                            against = f"{metric}_minus_{other}"
                            rows.append(_mean_row(keys, against, ratio, mine - theirs, count))
    return rows


def prediction_keys(
    scenario: str, predictor: str, horizon_s: float, split: str, behavior: str = "all"
) -> dict[str, Cell]:
    """What the rows of prediction say was measured."""
    return {
        "scenario": scenario, "predictor": predictor, "horizon_s": horizon_s,
        "behavior": behavior, "split": split,
    }  # fmt: skip


def root_ratio(sums: FloatArray) -> FloatArray:
    """The root of a `ratio`: of squares and a count, the root mean square."""
    return np.sqrt(ratio(sums))


def _mean_row(
    keys: Mapping[str, Cell], metric: str, mean: Statistic, total: FloatArray, count: FloatArray
) -> Row:
    found = bootstrap(mean, np.stack([total, count], axis=1))
    return tidy_row(keys, metric, *found, int(count.sum()))


def metrics_tree(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Rows as ``prediction.<scenario>.<predictor>.{ade_m,fde_m}.{1s,3s,5s}`` of ``metrics.json``.

    Args:
        rows: from `summarize`.

    Returns:
        Nested dictionaries that end in value, low, high, n and split, of all drivers together.
    """
    tree: dict[str, Any] = {}
    for row in rows:
        if row["behavior"] != "all" or row["metric"] not in ("ade_m", "fde_m"):
            continue
        by_horizon = (
            tree.setdefault(row["scenario"], {})
            .setdefault(row["predictor"], {})
            .setdefault(row["metric"], {})
        )
        by_horizon[f"{cast(float, row['horizon_s']):g}s"] = {
            key: row[key] for key in ("value", "low", "high", "n", "split")
        }
    return tree


def beliefs(tracks: Tracks, model: Model, stops: Sequence[int]) -> dict[int, Posterior]:
    """What a classifier believes at each instant of prediction.

    The same as a `graphrqi.stream.BehaviorStream` says, asked only where needed.

    Args:
        tracks: an episode.
        model: the trained classifier.
        stops: indices one past each present, ascending.

    Returns:
        Posterior by stop.
    """
    stream, wanted = BehaviorStream(model), set(stops)
    found: dict[int, Posterior] = {}
    for column, frame in enumerate(tracks.frames()):
        stream.push(frame)
        if column + 1 in wanted:
            found[column + 1] = stream.posterior()
    return found


def evaluate_episode(
    folder: Path, entry: EpisodeEntry, predictors: Sequence[str], horizons_s: Sequence[float],
    model: str, keep: bool = False,
) -> EpisodePrediction:  # fmt: skip
    """Predict one episode of a dataset with a classifier's beliefs.

    Args:
        folder: of the dataset.
        entry: which episode.
        predictors: keys of ``PREDICTORS``.
        horizons_s: ascending, s.
        model: the classifier: a shipped one's name or a folder.
        keep: whether the futures themselves are wanted.

    Returns:
        Its errors and futures; neither if it is too short.

    Raises:
        InputError: if the episode or the model cannot be read.
    """
    dataset = open_dataset(folder)
    tracks, road = dataset.read(entry).tracks, dataset.road(entry)
    stops = list(instants(tracks, max(horizons_s)))
    tables = [PREDICTIONS.empty_table()]
    length_s = float(tracks.time_s[-1] - tracks.time_s[0]) if tracks.time_s.size else 0.0
    if not stops:
        return EpisodePrediction({}, tables[0], length_s)

    def tell(name: str, history: Tracks, prediction: Prediction) -> None:
        tables.append(predictions_table(prediction, history, name, entry.id, max(horizons_s)))

    errors = evaluate(
        tracks, beliefs(tracks, load_model(model), stops), road, predictors, horizons_s,
        tell if keep else None,
    )  # fmt: skip
    futures = pa.concat_tables(tables).unify_dictionaries()
    return EpisodePrediction(errors, futures, length_s)


def predict_dataset(
    source: Path,
    predictors: Sequence[str],
    horizon_s: float = 5.0,
    model: str = DEFAULT_MODEL,
    *,
    out: Path | None = None,
    split: Split = "test",
    jobs: int | None = None,
    quiet: bool = False,
) -> list[Row]:
    """Predict every episode of a dataset's split and return the errors.

    Episodes that are too short are left out, each in a line on stderr.

    Args:
        source: a dataset.
        predictors: keys of ``PREDICTORS``.
        horizon_s: how far ahead, s.
        model: the classifier whose beliefs are used: a shipped one's name or a folder.
        out: where to write the futures (`experiments.scoring.prediction_file`); None: nowhere.
        split: which part of the dataset; all of a scenario that has no such part.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        Rows as `summarize` gives them, over all scenarios.

    Raises:
        InputError: if the dataset, the model or a predictor's name is wrong.
        NothingToScore: if every episode is too short, or nobody is seen for long enough in any.
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
        get_predictor(name)
    load_model(model)
    horizons_s = sorted({h for h in HORIZONS_S if h < horizon_s} | {horizon_s})
    dataset = open_dataset(source)
    rows: list[Row] = []
    entries = [
        (scenario, entry)
        for scenario in dataset.scenarios
        for entry in dataset.episodes(split, scenario) or dataset.episodes(None, scenario)
    ]
    if not entries:
        raise InputError(f"{source}: found no episode, expected at least 1")
    found: dict[str, list[Mapping[str, Errors]]] = {}
    short: list[tuple[EpisodeEntry, float]] = []
    least_s = shortest_s(horizon_s)
    keep = out is not None
    arguments = [(source, entry, predictors, horizons_s, model, keep) for _, entry in entries]
    with (
        Progress("predicting episodes", len(entries), quiet) as progress,
        nullcontext() if out is None else predictions_file(out) as file,
    ):
        for (scenario, entry), one in zip(
            entries, in_parallel(evaluate_episode, arguments, jobs), strict=True
        ):
            if one.errors:
                found.setdefault(scenario, []).append(one.errors)
            else:
                short.append((entry, one.length_s))
            if file is not None:
                file.write_table(one.futures)
            progress.advance(entry.agents, entry.agent_steps)
        if not found:
            raise NothingToScore(
                f"{source}: found {len(short)} episodes of at most "
                f"{max(length_s for _, length_s in short):g} s, expected one of {least_s:g} s or "
                f"longer to predict {horizon_s:g} s ahead: ask for a shorter horizon"
            )
        if not any(errors[predictors[0]].count.any() for one in found.values() for errors in one):
            raise NothingToScore(
                f"{source}: found nobody seen for {LEAST_SEEN_S:g} s and then for another "
                f"{horizon_s:g} s, expected at least one agent"
            )
    for entry, length_s in short:
        sys.stderr.write(
            f"graphrqi: skipped {_name_of(entry)}: found {length_s:g} s, expected at least "
            f"{least_s:g} s to predict {horizon_s:g} s ahead\n"
        )
    for scenario, episodes in found.items():
        whole = not dataset.episodes(split, scenario)
        rows += summarize(episodes, scenario, "all" if whole else split, horizons_s)
    return of_bench("prediction", rows)


def _name_of(entry: EpisodeEntry) -> str:
    recording = entry.options.get("recording")
    return f"episode {entry.id}" + (f" ({recording})" if recording else "")


def short_table(rows: Sequence[Row]) -> list[Row]:
    """One line per scenario and predictor: ADE and FDE of all drivers at each horizon."""
    lines: dict[tuple[Any, Any], dict[str, Any]] = {}
    for row in rows:
        if row["behavior"] == "all" and row["metric"] in ("ade_m", "fde_m"):
            line = lines.setdefault(
                (row["scenario"], row["predictor"]),
                {
                    "scenario": row["scenario"],
                    "episodes": row["split"],
                    "predictor": row["predictor"],
                },
            )
            line[f"{row['metric']} {cast(float, row['horizon_s']):g}s"] = round(
                cast(float, row["value"]), 3
            )
    return list(lines.values())
