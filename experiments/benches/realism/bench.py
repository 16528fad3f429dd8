"""Does simulated traffic look like the recorded traffic that it starts from?

From instants of recordings, all vehicles are driven on by several simulators. First, the
likelihood of what really happened is measured as in sim-agents challenges (`likelihood`). Second,
distributions of what drivers do are compared (`distances`). ``recorded`` stands for a simulator
that repeats what happened.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby, islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError, lookup
from experiments.benches.contract import Bench, option
from experiments.benches.realism.distances import (
    QUANTITIES,
    distances,
    lane_changes,
    pooled,
    samples,
)
from experiments.benches.realism.likelihood import (
    FEATURES,
    RoadEdge,
    features,
    kinematics,
    likelihoods,
    road_edge,
)
from experiments.benches.realism.simulators import SIMULATORS, simulate
from experiments.benches.realism.start import Start, starts
from experiments.score.metrics import bootstrap, ratio
from experiments.score.rows import Cell, Row, tidy_row
from experiments.training.recordings import OTHER, RecordedPlace, read_sources
from scenarios import get_scenario
from sim.engines import get_engine
from sim.episode.observables import observe
from sim.episode.rows import TrajectoryRows
from sim.frames import PEDESTRIAN, Tracks
from sim.road import Road
from sim.scenario import sample_agents

FloatArray = NDArray[np.float64]

SIMULATED: Final = "straight_road"
"""The road that is simulated where no recordings are given."""

DISTRIBUTED: Final = 4
"""So many of the futures are compared with the distributions recorded (more of them say the
same)."""


@dataclass(frozen=True, slots=True)
class Settings:
    """From which instants traffic is simulated, by what, and how often.

    Attributes:
        data: folder of datasets of recordings; None for a minute of a simulated road.
        simulators: names.
        futures: simulated from each instant.
        seconds: their length, s.
        every_s: time between instants of a recording, s.
        instants: most instants of a dataset.
        seed: of everything random.
    """

    data: Path | None = option(None, "Recordings with maps; none for a simulated road.", "FOLDER")
    simulators: tuple[str, ...] = option(SIMULATORS, "Who drives.")
    futures: int = option(32, "Futures of each instant.")
    seconds: float = option(8.0, "Length of each future, s.")
    every_s: float = option(8.0, "Time between instants of a recording, s.")
    instants: int = option(40, "Most instants of a dataset.")
    seed: int = option(0, "Same seed, same rows.")


@dataclass
class _Found:
    """What one simulator did in one dataset.

    Attributes:
        scores: likelihoods of each instant.
        samples: of the distributions, of each instant.
    """

    scores: list[dict[str, float]] = field(default_factory=list)
    samples: list[dict[str, FloatArray]] = field(default_factory=list)


def measure(settings: Settings) -> Iterator[list[Row]]:
    """The rows of each dataset.

    Yields:
        For every simulator: ``likelihood`` of each feature and ``meta``, means over instants with
        intervals; and for every quantity the distances ``wasserstein`` and ``kolmogorov``, and the
        ``mean`` of it. Rows of lane changes and of gaps accepted stand where there were any.

    Raises:
        InputError: if there is no recording with a map and a future long enough, a simulator is
            not known, or a number is out of range.
    """
    for name in settings.simulators:
        lookup(dict.fromkeys(SIMULATORS), name, "simulator")
    if settings.futures < 1 or settings.instants < 1 or not 0.5 <= settings.seconds <= 30.0:
        raise InputError(
            f"futures, instants, seconds: found {settings.futures}, {settings.instants}, "
            f"{settings.seconds:g}, expected 1 or more futures and instants of 0.5 to 30 s"
        )
    if not settings.every_s > 0.0:
        raise InputError(f"every_s: found {settings.every_s:g}, expected seconds > 0")
    places = _simulated() if settings.data is None else read_sources([settings.data])
    played = False
    for dataset, some in groupby(places, key=lambda place: place.dataset):
        known = {name: _Found() for name in settings.simulators}
        instants = (
            start for place in some for start in starts(place, settings.seconds, settings.every_s)
        )
        road: Road | None = None
        for start in islice(instants, settings.instants):
            if start.scene.road is not road:
                road = start.scene.road
                edge = road_edge(road)
            for name, found in known.items():
                score, sampled = play(name, start, edge, settings.futures, settings.seed)
                found.scores.append(score)
                found.samples.append(sampled)
            played = True
        if next(iter(known.values())).scores:
            yield list(_rows(dataset, known))
    if not played:
        raise InputError(
            f"{settings.data}: found no recording with a map that goes on for "
            f"{settings.seconds:g} s, expected one"
        )


def _simulated() -> Iterator[RecordedPlace]:
    """A minute of a simulated road in place of a recording."""
    scenario = get_scenario(SIMULATED)(duration_s=60.0, flow="dense")
    frames = list(get_engine("sumo")(scenario, sample_agents(scenario, 0), 0))
    tracks = Tracks.from_frames(frames[200:])  # nobody is there at first
    yield RecordedPlace("simulated", OTHER, "simulated", SIMULATED, tracks, scenario.road)


def play(
    name: str, start: Start, edge: RoadEdge, futures: int, seed: int
) -> tuple[dict[str, float], dict[str, FloatArray]]:
    """Simulate one instant.

    Returns:
        The likelihoods, and samples of the distributions of `DISTRIBUTED` futures, with the
        kilometres driven as ``km`` and the number of lane changes as ``changes``.
    """
    valid = start.recorded.valid[:, start.past :]
    real = features(start.recorded, kinematics(start.recorded), edge)
    each: list[dict[str, FloatArray]] = []
    sampled: list[dict[str, FloatArray]] = []
    for k, motion in enumerate(simulate(name, start, futures, seed)):
        moved = kinematics(motion)
        each.append(features(motion, moved, edge))
        if k < DISTRIBUTED:
            sampled.append(samples(motion, moved, valid, start.scored))
    simulated = {q: np.stack([one[q] for one in each]) for q in real}
    told = {q: pooled(sampled, q) for q in sampled[0]}
    count, gaps = _changes_recorded(start) if name == "recorded" else (0, np.empty(0))
    told["gap_accepted_s"], told["changes"] = gaps, np.array([float(count)])
    told["km"] = np.array([told["speed_mps"].sum() * start.tracks.step_s / 1000.0 / len(sampled)])
    return likelihoods(real, simulated, valid, start.scored), told


def _changes_recorded(start: Start) -> tuple[int, FloatArray]:
    """Lane changes of the vehicles that are scored, and the gaps that they left behind them."""
    when = slice(start.stop - 1, start.stop + start.ahead)
    tracks = start.tracks.part(start.rows, when)
    rows = TrajectoryRows.of(tracks)
    seen = observe(rows, start.scene.road)
    at = rows.row_index.agent, rows.row_index.step
    lane, s = np.full(tracks.valid.shape, -1), np.zeros(tracks.valid.shape)
    lane[at] = np.where(seen.on_road & (tracks.kind[at[0]] != PEDESTRIAN), seen.lane, -1)
    s[at] = seen.s
    speed = np.where(tracks.valid, tracks.speed, 0.0)
    return lane_changes(lane, s, speed, tracks.length, start.scene.paths.beside)


def _rows(dataset: str, known: dict[str, _Found]) -> Iterator[Row]:
    """Rows of one dataset."""
    truth = known.get("recorded")
    for name, found in known.items():
        keys: dict[str, Cell] = {"dataset": dataset, "simulator": name, "quantity": ""}
        for what in (*FEATURES, "meta"):
            values = np.array([one.get(what, np.nan) for one in found.scores])
            values = values[~np.isnan(values)]
            if values.size:
                mean = bootstrap(ratio, np.column_stack([values, np.ones(values.size)]))
                metric = what if what == "meta" else "likelihood"
                quantity = "" if what == "meta" else what
                yield tidy_row({**keys, "quantity": quantity}, metric, *mean, values.size)
        km = float(pooled(found.samples, "km").sum())
        changes = float(pooled(found.samples, "changes").sum())
        for quantity in QUANTITIES:
            of = {**keys, "quantity": quantity}
            if quantity == "lane_changes_per_km":
                yield tidy_row(of, "mean", changes / max(km, 1e-9), None, None, int(changes))
                continue
            mine = pooled(found.samples, quantity)
            if not mine.size:
                continue
            yield tidy_row(of, "mean", float(mine.mean()), None, None, mine.size)
            if truth is not None and name != "recorded":
                apart = distances(pooled(truth.samples, quantity), mine)
                for metric, value in apart.items():
                    if not np.isnan(value):
                        yield tidy_row(of, metric, value, None, None, mine.size)


def lay_out(rows: Sequence[Any]) -> list[Row]:
    """A line for each dataset and simulator: the meta metric and the distances."""
    lines: dict[tuple[Cell, Cell], dict[str, Cell]] = {}
    for row in rows:
        keys = (row["dataset"], row["simulator"])
        line = lines.setdefault(keys, {"dataset": keys[0], "simulator": keys[1]})
        if row["metric"] == "meta":
            line["meta"] = row["value"]
        elif row["metric"] == "wasserstein":
            line[str(row["quantity"])] = row["value"]
    columns = dict.fromkeys(name for line in lines.values() for name in line)
    return [{name: line.get(name) for name in columns} for line in lines.values()]


BENCH: Final = Bench(
    name="realism",
    summary="Ask how likely recordings are under simulated futures, and compare distributions.",
    keys=("dataset", "simulator", "quantity"),
    full=Settings(),
    quick=Settings(futures=4, seconds=4.0, instants=1),
    measure=measure,
    table=lay_out,
)
