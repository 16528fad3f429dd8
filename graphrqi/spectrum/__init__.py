"""The spectrum of a traffic graph: one contract, many eigenvalue algorithms.

Examples:
    >>> from graphrqi.graph import TrafficGraph
    >>> from graphrqi.spectrum import SOLVERS
    >>> star = TrafficGraph.from_edges([1, 2, 3, 4], [(1, 2), (1, 3), (1, 4)])
    >>> SOLVERS["graphrqi"](star, num_pairs=2).eigenvalues.round(6).tolist()
    [4.0, 1.0]
"""

from graphrqi.spectrum.certified import solver
from graphrqi.spectrum.certified.solver import certify
from graphrqi.spectrum.contract import Solver, Spectrum
from graphrqi.spectrum.full import full_spectrum, topology
from graphrqi.spectrum.rivals import (
    arpack,
    conjugate_gradient,
    eigh,
    exact,
    incremental_svd,
    lobpcg,
    paper,
    restart_svd,
    svd,
    truncated_svd,
)

SOLVERS: dict[str, Solver] = {
    "graphrqi": solver.solve,
    "graphrqi-paper": paper.solve,
    "graphrqi-exact": exact.solve,
    "eigh": eigh.solve,
    "svd": svd.solve,
    "truncated-svd": truncated_svd.solve,
    "incremental-svd": incremental_svd.solve,
    "restart-svd": restart_svd.solve,
    "conjugate-gradient": conjugate_gradient.solve,
    "arpack": arpack.solve,
    "lobpcg": lobpcg.solve,
}
"""Every eigenvalue algorithm by name; the first is the default."""

__all__ = ["SOLVERS", "Solver", "Spectrum", "certify", "full_spectrum", "topology"]
