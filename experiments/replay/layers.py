"""Layers of a replay beside positions: beliefs, futures, the traffic graph, and ghosts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.guard import guarded_call
from experiments.score.labels import beliefs
from experiments.score.tables import CHANCES, read_labels
from graphrqi.features.spectral import NEIGHBORS, RESET
from graphrqi.graph import TrafficGraph
from graphrqi.methods import Model
from graphrqi.places.other_traffic import Traffic
from graphrqi.posterior import Posterior
from graphrqi.predict import predict
from graphrqi.predict.metrics import SAMPLE_S
from graphrqi.predict.prediction import Prediction
from graphrqi.spectrum import SOLVERS
from graphrqi.stream import HISTORY_STEPS
from sim.frames import FloatArray, IntArray, Tracks
from sim.road import Road

LOOK_EVERY_S: Final = 0.5
"""Time between two beliefs, or graphs, that are kept, s (evidence gathers over seconds)."""

MAX_LOOKS: Final = 3_000_000
"""Most beliefs that are kept: agents times instants. Longer recordings have fewer instants (a page
of some megabytes)."""

HORIZON_S: Final = 5.0
"""How far ahead predictions are shown, s."""

PREDICT_EVERY_S: Final = 1.0
"""Time between two predictions, s (a horizon of 5 s is looked at five times)."""

LEAST_PROBABILITY: Final = 0.02
"""Futures less likely than this are not kept."""

MAX_PREDICTED: Final = 200_000
"""Most futures of one agent at an instant that a page keeps (some 15 MB, as an agent has up to six
futures). For longer recordings there are fewer instants."""

APART_M: Final = 0.5
"""A ghost is shown where an agent is farther than this from where it was, m (less does not
show)."""


def sampled(tracks: Tracks, every_s: float) -> IntArray:
    """(S,) ascending indices of the first frame in every interval of so many seconds."""
    slot = np.floor((tracks.time_s - tracks.time_s[:1]) / every_s + 1e-6)
    return np.flatnonzero(np.diff(slot, prepend=-1.0) > 0)


def kept_steps(tracks: Tracks) -> IntArray:
    """(S,) ascending indices of the frames at which beliefs and the graph are kept, 0 first.

    They are half a second apart, or farther where very many agents are seen for very long.
    """
    steps = sampled(tracks, LOOK_EVERY_S)
    return steps[:: max(1, -(-tracks.ids.size * steps.size // MAX_LOOKS))]


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

    @classmethod
    def none(cls, tracks: Tracks, steps: IntArray) -> Beliefs:
        """No beliefs at some frames, to be filled."""
        shape = tracks.ids.size, steps.size, len(BEHAVIORS)
        return cls(tracks.ids, tracks.time_s[steps], np.full(shape, np.nan, dtype=np.float32))

    def at(self, time_s: float) -> Posterior:
        """The latest beliefs at a time, of the agents that have any."""
        column = int(np.searchsorted(self.time_s, time_s + 1e-6)) - 1
        if column < 0:
            return Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))
        now = self.probability[:, column]
        known = np.isfinite(now).all(axis=1)
        return Posterior(self.ids[known], now[known].astype(np.float64))


def believe(tracks: Tracks, model: Model, is_scene: bool, traffic: Traffic) -> Beliefs:
    """The beliefs of a `graphrqi.stream.BehaviorStream` about an episode, every half a second.

    Where the frames show no plausible scene, every behaviour is as likely.
    """
    steps = kept_steps(tracks)
    found = Beliefs.none(tracks, steps)
    answers = beliefs(tracks, model, (steps + 1).tolist(), is_scene, traffic)
    for column, posterior in enumerate(answers.values()):
        known = (posterior.unknown < 1.0)[:, None]
        chance = np.where(known, posterior.probability, 1.0 / len(BEHAVIORS))
        found.probability[np.searchsorted(tracks.ids, posterior.ids), column] = chance
    return found


def read_beliefs(path: Path, episode: str, tracks: Tracks) -> Beliefs:
    """Beliefs about an episode from a labels file (.parquet) of ``graphrqi classify``."""
    path.stat()  # which says in the system's words that there is no such file
    table = guarded_call(path, read_labels, path, episode)
    agent, time_s = table["agent"].to_numpy(), table["time_s"].to_numpy()
    row = np.minimum(np.searchsorted(tracks.ids, agent), tracks.ids.size - 1)
    strangers = agent[tracks.ids[row] != agent]
    if strangers.size:
        raise InputError(
            f"{path}: found agent {strangers[0]}, expected one of {episode}'s {tracks.ids.size}"
        )
    found = Beliefs.none(tracks, kept_steps(tracks))
    times = found.time_s
    column = np.clip(np.searchsorted(times, time_s - 1e-4), 0, times.size - 1)
    here = np.abs(times[column] - time_s) < 1e-3
    found.probability[row[here], column[here]] = table[CHANCES].to_numpy(np.float32)[here]
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Predictions of one instant.

    Attributes:
        time_s: the present, s.
        agent: (M,) index into the tracks' agents of each future, ascending.
        probability: (M,) of each future; falling within an agent.
        ahead_s: (H,) s from the present.
        xy: (M, H, 2) m.
    """

    time_s: float
    agent: IntArray
    probability: FloatArray
    ahead_s: FloatArray
    xy: FloatArray

    @property
    def likeliest(self) -> IntArray:
        """Indices of each agent's likeliest future."""
        return np.flatnonzero(np.diff(self.agent, prepend=-1) != 0)


def forecast(
    tracks: Tracks, believed: Beliefs, road: Road | None, predictor: str
) -> list[Forecast]:  # fmt: skip
    """Predict every agent throughout an episode: every second, or less often if there are many.

    Each prediction by this key of ``PREDICTORS`` sees the past alone. There is one for each instant
    at which anybody is there.
    """
    found = []
    seconds = sampled(tracks, PREDICT_EVERY_S)
    stride = -(-int(tracks.index.counts()[seconds].sum()) // MAX_PREDICTED)
    for step in seconds[1 :: max(stride, 1)]:
        history = tracks.window(int(step) + 1, HISTORY_STEPS)
        if not history.ids.size:
            continue
        time_s = float(tracks.time_s[step])
        prediction = predict(history, believed.at(time_s), road, HORIZON_S, predictor)
        found.append(_kept(time_s, np.searchsorted(tracks.ids, prediction.ids), prediction))
    return found


def _kept(time_s: float, rows: IntArray, prediction: Prediction) -> Forecast:
    """The futures worth keeping, those of one agent together, the likeliest first."""
    ahead = np.arange(1, round(prediction.time_s[-1] / SAMPLE_S) + 1) * SAMPLE_S
    at = np.clip(np.searchsorted(prediction.time_s, ahead - 1e-6), 0, prediction.time_s.size - 1)
    order = np.argsort(-prediction.probability, axis=1, kind="stable")
    probability = np.take_along_axis(prediction.probability, order, axis=1)
    kept = probability >= LEAST_PROBABILITY
    kept[:, 0] = True
    agent, rank = np.nonzero(kept)
    return Forecast(
        time_s, rows[agent], probability[agent, rank], prediction.time_s[at],
        prediction.xy[agent, order[agent, rank]][:, at],
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class GraphHistory:
    """A traffic graph over time, and each agent's part in w = L u.

    w is the graph's Laplacian times the eigenvector u of its largest eigenvalue, the paper's figure
    of which vehicles the leading eigenvector is about. The sign of u means nothing; |w| is kept.

    Attributes:
        time_s: (S,) times of the samples, s.
        w: (N, S) |w| of each agent; NaN where it is not there.
        edges: (E, 4) of each edge: the two agents' rows, the first sample that found it and the
            first that did not.
    """

    time_s: FloatArray
    w: FloatArray
    edges: IntArray


def graph_history(tracks: Tracks) -> GraphHistory:
    """Follow the paper's accumulated 4-nearest-neighbour graph through an episode."""
    steps, index, many = kept_steps(tracks), tracks.index, tracks.ids.size
    column = {int(step): i for i, step in enumerate(steps)}
    w = np.full((many, steps.size), np.nan)
    graph = TrafficGraph.empty(neighbors=NEIGHBORS, reset=RESET, kind="accumulated")
    previous = None
    since: dict[int, int] = {}
    edges: list[tuple[int, int, int, int]] = []
    for step in range(tracks.time_s.size):
        at = index.at(step)
        rows = index.agent[at]
        graph = graph.observe(tracks.ids[rows], tracks.row_xy[at])
        if step not in column:
            continue
        sample = column[step]
        pairs = np.sort(np.searchsorted(tracks.ids, graph.edges), axis=1)
        keys = (pairs[:, 0] * many + pairs[:, 1]).tolist()
        for key in since.keys() - set(keys):
            edges.append((*divmod(key, many), since.pop(key), sample))
        for key in keys:
            since.setdefault(key, sample)
        if not rows.size:
            continue
        previous = SOLVERS["graphrqi"](graph, num_pairs=1, end="largest", previous=previous)
        value = np.abs(np.asarray(graph.laplacian @ np.asarray(previous.eigenvectors[:, 0])))
        w[rows, sample] = value[graph.rows_of(tracks.ids[rows])]
    edges += [(*divmod(key, many), begin, steps.size) for key, begin in since.items()]
    return GraphHistory(
        tracks.time_s[steps], w, np.array(sorted(edges), dtype=np.int64).reshape(-1, 4)
    )


def find_ghosts(factual: Tracks, shown: Tracks) -> Tracks:
    """Factual places of all who are `APART_M` away from their counterfactual self, or have none.

    The times of the counterfactual episode that is shown are among the factual ones.
    """
    columns = np.searchsorted(factual.time_s, shown.time_s - 1e-6)
    there = factual.part(np.arange(factual.ids.size), columns)
    rows = np.minimum(np.searchsorted(shown.ids, there.ids), max(shown.ids.size - 1, 0))
    both = there.valid & (shown.ids[rows] == there.ids)[:, None] & shown.valid[rows]
    apart = np.where(both[..., None], there.xy - shown.xy[rows], 0.0)
    differs = there.valid & (~both | (np.hypot(apart[..., 0], apart[..., 1]) > APART_M))
    some = np.flatnonzero(differs.any(axis=1))
    return Tracks.of_dense(
        ids=there.ids[some], names=tuple(there.names[i] for i in some), kind=there.kind[some],
        length=there.length[some], width=there.width[some], time_s=there.time_s,
        signals=there.signals, xy=there.xy[some], heading=there.heading[some],
        speed=there.speed[some], valid=differs[some],
    )  # fmt: skip
