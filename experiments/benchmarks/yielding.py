"""Will a driver let the pedestrian go first? The paper's pedestrian figure, as a number.

An encounter is a driver about to reach an occupied crossing without a red light. It is scored where
the episode's events (`sim.episode.incidents`) say whether the driver yielded. The behaviours'
profiles state how often each yields, so beliefs about the driver give a chance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from experiments.score.metrics import RESAMPLES, RESAMPLING_SEED
from experiments.score.predictions import HISTORY_S
from experiments.score.rows import Cell, Row, tidy_row
from graphrqi.posterior import Posterior
from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.rollout.driver_table import YIELDS
from graphrqi.predict.scene.scene import LEARNED_S, Scene, make_scene
from graphrqi.predict.scene.stop_constraints import PROCEED
from sim.frames import EventKind, FloatArray, IntArray, Tracks
from sim.road import Road

BEFORE_S: Final = (1.5, 2.5)
"""An encounter is judged when the crossing is between these times away, s: two seconds."""

LEAST_SPEED_MPS: Final = 2.0
"""Slower drivers are left out: they have already decided to stop."""

SAME_PLACE_M: Final = 3.0
"""An event counts as that of an encounter if it happens within this of where the crossing was, m
(less than lies between two crossings)."""

EVERY_S: Final = 0.5
"""Encounters are searched at this interval, s."""


def yield_chances(tracks: Tracks, road: Road, posteriors: Mapping[int, Posterior]) -> FloatArray:
    """Believed chances of yielding in every first encounter of a driver in an episode.

    Args:
        tracks: the episode.
        road: where it happened.
        posteriors: beliefs about the drivers, by index of the frame after which they are held.

    Returns:
        (m, 2) the chance of yielding, and 1 if the driver went on to yield or 0 if not.
    """
    met: set[int] = set()
    found = [np.empty((0, 2))]
    for stop, posterior in posteriors.items():
        history = tracks.window(stop, round(HISTORY_S / tracks.step_s))
        if not history.ids.size:
            continue
        scene = make_scene(history, road, LEARNED_S)
        row, room = _approaching(scene)
        new = ~np.isin(history.ids[row], list(met))
        row, room = row[new], room[new]
        met.update(history.ids[row].tolist())
        yielded = _outcome(tracks, stop - 1, np.searchsorted(tracks.ids, history.ids[row]), room)
        chance = posterior.of(scene.ids[row]) @ YIELDS
        found.append(np.stack([chance, yielded], axis=1)[np.isfinite(yielded)])
    return np.concatenate(found)


def auc_row(episodes: Sequence[FloatArray], keys: Mapping[str, Cell]) -> list[Row]:
    """The area under the ROC curve of `yield_chances`, with an interval over encounters.

    Args:
        episodes: the chances of each episode.
        keys: what was measured, for the row.

    Returns:
        A row ``yield_auc``; none unless some drivers yielded and some did not.
    """
    from sklearn.metrics import roc_auc_score

    chance, happened = np.concatenate(episodes).T
    if np.unique(happened).size < 2:
        return []
    rng = np.random.default_rng(RESAMPLING_SEED)
    draws = rng.integers(0, happened.size, (RESAMPLES // 4, happened.size))
    areas = [roc_auc_score(happened[i], chance[i]) for i in draws if np.ptp(happened[i])]
    low, high = np.quantile(areas, [0.025, 0.975])
    value = float(roc_auc_score(happened, chance))
    return [tidy_row(keys, "yield_auc", value, low, high, happened.size)]


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


def _outcome(tracks: Tracks, column: int, rows: IntArray, room: FloatArray) -> FloatArray:
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
        way = np.diff(tracks.xy[row, column : until + 1], axis=0)
        if abs(np.hypot(*way.T).sum() - room[k]) <= SAME_PLACE_M:
            found[k] = first.kind == EventKind.YIELDED
    return found
