"""How quick and how right the eigenvalue algorithms are: the paper's runtime table, measured.

All solvers run interleaved, in one process and one thread, on the same sequences of traffic graphs,
each starting from its own last answer: vehicles at constant speed on a one-way road or on the arms
of a crossing.

Source of the table: Chandra et al., GraphRQI (ICRA 2020), which prints complexities, a speed-up
of 2 over the best rival, cubic convergence and storage O(d).
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any, Final, cast

import numpy as np
import pandas as pd
import scipy.linalg  # loaded here: only libraries that are loaded can be limited to a thread
from threadpoolctl import threadpool_limits

from behaviors.errors import lookup
from experiments.score.rows import Cell, Row, tidy_row
from graphrqi.graph import TrafficGraph
from graphrqi.spectrum import SOLVERS, Spectrum
from graphrqi.spectrum.contract import End, Pairs, Problem, Solver, eigensolver
from sim.frames import FloatArray

LAYOUTS: Final = ("road", "crossing")
"""Where the vehicles are."""

ENDS: Final[tuple[End, ...]] = ("largest", "smallest")

STEP_S, PAIRS, TOLERANCE = 0.1, 8, 1e-8
"""Time between observations, s; eigenpairs asked for, and their residual relative to max(1,
lambda_max)."""

DENSE: Final = (
    "graphrqi-paper", "graphrqi-exact", "eigh", "svd", "incremental-svd", "restart-svd",
    "lapack-dsyevr",
)  # fmt: skip
DENSE_UP_TO: Final = 1000
"""Solvers that need O(d^2) memory and O(d^3) time, and the largest graph that they are run on."""

STEP_BUDGET_S, SEQUENCE_BUDGET_S = 2.0, 10.0
"""CPU time of a step from which on a solver is not run on larger graphs, and what it gets for a
sequence, of which it always gets three steps."""

SLOPE_FROM: Final = 400
"""Smallest graph that counts for the slopes: below, fixed costs rule."""


def graph_sequence(
    layout: str, kind: str, d: int, steps: int, skip: int = 0, seed: int = 0
) -> Iterator[TrafficGraph]:
    """Traffic graphs of d vehicles every 0.1 s, four neighbours, reset at 100.

    A "road" is one way with three lanes, 20 m apart per lane on average, at 25 m/s. A "crossing"
    has four arms of three lanes, 12 m apart, and three in ten stand. The kind of graph is
    "instantaneous" or "accumulated". There are so many ``steps`` after those that are skipped.
    """
    graph = TrafficGraph.empty(neighbors=4, reset=100, kind=cast(Any, kind))
    for step, xy in enumerate(_positions(layout, d, skip + steps, seed)):
        graph = graph.observe(np.arange(d), xy)
        if step >= skip:
            yield graph


def _positions(layout: str, d: int, steps: int, seed: int) -> Iterator[FloatArray]:
    """(d, 2) positions of each step, m."""
    rng = np.random.default_rng(seed)
    lane = 3.5 * rng.integers(0, 3, d)
    if layout == "road":
        along, speed, turn = rng.random(d) * d / 3 * 20.0, rng.normal(25.0, 3.0, d), np.zeros(d)
    else:
        reach = d / 12 * 12.0 + 30.0
        along = rng.random(d) * 2 * reach - reach
        speed = rng.normal(10.0, 3.0, d) * (rng.random(d) < 0.7)
        turn = rng.integers(0, 4, d) * np.pi / 2
        lane += 1.75
    ahead = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    right = np.stack([np.sin(turn), -np.cos(turn)], axis=1)
    for _ in range(steps):
        xy = along[:, None] * ahead + lane[:, None] * right
        yield xy + rng.normal(0.0, 0.05, xy.shape)
        along = along + speed * STEP_S


@eigensolver()
def _dsyevr(problem: Problem) -> Pairs:
    """LAPACK's dsyevr for a range of indices: a rival that keeps nothing."""
    d, k = problem.graph.ids.size, problem.num_pairs
    span = (d - k, d - 1) if problem.end == "largest" else (0, k - 1)
    matrix = problem.graph.laplacian.toarray()
    values, vectors = scipy.linalg.eigh(matrix, subset_by_index=span, driver="evr")
    if problem.end == "largest":
        values, vectors = values[::-1], vectors[:, ::-1]
    return Pairs(values, vectors)


def measure(
    sizes: Sequence[int] = (25, 100, 400, 1000, 4000, 20000), graphs: Sequence[str] = LAYOUTS,
    solvers: Sequence[str] = (), steps: int = 60,
) -> Iterator[list[Row]]:  # fmt: skip
    """Rows of every solver on graphs of so many vehicles, in so many observations of each.

    Solvers are keys of ``SOLVERS``, or "lapack-dsyevr"; () for all. ``cpu_ms`` is the median of a
    step, and ``ratio_to_eigh`` the speed over that of numpy's eigh. With ``d`` None, ``slope`` is
    that of log ``cpu_ms`` against log d. A solver that would exceed ``STEP_BUDGET_S`` a step or its
    memory has one row: ``cpu_ms`` without a value.
    """
    everything: dict[str, Solver] = {**SOLVERS, "lapack-dsyevr": _dsyevr}
    chosen = {name: lookup(everything, name, "solver") for name in solvers or everything}
    layouts = [lookup({name: name for name in LAYOUTS}, name, "graph") for name in graphs]
    with threadpool_limits(1):
        _warm_up(chosen)
        for layout, kind, end in product(layouts, ("instantaneous", "accumulated"), ENDS):
            costs: dict[str, list[tuple[int, float]]] = defaultdict(list)
            keys: dict[str, Cell] = {"d": None, "graph": layout, "kind": kind, "end": end}
            for d in sorted(sizes):
                yield list(_sequence_rows(chosen, costs, {**keys, "d": d}, d, end, steps))
            slopes: list[Row] = []
            for name, points in costs.items():
                large = np.log([point for point in points if point[0] >= SLOPE_FROM])
                if len(large) > 1:
                    slope = float(np.polyfit(large[:, 0], large[:, 1], 1)[0])
                    slopes.append(tidy_row({"solver": name, **keys}, "slope", slope, n=len(large)))
            yield slopes


def _warm_up(solvers: Mapping[str, Solver]) -> None:
    """Load and compile everything once, untimed, also what large graphs need."""
    for end in ENDS:
        first, second = graph_sequence("road", "accumulated", 40, 2)
        for solver in solvers.values():
            last = solver(first, 4, end, None, TOLERANCE)
            solver(second, 4, end, last, TOLERANCE)
    previous: Spectrum | None = None
    for graph in graph_sequence("road", "accumulated", 700, 3):
        previous = SOLVERS["graphrqi"](graph, PAIRS, "largest", previous)


def _sequence_rows(
    solvers: Mapping[str, Solver], costs: dict[str, list[tuple[int, float]]],
    keys: Mapping[str, Cell], d: int, end: End, steps: int,
) -> Iterator[Row]:  # fmt: skip
    """The rows of one sequence; its costs are added to those of smaller graphs."""
    found: dict[str, list[tuple[float, Spectrum, int]]] = {}
    for name in solvers:
        slow = bool(costs[name]) and costs[name][-1][1] > 1e3 * STEP_BUDGET_S
        if slow or (name in DENSE and d > DENSE_UP_TO):
            yield tidy_row({"solver": name, **keys}, "cpu_ms", None, n=0)
        else:
            found[name] = []
    last: dict[str, Spectrum] = {}
    sequence = graph_sequence(str(keys["graph"]), str(keys["kind"]), d, steps + 2, 98 - steps)
    for graph in sequence:
        now: dict[str, tuple[float, Spectrum]] = {}
        for name, done in found.items():
            if len(done) > 2 and sum(ms for ms, *_ in done) > 1e3 * SEQUENCE_BUDGET_S:
                continue
            begin = time.process_time()
            last[name] = solvers[name](graph, PAIRS, end, last.get(name), TOLERANCE)
            now[name] = 1e3 * (time.process_time() - begin), last[name]
        _, reference = now.get("eigh") or now.get("graphrqi") or (0.0, None)
        for name, (ms, spectrum) in now.items():
            missed = 0 if reference is None else _missed_pairs(reference, spectrum)
            found[name].append((ms, spectrum, missed))
    medians = {name: float(np.median([ms for ms, *_ in done[2:]])) for name, done in found.items()}
    for name, done in found.items():
        warm, key = done[2:], {"solver": name, **keys}
        costs[name].append((d, medians[name]))
        figures: dict[str, Any] = {
            "cpu_ms": medians[name],
            "residual_max": max(float(one.residuals.max(initial=0.0)) for _, one, _ in warm),
            "missed_pairs": sum(missed for *_, missed in done[1:]),
            "certified_share": float(np.mean([one.certified for _, one, _ in warm])),
        }
        if "eigh" in medians:
            figures["ratio_to_eigh"] = medians["eigh"] / medians[name]
        for metric, value in figures.items():
            yield tidy_row(key, metric, value, n=len(warm))


def _missed_pairs(reference: Spectrum, found: Spectrum) -> int:
    """How many of the right eigenvalues have no partner near in another answer, each used once."""
    near = 1e-6 * max(1.0, float(np.abs(reference.eigenvalues).max(initial=0.0)))
    left = sorted(found.eigenvalues.tolist())
    for value in sorted(reference.eigenvalues.tolist()):
        match = next((v for v in left if abs(v - value) <= near), None)
        if match is not None:
            left.remove(match)
    return reference.eigenvalues.size - (found.eigenvalues.size - len(left))


def table(rows: Sequence[Row]) -> list[Row]:
    """One line per solver and sequence: ms of every d, worst residual, missed pairs and slope."""
    lines: list[Row] = []
    names = ["graph", "kind", "end", "solver"]
    for key, some in pd.DataFrame([dict(row) for row in rows]).groupby(names, sort=False):
        value = {metric: one.set_index("d")["value"] for metric, one in some.groupby("metric")}
        line: dict[str, Any] = dict(zip(names, key, strict=True))
        for d, ms in value["cpu_ms"].items():
            line[f"{d:.0f} (ms)"] = "skipped" if np.isnan(ms) else ms
        if "residual_max" in value:
            line["worst residual"] = value["residual_max"].max()
            line["missed"] = int(value["missed_pairs"].sum())
        if "slope" in value:
            line["slope"] = float(value["slope"].iloc[0])
        lines.append(line)
    return lines
