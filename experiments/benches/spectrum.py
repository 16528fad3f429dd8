"""How quick and how right the eigenvalue algorithms are: the paper's runtime table, measured.

All solvers run interleaved, in one process and one thread, on the same sequences of traffic graphs,
each starting from its own last answer. The sequences are made here from a formula (vehicles at
constant speed on a one-way road, or on the four arms of a crossing), so that nothing but this file
is needed to repeat them.

Source of the table: Chandra et al., GraphRQI (ICRA 2020), which prints complexities, a speed-up
of 2 over the best rival, cubic convergence and storage O(d).
"""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from typing import Any, Final, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError, lookup
from experiments.benches.contract import Bench, option
from graphrqi.graph import TrafficGraph
from graphrqi.spectrum import SOLVERS, Spectrum
from graphrqi.spectrum.contract import Pairs, Problem, Solver, check_arguments, eigensolver
from graphrqi.spectrum.spectrum import End
from graphrqi.spectrum.subspaces import null_space

Floats: TypeAlias = NDArray[np.float64]
Row: TypeAlias = dict[str, Any]

SIZES: Final = (25, 100, 400, 1000, 4000, 20000)
STEP_S: Final = 0.1
"""Time between observations, s."""
DENSE_UP_TO: Final = 1000
"""Largest graph the O(d^3) solvers are run on (our choice: a tenth of a second a step)."""
BUDGET_S: Final = 1.0
"""CPU time after which a solver is asked no more on one sequence (our choice)."""
STEP_BUDGET_S: Final = 2.0
"""CPU time of a step, as expected from smaller graphs, above which a solver is skipped (our
choice)."""
COMPARED: Final = ("graphrqi", "eigh", "lapack-dsyevr", "arpack")
"""Solvers that are not cut short while their steps are no longer than QUICK_STEP_S."""
QUICK_STEP_S: Final = 0.3
"""See COMPARED (our choice: above eigh at 1000 vehicles)."""
SLOPE_FROM: Final = 400
"""Smallest graph that counts for the slopes: below, fixed costs rule (our choice)."""
PAPER_SPEED_UP: Final = 2.0
"""What the paper's abstract claims over the best previous method."""

DENSE: Final = (
    "graphrqi-paper",
    "graphrqi-exact",
    "eigh",
    "svd",
    "incremental-svd",
    "restart-svd",
    "lapack-dsyevr",
)
"""Solvers that need O(d^2) memory and O(d^3) time."""


def traffic_positions(layout: str, d: int, steps: int, seed: int = 0) -> Iterator[Floats]:
    """Positions of d vehicles, every 0.1 s.

    Args:
        layout: "road" (one way, three lanes, 20 m apart per lane on average, 25 m/s) or "crossing"
            (four arms of three lanes, 12 m apart, three in ten standing).
        d: vehicles.
        steps: observations.
        seed: of the places and speeds.

    Yields:
        (d, 2) positions, m.

    Raises:
        InputError: for an unknown layout.
    """
    rng = np.random.default_rng(seed)
    lane = 3.5 * rng.integers(0, 3, d)
    if layout == "road":
        along, speed, turn = rng.random(d) * d / 3 * 20.0, rng.normal(25.0, 3.0, d), np.zeros(d)
    elif layout == "crossing":
        reach = d / 12 * 12.0 + 30.0
        along = rng.random(d) * 2 * reach - reach
        speed = rng.normal(10.0, 3.0, d) * (rng.random(d) < 0.7)
        turn = rng.integers(0, 4, d) * np.pi / 2
        lane += 1.75
    else:
        raise InputError(f"graph: found {layout!r}, expected road or crossing")
    for _ in range(steps):
        xy = np.stack(
            [
                along * np.cos(turn) + lane * np.sin(turn),
                along * np.sin(turn) - lane * np.cos(turn),
            ],
            axis=1,
        )
        yield xy + rng.normal(0.0, 0.05, xy.shape)
        along = along + speed * STEP_S


def graph_sequence(
    layout: str, kind: str, d: int, steps: int, skip: int = 0, seed: int = 0
) -> Iterator[TrafficGraph]:
    """Traffic graphs of `traffic_positions`, four neighbours, reset at 100.

    Args:
        layout: "road" or "crossing".
        kind: "instantaneous" or "accumulated".
        d: vehicles.
        steps: graphs wanted.
        skip: observations before the first of them.
        seed: of the positions.

    Yields:
        The graphs.
    """
    graph = TrafficGraph.empty(neighbors=4, reset=100, kind=cast(Any, kind))
    ids = np.arange(d)
    for step, xy in enumerate(traffic_positions(layout, d, skip + steps, seed)):
        graph = graph.observe(ids, xy)
        if step >= skip:
            yield graph


@eigensolver()
def dsyevr(problem: Problem) -> Pairs:
    """LAPACK's dsyevr for a range of indices: a rival that keeps nothing."""
    from scipy.linalg import eigh

    d, k, zeros = problem.graph.ids.size, problem.num_pairs, problem.null.shape[1]
    span = (d - k, d - 1) if problem.end == "largest" else (zeros, zeros + k - 1)
    matrix = problem.graph.laplacian.toarray()
    values, vectors = eigh(matrix, subset_by_index=span, driver="evr")
    if problem.end == "largest":
        values, vectors = values[::-1], vectors[:, ::-1]
    return Pairs(values, vectors)


def run_spectrum_bench(
    sizes: Sequence[int] = SIZES,
    pairs: int = 8,
    ends: Sequence[End] = ("largest", "smallest"),
    graphs: Sequence[str] = ("road", "crossing"),
    kinds: Sequence[str] = ("instantaneous", "accumulated"),
    steps: int = 60,
    solvers: Sequence[str] | None = None,
    tol: float = 1e-8,
    seed: int = 0,
    budget_s: float = BUDGET_S,
    progress: Callable[[str], None] | None = None,
    keep: Callable[[Sequence[Row]], None] | None = None,
) -> list[Row]:
    """Measure every solver on every kind of graph.

    Args:
        sizes: numbers of vehicles.
        pairs: k, the pairs asked for.
        ends: ends of the spectrum.
        graphs: "road", "crossing".
        kinds: "instantaneous", "accumulated".
        steps: observations per sequence; slow solvers get fewer.
        solvers: names out of SOLVERS or "lapack-dsyevr"; all if not given.
        tol: residual asked for, relative to max(1, lambda_max).
        seed: of the positions.
        budget_s: CPU seconds a solver gets per sequence; it always gets a step, and COMPARED get
            all of them while they are quick.
        progress: called with a line of text before each sequence.
        keep: called with all rows so far after each sequence.

    Returns:
        Flat rows keyed ``solver d graph kind end`` with ``metric, value, low, high, n, reason``. A
        solver that would need more than STEP_BUDGET_S a step, by its costs on smaller graphs, or
        more than d^2 numbers above DENSE_UP_TO, has one row, ``cpu_ms`` without a value, and the
        reason; elsewhere that is null. Metrics:
        ``cpu_ms`` and ``wall_ms`` (median per step and its 95 % interval), ``residual_max``,
        ``missed_pairs`` (in all steps; an eigenvalue further than 1e-6 lambda_max from its
        reference), ``certified_share``, ``ratio_to_eigh`` (how many times faster than numpy's
        eigh), ``peak_memory_mb``, and with ``d`` null ``slope`` and ``memory_slope`` (of the
        logarithm, against the logarithm of d). The solvers ``positions-to-features`` and
        ``positions-to-features-scipy`` are the whole path from positions; ``graphrqi`` has
        further rows with ``metric`` ``residual_after_N`` and ``order_of_convergence``.

    Raises:
        InputError: for an unknown name.
    """
    import scipy.linalg  # noqa: F401  # only libraries that are loaded can be limited to a thread
    from threadpoolctl import threadpool_limits

    everything: dict[str, Solver] = {**SOLVERS, "lapack-dsyevr": dsyevr}
    chosen = {
        name: lookup(everything, name, "solver")
        for name in (everything if solvers is None else solvers)
    }
    for layout, kind, end in product(graphs, kinds, ends):  # all words, before hours of work
        next(traffic_positions(layout, 1, 1))
        TrafficGraph.empty(kind=cast(Any, kind))
        check_arguments(pairs, end, tol)
    rows: list[Row] = []
    with threadpool_limits(1):
        for end in ends:  # load and compile everything once, untimed
            start = list(graph_sequence("road", "accumulated", 40, 2))
            for solver in chosen.values():
                first = solver(start[0], 4, end, None, tol, end == "smallest")
                solver(start[1], 4, end, first, tol, end == "smallest")
        previous: Spectrum | None = None
        for graph in graph_sequence("road", "accumulated", 700, 3):  # what large graphs need
            previous = SOLVERS["graphrqi"](graph, pairs, "largest", previous)
        for layout in graphs:
            for kind in kinds:
                for end in ends:
                    costs: dict[str, list[tuple[int, float]]] = {name: [] for name in chosen}
                    for d in sorted(sizes):
                        if progress is not None:
                            progress(f"{layout}, {kind}, {end} end, {d} vehicles")
                        key = {"d": d, "graph": layout, "kind": kind, "end": end}
                        active = dict(chosen)
                        for name in chosen:
                            reason = why_not(name, d, costs[name])
                            if reason is not None:
                                del active[name]
                                rows.append(_skipped({"solver": name, **key}, reason))
                        measured = _measure(
                            active, layout, kind, end, d, pairs, steps, tol, seed, budget_s
                        )
                        for row in measured:
                            if row["metric"] == "cpu_ms":
                                costs[row["solver"]].append((d, row["value"]))
                        rows += measured
                        if keep is not None:
                            keep(rows)
                for d in sorted(sizes):
                    if solvers is None or "graphrqi" in solvers:
                        rows += _measure_path(layout, kind, d, pairs, steps, seed, budget_s)
            rows += convergence_rows(layout, seed=seed)
    return rows + _slopes(rows)


def _measure(
    solvers: dict[str, Solver],
    layout: str,
    kind: str,
    end: End,
    d: int,
    pairs: int,
    steps: int,
    tol: float,
    seed: int,
    budget_s: float,
) -> list[Row]:
    active = solvers
    sequence = list(graph_sequence(layout, kind, d, steps + 2, 100 - steps - 2, seed))
    last: dict[str, Spectrum | None] = dict.fromkeys(active)
    cpu: dict[str, list[float]] = {n: [] for n in active}
    wall: dict[str, list[float]] = {n: [] for n in active}
    residual, spent = dict.fromkeys(active, 0.0), dict.fromkeys(active, 0.0)
    missed, certified = dict.fromkeys(active, 0), dict.fromkeys(active, 0)
    nonzero = end == "smallest"
    for step, graph in enumerate(sequence):
        found: dict[str, Spectrum] = {}
        for name, solver in active.items():
            done = cpu[name]
            quick = name in COMPARED and bool(done) and float(np.median(done)) < 1e3 * QUICK_STEP_S
            if spent[name] > budget_s and done and not quick:
                continue
            begin, begin_cpu = time.perf_counter(), time.process_time()
            spectrum = solver(graph, pairs, end, last[name], tol, nonzero)
            used, passed = time.process_time() - begin_cpu, time.perf_counter() - begin
            last[name] = found[name] = spectrum
            spent[name] += used
            if step >= 2 or (step == 1 and spent[name] > budget_s):  # the first answer is cold
                cpu[name].append(1e3 * used)
                wall[name].append(1e3 * passed)
                residual[name] = max(residual[name], float(spectrum.residuals.max(initial=0.0)))
                certified[name] += spectrum.certified
        reference = found.get("eigh", found.get("graphrqi"))
        if reference is not None and step >= 1:
            for name, spectrum in found.items():
                missed[name] += missed_pairs(reference, spectrum)
    rows = []
    eigh_ms = float(np.median(cpu["eigh"])) if cpu.get("eigh") else None
    for name in active:
        if not cpu[name]:
            continue
        key = {"solver": name, "d": d, "graph": layout, "kind": kind, "end": end}
        n = len(cpu[name])
        rows.append(_median_row(key, "cpu_ms", cpu[name]))
        rows.append(_median_row(key, "wall_ms", wall[name]))
        rows.append(_row(key, "residual_max", residual[name], n))
        rows.append(_row(key, "missed_pairs", missed[name], n))
        rows.append(_row(key, "certified_share", certified[name] / n, n))
        if eigh_ms is not None:
            rows.append(_row(key, "ratio_to_eigh", eigh_ms / float(np.median(cpu[name])), n))
        if float(np.median(cpu[name])) <= 1e3 * STEP_BUDGET_S:
            call = partial(active[name], sequence[-1], pairs, end, last[name], tol, nonzero)
            memory = _peak_memory_mb(call)
            if memory is not None:
                rows.append(_row(key, "peak_memory_mb", memory, 1))
    return rows


def why_not(name: str, d: int, costs: Sequence[tuple[int, float]]) -> str | None:
    """Why a solver is not run on graphs of a size.

    Args:
        name: of the solver.
        d: vehicles.
        costs: its (vehicles, ms per step) so far, by size.

    Returns:
        The reason, or None if it is run.

    Examples:
        >>> why_not("svd", 4000, [])
        'needs d^2 numbers and d^3 time: run up to 1000 vehicles'
        >>> why_not("lobpcg", 4000, [(100, 10.0), (1000, 1000.0)])
        'a step would take 16 s, allowed are 2 s'
    """
    if name in DENSE and d > DENSE_UP_TO:
        return f"needs d^2 numbers and d^3 time: run up to {DENSE_UP_TO} vehicles"
    if not costs:
        return None
    size, cost = costs[-1]
    power = 1.0
    if len(costs) > 1:
        before, cheaper = costs[-2]
        power = max(power, float(np.log(cost / cheaper) / np.log(size / before)))
    expected = 1e-3 * cost * (d / size) ** power
    if expected > STEP_BUDGET_S:
        return f"a step would take {expected:.0f} s, allowed are {STEP_BUDGET_S:.0f} s"
    return None


def missed_pairs(reference: Spectrum, found: Spectrum) -> int:
    """How many of the reference's eigenvalues have no partner in another answer.

    Args:
        reference: k right pairs.
        found: the answer to judge.

    Returns:
        Eigenvalues without one within 1e-6 of max(1, the largest), each partner used once.
    """
    near = 1e-6 * max(1.0, float(np.abs(reference.eigenvalues).max(initial=0.0)))
    left = sorted(found.eigenvalues.tolist())
    missing = 0
    for value in sorted(reference.eigenvalues.tolist()):
        match = next((v for v in left if abs(v - value) <= near), None)
        if match is None:
            missing += 1
        else:
            left.remove(match)
    return missing


def _measure_path(
    layout: str, kind: str, d: int, pairs: int, steps: int, seed: int, budget_s: float
) -> list[Row]:
    """Time the whole way from positions to features, ours and the usual one."""
    ids = np.arange(d)
    graph = TrafficGraph.empty(neighbors=4, reset=100, kind=cast(Any, kind))
    usual = _UsualPath(kind, d)
    spectrum: Spectrum | None = None
    cpu: dict[str, list[float]] = {"positions-to-features": [], "positions-to-features-scipy": []}
    for step, xy in enumerate(traffic_positions(layout, d, 98, seed)):
        measured = step >= 98 - steps
        begin = time.process_time()
        graph = graph.observe(ids, xy)
        if measured or step >= 96 - steps:
            spectrum = SOLVERS["graphrqi"](graph, pairs, "largest", spectrum)
            cheap_features(spectrum.eigenvalues, spectrum.eigenvectors)
        if measured:
            cpu["positions-to-features"].append(1e3 * (time.process_time() - begin))
        begin = time.process_time()
        matrix = usual.observe(xy)
        slow = cpu["positions-to-features-scipy"]
        if measured and d <= DENSE_UP_TO and (not slow or sum(slow) < 1e3 * budget_s):
            values, vectors = np.linalg.eigh(matrix)
            cheap_features(values[: -pairs - 1 : -1], vectors[:, : -pairs - 1 : -1])
            slow.append(1e3 * (time.process_time() - begin))
    rows = []
    for name, times in cpu.items():
        if times:
            key = {"solver": name, "d": d, "graph": layout, "kind": kind, "end": "largest"}
            rows.append(_median_row(key, "cpu_ms", times))
    return rows


def cheap_features(values: Floats, vectors: Floats) -> Floats:
    """Sizes of the eigenvectors' rows and two heat kernels.

    Args:
        values: (k,) eigenvalues.
        vectors: (d, k) eigenvectors.

    Returns:
        (d, k + 2) |u| and the sums over pairs of u^2 exp(-t lambda), t = 0.1 and 1.
    """
    kernels = np.exp(-np.outer(values, (0.1, 1.0)))
    return np.hstack([np.abs(vectors), vectors**2 @ kernels])


class _UsualPath:
    """Positions to a dense Laplacian with cKDTree, numpy and scipy."""

    def __init__(self, kind: str, d: int) -> None:
        self.kind, self.d = kind, d
        self.kept = np.empty(0, np.int64)

    def observe(self, xy: Floats) -> Floats:
        from scipy.sparse import csr_array, diags_array
        from scipy.spatial import cKDTree

        _, near = cKDTree(xy).query(xy, k=5)
        rows = np.repeat(np.arange(self.d), 4)
        columns = np.asarray(near, dtype=np.int64)[:, 1:].ravel()
        pairs = np.minimum(rows, columns) * self.d + np.maximum(rows, columns)
        self.kept = np.union1d(self.kept, pairs) if self.kind == "accumulated" else np.unique(pairs)
        i, j = self.kept // self.d, self.kept % self.d
        ones = np.ones(2 * i.size)
        shape = (self.d, self.d)
        a = csr_array((ones, (np.concatenate([i, j]), np.concatenate([j, i]))), shape=shape)
        laplacian: Any = diags_array(a.sum(axis=1)) - a
        return laplacian.toarray() if self.d <= DENSE_UP_TO else np.empty((0, 0))


def convergence_rows(layout: str, d: int = 100, seed: int = 0, tries: int = 40) -> list[Row]:
    """Residuals of Rayleigh-quotient iterations, and the order they fall with.

    Plain iterations (one solution per shift) from eigenvectors of the graph before, on the graph
    after, both ends of the instantaneous graph's spectrum.

    Args:
        layout: "road" or "crossing".
        d: vehicles.
        seed: of the positions.
        tries: vectors to follow.

    Returns:
        Rows of ``graphrqi``: ``residual_after_0`` to ``_6`` (medians) and
        ``order_of_convergence``: the median of log(r_{i+2} / r_{i+1}) / log(r_{i+1} / r_i) over
        the iterations with r_i < 0.1 and r_{i+2} > 1e-13, r relative to the largest eigenvalue.
    """
    paths, orders = [], []
    sequence = list(graph_sequence(layout, "instantaneous", d, 6, 0, seed))
    for before, after in pairwise(sequence):
        matrix = after.laplacian.toarray()
        _, old = np.linalg.eigh(before.laplacian.toarray())
        size = float(np.linalg.norm(matrix, 2))
        for column in range(d - 1, d - 1 - tries // 5, -1):
            x = old[:, column]
            path = []
            for _ in range(7):
                mu = float(x @ matrix @ x)
                path.append(float(np.linalg.norm(matrix @ x - mu * x)) / size)
                try:
                    x = np.linalg.solve(matrix - mu * np.eye(d), x)
                except np.linalg.LinAlgError:  # mu is an eigenvalue to the last bit
                    break
                x = x / np.linalg.norm(x)
            paths.append(path + [path[-1]] * (7 - len(path)))
            orders += [
                np.log(c / b) / np.log(b / a)
                for a, b, c in zip(path[:-2], path[1:-1], path[2:], strict=True)
                if 1e-13 < c < b < a < 0.1
            ]
    key = {
        "solver": "graphrqi",
        "d": d,
        "graph": layout,
        "kind": "instantaneous",
        "end": "largest",
    }
    table = np.array(paths)
    rows = [
        _median_row(key, f"residual_after_{i}", table[:, i].tolist()) for i in range(table.shape[1])
    ]
    if orders:
        rows.append(_median_row(key, "order_of_convergence", orders))
    return rows


def _slopes(rows: Sequence[Row]) -> list[Row]:
    out = []
    for metric, name in (("cpu_ms", "slope"), ("peak_memory_mb", "memory_slope")):
        groups: dict[tuple[str, ...], list[tuple[int, float]]] = {}
        for row in rows:
            if row["metric"] == metric and row["d"] >= SLOPE_FROM and (row["value"] or 0.0) > 0.0:
                key = (row["solver"], row["graph"], row["kind"], row["end"])
                groups.setdefault(key, []).append((row["d"], row["value"]))
        for (solver, layout, kind, end), points in groups.items():
            if len(points) < 2:
                continue
            d, value = np.log(np.array(points)).T
            slope = float(np.polyfit(d, value, 1)[0])
            key_of = {"solver": solver, "d": None, "graph": layout, "kind": kind, "end": end}
            out.append(_row(key_of, name, slope, len(points)))
    return out


def _row(key: dict[str, Any], metric: str, value: float, n: int) -> Row:
    row = {**key, "metric": metric, "value": float(value), "low": None, "high": None, "n": n}
    return row | {"reason": None}


def _skipped(key: dict[str, Any], reason: str) -> Row:
    row = {**key, "metric": "cpu_ms", "value": None, "low": None, "high": None, "n": 0}
    return row | {"reason": reason}


def _median_row(key: dict[str, Any], metric: str, values: Sequence[float]) -> Row:
    """A median with the 95 % interval of its order statistics."""
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    n = ordered.size
    reach = 0.98 * np.sqrt(n)
    row = _row(key, metric, float(np.median(ordered)), n)
    if n >= 6:
        row["low"] = float(ordered[max(int(np.floor(n / 2 - reach)), 0)])
        row["high"] = float(ordered[min(int(np.ceil(n / 2 + reach)), n - 1)])
    return row


def _peak_memory_mb(call: Callable[[], object]) -> float | None:
    """How far a call raises the memory of a forked process, in MB; None where that is unknown."""
    if not Path("/proc/self/clear_refs").exists():
        return None
    read, write = os.pipe()
    child = os.fork()
    if child == 0:  # never returns to the caller's code
        code = 1
        try:
            ctypes.CDLL(None).malloc_trim(0)  # give back what earlier calls left
            Path("/proc/self/clear_refs").write_text("5")
            before = _status_kb("VmRSS")
            call()
            os.write(write, str(_status_kb("VmHWM") - before).encode())
            code = 0
        finally:
            os._exit(code)
    os.close(write)
    with os.fdopen(read) as pipe:
        text = pipe.read()
    os.waitpid(child, 0)
    return max(float(text), 0.0) / 1024.0 if text else None


def _status_kb(field: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field + ":"):
            return int(line.split()[1])
    raise InputError(f"/proc/self/status: found no {field}, expected Linux's fields")


def spectrum_table(rows: Sequence[Row]) -> list[Row]:
    """Lay the bench out as a table for reading.

    Args:
        rows: of `run_spectrum_bench`.

    Returns:
        One row per solver and sequence: milliseconds of CPU per step for every d ("skipped" where
        it was not run), worst residual, missed pairs, the slopes of cost and memory; for plain
        Rayleigh-quotient iterations, in the rows of ``graphrqi``, the order of convergence and
        the residuals after each.
    """
    sizes = sorted({row["d"] for row in rows if row["d"] is not None})
    lines: dict[tuple[str, ...], Row] = {}
    for row in rows:
        names = ("graph", "kind", "end", "solver")
        key = tuple(str(row[name]) for name in names)
        line = lines.setdefault(
            key,
            dict(zip(names, key, strict=True))
            | {f"{d} (ms)": None for d in sizes}
            | dict.fromkeys(
                ("worst residual", "missed", "slope", "memory slope", "order", "residuals")
            ),
        )
        if row["metric"] == "cpu_ms":
            line[f"{row['d']} (ms)"] = "skipped" if row["value"] is None else row["value"]
        elif row["metric"] == "residual_max":
            line["worst residual"] = max(line["worst residual"] or 0.0, row["value"])
        elif row["metric"] == "missed_pairs":
            line["missed"] = (line["missed"] or 0) + int(row["value"])
        elif row["metric"] in ("slope", "memory_slope"):
            line[row["metric"].replace("_", " ")] = row["value"]
        elif row["metric"] == "order_of_convergence":
            line["order"] = row["value"]
        elif row["metric"].startswith("residual_after_"):
            line["residuals"] = f"{line['residuals'] or ''} {row['value']:.0e}".strip()
    return list(lines.values())


def plot_spectrum(rows: Sequence[Row], path: Path) -> None:
    """Draw CPU time against d, log-log, one panel per sequence.

    The dashed line is what the paper claims: half the time of the best previous method, here the
    quickest rival that missed no pair (of those printed in the paper's table). The runtimes
    printed in the paper were not at hand, and are not drawn.

    Args:
        rows: of `run_spectrum_bench`.
        path: picture to write, its ending says the format.
    """
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    costs = [row for row in rows if row["metric"] == "cpu_ms" and row["value"] is not None]
    panels = list(dict.fromkeys((r["graph"], r["kind"], r["end"]) for r in costs))
    solvers = list(dict.fromkeys(r["solver"] for r in costs))
    wrong = {
        (r["solver"], r["d"], r["graph"], r["kind"], r["end"])
        for r in rows
        if r["metric"] == "missed_pairs" and r["value"] > 0
    }
    columns = min(4, len(panels))
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(4.6 * columns, 4.2 * lines + 1.2), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True)
    styles = [colormaps["tab20"](i % 20) for i in range(len(solvers))]
    sizes = sorted({row["d"] for row in costs})
    ours = ("graphrqi", "positions-to-features")
    for axis, panel in zip(axes.flat, panels, strict=False):
        best: dict[int, float] = {}
        for color, solver in zip(styles, solvers, strict=True):
            points = sorted(
                (r["d"], r["value"])
                for r in costs
                if r["solver"] == solver and (r["graph"], r["kind"], r["end"]) == panel
            )
            if not points:
                continue
            d, value = zip(*points, strict=True)
            axis.plot(
                d,
                value,
                color=color,
                label=solver,
                linewidth=2.6 if solver in ours else 1.1,
                linestyle=":" if solver.startswith("positions") else "-",
                zorder=3 if solver in ours else 2,
            )
            right = [p for p in points if (solver, p[0], *panel) not in wrong]
            bad = [p for p in points if (solver, p[0], *panel) in wrong]
            axis.plot([p[0] for p in right], [p[1] for p in right], "o", color=color, markersize=4)
            axis.plot([p[0] for p in bad], [p[1] for p in bad], "x", color=color, markersize=6)
            if not solver.startswith(("graphrqi", "positions", "lapack")):
                for size, cost in right:
                    best[size] = min(best.get(size, np.inf), cost)
        if best:
            claim = sorted((size, cost / PAPER_SPEED_UP) for size, cost in best.items())
            axis.plot(*zip(*claim, strict=True), "k--", linewidth=1.2, label="claimed in the paper")
        axis.set(title=", ".join(panel) + " end", xscale="log", yscale="log")
        axis.set_xticks(sizes, [str(size) for size in sizes])
        axis.minorticks_off()
        axis.grid(True, which="major", alpha=0.3)
        axis.set_xlabel("vehicles d")
    for axis in axes[:, 0]:
        axis.set_ylabel("CPU per step, ms")
    handles: dict[str, Any] = {}
    for axis in axes.flat:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(
        list(handles.values()),
        list(handles),
        loc="outside lower center",
        ncols=columns + 1,
        fontsize=9,
    )
    figure.suptitle("Eigenvalue algorithms on traffic graphs (crosses: pairs were missed)")
    figure.savefig(path, dpi=110)


def hostile_graphs(count: int, largest: int = 400, seed: int = 0) -> Iterator[tuple[Any, ...]]:
    """Graphs and questions that eigenvalue algorithms get wrong.

    Sequences of ten: traffic graphs of either kind, nearest or within a radius, with and without
    weights, on a road or a crossing, vehicles coming and going, at times on whole metres (equal
    distances, coincident vehicles); between them stars, rings, complete graphs, paths, matchings,
    random graphs, trees, cliques and graphs without edges, with and without weights.

    Args:
        count: how many.
        largest: vehicles of the largest.
        seed: of all of it.

    Yields:
        Graph, pairs wanted (1 to 32), end, whether to leave out the null space, whether to start
        from the last answer at that end.
    """
    rng = np.random.default_rng(seed)
    done = 0
    while done < count:
        d = int(np.exp(rng.uniform(0.0, np.log(largest))))
        kind = ("accumulated", "instantaneous")[rng.integers(2)]
        radius = float(rng.choice([15.0, 40.0])) if rng.random() < 0.3 else None
        scale = float(rng.choice([5.0, 20.0])) if rng.random() < 0.4 else None
        traffic = TrafficGraph.empty(
            int(rng.integers(1, 6)), int(rng.integers(3, 12)), cast(Any, kind), radius, scale
        )
        xy = rng.random((2 * d, 2)) * [[4.0 * d, 12.0]]
        if rng.random() < 0.5:
            xy[::2] = xy[::2, ::-1]
        speed = rng.normal(0.0, 2.0, (2 * d, 2))
        present = np.arange(0)
        for step in range(10):
            xy = xy + speed * STEP_S
            if step % 3 == 0:
                present = np.flatnonzero(rng.random(2 * d) < 0.5)
            if rng.random() < 0.25:
                graph = _special_graph(d, rng)
            else:
                seen = np.round(xy[present]) if rng.random() < 0.15 else xy[present]
                graph = traffic = traffic.observe(present, seen)
            end = ("largest", "smallest")[rng.integers(2)]
            yield graph, int(rng.integers(1, 33)), end, rng.random() < 0.5, rng.random() < 0.8
            done += 1
            if done == count:
                return


def _special_graph(d: int, rng: np.random.Generator) -> TrafficGraph:
    i = np.arange(d)
    shape = int(rng.integers(9))
    block = int(rng.integers(2, 8))
    random = rng.integers(0, d, (int(rng.integers(0, 3 * d)), 2))
    edges = [
        np.stack([0 * i[1:], i[1:]], 1),  # star
        np.stack([i, (i + 1) % d], 1),  # ring
        np.stack(np.triu_indices(min(d, 60), 1), 1),  # complete
        np.stack([i[:-1], i[1:]], 1),  # path
        np.stack([i[: d - d % 2 : 2], i[1::2]], 1),  # matching
        random,
        np.stack([(i[1:] - 1) // 2, i[1:]], 1),  # binary tree
        np.array([(a, b) for a in i for b in range(a - a % block, a)]).reshape(-1, 2),  # cliques
        np.empty((0, 2), np.int64),
    ][shape].astype(np.int64)
    edges = edges[edges[:, 0] != edges[:, 1]]
    weights = rng.random(len(edges)) ** 3 * 10.0 if rng.random() < 0.4 else None
    ids = rng.permutation(5 * d)[:d]
    return TrafficGraph.from_edges(ids, ids[edges], weights)


def run_spectrum_study(
    count: int = 2000, largest: int = 400, seed: int = 0, solver: str = "graphrqi"
) -> list[Row]:
    """Compare a solver with LAPACK on hostile graphs.

    Args:
        count: graphs.
        largest: vehicles of the largest.
        seed: of the graphs.
        solver: name of the solver.

    Returns:
        Flat rows as of `run_spectrum_bench`, with ``d`` the largest: ``wrong_answers``,
        ``uncertified``, ``fallbacks``, ``eigenvalue_error_max`` and ``residual_max`` (both
        relative to max(1, lambda_max)), ``orthonormality_error_max``.
    """
    solve = SOLVERS[solver]
    last: dict[str, Spectrum] = {}
    wrong = uncertified = fallbacks = 0
    worst = np.zeros(3)
    for graph, k, end, nonzero, warm in hostile_graphs(count, largest, seed):
        found = solve(graph, k, end, last.get(end) if warm else None, 1e-8, nonzero)
        last[end] = found
        errors = errors_against_lapack(found, k, nonzero)
        worst = np.maximum(worst, errors)
        wrong += bool(errors[0] > 1e-8 or errors[1] > 1e-8 or errors[2] > 1e-9)
        uncertified += not found.certified
        fallbacks += found.note.startswith("fell back")
    key = {"solver": solver, "d": largest, "graph": "hostile", "kind": "mixed", "end": "both"}
    return [
        _row(key, "wrong_answers", wrong, count),
        _row(key, "uncertified", uncertified, count),
        _row(key, "fallbacks", fallbacks, count),
        _row(key, "eigenvalue_error_max", worst[0], count),
        _row(key, "residual_max", worst[1], count),
        _row(key, "orthonormality_error_max", worst[2], count),
    ]


def errors_against_lapack(found: Spectrum, num_pairs: int, nonzero: bool) -> Floats:
    """How far an answer is from right.

    Args:
        found: the answer.
        num_pairs: pairs that were asked for.
        nonzero: whether the null space was to be left out.

    Returns:
        (3,) largest eigenvalue error and residual, relative to max(1, lambda_max), and largest
        departure from orthonormality; infinite where the number of pairs is wrong.
    """
    matrix = found.graph.laplacian.toarray()
    right: Floats = np.linalg.eigvalsh(matrix) if matrix.size else np.zeros(0)
    scale = max(1.0, float(right.max(initial=0.0)))
    if nonzero:
        right = right[null_space(found.graph).shape[1] :]
    right = (right[::-1] if found.end == "largest" else right)[:num_pairs]
    values, vectors = found.eigenvalues, found.eigenvectors
    if values.shape != right.shape or vectors.shape != (len(matrix), right.size):
        return np.full(3, np.inf)
    gram = vectors.T @ vectors - np.eye(right.size)
    return np.array(
        [
            np.abs(values - right).max(initial=0.0) / scale,
            np.linalg.norm(matrix @ vectors - vectors * values, axis=0).max(initial=0.0) / scale,
            np.abs(gram).max(initial=0.0),
        ]
    )


@dataclass(frozen=True, slots=True)
class Settings:
    """What is measured, and on how many graphs.

    Attributes:
        sizes: numbers of vehicles.
        pairs: eigenpairs asked for.
        ends: ends of the spectrum.
        graphs: where the vehicles are.
        kinds: kinds of graph.
        steps: observations per sequence.
        solvers: names out of SOLVERS or "lapack-dsyevr"; () for all.
        study: hostile graphs on which the certified solver is compared with LAPACK.
        largest: vehicles of the largest of those.
    """

    sizes: tuple[int, ...] = option(SIZES, "Numbers of vehicles.", "D,D")
    pairs: int = option(8, "Eigenpairs asked for.")
    ends: tuple[str, ...] = option(("largest", "smallest"), "Ends of the spectrum.")
    graphs: tuple[str, ...] = option(("road", "crossing"), "Where the vehicles are.")
    kinds: tuple[str, ...] = option(("instantaneous", "accumulated"), "Kinds of graph.")
    steps: int = option(60, "Steps of each sequence.")
    solvers: tuple[str, ...] = option((), "Algorithms to measure [default: all].")
    study: int = option(2000, "Hostile graphs on which the solver is compared with LAPACK.")
    largest: int = 400


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Measure the solvers, then study the certified one on hostile graphs."""
    yield run_spectrum_bench(
        settings.sizes, settings.pairs, cast("tuple[End, ...]", settings.ends), settings.graphs,
        settings.kinds, settings.steps, settings.solvers or None,
    )  # fmt: skip
    if settings.study:
        yield run_spectrum_study(settings.study, settings.largest)


BENCH: Final = Bench(
    name="spectrum",
    summary="Measure every eigenvalue algorithm on the same graphs, in one process.",
    keys=("solver", "d", "graph", "kind", "end", "reason"),
    full=Settings(),
    quick=Settings(sizes=(25, 50), steps=10, study=50, largest=50),
    measure=measure,
    table=cast(Any, spectrum_table),
    plot=cast(Any, plot_spectrum),
)
