"""Will a driver let the pedestrian go first? The paper's pedestrian figure, as a number.

An encounter is a driver about to reach an occupied crossing without a red light. It is scored where
the episode's events (`sim.episode.incidents`) say whether the driver yielded. The behaviours'
profiles state how often each yields, so beliefs about the driver give a chance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from sklearn.metrics import roc_auc_score

from experiments.score.metrics import RESAMPLES, RESAMPLING_SEED
from experiments.score.predictions import HISTORY_S
from experiments.score.rows import Cell, Row, tidy_row
from graphrqi.posterior import Posterior
from graphrqi.predict.prediction import STEP_S
from graphrqi.predict.rollout.driver_table import YIELDS
from graphrqi.predict.scene.scene import LEARNED_S, Scene, make_scene
from graphrqi.predict.scene.stop_constraints import PROCEED
from sim.frames import EventKind, FloatArray, Tracks
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
    """(m, 2) believed chance of yielding in every first encounter of a driver, and what happened.

    Beliefs about the drivers are given by index of the frame after which they are held. What
    happened is 1 if the driver went on to yield, and 0 if not.
    """
    met: set[int] = set()
    found = []
    for stop, posterior in posteriors.items():
        history = tracks.window(stop, round(HISTORY_S / tracks.step_s))
        if not history.ids.size:
            continue
        scene = make_scene(history, road, LEARNED_S)
        for row, left_m in _approaching(scene).items():
            agent = int(history.ids[row])
            if agent in met:
                continue
            met.add(agent)
            yielded = _outcome(tracks, stop - 1, agent, left_m)
            if yielded is not None:
                chance = float(posterior.of(scene.ids[[row]])[0] @ YIELDS)
                found.append((chance, yielded))
    return np.array(found, dtype=np.float64).reshape(-1, 2)


def auc_row(episodes: Sequence[FloatArray], keys: Mapping[str, Cell]) -> list[Row]:
    """The area under the ROC curve of `yield_chances`, with an interval over encounters.

    There is no row ``yield_auc`` unless some drivers yielded and some did not.
    """
    chance, happened = np.concatenate(episodes).T
    if np.unique(happened).size < 2:
        return []
    rng = np.random.default_rng(RESAMPLING_SEED)
    draws = rng.integers(0, happened.size, (RESAMPLES // 4, happened.size))
    areas = [roc_auc_score(happened[i], chance[i]) for i in draws if np.ptp(happened[i])]
    low, high = np.quantile(areas, [0.025, 0.975])
    value = float(roc_auc_score(happened, chance))
    return [tidy_row(keys, "yield_auc", value, low, high, happened.size)]


def _approaching(scene: Scene) -> dict[int, float]:
    """The way left, m, of each row whose driver is two seconds before an occupied crossing."""
    graph, paths = scene.graph, scene.paths
    found: dict[int, float] = {}
    soon = scene.stop_state[:, : round(BEFORE_S[1] / STEP_S) + 1]
    shut = (soon != PROCEED).any(axis=1)
    for i in np.flatnonzero(scene.on_path & (scene.speed > LEAST_SPEED_MPS)):
        q = scene.path[i]
        front = scene.s[i] + scene.history.length[i] / 2
        for j, lane in enumerate(paths.lane[q]):
            if lane < 0:
                break
            for z in np.flatnonzero(graph.cross_lane == lane):
                at = paths.start[q, j] + graph.cross_s[z]
                left = float(at - front)
                timely = BEFORE_S[0] <= left / scene.speed[i] <= BEFORE_S[1]
                gates = (paths.stop_row[q] < paths.groups) & (paths.stop_x[q] <= at + 1e-6)
                red = shut[paths.stop_row[q][gates & (paths.stop_x[q] > front)]].any()
                if timely and shut[paths.groups + z] and not red:
                    found.setdefault(int(i), left)
    return found


def _outcome(tracks: Tracks, column: int, agent: int, left_m: float) -> bool | None:
    """Whether a driver went on to yield, by the episode's events; None without one there."""
    events = [
        e for e in tracks.events
        if e.kind in (EventKind.YIELDED, EventKind.NOT_YIELDED)
        and e.agent == agent and e.time_s > float(tracks.time_s[column])
    ]  # fmt: skip
    if not events:
        return None
    first = min(events, key=lambda event: event.time_s)
    until = int(np.searchsorted(tracks.time_s, first.time_s - 1e-6))
    row = int(np.searchsorted(tracks.ids, agent))
    way = np.diff(tracks.xy[row, column : until + 1], axis=0)
    near = abs(np.hypot(*way.T).sum() - left_m) <= SAME_PLACE_M
    return first.kind is EventKind.YIELDED if near else None
