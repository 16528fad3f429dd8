"""Predictors on recordings that nothing was trained on: each dataset or place is left out in turn.

The network for recordings is trained on all others (``left-out``) and predicts the one left out;
rules and the weights that ship stand beside it. Moving agents are scored (see
`experiments.training.recordings`), once with the past as recorded and once with noise added to it.
Errors are divided by those of constant velocity with the same past. Intervals resample vehicles
and, in the metrics that end in ``_by_place``, places.

Shipped weights were trained on some open recordings (their card says which); their rows for those
datasets say nothing about new places.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from experiments.score.metrics import bootstrap, ratio, summed
from experiments.score.predictions import hits, off_road, set_measures
from experiments.score.rows import Row, tidy_row
from experiments.training.recorded import (
    PER_DATASET,
    DatasetExamples,
    fit_network,
    gather_examples,
    with_noise,
)
from experiments.training.recordings import (
    RecordedPlace,
    happened,
    history_of,
    moving,
    read_sources,
    recorded_instants,
    steady_motion,
)
from graphrqi.predict.extrapolation import WITHOUT_MAP
from graphrqi.predict.metrics import MISS_THRESHOLD_M
from graphrqi.predict.networks.futures import TIME_S
from graphrqi.predict.prediction import STEP_S, Prediction
from graphrqi.predict.recorded.motion import (
    SLOPE_FADE_S,
    SLOPE_SHARE,
    YAW_FADE_S,
    Motion,
    bent,
    fading,
)
from graphrqi.predict.recorded.network import RecordedNetwork
from graphrqi.predict.recorded.predictor import predict_recorded
from graphrqi.predict.rollout.lane_positions import along_path
from graphrqi.predict.rollout.rollout import on_lanes
from graphrqi.predict.scene.scene import make_scene
from sim.frames import BoolArray, FloatArray, IntArray, Tracks
from sim.road import Road

NOISES_M: Final = (0.0, 0.1)
"""Noise added to the past, standard deviation of each coordinate, m."""

SCORED_PER_DATASET: Final = 1_500
"""Number of cases, a vehicle at an instant each, that are scored in a dataset, about."""

SHIPPED, LEFT_OUT = "graphrqi-predict", "left-out"

Told = Callable[[Tracks, Road | None], Prediction]
"""A predictor of the bench: the past and the map in, futures out."""

COLUMNS: Final = (
    "ade_m", "fde_m", "cv_ade_m", "cv_fde_m", "mean_ade_m", "min_ade_m", "miss_rate",
    "coverage_90", "collisions", "off_road",
)  # fmt: skip
"""What is known of each vehicle at each instant."""

RATIOS: Final = (
    ("ratio_to_cv", "ade_m", "cv_ade_m"),
    ("fde_ratio_to_cv", "fde_m", "cv_fde_m"),
    ("mean_ratio_to_cv", "mean_ade_m", "cv_ade_m"),
    ("min_ratio_to_cv", "min_ade_m", "cv_ade_m"),
)
"""Metric, what is divided, and by what."""

_AT: Final[IntArray] = np.round(TIME_S / STEP_S).astype(np.int64) - 1
_STEPS: Final = int(_AT[-1]) + 1


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """Errors of one predictor in one dataset.

    Attributes:
        values: (m, COLUMNS) of each vehicle at each instant; NaN where not known.
        vehicle: (m,) number of the vehicle.
        place: (m,) number of the place.
        ms: (I,) time that each scene took, ms.
    """

    values: FloatArray
    vehicle: IntArray
    place: IntArray
    ms: FloatArray


def measure(
    data: Path,
    leave_out: str = "dataset",
    epochs: int = 4,
    seed: int = 0,
    per_dataset: int = PER_DATASET,
) -> Iterator[list[Row]]:
    """Score predictors on recordings, each dataset or place left out of the training in turn.

    Args:
        data: a folder of datasets of recordings, or one of them.
        leave_out: ``dataset``, ``place``, or ``nothing``: then nothing is trained here.
        epochs: of each training.
        seed: of trainings and noise.
        per_dataset: about how many agents at instants are learned from in each.

    Yields:
        The rows of each part that was left out.

    Raises:
        InputError: if the option is wrong, or there is nothing to score.
    """
    if leave_out not in ("dataset", "place", "nothing"):
        raise InputError(f"leave_out: found {leave_out!r}, expected dataset, place or nothing")
    parts: dict[str, list[RecordedPlace]] = {}
    for one in read_sources([data]):
        parts.setdefault(one.place if leave_out == "place" else one.dataset, []).append(one)
    examples: dict[str, DatasetExamples] = {}
    if leave_out != "nothing" and len(parts) > 1:
        for number, name in enumerate(sorted(parts)):
            found = gather_examples(parts[name], number, seed, per_dataset)
            if found is not None:
                examples[name] = found
    for name in sorted(parts):
        others = [found for other, found in examples.items() if other != name]
        network = fit_network(others, epochs, seed) if others else None
        rows = list(score_part(name, parts[name], network, seed))
        if rows:
            yield rows


def score_part(
    name: str,
    places: Sequence[RecordedPlace],
    network: RecordedNetwork | None,
    seed: int,
) -> Iterator[Row]:
    """Rows of one part: every predictor, with and without noise."""
    predictors: dict[str, Told] = {
        rule: (lambda history, road, by=by: by(history, _STEPS))  # type: ignore[misc]
        for rule, by in WITHOUT_MAP.items()
    }
    predictors["fading"] = _fading
    if all(one.road is not None for one in places):
        predictors["lane-rule"] = _along_lanes
    predictors[SHIPPED] = lambda history, road: predict_recorded(history, _STEPS, road=road)
    if network is not None:
        predictors[LEFT_OUT] = lambda history, road: predict_recorded(
            history, _STEPS, network, road
        )
    for noise_m in NOISES_M:
        scored = _scored(places, predictors, noise_m, seed)
        for predictor, one in scored.items():
            keys: dict[str, str | float] = {
                "dataset": places[0].dataset, "family": places[0].family, "place": name,
                "predictor": predictor, "noise_m": noise_m, "horizon_s": float(TIME_S[-1]),
            }  # fmt: skip
            yield from _rows(keys, one)


def _fading(history: Tracks, road: Road | None) -> Prediction:
    """The base of the predictor for recordings: acceleration and yaw rate fade."""
    motion = Motion.of(history)
    time_s = np.arange(1, _STEPS + 1, dtype=np.float64) * STEP_S
    xy = motion.from_own_frame(fading(motion, time_s))[:, None]
    return Prediction(history.ids, time_s, xy, np.ones((history.ids.size, 1)))


def _along_lanes(history: Tracks, road: Road | None) -> Prediction:
    """Accelerations fade along the likeliest lanes; agents on no lane keep the base."""
    assert road is not None
    scene = make_scene(history, road, float(TIME_S[-1]))
    motion = Motion.of(scene.history)
    none = np.zeros_like(motion.speed)
    ahead = bent(
        motion.speed, SLOPE_SHARE * motion.accel, SLOPE_FADE_S, none, YAW_FADE_S, scene.time_s
    )[..., 0]  # fmt: skip
    lane, s = along_path(scene.path, scene.s[:, None] + ahead, scene.paths.lane, scene.paths.start)
    xy = on_lanes(scene, lane, s, scene.offsets())
    off = ~scene.on_path
    xy[off] = motion.from_own_frame(fading(motion, scene.time_s))[off]
    return scene.predicted(xy)


def _scored(
    places: Sequence[RecordedPlace], predictors: dict[str, Told], noise_m: float, seed: int
) -> dict[str, Scored]:
    """Errors of every predictor over a part's recordings; {} where nobody moves long enough."""
    values: dict[str, list[FloatArray]] = {name: [] for name in predictors}
    ms: dict[str, list[float]] = {name: [] for name in predictors}
    vehicle: list[IntArray] = []
    place: list[IntArray] = []
    names = {one: number for number, one in enumerate(sorted({p.place for p in places}))}
    every_s = scored_every_s(places)
    first = 0
    for index, one in enumerate(places):
        rng = np.random.default_rng((seed, index))
        for stop in recorded_instants(one.tracks, every_s):
            clean = history_of(one.tracks, stop)
            truth = happened(one.tracks, clean, stop)
            counts = moving(clean) & np.isfinite(truth).all(axis=(1, 2))
            if not counts.any():
                continue
            history = with_noise(clean, noise_m, rng, 1) if noise_m else clean
            steady = np.linalg.norm(steady_motion(history, TIME_S) - truth, axis=-1)
            for name, predict in predictors.items():
                begun = time.perf_counter()
                told = predict(history, one.road)
                ms[name].append(1e3 * (time.perf_counter() - begun))
                values[name].append(_values(one, history, told, truth, steady, counts))
            rows = np.searchsorted(one.tracks.ids, clean.ids[counts])
            vehicle.append(first + rows)
            place.append(np.full(rows.size, names[one.place]))
        first += one.tracks.ids.size
    if not vehicle:
        return {}
    who, where = np.concatenate(vehicle), np.concatenate(place)
    return {
        name: Scored(np.concatenate(values[name]), who, where, np.array(ms[name]))
        for name in predictors
    }


def _values(
    one: RecordedPlace, history: Tracks, told: Prediction, truth: FloatArray, steady: FloatArray,
    counts: BoolArray,
) -> FloatArray:  # fmt: skip
    """(m, COLUMNS) of those who count."""
    rows = np.flatnonzero(counts)
    apart = np.linalg.norm(told.xy[rows][:, :, _AT] - truth[rows, None], axis=-1)
    row, best = np.arange(rows.size), told.probability[rows].argmax(axis=1)
    mean = np.einsum("nk,nkhc->nhc", told.probability[rows], told.xy[rows][:, :, _AT])
    touching = hits(history, told.best[:, _AT])[rows].any(axis=1)
    inside = set_measures(told, rows, int(_AT[-1]), truth[rows, -1])[0]
    columns = [
        apart[row, best].mean(axis=1),
        apart[row, best, -1],
        steady[rows].mean(axis=1),
        steady[rows, -1],
        np.linalg.norm(mean - truth[rows], axis=-1).mean(axis=1),
        apart.mean(axis=2).min(axis=1),
        apart[:, :, -1].min(axis=1) > MISS_THRESHOLD_M,
        inside,
        touching,
        off_road(one.road, told, rows, int(_AT[-1])),
    ]
    return np.stack([np.asarray(column, dtype=np.float64) for column in columns], axis=1)


def scored_every_s(places: Sequence[RecordedPlace]) -> float:
    """Time between the instants of a dataset, s."""
    seconds = 0.0
    for one in places:
        if one.tracks.time_s.size > 1:
            fast = one.tracks.valid & (np.nan_to_num(one.tracks.speed) >= 1.0)
            seconds += float(fast.sum()) * one.tracks.step_s
    return float(np.clip(seconds / SCORED_PER_DATASET, 1.0, 60.0))


def _rows(keys: dict[str, str | float], one: Scored) -> Iterator[Row]:
    """Every metric of a predictor, with its intervals."""
    column = {name: one.values[:, k] for k, name in enumerate(COLUMNS)}
    ones, n = np.ones(len(one.values)), len(one.values)
    for metric in COLUMNS:
        if metric.startswith("cv_") or not np.isfinite(column[metric]).all():
            continue
        found = bootstrap(ratio, summed(one.vehicle, column[metric], ones))
        yield tidy_row(keys, metric, *found, n)
    for metric, above, below in RATIOS:
        for suffix, group in (("", one.vehicle), ("_by_place", one.place)):
            found = bootstrap(ratio, summed(group, column[above], column[below]))
            yield tidy_row(keys, metric + suffix, *found, n)
    median = float(np.median(one.ms))
    yield tidy_row(keys, "ms_per_scene", median, float("nan"), float("nan"), one.ms.size)
