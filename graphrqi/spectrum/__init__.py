"""The spectrum of a traffic graph: one contract, many eigenvalue algorithms.

Example:
    >>> from graphrqi.graph import TrafficGraph
    >>> from graphrqi.spectrum import SOLVERS
    >>> star = TrafficGraph.from_edges([1, 2, 3, 4], [(1, 2), (1, 3), (1, 4)])
    >>> SOLVERS["graphrqi"](star, num_pairs=2).eigenvalues.round(6).tolist()
    [4.0, 1.0]
"""

from graphrqi.spectrum import eigh, exact
from graphrqi.spectrum.contract import Solver, Spectrum

SOLVERS: dict[str, Solver] = {
    "graphrqi": exact.solve,
    "graphrqi-exact": exact.solve,
    "eigh": eigh.solve,
}
"""Every eigenvalue algorithm by name; the first is the default."""

__all__ = ["SOLVERS", "Solver", "Spectrum"]
