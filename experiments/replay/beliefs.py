"""What a classifier believes about each driver over the time of one episode."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.guard import guarded_call
from graphrqi.methods import Model
from graphrqi.places.other_traffic import Traffic
from graphrqi.posterior import Posterior
from graphrqi.stream import BehaviorStream
from sim.frames import FloatArray, IntArray, Tracks

EVERY_S: Final = 0.5
"""Time between two beliefs that are kept, s (evidence gathers over seconds)."""

MAX_LOOKS: Final = 3_000_000
"""Most beliefs that are kept: agents times instants. Longer recordings have fewer instants (a page
of some megabytes)."""


CHANCES: Final = [f"p_{b.value}" for b in BEHAVIORS]
"""Columns of a labels file with the probability of each behaviour."""


@dataclass(frozen=True, slots=True, eq=False)
class Beliefs:
    """Posteriors of every agent of an episode at some times.

    Attributes:
        ids: (N,) agent ids, ascending.
        time_s: (S,) when, s, increasing.
        probability: (N, S, 6) in the order of ``BEHAVIORS``; NaN where nothing is believed.
    """

    ids: IntArray
    time_s: FloatArray
    probability: NDArray[np.float32]

    def at(self, time_s: float) -> Posterior:
        """The latest beliefs at a time, of the agents that have any."""
        column = int(np.searchsorted(self.time_s, time_s + 1e-6)) - 1
        if column < 0:
            return Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))
        now = self.probability[:, column]
        known = np.isfinite(now).all(axis=1)
        return Posterior(self.ids[known], now[known].astype(np.float64))


def kept_steps(tracks: Tracks) -> IntArray:
    """Indices of the frames at which beliefs and the graph are kept: every half a second.

    Args:
        tracks: an episode; of one with very many agents for very long, looks are farther apart.

    Returns:
        (S,) ascending; the first is 0.
    """
    steps = sampled(tracks, EVERY_S)
    return steps[:: max(1, -(-tracks.ids.size * steps.size // MAX_LOOKS))]


def sampled(tracks: Tracks, every_s: float) -> IntArray:
    """Indices of the first frame in every interval of so many seconds.

    Args:
        tracks: an episode.
        every_s: length of the intervals, s.

    Returns:
        (S,) ascending; the first is 0.
    """
    slot = np.floor((tracks.time_s - tracks.time_s[:1]) / every_s + 1e-6)
    return np.flatnonzero(np.diff(slot, prepend=-1.0) > 0)


def believe(
    tracks: Tracks, model: Model, is_scene: bool = True, traffic: Traffic = "simulated"
) -> Beliefs:
    """Classify the drivers of an episode from their positions.

    Args:
        tracks: an episode; its labels, if any, are not looked at.
        model: a trained model.
        is_scene: as for `graphrqi.stream.BehaviorStream`.
        traffic: as for `graphrqi.stream.BehaviorStream`.

    Returns:
        Its beliefs every half a second.
    """
    steps = kept_steps(tracks)
    probability = _nothing(tracks, steps)
    column = {int(step): i for i, step in enumerate(steps)}
    stream = BehaviorStream(model, traffic=traffic, is_scene=is_scene)
    for step, frame in enumerate(tracks.frames()):
        stream.push(frame)
        if step in column:
            posterior = stream.posterior()
            rows = np.searchsorted(tracks.ids, posterior.ids)
            # Where the frames show no scene that can be believed, every behaviour is as likely.
            earned = (posterior.unknown < 1.0)[:, None]
            chance = np.where(earned, posterior.probability, 1.0 / len(BEHAVIORS))
            probability[rows, column[step]] = chance
    return Beliefs(tracks.ids, tracks.time_s[steps], probability)


def read_beliefs(path: Path, episode: str, tracks: Tracks) -> Beliefs:
    """Beliefs from a labels file, as ``graphrqi classify`` writes them.

    Args:
        path: the Parquet file.
        episode: whose rows.
        tracks: that episode.

    Returns:
        The beliefs at every half a second of which the file says something.

    Raises:
        InputError: if the file is not a labels file or does not speak of this episode.
    """
    path.stat()  # which says in the system's words that there is no such file
    table = guarded_call(path, _read_labels, path, episode)
    if table.empty:
        raise InputError(f"{path}: found no row of episode {episode}, expected its labels")
    empty = [name for name in table if table[name].isna().any()]
    if empty:
        raise InputError(f"{path}: found an empty {empty[0]}, expected one in every row")
    believed = table[CHANCES].to_numpy(dtype=np.float32)
    if not (np.abs(believed.sum(axis=1) - 1.0) < 1e-3).all():
        raise InputError(f"{path}: found p_ columns that do not add to 1, expected probabilities")
    agent, time_s = table["agent"].to_numpy(), table["time_s"].to_numpy()
    row = np.minimum(np.searchsorted(tracks.ids, agent), tracks.ids.size - 1)
    strangers = agent[tracks.ids[row] != agent]
    if strangers.size:
        raise InputError(
            f"{path}: found agent {strangers[0]}, expected one of {episode}'s {tracks.ids.size}"
        )
    steps = kept_steps(tracks)
    times = tracks.time_s[steps]
    column = np.clip(np.searchsorted(times, time_s - 1e-4), 0, times.size - 1)
    here = np.abs(times[column] - time_s) < 1e-3
    probability = _nothing(tracks, steps)
    probability[row[here], column[here]] = believed[here]
    return Beliefs(tracks.ids, times, probability)


def _read_labels(path: Path, episode: str) -> pd.DataFrame:
    """The rows of an episode, read in the guarded child."""
    try:
        return pd.read_parquet(
            path, columns=["agent", "time_s", *CHANCES], filters=[("episode", "==", episode)]
        )
    except (ValueError, OSError, KeyError) as error:
        said = " ".join(str(error).split())
        raise InputError(f"{path}: {said:.120}, expected a file of labels") from None


def _nothing(tracks: Tracks, steps: IntArray) -> NDArray[np.float32]:
    return np.full((tracks.ids.size, steps.size, len(BEHAVIORS)), np.nan, dtype=np.float32)
