"""Trains the predictor for recordings: ``graphrqi train --predictor DATA... --out FOLDER``.

Every instant of a recording is used several times: as recorded, and in altered versions with
noise, fewer frames, shorter pasts or speeds constant between key frames. Half of these are
mirrored, so that traffic on the left is learned, too. Maps are moved a little, since those of
other places fit less well than a simulator's. The future is never altered.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.elementwise import log_uniform
from behaviors.errors import InputError
from experiments.console.progress import Progress
from experiments.training.recordings import (
    PAST_S,
    RecordedPlace,
    by_dataset,
    cases,
    history_of,
    moving_s,
    steady_motion,
)
from graphrqi.predict.networks import TIME_S
from graphrqi.predict.recorded.features import features_of, plausible
from graphrqi.predict.recorded.lanes_ahead import LanesAhead, lanes_ahead
from graphrqi.predict.recorded.motion import Motion, fading
from graphrqi.predict.recorded.network import SHIPPED, RecordedNetwork
from graphrqi.predict.training.recorded import (
    EPOCHS,
    RecordedExamples,
    earned_shares,
    errors_by_share,
    guesses,
    train_recorded,
)
from sim.files import whole_file
from sim.frames import BoolArray, FloatArray, Tracks
from sim.road import Road

PER_DATASET: Final = 1_200
"""Number of examples, a moving agent at an instant each, that are taken from a dataset, about."""

LEAST_EVERY_S, MOST_EVERY_S = 0.4, 30.0
"""Shortest and longest time between the instants of a recording, s."""

NOISE_M, MAP_OFF_M = (0.02, 0.3), 0.6
"""Range of the noise added to the past, log-uniform, and the map's offset in an altered version:
standard deviations of each coordinate, m."""

COARSER, DENSE_S = (2, 3, 5), 0.15
"""Every second, third or fifth frame is kept in another version, where frames are closer than
this, s."""

KEY_FRAMES_S, SHORTEST_PAST_S = (1.0, 5.0), 0.4
"""Range of the time between key frames, s, uniform (after NGSIM's Peachtree Street, whose speeds
are piecewise constant), and the shortest past that is learned from, s."""

MIRROR: Final = np.array([1.0, -1.0])
"""Swaps left and right."""

MIRRORED_SHARE, ALONE_SHARE = 0.5, 0.08
"""Shares of versions in which left and right are swapped, and of those without neighbours, as where
gaps are implausible."""

FOLDS, VALIDATION_EVERY = 3, 10
"""Groups of datasets that are left out in turn to see what corrections earn. Every tenth recording
scales the spreads and is not trained on."""


@dataclass(frozen=True, slots=True, eq=False)
class DatasetExamples:
    """Examples of one dataset: in all versions, and of other recordings as recorded."""

    dataset: str
    training: RecordedExamples
    validation: RecordedExamples | None


def with_noise(history: Tracks, deviation_m: float, rng: np.random.Generator, style: int) -> Tracks:
    """A history with noise of this deviation added to each coordinate of its positions, m.

    In style 0 velocities stay as recorded, and in style 1 speeds and headings follow from the noisy
    positions. In style 2 the noise is also correlated over half a second.
    """
    noise = rng.normal(0.0, deviation_m, history.xy.shape)
    if style == 2 and history.time_s.size > 1:
        keep = float(np.exp(-history.step_s / 0.5))
        for t in range(1, history.time_s.size):
            noise[:, t] = keep * noise[:, t - 1] + np.sqrt(1 - keep**2) * noise[:, t]
    xy = history.xy + noise
    if style == 0 or history.time_s.size < 2:
        return history.with_dense(xy=xy)
    step = np.diff(xy, axis=1) / np.diff(history.time_s)[None, :, None]
    before = np.concatenate([step[:, :1], step], axis=1)
    after = np.concatenate([step, step[:, -1:]], axis=1)
    velocity = np.where(np.isfinite(before), before, after)
    speed = np.hypot(velocity[..., 0], velocity[..., 1])
    known = history.valid & np.isfinite(speed)
    heading = np.arctan2(velocity[..., 1], velocity[..., 0])
    return history.with_dense(
        xy=xy,
        speed=np.where(known, speed, history.speed),
        heading=np.where(known & (speed > 0.5), heading, history.heading),
    )


def between_key_frames(tracks: Tracks, rng: np.random.Generator) -> Tracks:
    """A recording in which each agent moves steadily between key frames, as if filled in there."""
    xy, speed = tracks.xy.copy(), tracks.speed.copy()
    for row, seen in enumerate(tracks.valid):
        columns = np.flatnonzero(seen)
        if columns.size < 3:
            continue
        time_s = tracks.time_s[columns]
        most = int(np.ceil((time_s[-1] - time_s[0]) / KEY_FRAMES_S[0])) + 1
        due = time_s[0] + np.cumsum(rng.uniform(*KEY_FRAMES_S, most))
        keys = np.unique([0, *np.searchsorted(time_s, due[due < time_s[-1]]), columns.size - 1])
        place = tracks.xy[row, columns[keys]]
        xy[row, columns] = np.stack(
            [np.interp(time_s, time_s[keys], place[:, axis]) for axis in range(2)], axis=1
        )
        along = np.linalg.norm(np.diff(place, axis=0), axis=1) / np.diff(time_s[keys])
        piece = np.searchsorted(keys, np.arange(columns.size)).clip(1) - 1
        speed[row, columns] = along[piece]
    return tracks.with_dense(xy=xy, speed=speed)


def mirrored(tracks: Tracks) -> Tracks:
    """Tracks with left and right swapped."""
    xy, heading = tracks.row_xy * MIRROR, -tracks.row_heading
    return dataclasses.replace(tracks, row_xy=xy, row_heading=heading)


def _versions(history: Tracks, rng: np.random.Generator) -> list[Tracks]:
    """The same instant as other sensors would have seen it."""
    noise_m = log_uniform(rng, *NOISE_M)
    found = [history, with_noise(history, noise_m, rng, int(rng.integers(3)))]
    everyone = np.arange(history.ids.size)
    if history.step_s < DENSE_S:
        backwards = np.arange(history.time_s.size - 1, -1, -int(rng.choice(COARSER)))
        found.append(history.part(everyone, backwards[::-1]))
    last, past_s = found[-1], float(rng.uniform(SHORTEST_PAST_S, PAST_S))
    first = int(np.searchsorted(last.time_s, last.time_s[-1] - past_s - 1e-6))
    return [*found, last.part(everyone, slice(first, None))]


def recorded_examples(
    history: Tracks, truth: FloatArray, counts: BoolArray, group: int, believable: bool,
    road: Road | None = None, map_off_m: FloatArray | float = 0.0,
) -> RecordedExamples:  # fmt: skip
    """Training examples of one instant, whose agents that count (n,) went to (n, KNOTS, 2), m.

    ``group`` is the dataset's number. Neighbours are seen only if their gaps are ``believable``.
    The map may be off by ``map_off_m`` (2,), m.
    """
    motion = Motion.of(history)
    ahead = LanesAhead.none(history.ids.size)
    if road is not None:
        ahead = lanes_ahead(history, dataclasses.replace(motion, xy=motion.xy - map_off_m), road)
    step_s = history.step_s if history.time_s.size > 1 else 0.1
    measured = np.stack(
        [motion.speed, motion.noise_m, motion.noise_mps, np.full_like(motion.speed, step_s)], axis=1
    )
    steady = np.linalg.norm(steady_motion(history, TIME_S) - truth, axis=-1).mean(axis=1)
    return RecordedExamples(
        features_of(history, motion, believable)[counts].astype(np.float32),
        fading(motion, TIME_S)[counts].astype(np.float32),
        motion.to_own_frame(truth)[counts].astype(np.float32),
        measured[counts].astype(np.float32),
        motion.stands[counts],
        steady[counts].astype(np.float32),
        np.full(int(counts.sum()), group),
        ahead.of(counts).in_single_precision(),
    )


def examples_of(
    one: RecordedPlace, every_s: float, group: int, rng: np.random.Generator, versions: bool
) -> list[RecordedExamples]:
    """Training examples of one recording at instants ``every_s`` apart, also in altered versions.

    Between key frames places are interpolated, so the key frame to come shows in the past.
    """
    found, tracks = [], one.tracks
    filled_in = between_key_frames(tracks, rng) if versions else tracks
    for stop, history, truth, counts in cases(tracks, every_s):
        believable = plausible(history)
        seen_as = [history]
        if versions:
            seen_as = [*_versions(history, rng), history_of(filled_in, stop)]
        for number, seen in enumerate(seen_as):
            near = believable and (not versions or rng.random() >= ALONE_SHARE)
            off = rng.normal(0.0, MAP_OFF_M, 2) if number else 0.0
            shown, went, road = seen, truth, one.road
            if versions and rng.random() < MIRRORED_SHARE:
                shown, went, road = mirrored(seen), truth * MIRROR, road and road.mirrored
            found.append(recorded_examples(shown, went, counts, group, near, road, off))
    return found


def gather_examples(
    places: Sequence[RecordedPlace], group: int, seed: int = 0, per_dataset: int = PER_DATASET
) -> DatasetExamples | None:
    """Training examples of one dataset, about ``per_dataset`` agents at instants.

    None if no agent moves for long enough. ``group`` is the dataset's number.
    """
    every_s = np.clip(0.7 * moving_s(places) / per_dataset, LEAST_EVERY_S, MOST_EVERY_S)
    parts: tuple[list[RecordedExamples], list[RecordedExamples]] = ([], [])
    for index, one in enumerate(places):
        rng = np.random.default_rng((seed, group, index))
        apart = index % VALIDATION_EVERY == VALIDATION_EVERY - 1
        parts[apart].extend(examples_of(one, float(every_s), group, rng, not apart))
    if not parts[0]:
        return None
    validation = RecordedExamples.join(parts[1]) if parts[1] else None
    return DatasetExamples(places[0].dataset, RecordedExamples.join(parts[0]), validation)


def train_on_recordings(
    sources: Sequence[Path], out: Path, *, epochs: int = EPOCHS, seed: int = 0, quiet: bool = False
) -> dict[str, float]:
    """Train the predictor for recordings, and save it with its card in a folder.

    Sources are as `by_dataset` takes them. Returned is, by dataset, the mean error of the best
    guesses over that of constant velocity, on its recordings apart; on its training recordings
    where it has too few.
    """
    places = by_dataset(sources, quiet=quiet)
    found: list[DatasetExamples] = []
    with Progress("observing recordings", len(places), quiet) as progress:
        for each in places.values():
            examples = gather_examples(each, len(found), seed)
            if examples is not None:
                found.append(examples)
            progress.advance()
    if not found:
        raise InputError(
            f"{', '.join(map(str, sources))}: found no moving vehicle seen for 8 s, expected one "
            "to train on"
        )
    network = fit_network(found, epochs, seed, quiet)
    scores = {}
    for given in found:
        apart = given.validation or given.training
        error = np.linalg.norm(guesses(network, apart) - apart.truth, axis=-1)
        scores[given.dataset] = float(error.mean() / max(float(apart.steady.mean()), 1e-9))
    card: dict[str, Any] = {
        "data": {one.dataset: len(one.training) for one in found}, "epochs": epochs, "seed": seed,
        "ade_over_constant_velocity": {name: round(value, 3) for name, value in scores.items()},
    }  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    with whole_file(out / SHIPPED) as partial:
        network.save(partial, card)
    return scores


def fit_network(
    found: Sequence[DatasetExamples], epochs: int, seed: int, quiet: bool = True
) -> RecordedNetwork:
    """Train on what datasets give; their validation parts scale the spreads.

    Networks trained without some of the datasets give the reliability of corrections there.
    """
    errors = []
    for fold in range(FOLDS if len(found) > FOLDS else 0):
        others = [one for number, one in enumerate(found) if number % FOLDS != fold]
        network = _fit(others, epochs, seed, True)
        errors += [errors_by_share(network, one.training) for one in found[fold::FOLDS]]
    network = _fit(found, epochs, seed, quiet)
    return dataclasses.replace(network, earned=earned_shares(errors)) if errors else network


def _fit(found: Sequence[DatasetExamples], epochs: int, seed: int, quiet: bool) -> RecordedNetwork:
    """Train once."""
    training = RecordedExamples.join([one.training for one in found])
    apart = [one.validation for one in found if one.validation is not None]
    with Progress("training epochs", epochs, quiet) as progress:
        return train_recorded(
            training, RecordedExamples.join(apart) if apart else training, epochs=epochs,
            seed=seed, on_epoch=lambda epoch: progress.advance(),
        )  # fmt: skip
