"""Everything a replay shows of one episode, gathered once for the page, the film, the picture.

Beside positions these are a classifier's beliefs, predicted futures, the traffic graph, and, of a
counterfactual episode, where everyone factually was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from behaviors.row_index import find_sorted
from behaviors.traits import ShownTrait
from experiments.console.progress import Progress
from experiments.data.scene_check import SCALED, is_scene
from experiments.data.units import image_scale
from experiments.data.windows import measured, traffic_of
from experiments.guard import guarded_call
from experiments.score.labels import beliefs
from experiments.score.tables import CHANCES, read_labels
from experiments.what_if.branches import branch_of, change_of
from experiments.what_if.outcomes import factual_of
from graphrqi.features.spectral import NEIGHBORS, RESET
from graphrqi.graph import TrafficGraph
from graphrqi.methods import Model
from graphrqi.model_files import load_model
from graphrqi.places.other_traffic import Traffic
from graphrqi.posterior import Posterior
from graphrqi.predict import predict
from graphrqi.predict.metrics import SAMPLE_S
from graphrqi.spectrum import SOLVERS
from graphrqi.stream import HISTORY_STEPS
from sim.episode.annotate import annotate_recording, near_misses
from sim.formats import FORMATS
from sim.frames import Event, EventKind, FloatArray, IntArray, Tracks
from sim.road import Road
from sim.scenario import AgentSpec
from sim.store.dataset import Dataset, Episode
from sim.store.schema import EpisodeEntry

SHOWN_EVERY_S, LOOK_EVERY_S, PREDICT_EVERY_S, HORIZON_S = 0.1, 0.5, 1.0, 5.0
"""Time between two kept positions, beliefs or graphs, and predictions, and how far ahead these
are shown, s (agents move straight between positions; evidence gathers over seconds)."""

MAX_PLACES, MAX_LOOKS, MAX_PREDICTED = 1_000_000, 3_000_000, 200_000
"""Most positions, beliefs and predicted agents that a page keeps (some megabytes each); of longer
episodes fewer instants are kept."""

LEAST_PROBABILITY: Final = 0.02
"""Futures less likely than this are not kept."""

APART_M: Final = 0.5
"""A ghost is shown where an agent is farther than this from where it was, m (less does not
show)."""

NAMED: Final = 6
"""Most episodes that a message names."""

DEFAULT_PREDICTOR: Final = "graphrqi-predict"

PARKED_M: Final = 2.0
"""A vehicle that stays within this is parked, m (more than the noise of recordings)."""

DRAWN_QUANTILE, CAR_SHAPE = 0.25, 2.5
"""Vehicles in an image are drawn as long as so many of its boxes are at most, and with a car's
length over width."""


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
        now = self.probability[:, max(column, 0)]
        known = np.isfinite(now).all(axis=1) & (column >= 0)
        return Posterior(self.ids[known], now[known].astype(np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class Futures:
    """F predicted futures of an episode, by instant, agent and falling probability.

    Attributes:
        ahead_s: (H,) s from the present.
        time_s: (F,) the present, s.
        agent: (F,) index into the tracks' agents.
        probability: (F,) of each future.
        xy: (F, H, 2) m.
    """

    ahead_s: FloatArray
    time_s: FloatArray
    agent: IntArray
    probability: FloatArray
    xy: FloatArray

    @property
    def likeliest(self) -> IntArray:
        """Indices of each agent's likeliest future at each instant."""
        other = np.diff(self.agent, prepend=-1) != 0
        return np.flatnonzero(other | (np.diff(self.time_s, prepend=-np.inf) > 0.0))


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


@dataclass(frozen=True, slots=True, eq=False)
class ReplayScene:
    """One episode, ready to be drawn.

    Attributes:
        entry: what it is and how it was made.
        unit: of lengths, "m" or "px".
        road: where it happened; None if not known.
        tracks: everyone, at the times that are shown.
        agents: what was drawn for each agent, by id.
        shown_traits: the traits that were shown.
        beliefs: what a classifier believes.
        believer: who believes it, in words.
        graph: the traffic graph.
        futures: predictions; None without any.
        predictor: whose; "" if there are none.
        notes: what a reader should know of the data, one sentence each.
        ghosts: of a counterfactual episode, where everyone factually was.
    """

    entry: EpisodeEntry
    unit: str
    road: Road | None
    tracks: Tracks
    agents: dict[int, AgentSpec]
    shown_traits: tuple[ShownTrait, ...]
    beliefs: Beliefs
    believer: str
    graph: GraphHistory
    futures: Futures | None
    predictor: str
    notes: tuple[str, ...]
    ghosts: Tracks | None = None

    @property
    def fullest_s(self) -> float:
        """The time with most agents, s."""
        return float(self.tracks.time_s[self.tracks.index.counts().argmax()])


def chosen_entry(dataset: Dataset, episode: str | None) -> EpisodeEntry:
    """The episode that is asked for; by default the first.

    It is called by its id, the beginning of its id, its name (the recording, with its folder or
    without, or the scenario and the index), or its scenario, of which it is the first then.
    """
    entries = dataset.manifest.episodes
    if not entries:
        raise InputError(f"{dataset.path}: found no episode, expected at least 1")
    if episode is None:
        return entries[0]
    found = [entry for entry in entries if entry.id.startswith(episode)]
    found = found or [entry for entry in entries if entry.name == episode]
    found = found or [e for e in entries if e.name.rpartition("/")[2] == episode]
    found = found or [entry for entry in entries if entry.scenario == episode][:1]
    if len(found) != 1:
        near = get_close_matches(episode, {e.name for e in entries}, NAMED, cutoff=0.0)
        nearest = found or [e for name in near for e in entries if e.name == name]
        known = [f"{e.id} ({e.name})" for e in nearest[:NAMED]]
        more = ["..."] if len(nearest) > NAMED else []
        raise InputError(
            f"--episode: found {len(found)} episodes called {episode!r}, expected one of "
            f"{', '.join(known + more)}"
        )
    return found[0]


def gather(
    dataset: Dataset,
    entry: EpisodeEntry,
    *,
    model: str,
    labels: Path | None = None,
    predictor: str = DEFAULT_PREDICTOR,
    quiet: bool = True,
) -> ReplayScene:
    """Read an episode, and classify and predict in it what no file says.

    The classifier, a shipped one's name or a folder, is not used where a labels file of
    ``graphrqi classify`` is given. The predictor is a key of ``PREDICTORS``, or "none".
    """
    episode = dataset.read(entry)
    tracks, road = measured(episode), dataset.road(entry)
    if not tracks.ids.size or tracks.time_s.size < 2:
        raise InputError(
            f"{entry.name}: found {tracks.ids.size} agents in {tracks.time_s.size} frames, "
            "expected at least 1 in 2"
        )
    shown_traits = episode.shown_traits
    if entry.engine in FORMATS:  # a recording: nobody has looked yet
        events = tuple(near_misses(dataset.conflicts(entry)))
        if road is not None:
            events, shown_traits = annotate_recording(tracks, road)
        tracks = replace(tracks, events=_without_parked(tracks, events))
    with Progress("looking at the episode", 3, quiet) as progress:
        if labels is None:
            trained = load_model(model)
            believed = _believed(tracks, trained, is_scene(entry), traffic_of(entry))
            believer = trained.method.name
        else:
            believed, believer = read_beliefs(labels, entry.id, tracks), labels.name
        progress.advance()
        futures = None if predictor == "none" else _predicted(tracks, believed, road, predictor)
        progress.advance()
        graph = graph_history(tracks)
        progress.advance()
    scaled = entry.engine not in FORMATS or SCALED in entry.options
    unit = "m" if scaled else FORMATS[entry.engine].unit
    stride = max(1, round(SHOWN_EVERY_S / tracks.step_s))
    stride = max(stride, -(-tracks.row_speed.size // MAX_PLACES))
    if unit == "px":  # boxes are as large as the perspective makes them: draw cars of one size
        box = np.quantile(np.sqrt(tracks.length * tracks.width), DRAWN_QUANTILE)
        length = np.full(tracks.ids.size, float(box))
        tracks = replace(tracks, length=length, width=length / CAR_SHAPE)
    kept = tracks.part(np.arange(tracks.ids.size), slice(None, None, stride))
    ghosts, notes, branch = None, [], branch_of(entry)
    if branch is not None:
        said = f"what if driver {branch['agent']} had changed at {branch['at_s']} s"
        notes.append(f"{said}: {change_of(entry)}; dashed outlines: where everyone factually was")
        ghosts = find_ghosts(dataset.read(factual_of(dataset, entry)).tracks, kept)
    notes += _notes(episode, road, unit, stride)
    return ReplayScene(
        entry=entry, unit=unit, road=road, tracks=kept,
        agents={spec.id: spec for spec in episode.agents}, shown_traits=shown_traits,
        beliefs=believed, believer=believer, graph=graph, futures=futures,
        predictor="" if futures is None else predictor, notes=tuple(notes), ghosts=ghosts,
    )  # fmt: skip


def _without_parked(tracks: Tracks, events: Sequence[Event]) -> tuple[Event, ...]:
    """The events but for near misses with a parked vehicle: passing it closely is no conflict."""
    parked = set()
    for row, agent in enumerate(tracks.ids.tolist()):
        places = tracks.row_xy[tracks.index.rows(row)]
        if len(places) and np.ptp(places, axis=0).max() < PARKED_M:
            parked.add(agent)
    near = EventKind.NEAR_MISS
    return tuple(e for e in events if e.kind is not near or not parked & {e.agent, e.other})


def _notes(episode: Episode, road: Road | None, unit: str, stride: int) -> list[str]:
    """Notes on the data for a reader."""
    known = episode.entry.options.get("notes")
    notes = [str(note) for note in known] if isinstance(known, list) else []
    if road is None:
        notes.append("no road is known: faint lines show where everyone went")
    if unit == "px":
        notes.append(
            "positions are pixels of an image, and all vehicles are drawn in one size: the shipped "
            "classifier and predictors were made for metres, so what they say here is a guess"
        )
    if episode.entry.options.get("pixels_per_m"):
        notes.append(f"seen in pixels: by sizes and speeds {image_scale(episode.tracks)}")
    if episode.tracks.behavior is None:
        notes.append("nobody's true behaviour is known in this data")
    shown_s = stride * episode.tracks.step_s
    if shown_s > 1.5 * SHOWN_EVERY_S:
        notes.append(f"places every {shown_s:.2g} s are kept, to keep the page small")
    return notes


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


def _no_beliefs(tracks: Tracks, steps: IntArray) -> Beliefs:
    """No beliefs at some frames, to be filled."""
    shape = tracks.ids.size, steps.size, len(BEHAVIORS)
    return Beliefs(tracks.ids, tracks.time_s[steps], np.full(shape, np.nan, dtype=np.float32))


def _believed(tracks: Tracks, model: Model, is_scene: bool, traffic: Traffic) -> Beliefs:
    """The beliefs of a `graphrqi.stream.BehaviorStream` about an episode, every half a second.

    Where the frames show no plausible scene, every behaviour is as likely.
    """
    steps = kept_steps(tracks)
    found = _no_beliefs(tracks, steps)
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
    strangers = table["agent"][~table["agent"].isin(tracks.ids)]
    if len(strangers):
        raise InputError(
            f"{path}: found agent {strangers.iloc[0]}, expected one of {episode}'s "
            f"{tracks.ids.size}"
        )
    found = _no_beliefs(tracks, kept_steps(tracks))
    row, time_s = np.searchsorted(tracks.ids, table["agent"]), table["time_s"].to_numpy()
    column = np.clip(np.searchsorted(found.time_s, time_s - 1e-4), 0, found.time_s.size - 1)
    here = np.abs(found.time_s[column] - time_s) < 1e-3
    found.probability[row[here], column[here]] = table[CHANCES].to_numpy(np.float32)[here]
    return found


def _predicted(
    tracks: Tracks, believed: Beliefs, road: Road | None, predictor: str
) -> Futures | None:
    """Predict every agent throughout an episode: every second, or less often if there are many.

    Each prediction by this key of ``PREDICTORS`` sees the past alone.
    """
    parts = []
    seconds = sampled(tracks, PREDICT_EVERY_S)
    stride = -(-int(tracks.index.counts()[seconds].sum()) // MAX_PREDICTED)
    for step in seconds[1 :: max(stride, 1)]:
        history = tracks.window(int(step) + 1, HISTORY_STEPS)
        if not history.ids.size:
            continue
        now_s = float(tracks.time_s[step])
        found = predict(history, believed.at(now_s), road, HORIZON_S, predictor)
        likely = np.minimum(LEAST_PROBABILITY, found.probability.max(axis=1, keepdims=True))
        agent, mode = np.nonzero(found.probability >= likely)
        order = np.lexsort((-found.probability[agent, mode], agent))
        agent, mode = agent[order], mode[order]
        ahead = np.arange(1, round(found.time_s[-1] / SAMPLE_S) + 1) * SAMPLE_S
        at = np.minimum(np.searchsorted(found.time_s, ahead - 1e-6), found.time_s.size - 1)
        parts.append((
            found.time_s[at], np.full(agent.size, now_s),
            np.searchsorted(tracks.ids, found.ids)[agent], found.probability[agent, mode],
            found.xy[agent, mode][:, at],
        ))  # fmt: skip
    if not parts:
        return None
    ahead_s, *columns = zip(*parts, strict=True)
    return Futures(ahead_s[0], *map(np.concatenate, columns))


def graph_history(tracks: Tracks) -> GraphHistory:
    """Follow the paper's accumulated 4-nearest-neighbour graph through an episode."""
    steps, index, many = kept_steps(tracks), tracks.index, tracks.ids.size
    sample_of = {step: sample for sample, step in enumerate(steps.tolist())}
    w = np.full((many, steps.size), np.nan)
    graph = TrafficGraph.empty(neighbors=NEIGHBORS, reset=RESET, kind="accumulated")
    previous = None
    since: dict[int, int] = {}
    edges: list[tuple[int, int, int, int]] = []
    for step in range(tracks.time_s.size):
        at = index.at(step)
        rows = index.agent[at]
        graph = graph.observe(tracks.ids[rows], tracks.row_xy[at])
        sample = sample_of.get(step)
        if sample is None:
            continue
        pairs = np.sort(np.searchsorted(tracks.ids, graph.edges), axis=1)
        keys = (pairs[:, 0] * many + pairs[:, 1]).tolist()
        edges += [(*divmod(key, many), since.pop(key), sample) for key in since.keys() - {*keys}]
        since = dict.fromkeys(keys, sample) | since
        if rows.size:
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
    rows, both = find_sorted(shown.ids, there.ids)
    apart = there.xy - shown.xy[rows]  # NaN where one of the two is not there
    near = both[:, None] & (np.hypot(apart[..., 0], apart[..., 1]) <= APART_M)
    differs = there.valid & ~near
    some = np.flatnonzero(differs.any(axis=1))
    return there.with_dense(valid=differs).part(some, slice(None))
