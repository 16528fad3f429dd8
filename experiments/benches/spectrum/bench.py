"""How quick and how right the eigenvalue algorithms are: the paper's runtime table, measured.

All solvers run interleaved, in one process and one thread, on the same sequences of traffic graphs,
each starting from its own last answer. The sequences are made from a formula (vehicles at constant
speed on a one-way road, or on the four arms of a crossing), so that no data are needed to repeat
them. Those of a ``city`` are what SUMO's vehicles do on a grid of streets with signals.

Source of the table: Chandra et al., GraphRQI (ICRA 2020), which prints complexities, a speed-up
of 2 over the best rival, cubic convergence and storage O(d).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final, cast

from behaviors.errors import lookup
from experiments.benches.contract import Bench, option
from experiments.benches.spectrum.convergence import convergence_rows
from experiments.benches.spectrum.costs import dsyevr, measure_sequence, why_not
from experiments.benches.spectrum.path import path_rows
from experiments.benches.spectrum.picture import plot_spectrum, spectrum_table
from experiments.benches.spectrum.rows import Row, skipped_row, slope_rows
from experiments.benches.spectrum.sequences import check_layout, graph_sequence
from experiments.benches.spectrum.study import study_rows
from graphrqi.spectrum import SOLVERS, Spectrum
from graphrqi.spectrum.contract import Solver, check_arguments
from graphrqi.spectrum.spectrum import End

TOLERANCE: Final = 1e-8
"""Residual asked for, relative to max(1, lambda_max)."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What is measured, and on how many graphs.

    Attributes:
        sizes: numbers of vehicles.
        pairs: eigenpairs asked for.
        ends: ends of the spectrum.
        graphs: where the vehicles are; cities need netgenerate above some 200 vehicles.
        kinds: kinds of graph.
        steps: observations per sequence.
        solvers: names out of SOLVERS or "lapack-dsyevr"; () for all.
        budget_s: CPU seconds that a solver gets per sequence; it always gets a step, and
            ``COMPARED`` get all of them while they are quick.
        study: hostile graphs on which the certified solver is compared with LAPACK.
        largest: vehicles of the largest of those.
    """

    sizes: tuple[int, ...] = option(
        (25, 100, 400, 1000, 4000, 20000), "Numbers of vehicles.", "D,D"
    )
    pairs: int = option(8, "Eigenpairs asked for.")
    ends: tuple[str, ...] = option(("largest", "smallest"), "Ends of the spectrum.")
    graphs: tuple[str, ...] = option(
        ("road", "crossing"), "Where the vehicles are: road, crossing, city."
    )
    kinds: tuple[str, ...] = option(("instantaneous", "accumulated"), "Kinds of graph.")
    steps: int = option(60, "Steps of each sequence.")
    solvers: tuple[str, ...] = option((), "Algorithms to measure [default: all].")
    budget_s: float = 1.0
    study: int = option(2000, "Hostile graphs on which the solver is compared with LAPACK.")
    largest: int = 400


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Measure every solver on every kind of graph, then study the certified one on hostile graphs.

    A solver that would need more than ``STEP_BUDGET_S`` a step, by its costs on smaller graphs, or
    more than d^2 numbers above ``DENSE_UP_TO``, has one row, ``cpu_ms`` without a value, and the
    ``reason``; elsewhere that is None.

    Yields:
        For each sequence ``cpu_ms`` and ``wall_ms`` (median per step and its 95 % interval),
        ``residual_max``, ``missed_pairs`` (in all steps; an eigenvalue further than 1e-6 lambda_max
        from its reference), ``certified_share``, ``ratio_to_eigh`` (how many times faster than
        numpy's eigh) and ``peak_memory_mb``; then those of the whole way from positions to
        features, ours and scipy's; ``residual_after_N`` and ``order_of_convergence``; and with
        ``d`` None ``slope`` and ``memory_slope`` (of the logarithm, against the logarithm of d).

    Raises:
        InputError: for an unknown name.
    """
    import scipy.linalg  # noqa: F401  # only libraries that are loaded can be limited to a thread
    from threadpoolctl import threadpool_limits

    everything: dict[str, Solver] = {**SOLVERS, "lapack-dsyevr": dsyevr}
    names = settings.solvers or tuple(everything)
    chosen = {name: lookup(everything, name, "solver") for name in names}
    ends = cast("tuple[End, ...]", settings.ends)
    for layout, kind, end in product(settings.graphs, settings.kinds, ends):  # before hours of work
        check_layout(layout, settings.sizes)
        next(graph_sequence("road", kind, 1, 1))
        check_arguments(settings.pairs, end, TOLERANCE)
    rows: list[Row] = []
    with threadpool_limits(1):
        _warm_up(chosen, ends, settings.pairs)
        for layout, kind in product(settings.graphs, settings.kinds):
            for end in ends:
                for part in _sequence_rows(settings, chosen, layout, kind, end):
                    rows += part
                    yield part
            if "graphrqi" in chosen:
                yield [
                    row
                    for d in sorted(settings.sizes)
                    for row in path_rows(
                        layout, kind, d, settings.pairs, settings.steps, 0, settings.budget_s
                    )
                ]
        for layout in settings.graphs:
            yield convergence_rows(layout)
    yield slope_rows(rows)
    if settings.study and "graphrqi" in chosen:
        yield study_rows(settings.study, settings.largest)


def _warm_up(solvers: Mapping[str, Solver], ends: Sequence[End], pairs: int) -> None:
    """Load and compile everything once, untimed, also what large graphs need."""
    for end in ends:
        start = list(graph_sequence("road", "accumulated", 40, 2))
        for solver in solvers.values():
            first = solver(start[0], 4, end, None, TOLERANCE, end == "smallest")
            solver(start[1], 4, end, first, TOLERANCE, end == "smallest")
    previous: Spectrum | None = None
    for graph in graph_sequence("road", "accumulated", 700, 3):
        previous = SOLVERS["graphrqi"](graph, pairs, "largest", previous)


def _sequence_rows(
    settings: Settings, solvers: Mapping[str, Solver], layout: str, kind: str, end: End
) -> Iterator[list[Row]]:
    """The rows of one kind of sequence, from few vehicles to many."""
    costs: dict[str, list[tuple[int, float]]] = {name: [] for name in solvers}
    for d in sorted(settings.sizes):
        print(f"{layout}, {kind}, {end} end, {d} vehicles", file=sys.stderr, flush=True)
        reasons = {name: why_not(name, d, costs[name]) for name in solvers}
        key = {"d": d, "graph": layout, "kind": kind, "end": end}
        rows = [
            skipped_row({"solver": name, **key}, reason)
            for name, reason in reasons.items()
            if reason is not None
        ]
        measured = measure_sequence(
            {name: solver for name, solver in solvers.items() if reasons[name] is None},
            layout, kind, end, d, settings.pairs, settings.steps, TOLERANCE, 0, settings.budget_s,
        )  # fmt: skip
        for row in measured:
            if row["metric"] == "cpu_ms":
                costs[row["solver"]].append((d, row["value"]))
        yield rows + measured


BENCH: Final = Bench(
    name="spectrum",
    summary="Measure every eigenvalue algorithm on the same graphs, in one process.",
    keys=("solver", "d", "graph", "kind", "end", "reason"),
    full=Settings(),
    quick=Settings(sizes=(25,), steps=5, study=25, largest=25),
    measure=measure,
    table=spectrum_table,
    plot=plot_spectrum,
)
