"""What solvers cost and how right they are on one sequence of graphs."""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from experiments.benches.spectrum.rows import Row, median_row, plain_row
from experiments.benches.spectrum.sequences import graph_sequence
from graphrqi.spectrum import Spectrum
from graphrqi.spectrum.contract import Pairs, Problem, Solver, eigensolver
from graphrqi.spectrum.spectrum import End

DENSE_UP_TO: Final = 1000
"""Largest graph the O(d^3) solvers are run on (a tenth of a second a step)."""


STEP_BUDGET_S: Final = 2.0
"""CPU time of a step, as expected from smaller graphs, above which a solver is skipped."""


COMPARED: Final = ("graphrqi", "eigh", "lapack-dsyevr", "arpack")
"""Solvers that are not cut short while their steps are no longer than QUICK_STEP_S."""


QUICK_STEP_S: Final = 0.3
"""See COMPARED (above eigh at 1000 vehicles)."""


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


def measure_sequence(
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
    """Run solvers interleaved on one sequence of graphs.

    Args:
        solvers: those to run, by name.
        layout: one of `LAYOUTS`.
        kind: "instantaneous" or "accumulated".
        end: end of the spectrum.
        d: vehicles.
        pairs: eigenpairs asked for.
        steps: observations; slow solvers get fewer.
        tol: residual asked for, relative to max(1, lambda_max).
        seed: of the positions.
        budget_s: CPU seconds that a solver gets.

    Returns:
        The rows of every solver.
    """
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
        rows.append(median_row(key, "cpu_ms", cpu[name]))
        rows.append(median_row(key, "wall_ms", wall[name]))
        rows.append(plain_row(key, "residual_max", residual[name], n))
        rows.append(plain_row(key, "missed_pairs", missed[name], n))
        rows.append(plain_row(key, "certified_share", certified[name] / n, n))
        if eigh_ms is not None:
            rows.append(plain_row(key, "ratio_to_eigh", eigh_ms / float(np.median(cpu[name])), n))
        if float(np.median(cpu[name])) <= 1e3 * STEP_BUDGET_S:
            call = partial(active[name], sequence[-1], pairs, end, last[name], tol, nonzero)
            memory = _peak_memory_mb(call)
            if memory is not None:
                rows.append(plain_row(key, "peak_memory_mb", memory, 1))
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
