"""The spectrum of a traffic graph: one contract, many eigenvalue algorithms.

Examples:
    >>> from graphrqi.graph import TrafficGraph
    >>> from graphrqi.spectrum import SOLVERS
    >>> star = TrafficGraph.from_edges([1, 2, 3, 4], [(1, 2), (1, 3), (1, 4)])
    >>> SOLVERS["graphrqi"](star, num_pairs=2).eigenvalues.round(6).tolist()
    [4.0, 1.0]
"""

from typing import Final

from behaviors.registry import Registry
from graphrqi.spectrum.certified.certificate import certify
from graphrqi.spectrum.contract import Solver, Spectrum

SOLVERS: Final[Registry[Solver]] = Registry(
    "solver",
    "graphrqi.solvers",
    {
        "graphrqi": "graphrqi.spectrum.certified.solver:solve",
        "graphrqi-paper": "graphrqi.spectrum.rivals:paper",
        "graphrqi-exact": "graphrqi.spectrum.rivals:exact",
        "eigh": "graphrqi.spectrum.libraries:eigh",
        "svd": "graphrqi.spectrum.libraries:svd",
        "truncated-svd": "graphrqi.spectrum.libraries:truncated_svd",
        "incremental-svd": "graphrqi.spectrum.rivals:incremental_svd",
        "restart-svd": "graphrqi.spectrum.rivals:restart_svd",
        "conjugate-gradient": "graphrqi.spectrum.rivals:conjugate_gradient",
        "arpack": "graphrqi.spectrum.libraries:arpack",
        "lobpcg": "graphrqi.spectrum.libraries:lobpcg",
    },
)
"""Every eigenvalue algorithm by name; the first is the default."""

__all__ = ["SOLVERS", "Solver", "Spectrum", "certify"]
