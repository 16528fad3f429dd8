"""Where every agent may be over the next seconds, and how likely each future is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.arrays import FloatArray, read_only

STEP_S: Final = 0.1
"""Time between predicted positions, s: the simulators' usual step."""


def coming_times(steps: int) -> FloatArray:
    """(H,) seconds from the present of each predicted position."""
    return np.arange(1, steps + 1, dtype=np.float64) * STEP_S


@dataclass(frozen=True, slots=True, repr=False)
class Prediction:
    """K possible futures of n agents at H coming times.

    Attributes:
        ids: (n,) agent ids, ascending.
        time_s: (H,) seconds from the present, above 0, increasing.
        xy: (n, K, H, 2) centres, m.
        probability: (n, K) of each future; rows sum to 1.
        spread: (n, K, H) standard deviation of each coordinate, m, or None.

    Examples:
        >>> one = Prediction([4], [1.0], np.zeros((1, 2, 1, 2)), [[0.3, 0.7]])
        >>> one.best.shape
        (1, 1, 2)
        >>> one
        Prediction(1 agent, 2 futures each, 1 time up to 1 s, without spread)
    """

    ids: NDArray[np.int64]
    time_s: FloatArray
    xy: FloatArray
    probability: FloatArray
    spread: FloatArray | None = None

    def __post_init__(self) -> None:
        """Check shapes, positions and probabilities, and make the arrays read-only."""
        ids, time_s = np.asarray(self.ids, np.int64), np.asarray(self.time_s, np.float64)
        xy, probability = np.asarray(self.xy, np.float64), np.asarray(self.probability, np.float64)
        n, h = ids.size, time_s.size
        if not (np.diff(ids) > 0).all():
            raise InputError(f"Prediction.ids: found {ids}, expected ascending ones")
        if not (np.diff(time_s, prepend=0.0) > 0.0).all():
            raise InputError(f"Prediction.time_s: found {time_s}, expected ascending ones above 0")
        if xy.ndim != 4 or xy.shape != (n, xy.shape[1], h, 2):
            raise InputError(f"Prediction.xy: found shape {xy.shape}, expected ({n}, K, {h}, 2)")
        if probability.shape != xy.shape[:2]:
            raise InputError(
                f"Prediction.probability: found shape {probability.shape}, expected {xy.shape[:2]}"
            )
        if not np.isfinite(xy).all():
            raise InputError("Prediction.xy: found positions that are not finite, expected metres")
        if n and not (
            np.abs(probability.sum(axis=1) - 1.0).max() <= 1e-5 and probability.min() > -1e-9
        ):
            raise InputError(
                "Prediction.probability: found negative ones or rows that do not sum to 1, "
                "expected probabilities"
            )
        if self.spread is not None:
            spread = np.asarray(self.spread, np.float64)
            if spread.shape != xy.shape[:3]:
                raise InputError(
                    f"Prediction.spread: found shape {spread.shape}, expected {xy.shape[:3]}"
                )
            if not (np.isfinite(spread) & (spread > 0.0)).all():
                raise InputError("Prediction.spread: found numbers up to 0 m, expected above 0")
            object.__setattr__(self, "spread", read_only(spread))
        for name, array in (
            ("ids", ids), ("time_s", time_s), ("xy", xy), ("probability", probability)
        ):  # fmt: skip
            object.__setattr__(self, name, read_only(array))

    @property
    def modes(self) -> int:
        """How many futures each agent has (K)."""
        return int(self.xy.shape[1])

    def until(self, horizon_s: float) -> Prediction:
        """The same futures up to a horizon, s."""
        keep = self.time_s <= horizon_s + 1e-6
        if keep.all():
            return self
        spread = None if self.spread is None else self.spread[:, :, keep]
        return replace(self, time_s=self.time_s[keep], xy=self.xy[:, :, keep], spread=spread)

    @property
    def best(self) -> FloatArray:
        """(n, H, 2) the most likely future of each agent, m."""
        return np.asarray(
            self.xy[np.arange(self.ids.size), self.probability.argmax(axis=1)], dtype=np.float64
        )

    def __repr__(self) -> str:
        """How many agents, futures and times there are, and the horizon."""
        n, k, h = self.xy.shape[:3]
        parts = [
            f"{n} agent{'s' * (n != 1)}", f"{k} future{'s' * (k != 1)} each",
            f"{h} time{'s' * (h != 1)}" + (f" up to {self.time_s[-1]:g} s" if h else ""),
            f"{'without' if self.spread is None else 'with'} spread",
        ]  # fmt: skip
        return f"Prediction({', '.join(parts)})"
