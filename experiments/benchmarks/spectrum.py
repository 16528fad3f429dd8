"""How quick and how right the eigenvalue algorithms are: the paper's runtime table, measured.

All solvers run interleaved, in one process and one thread, on the same sequences of traffic graphs,
each starting from its own last answer. The sequences are computed by a formula: vehicles at
constant speed on a one-way road or on the arms of a crossing. Those of a ``city`` are what SUMO's
vehicles do on a grid of streets with signals.

Source of the table: Chandra et al., GraphRQI (ICRA 2020), which prints complexities, a speed-up
of 2 over the best rival, cubic convergence and storage O(d).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from itertools import product
from typing import Final, cast

import numpy as np

from behaviors.errors import InputError, lookup
from experiments.benchmarks.graph_sequences import check_layout, graph_sequence
from experiments.score.rows import Cell, Row, tidy_row
from graphrqi.spectrum import SOLVERS, Spectrum
from graphrqi.spectrum.contract import Pairs, Problem, Solver, check_arguments, eigensolver
from graphrqi.spectrum.spectrum import End

TOLERANCE: Final = 1e-8
"""Residual asked for, relative to max(1, lambda_max)."""

PAIRS: Final = 8
"""Eigenpairs asked for."""

DENSE: Final = (
    "graphrqi-paper", "graphrqi-exact", "eigh", "svd", "incremental-svd", "restart-svd",
    "lapack-dsyevr",
)  # fmt: skip
"""Solvers that need O(d^2) memory and O(d^3) time."""

DENSE_UP_TO: Final = 1000
"""Largest graph those are run on (a tenth of a second a step)."""

STEP_BUDGET_S: Final = 2.0
"""CPU time of a step, as expected from smaller graphs, above which a solver is skipped."""

SEQUENCE_BUDGET_S: Final = 1.0
"""CPU time that a solver gets per sequence; it always gets a step."""

COMPARED: Final = ("graphrqi", "eigh", "lapack-dsyevr", "arpack", "primme")
"""Solvers that are not cut short while their steps are no longer than QUICK_STEP_MS."""

QUICK_STEP_MS: Final = 300.0
"""See COMPARED (above eigh at 1000 vehicles)."""

SLOPE_FROM: Final = 400
"""Smallest graph that counts for the slopes: below, fixed costs rule."""


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


@eigensolver(dense_share=5)
def primme(problem: Problem) -> Pairs:
    """PRIMME's default method, started from the earlier vectors.

    References:
        Stathopoulos, McCombs (2010), PRIMME: preconditioned iterative multimethod eigensolver,
        ACM Trans. Math. Softw. 37 (2), 21.
    """
    try:
        from primme import eigsh
    except ImportError:
        raise InputError("primme: not found, expected it: pip install graphrqi[primme]") from None
    values, vectors = eigsh(
        problem.graph.laplacian,
        problem.num_pairs,
        which="LA" if problem.end == "largest" else "SA",
        v0=problem.starting_block(),
        tol=0.3 * problem.tol,
        lock=problem.null if problem.null.shape[1] else None,
        return_unconverged=True,
    )
    return Pairs(*problem.chosen(values, vectors))


def measure(
    sizes: Sequence[int],
    graphs: Sequence[str] = ("road", "crossing"),
    solvers: Sequence[str] = (),
    steps: int = 60,
) -> Iterator[list[Row]]:
    """Measure every solver on every kind of graph.

    A solver that would exceed ``STEP_BUDGET_S`` a step or its memory has one row: ``cpu_ms``
    without a value.

    Args:
        sizes: numbers of vehicles.
        graphs: road, crossing or city.
        solvers: keys of ``SOLVERS``, "lapack-dsyevr", or "primme"; () for all that are installed.
        steps: observations of each sequence.

    Yields:
        Rows of each sequence: ``cpu_ms`` (median per step), ``residual_max``, ``missed_pairs``,
        ``certified_share`` and ``ratio_to_eigh`` (speed over that of numpy's eigh). With ``d``
        None, ``slope`` is that of log ``cpu_ms`` against log d.

    Raises:
        InputError: for an unknown name.
    """
    import scipy.linalg  # noqa: F401  # only libraries that are loaded can be limited to a thread
    from threadpoolctl import threadpool_limits

    everything: dict[str, Solver] = {**SOLVERS, "lapack-dsyevr": dsyevr, "primme": primme}
    usual = [name for name in everything if name != "primme" or find_spec(name)]
    chosen = {name: lookup(everything, name, "solver") for name in solvers or usual}
    for layout in graphs:  # before hours of work
        check_layout(layout, sizes)
    ends: tuple[End, ...] = ("largest", "smallest")
    for end in ends:
        check_arguments(PAIRS, end, TOLERANCE)
    rows: list[Row] = []
    with threadpool_limits(1):
        _warm_up(chosen, ends)
        for layout, kind, end in product(graphs, ("instantaneous", "accumulated"), ends):
            costs: dict[str, list[tuple[int, float]]] = {name: [] for name in chosen}
            for d in sorted(sizes):
                print(f"{layout}, {kind}, {end} end, {d} vehicles", file=sys.stderr, flush=True)
                keys: dict[str, Cell] = {"d": d, "graph": layout, "kind": kind, "end": end}
                part = list(_sequence_rows(chosen, costs, keys, steps))
                rows += part
                yield part
    yield slope_rows(rows)


def _warm_up(solvers: Mapping[str, Solver], ends: Sequence[End]) -> None:
    """Load and compile everything once, untimed, also what large graphs need."""
    for end in ends:
        first, second = graph_sequence("road", "accumulated", 40, 2)
        for solver in solvers.values():
            last = solver(first, 4, end, None, TOLERANCE, end == "smallest")
            solver(second, 4, end, last, TOLERANCE, end == "smallest")
    previous: Spectrum | None = None
    for graph in graph_sequence("road", "accumulated", 700, 3):
        previous = SOLVERS["graphrqi"](graph, PAIRS, "largest", previous)


def _sequence_rows(
    solvers: Mapping[str, Solver],
    costs: dict[str, list[tuple[int, float]]],
    keys: dict[str, Cell],
    steps: int,
) -> Iterator[Row]:
    """The rows of one sequence; its costs are added to those of smaller graphs."""
    d = int(cast("int", keys["d"]))
    active: dict[str, Solver] = {}
    for name, solver in solvers.items():
        reason = why_not(name, d, costs[name])
        if reason is None:
            active[name] = solver
            continue
        print(f"{name}: skipped: {reason}", file=sys.stderr)
        yield tidy_row({"solver": name, **keys}, "cpu_ms", None, None, None, 0)
    end = cast("End", keys["end"])
    last: dict[str, Spectrum | None] = dict.fromkeys(active)
    cpu: dict[str, list[float]] = {name: [] for name in active}
    spent, residual = dict.fromkeys(active, 0.0), dict.fromkeys(active, 0.0)
    missed, certified = dict.fromkeys(active, 0), dict.fromkeys(active, 0)
    sequence = graph_sequence(str(keys["graph"]), str(keys["kind"]), d, steps + 2, 98 - steps)
    for step, graph in enumerate(sequence):
        found: dict[str, Spectrum] = {}
        for name, solver in active.items():
            done = cpu[name]
            quick = name in COMPARED and bool(done) and float(np.median(done)) < QUICK_STEP_MS
            if spent[name] > SEQUENCE_BUDGET_S and done and not quick:
                continue
            begin = time.process_time()
            spectrum = solver(graph, PAIRS, end, last[name], TOLERANCE, end == "smallest")
            used = time.process_time() - begin
            last[name] = found[name] = spectrum
            spent[name] += used
            if step >= 2 or (step == 1 and spent[name] > SEQUENCE_BUDGET_S):  # the first is cold
                done.append(1e3 * used)
                residual[name] = max(residual[name], float(spectrum.residuals.max(initial=0.0)))
                certified[name] += spectrum.certified
        reference = found.get("eigh", found.get("graphrqi"))
        if reference is not None and step >= 1:
            for name, spectrum in found.items():
                missed[name] += missed_pairs(reference, spectrum)
    for name in (name for name in active if cpu[name]):
        key: dict[str, Cell] = {"solver": name, **keys}
        n, median = len(cpu[name]), float(np.median(cpu[name]))
        costs[name].append((d, median))
        yield median_row(key, "cpu_ms", cpu[name])
        yield tidy_row(key, "residual_max", residual[name], None, None, n)
        yield tidy_row(key, "missed_pairs", missed[name], None, None, n)
        yield tidy_row(key, "certified_share", certified[name] / n, None, None, n)
        if cpu.get("eigh"):
            ratio = float(np.median(cpu["eigh"])) / median
            yield tidy_row(key, "ratio_to_eigh", ratio, None, None, n)


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


def median_row(key: Mapping[str, Cell], metric: str, values: Sequence[float]) -> Row:
    """A median with the 95 % interval of its order statistics; none for fewer than six values."""
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    n = ordered.size
    reach = 0.98 * np.sqrt(n)
    low = high = None
    if n >= 6:
        low = float(ordered[max(int(np.floor(n / 2 - reach)), 0)])
        high = float(ordered[min(int(np.ceil(n / 2 + reach)), n - 1)])
    return tidy_row(key, metric, float(np.median(ordered)), low, high, n)


def slope_rows(rows: Sequence[Row]) -> list[Row]:
    """Slopes of cost against the number of vehicles, both in logarithms."""
    groups: dict[tuple[Cell, ...], list[tuple[float, float]]] = {}
    for row in rows:
        d, value = row["d"], row["value"]
        if row["metric"] == "cpu_ms" and value and int(cast("int", d)) >= SLOPE_FROM:
            key = (row["solver"], row["graph"], row["kind"], row["end"])
            groups.setdefault(key, []).append((float(cast("int", d)), float(value)))
    found: list[Row] = []
    for (solver, layout, kind, end), points in groups.items():
        if len(points) > 1:
            across, costs = np.log(np.array(points)).T
            slope = float(np.polyfit(across, costs, 1)[0])
            keys: dict[str, Cell] = {
                "solver": solver, "d": None, "graph": layout, "kind": kind, "end": end,
            }  # fmt: skip
            found.append(tidy_row(keys, "slope", slope, None, None, len(points)))
    return found


def table(rows: Sequence[Row]) -> list[Row]:
    """One line per solver and sequence: ms of every d, worst residual, missed pairs and slope."""
    lines: dict[tuple[Cell, ...], dict[str, Cell]] = {}
    for row in rows:
        names = ("graph", "kind", "end", "solver")
        key = tuple(row[name] for name in names)
        line = lines.setdefault(key, dict(zip(names, key, strict=True)))
        metric, value = str(row["metric"]), row["value"]
        if metric == "cpu_ms":
            line[f"{row['d']} (ms)"] = "skipped" if value is None else value
        elif metric == "residual_max":
            line["worst residual"] = max(float(line.get("worst residual") or 0), float(value or 0))
        elif metric == "missed_pairs":
            line["missed"] = int(line.get("missed") or 0) + int(value or 0)
        elif metric == "slope":
            line["slope"] = value
    return list(lines.values())
