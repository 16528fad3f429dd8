"""The answer of every eigenvalue algorithm: eigenpairs, and how far they can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphrqi.graph import TrafficGraph

End: TypeAlias = Literal["largest", "smallest"]
Floats: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Spectrum:
    """Eigenpairs of a traffic graph's Laplacian.

    Attributes:
        ids: (d,) the vehicle of each row of ``eigenvectors``.
        eigenvalues: (k,) descending for the largest end, ascending for the smallest.
        eigenvectors: (d, k) orthonormal columns.
        residuals: (k,) norms of L u - lambda u, as computed from the answer.
        certified: every residual is at most tol * max(1, lambda_max), the columns are
            orthonormal, and a count of the eigenvalues beyond the last one (Sylvester's law of
            inertia, or having them all) says that none was missed. False says only that this
            was not shown.
        graph: the graph the pairs belong to.
        end: which end of the spectrum.
        note: the solver's remark on this answer, such as that it fell back; or "".
        carried: what the same solver needs for its next step; None for most.
    """

    ids: NDArray[np.int64]
    eigenvalues: Floats
    eigenvectors: Floats
    residuals: Floats
    certified: bool
    graph: TrafficGraph
    end: End = "largest"
    note: str = ""
    carried: object = None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for array in (self.eigenvalues, self.eigenvectors, self.residuals):
            array.setflags(write=False)

    def __repr__(self) -> str:
        """How many pairs of how many vehicles, from where, and how far they can be trusted."""
        k, d = self.eigenvalues.size, self.ids.size
        parts = [f"{k} pair{'s' * (k != 1)} at the {self.end} end"]
        if k:
            parts[0] += f", eigenvalues {self.eigenvalues[0]:.6g} to {self.eigenvalues[-1]:.6g}"
        parts.append(f"{d} vehicle{'s' * (d != 1)}")
        if d:
            parts[-1] += f" with ids {self.ids.min()} to {self.ids.max()}"
        parts.append("certified" if self.certified else "not certified")
        if k:
            parts.append(f"residuals up to {self.residuals.max():.0e}")
        if self.note:
            parts.append(f"note: {self.note:.120}")
        return f"Spectrum({', '.join(parts)})"
