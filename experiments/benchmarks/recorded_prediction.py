"""Predictors on recordings that nothing was trained on: each dataset is left out in turn.

The networks for recordings are trained on all others and on simulated traffic (``left-out``), and
predict the one left out. The base, the Kalman filter, constant velocity and the weights that ship
stand beside them; their card says on which recordings they were trained. All predict with and
without the map, as recorded and with noise added. Errors are means up to a horizon, over those of
constant velocity with the same past. Standing, slow, free and following vehicles have rows of their
own. Intervals resample vehicles.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np

from experiments.model import simulated_like_recordings
from experiments.score.metrics import bootstrap, ratio, summed
from experiments.score.rows import Cell, Row, tidy_row
from experiments.training.recorded import PER_DATASET, fit_network, gather_examples, with_noise
from experiments.training.recordings import (
    CLASSES,
    RecordedPlace,
    by_dataset,
    cases,
    classes_of,
    moving,
    moving_s,
    steady_motion,
)
from graphrqi.predict.extrapolation import constant_velocity, kalman
from graphrqi.predict.networks import TIME_S
from graphrqi.predict.prediction import STEP_S, Prediction
from graphrqi.predict.recorded.motion import Motion, fading
from graphrqi.predict.recorded.network import RecordedNetwork
from graphrqi.predict.recorded.predictor import predict_recorded
from graphrqi.predict.scene.scene import Unmapped
from sim.frames import FloatArray, Tracks
from sim.road import Road

NOISES_M: Final = (0.0, 0.1)
"""Noise added to the past, standard deviation of each coordinate, m."""

HORIZONS_S: Final = (0.5, 1.0, 3.0, 5.0)
"""Horizons up to which errors are averaged, s."""

SCORED_PER_DATASET, LEAST_CASES = 1_500, 5
"""About how many cases, a vehicle at an instant each, are scored in a dataset; classes of fewer
cases have no row."""

_Predictor = Callable[[Tracks, Road | None], Prediction]
"""A predictor of the bench: the past and the map in, futures out."""

_AT: Final = np.round(TIME_S / STEP_S).astype(np.int64) - 1
_STEPS: Final = int(_AT[-1]) + 1


def measure(
    data: Path, epochs: int = 4, seed: int = 0, per_dataset: int = PER_DATASET,
    simulate: bool = False,
) -> Iterator[list[Row]]:  # fmt: skip
    """Rows of each dataset of recordings in a folder, left out of the training in its turn.

    If ``simulate``, the simulated traffic that the shipped weights learn from is generated and
    learned from, too. About ``per_dataset`` agents at instants are learned from in each dataset. If
    there is one dataset of recordings alone, nothing is trained.
    """
    recorded = by_dataset([data])
    every = dict(recorded)
    if simulate and len(recorded) > 1:
        with tempfile.TemporaryDirectory() as work:
            every |= by_dataset(simulated_like_recordings(Path(work), quiet=True))
    examples = {
        name: found
        for number, name in enumerate(sorted(every) if len(recorded) > 1 else ())
        if (found := gather_examples(every[name], number, seed, per_dataset)) is not None
    }
    for name in recorded:
        others = [found for other, found in examples.items() if other != name]
        network = fit_network(others, epochs, seed) if others else None
        yield list(_dataset_rows(recorded[name], network, seed))


def _base(history: Tracks, road: Road | None) -> Prediction:
    """The motion that the networks for recordings correct."""
    motion = Motion.of(history)
    time_s = np.arange(1, _STEPS + 1, dtype=np.float64) * STEP_S
    xy = motion.from_own_frame(fading(motion, time_s))[:, None]
    return Prediction(history.ids, time_s, xy, np.ones((history.ids.size, 1)))


def _dataset_rows(
    places: Sequence[RecordedPlace], network: RecordedNetwork | None, seed: int
) -> Iterator[Row]:
    """Rows of one dataset: every predictor, with and without noise."""
    predictors: dict[str, _Predictor] = {
        "constant-velocity": lambda history, road: constant_velocity(Unmapped(history, _STEPS)),
        "kalman": lambda history, road: kalman(Unmapped(history, _STEPS)),
        "base": _base,
        "graphrqi-predict": lambda history, road: predict_recorded(history, _STEPS, road=road),
    }
    if network is not None:
        predictors["left-out"] = lambda history, road: predict_recorded(
            history, _STEPS, network, road
        )
    mapped = any(one.road is not None for one in places)
    for noise_m, (name, predictor) in product(NOISES_M, predictors.items()):
        learned = mapped and name in ("graphrqi-predict", "left-out")
        for with_map in (False, True) if learned else (False,):
            keys: dict[str, Cell] = {
                "dataset": places[0].dataset, "predictor": name, "map": with_map,
                "noise_m": noise_m,
            }  # fmt: skip
            yield from _rows(keys, places, predictor, with_map, noise_m, seed)


def _rows(
    keys: dict[str, Cell], places: Sequence[RecordedPlace], predictor: _Predictor, with_map: bool,
    noise_m: float, seed: int,
) -> Iterator[Row]:  # fmt: skip
    """The figures of a predictor, by class of vehicles and horizon."""
    found: list[tuple[FloatArray, ...]] = []
    every_s, first = float(np.clip(moving_s(places) / SCORED_PER_DATASET, 1.0, 60.0)), 0
    for index, one in enumerate(places):
        rng = np.random.default_rng((seed, index))
        for _, clean, truth, counts in cases(one.tracks, every_s):
            history = with_noise(clean, noise_m, rng, 1) if noise_m else clean
            best = predictor(history, one.road if with_map else None).best[:, _AT]
            errors, steady = (
                np.linalg.norm(each - truth, axis=-1)
                for each in (best, steady_motion(history, TIME_S))
            )
            vehicle = first + np.searchsorted(one.tracks.ids, clean.ids)
            kinds = np.stack([vehicle, classes_of(clean), moving(clean)], axis=1)
            found.append((errors[counts], steady[counts], kinds[counts]))
        first += one.tracks.ids.size
    if not found:
        return
    errors, steady, kinds = (np.concatenate(each) for each in zip(*found, strict=True))
    groups = {"moving": kinds[:, 2] > 0}
    groups |= {name: kinds[:, 1] == code for code, name in enumerate(CLASSES)}
    for (name, rows), horizon_s in product(groups.items(), HORIZONS_S):
        n, vehicle = int(rows.sum()), kinds[rows, 0]
        if n < LEAST_CASES:
            continue
        upto = int(np.searchsorted(TIME_S, horizon_s - 1e-9)) + 1
        ours, theirs = (one[rows, :upto].mean(axis=1) for one in (errors, steady))
        here: dict[str, Cell] = {**keys, "class": name, "horizon_s": horizon_s}
        for metric, below in (("ratio_to_cv", theirs), ("ade_m", np.ones(n))):
            yield tidy_row(here, metric, *bootstrap(ratio, summed(vehicle, ours, below)), n)
