"""The plain rival: a random forest on nine numbers of each driver's whole track.

It knows nothing of spectra, graphs or traits. Trained on the same drivers, it says what a method of
ours is good for: what does not beat it needs no theory.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from behaviors.traits import lane_changes
from experiments.data.parallel import in_parallel
from experiments.data.windows import measured
from graphrqi.samples import Samples
from sim.episode.observables import detector_inputs, observe
from sim.frames import FloatArray, IntArray, Tracks
from sim.road import Road
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import EpisodeEntry, Split

NAMES: Final = (
    "mean_speed_mps", "median_speed_mps", "deviation_of_speed_mps", "deviation_of_accel_mps2",
    "least_headway_s", "median_headway_s", "least_gap_m", "median_gap_m", "lane_changes_per_km",
)  # fmt: skip
"""The nine numbers."""

AHEAD_M, BESIDE_M, LEAST_SPEED_MPS = 100.0, 1.8, 1.0
"""Without a map, the leader is the nearest within this far ahead and to the side, m. Headways count
from the last speed on, m/s."""


def nine_numbers(tracks: Tracks, road: Road | None) -> FloatArray:
    """(N, 9) `NAMES` of every agent; NaN where a number is not known.

    Speeds and accelerations are differences of positions over half a second. Leaders and lanes are
    those of the map; without one, leaders are found by position and lane changes are unknown.
    """
    found = np.full((tracks.ids.size, len(NAMES)), np.nan)
    if tracks.time_s.size < 2:
        return found
    gap = _gaps(tracks) if road is None else np.full(tracks.valid.shape, np.inf)
    changes = np.full(tracks.ids.size, np.nan)
    if road is not None:
        index, seen = tracks.index, observe(tracks, road)
        gap[index.agent, index.step] = seen.gap
        agent = index.agent[lane_changes(detector_inputs(tracks, road, seen))]
        changes = np.bincount(agent, minlength=tracks.ids.size).astype(np.float64)
    half = max(1, round(0.25 / tracks.step_s))
    for row in range(tracks.ids.size):
        here = tracks.valid[row]
        xy, time_s = tracks.xy[row, here], tracks.time_s[here]
        if time_s.size < 4 * half + 2:
            continue
        speed = np.hypot(*_over(xy, half).T) / _over(time_s, half)
        accel = _over(speed, half) / _over(time_s[half:-half], half)
        followed = gap[row, here][half:-half]
        followed = np.where(np.isfinite(followed), np.maximum(followed, 0.0), np.nan)
        headway = np.where(speed > LEAST_SPEED_MPS, followed / np.maximum(speed, 1e-9), np.nan)
        found[row, :4] = speed.mean(), np.median(speed), speed.std(), accel.std()
        for column, values in ((4, headway), (6, followed)):
            known = values[np.isfinite(values)]
            if known.size:
                found[row, column : column + 2] = known.min(), np.median(known)
        found[row, 8] = changes[row] / max(speed.mean() * (time_s[-1] - time_s[0]), 50.0) * 1e3
    return found


def _over(values: FloatArray, half: int) -> FloatArray:
    """Differences over twice so many steps."""
    return np.asarray(values[2 * half :] - values[: -2 * half])


def _gaps(tracks: Tracks) -> FloatArray:
    """(N, T) distance to the nearest agent ahead in the own direction, less both halves, m."""
    gap = np.full(tracks.valid.shape, np.inf)
    for step in range(tracks.time_s.size):
        rows = np.flatnonzero(tracks.valid[:, step])
        heading = tracks.heading[rows, step]
        facing = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        apart = tracks.xy[rows, step][None] - tracks.xy[rows, step][:, None]
        along = (apart * facing[:, None]).sum(axis=2)
        across = np.abs(facing[:, None, 0] * apart[..., 1] - facing[:, None, 1] * apart[..., 0])
        long = tracks.length[rows]
        ahead = (along > 0.0) & (along < AHEAD_M) & (across < BESIDE_M)
        between = along - (long[None] + long[:, None]) / 2
        gap[rows, step] = np.where(ahead, between, np.inf).min(axis=1, initial=np.inf)
    return gap


def _episode(folder: Path, entry: EpisodeEntry, number: int) -> Samples:
    """The labelled drivers of one episode."""
    dataset = open_dataset(folder)
    tracks = measured(dataset.read(entry))
    numbers = nine_numbers(tracks, dataset.road(entry))
    codes = np.full(tracks.ids.size, -1) if tracks.behavior is None else tracks.behavior
    rows = np.flatnonzero((codes >= 0) & np.isfinite(numbers[:, 0]))
    episode = np.full(rows.size, number)
    return whole_track_samples(numbers[rows], codes[rows], episode, tracks.ids[rows])


def whole_track_samples(
    features: FloatArray, codes: NDArray[np.integer[Any]], episode: IntArray, agent: IntArray
) -> Samples:
    """Samples of whole tracks: (n, F) features, (n,) codes of behaviours, episodes and agents."""
    n = len(features)
    whole = np.full(n, np.inf)
    return Samples(
        features.astype(np.float32), codes.astype(np.int8), episode, agent, np.zeros(n), whole,
        whole, np.ones(n, dtype=bool),
    )  # fmt: skip


def whole_tracks(dataset: Dataset, split: Split | None = None, jobs: int | None = None) -> Samples:
    """The nine numbers of every labelled driver of a split, or of all, a sample each.

    Episodes are numbered as in the dataset.
    """
    every = enumerate(dataset.manifest.episodes)
    arguments = [(dataset.path, e, i) for i, e in every if split in (None, e.split)]
    return Samples.join(list(in_parallel(_episode, arguments, jobs)))


class PlainRival:
    """A random forest of scikit-learn on `nine_numbers`; unknown numbers are left to its trees."""

    def __init__(self, training: Samples, seed: int = 0) -> None:
        from sklearn.ensemble import RandomForestClassifier

        self._forest = RandomForestClassifier(
            n_estimators=300, min_samples_leaf=3, random_state=seed, n_jobs=1
        )
        self._forest.fit(training.features, training.codes)

    def posterior(
        self, features: NDArray[np.floating[Any]], classes: int = len(BEHAVIORS)
    ) -> FloatArray:
        """(n, k) probabilities of so many behaviours, from (n, 9) numbers."""
        found = np.zeros((len(features), classes))
        found[:, self._forest.classes_] = self._forest.predict_proba(features.astype(np.float32))
        return found
