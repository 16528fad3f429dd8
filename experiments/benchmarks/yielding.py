"""Will a driver let the pedestrian go first? The paper's pedestrian figure, as numbers.

An encounter is a driver about to reach an occupied crossing without a red light. Two questions are
scored.

- Does it let the pedestrian go first? Encounters are scored where the episode's events
  (`sim.episode.incidents`) say whether the driver yielded. Beliefs about who drives how give the
  chance that the behaviours' profiles state; predictors give it with their futures.
- Has it not entered the crossing `DECIDED_S` later? Scored for every encounter: some drivers are
  held by others, and some find the crossing free again when they get there. A predictor's chance is
  the share of its futures that have not entered.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from experiments.benchmarks.statistics import auc, prediction_keys
from experiments.score.metrics import RESAMPLES
from experiments.score.predictions import HISTORY_S, future
from experiments.score.rows import Row, tidy_row
from graphrqi.posterior import Posterior
from graphrqi.predict import chosen_predictor
from graphrqi.predict.prediction import STEP_S, Prediction
from graphrqi.predict.rollout.driver_table import YIELDS
from graphrqi.predict.scene.scene import LEARNED_S, Scene, make_scene
from graphrqi.predict.scene.stop_constraints import PROCEED
from sim.frames import EventKind, FloatArray, IntArray, Tracks
from sim.road import Road

BEFORE_S: Final = (1.5, 2.5)
"""An encounter is judged when the crossing is between these times away, s: two seconds."""

DECIDED_S: Final = 3.5
"""A driver that has not entered the crossing after this time waited, s (1.5 s later than at its
speed)."""

LEAST_SPEED_MPS: Final = 2.0
"""Slower drivers are left out: they have already decided to stop."""

ENTERED_M: Final = 1.0
"""A driver this far into the crossing has entered it."""

SAME_PLACE_M: Final = 3.0
"""An event counts as that of an encounter if it happens within this of where the crossing was, m
(less than lies between two crossings)."""

BELIEFS: Final = "beliefs"
"""Stands among the names of predictors for the beliefs alone."""

EVERY_S: Final = 0.5
"""Encounters are searched at this interval, s."""

VAGUE_M: Final = 1.5
"""Spread assumed for predictors that give none, m."""


def _approaching(scene: Scene) -> tuple[IntArray, FloatArray]:
    """Rows of the drivers about two seconds before an occupied crossing, and the way left, m."""
    graph, paths = scene.graph, scene.paths
    zones = graph.cross_lane.size
    row, room = [], []
    soon = scene.stop_state[:, : round(BEFORE_S[1] / STEP_S) + 1]
    shut = (soon != PROCEED).any(axis=1)
    for i in np.flatnonzero(scene.on_path & (scene.speed > LEAST_SPEED_MPS)):
        q = scene.path[i]
        front = scene.s[i] + scene.history.length[i] / 2
        for j, lane in enumerate(paths.lane[q]):
            if lane < 0:
                break
            for z in np.flatnonzero(graph.cross_lane == lane):
                left = float(paths.start[q, j] + graph.cross_s[z] - front)
                timely = BEFORE_S[0] <= left / scene.speed[i] <= BEFORE_S[1]
                gates = (paths.stop_row[q] < paths.groups) & (
                    paths.stop_x[q] <= paths.start[q, j] + graph.cross_s[z] + 1e-6
                )
                red = shut[paths.stop_row[q][gates & (paths.stop_x[q] > front)]].any()
                if timely and shut[paths.groups + z] and not red:
                    row.append(i)
                    room.append(left)
    if zones == 0 or not row:
        return np.empty(0, np.int64), np.empty(0)
    first = np.unique(np.array(row), return_index=True)[1]
    return np.array(row, dtype=np.int64)[first], np.array(room)[first]


def travelled(xy: FloatArray, start: FloatArray) -> FloatArray:
    """(...,) length of the path from start (..., 2) through places (..., H, 2), m."""
    steps = np.diff(np.concatenate([start[..., None, :], xy], axis=-2), axis=-2)
    return np.asarray(np.hypot(steps[..., 0], steps[..., 1]).sum(axis=-1))


def _wait_chance(
    prediction: Prediction, scene: Scene, row: IntArray, room: FloatArray
) -> FloatArray:
    """(m,) predicted chance that each driver has not entered the crossing at `DECIDED_S`."""
    from scipy.special import ndtr

    last = int(np.searchsorted(prediction.time_s, DECIDED_S - 1e-6)) + 1
    xy = prediction.xy[row, :, :last]
    gone = travelled(xy, np.repeat(scene.xy[row][:, None], xy.shape[1], axis=1))
    spread = (
        np.full(gone.shape, VAGUE_M)
        if prediction.spread is None
        else prediction.spread[row, :, last - 1]
    )
    not_entered = ndtr((room[:, None] + ENTERED_M - gone) / spread)
    return np.asarray((prediction.probability[row] * not_entered).sum(axis=1))


Encounters = tuple[IntArray, FloatArray, FloatArray, FloatArray]
"""Drivers before occupied crossings at one instant: (m,) rows of the scene, and the distance from
the front bumper to the crossing, m. Also returned: whether the driver yielded (NaN where unknown),
and whether it has not entered the crossing `DECIDED_S` later."""


def encounters(
    tracks: Tracks, road: Road, posteriors: Mapping[int, Posterior]
) -> Iterator[tuple[Scene, Posterior, Encounters]]:
    """Every first encounter of a driver in an episode, at the instants of the posteriors."""
    met: set[int] = set()
    ahead = np.arange(1, round(DECIDED_S / 0.5) + 1, dtype=np.float64) * 0.5
    for stop, posterior in posteriors.items():
        history = tracks.window(stop, round(HISTORY_S / tracks.step_s))
        if not history.ids.size:
            continue
        scene = make_scene(history, road, LEARNED_S)
        row, room = _approaching(scene)
        rows = np.searchsorted(tracks.ids, history.ids[row])
        truth = future(tracks, rows, stop, ahead)
        new = np.array([int(i) not in met for i in history.ids[row]], dtype=bool) & np.isfinite(
            truth
        ).all(axis=(1, 2))
        if not new.any():
            continue
        row, room, truth = row[new], room[new], truth[new]
        met |= {int(i) for i in history.ids[row]}
        gone = travelled(truth, scene.xy[row])
        waited = (gone < room + ENTERED_M).astype(np.float64)
        yielded = outcome(tracks, stop - 1, np.searchsorted(tracks.ids, history.ids[row]), room)
        yield scene, posterior, (row, room, yielded, waited)


def outcome(tracks: Tracks, column: int, rows: IntArray, room: FloatArray) -> FloatArray:
    """(m,) 1 if a driver went on to yield, 0 if not, by the episode's events; NaN without one."""
    found = np.full(len(rows), np.nan)
    now_s = float(tracks.time_s[column])
    for k, row in enumerate(rows):
        events = [
            e for e in tracks.events
            if e.kind in (EventKind.YIELDED, EventKind.NOT_YIELDED)
            and e.agent == tracks.ids[row] and e.time_s > now_s
        ]  # fmt: skip
        if not events:
            continue
        first = min(events, key=lambda event: event.time_s)
        until = int(np.searchsorted(tracks.time_s, first.time_s - 1e-6))
        way = tracks.xy[row, column : until + 1]
        if abs(travelled(way[1:], way[0]) - room[k]) <= SAME_PLACE_M:
            found[k] = first.kind == EventKind.YIELDED
    return found


@dataclass(frozen=True, slots=True)
class EncounterChances:
    """Predicted probabilities of the encounters of an episode.

    Attributes:
        chance: (m,) chance of not having entered by predictor, and of yielding by `BELIEFS`.
        yielded: (m,) as in `Encounters`.
        waited: (m,) as in `Encounters`.
    """

    chance: Mapping[str, FloatArray]
    yielded: FloatArray
    waited: FloatArray


NO_ENCOUNTERS: Final = EncounterChances({}, np.empty(0), np.empty(0))
"""Result of an episode without encounters."""


def encounter_chances(
    tracks: Tracks, road: Road, posteriors: Mapping[int, Posterior], predictors: Sequence[str]
) -> EncounterChances:
    """Predicted probabilities of every encounter of an episode."""
    functions = {name: chosen_predictor(name) for name in predictors}
    chance: dict[str, list[FloatArray]] = {name: [] for name in (*predictors, BELIEFS)}
    yielded: list[FloatArray] = []
    waited: list[FloatArray] = []
    for scene, posterior, (row, room, let_go, stayed) in encounters(tracks, road, posteriors):
        yielded.append(let_go)
        waited.append(stayed)
        chance[BELIEFS].append(posterior.of(scene.ids[row]) @ YIELDS)
        for name, function in functions.items():
            chance[name].append(_wait_chance(function(scene, posterior), scene, row, room))
    if not waited:
        return NO_ENCOUNTERS
    return EncounterChances(
        {n: np.concatenate(c) for n, c in chance.items()},
        np.concatenate(yielded),
        np.concatenate(waited),
    )


def score_chances(episodes: Sequence[EncounterChances], scenario: str, split: str) -> list[Row]:
    """AUC and Brier score of each predictor's chances, with intervals over encounters."""
    episodes = [e for e in episodes if e.waited.size]
    rows: list[Row] = []
    for question, answers in (
        ("yield", [e.yielded for e in episodes]),
        ("wait", [e.waited for e in episodes]),
    ):
        happened = np.concatenate([np.empty(0), *answers])
        scored = ~np.isnan(happened)
        happened, n = happened[scored], int(scored.sum())
        if len(np.unique(happened)) < 2:
            continue
        draws = np.random.default_rng(0).integers(0, n, (RESAMPLES // 4, n))
        for name in episodes[0].chance:
            chance = np.concatenate([e.chance[name] for e in episodes])[scored]
            missed = (chance - happened) ** 2
            keys = prediction_keys(scenario, name, DECIDED_S, split)
            for metric, value, drawn in (
                ("auc", auc(chance, happened > 0), auc(chance[draws], happened[draws] > 0)),
                ("brier", missed.mean(), missed[draws].mean(axis=1)),
            ):
                low, high = np.nanquantile(drawn, [0.025, 0.975])
                rows.append(tidy_row(keys, f"{question}_{metric}", float(value), low, high, n))
    return rows
