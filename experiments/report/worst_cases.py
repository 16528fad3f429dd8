"""Where a run was most wrong: pictures and replays of unseen episodes, with links to moments."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from heapq import nlargest
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlencode

import numpy as np
import pandas as pd

from behaviors.labels import BEHAVIORS
from experiments.data.parallel import in_parallel
from experiments.replay.page import write_page
from experiments.replay.pictures import Drawing
from experiments.replay.scene import ReplayScene, gather
from experiments.report.pictures import Picture
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry

EPISODES: Final = 4
"""Unseen episodes of each scenario that are looked at."""

CASES: Final = 3
"""Worst cases of each sort that are shown for each scenario."""

DRAWN: Final = {"predicted": "predicted behaviours and paths", "w": "traffic graph"}
"""The pictures of a scenario, by the mode of `Drawing`."""


Case = tuple[float, str, str]
"""An agent about which the run was wrong: how badly, in words, and a link relative to the report.

The badness is the probability given to the wrong behaviour, or metres."""


def take_excerpts(
    folder: Path, jobs: int | None = None, quiet: bool = True
) -> Iterator[dict[str, Any]]:
    """Look at a run's unseen episodes, of each scenario that has some, and write their replays.

    The run's folder holds ``data`` and ``model``; replays go into ``replays`` in it.

    Yields:
        The name of each ``scenario``, ``pictures`` of the fullest moment of an episode, the
        ``href`` of its replay, and the worst ``cases``.
    """
    dataset = open_dataset(folder / "data")
    (folder / "replays").mkdir(exist_ok=True)
    for name in dataset.scenarios:
        entries = dataset.episodes("test", name)[:EPISODES]
        arguments = [(folder, entry, place == 0) for place, entry in enumerate(entries)]
        what = f"looking at unseen episodes of {name}"
        parts = list(in_parallel(_looked_at, arguments, jobs, what, quiet))
        if parts:
            answers = nlargest(CASES, itertools.chain(*(part[2] for part in parts)))
            predictions = nlargest(CASES, itertools.chain(*(part[3] for part in parts)))
            pictures, href, *_ = parts[0]
            cases = answers + predictions
            yield {"scenario": name, "pictures": pictures, "href": href, "cases": cases}


def _looked_at(
    folder: Path, entry: EpisodeEntry, draw: bool
) -> tuple[list[Picture], str, list[Case], list[Case]]:
    """Pictures of an episode if asked for, the link to its fullest moment, and all cases in it.

    Cases are wrong answers, and wrong predictions.
    """
    scene = gather(open_dataset(folder / "data"), entry, model=str(folder / "model"))
    page, moment = f"replays/{entry.id}.html", scene.fullest_s
    write_page(scene, folder / page, "predicted")
    pictures = [
        Picture(f"{entry.scenario} at {moment:.0f} s, {words}", Drawing(scene, mode).draw(moment))
        for mode, words in DRAWN.items()
        if draw
    ]
    wrong = list(_wrong_answers(scene, page)), list(_wrong_predictions(scene, page))
    return pictures, _link(page, moment), *wrong


def _link(page: str, time_s: float, agent: str = "") -> str:
    query = {"t": f"{time_s:.1f}", "mode": "predicted"} | ({"agent": agent} if agent else {})
    return f"{page}#{urlencode(query)}"


def _wrong_answers(scene: ReplayScene, page: str) -> Iterator[Case]:
    """Drivers whose last belief is wrong."""
    truth = scene.tracks.behavior
    for row, believed in enumerate(scene.beliefs.probability):
        samples = np.flatnonzero(np.isfinite(believed).all(axis=1))
        if truth is None or truth[row] < 0 or not samples.size:
            continue
        last = believed[samples[-1]]
        code = int(last.argmax())
        if code != truth[row]:
            surest = int(samples[believed[samples, code].argmax()])
            name = scene.tracks.names[row]
            text = (
                f"driver {name} is {scene.tracks.classes[truth[row]]}, "
                f"taken for {BEHAVIORS[code]} with {100 * last[code]:.0f} % at last"
            )
            yield float(last[code]), text, _link(page, float(scene.beliefs.time_s[surest]), name)


def _wrong_predictions(scene: ReplayScene, page: str) -> Iterator[Case]:
    """How far each agent was at most from the end of its likeliest future."""
    tracks, futures = scene.tracks, scene.futures
    if futures is None:
        return
    best = futures.likeliest
    end_s = futures.time_s[best] + futures.ahead_s[-1]
    step = np.searchsorted(tracks.time_s, end_s - 1e-3)
    best, step = best[step < tracks.time_s.size], step[step < tracks.time_s.size]
    missed = futures.xy[best, -1] - tracks.positions(futures.agent[best], step)
    table = pd.DataFrame({
        "agent": futures.agent[best], "time_s": futures.time_s[best],
        "error": np.hypot(missed[:, 0], missed[:, 1]),
    }).dropna()  # fmt: skip
    worst = table.loc[table.groupby("agent")["error"].idxmax()]
    for agent, time_s, error in worst.itertuples(index=False):
        name = tracks.names[agent]
        text = f"agent {name}, predicted at {time_s:.1f} s, ended {error:.1f} {scene.unit} away"
        yield error, text, _link(page, time_s, name)
