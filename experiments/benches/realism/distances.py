"""How far the distributions of simulated traffic lie from those of the recorded traffic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ks_2samp, wasserstein_distance

from experiments.benches.realism.likelihood import Kinematics, Motion

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

QUANTITIES: Final = (
    "speed_mps", "acceleration_mps2", "jerk_mps3", "time_headway_s", "time_to_collision_s",
    "lane_changes_per_km", "gap_accepted_s",
)  # fmt: skip
"""What is compared. The first five have a value at every step, a gap at every lane change, and the
rate of lane changes is one number."""

MOVING_MPS: Final = 1.0
"""Headways count from this speed on, m/s: standing, they are infinite."""

LONGEST_HEADWAY_S: Final = 10.0
"""Longer headways are no following, s."""


def samples(
    motion: Motion, moved: Kinematics, valid: BoolArray, scored: BoolArray
) -> dict[str, FloatArray]:
    """The values at every step of the future, by quantity; of the first five only.

    Args:
        motion: recorded, or one future.
        moved: of the same.
        valid: (n, H) which steps count.
        scored: (n,) whose.
    """
    counts = np.zeros(moved.speed.shape, dtype=bool)
    counts[:, motion.past :] = valid & scored[:, None]
    headway = moved.ahead / np.maximum(moved.speed, MOVING_MPS)
    follows = (moved.speed >= MOVING_MPS) & (headway < LONGEST_HEADWAY_S)
    closing = moved.ttc < moved.ttc.max(initial=5.0)
    found = {
        "speed_mps": (moved.speed, counts),
        "acceleration_mps2": (moved.accel, counts),
        "jerk_mps3": (moved.jerk, counts),
        "time_headway_s": (headway, counts & follows),
        "time_to_collision_s": (moved.ttc, counts & closing),
    }
    return {name: values[where & np.isfinite(values)] for name, (values, where) in found.items()}


def lane_changes(
    lane: IntArray, s: FloatArray, speed: FloatArray, length: FloatArray, beside: IntArray
) -> tuple[int, FloatArray]:
    """How often vehicles change to a lane beside, and the gaps that they leave to those behind.

    Args:
        lane: (n, T) lane of each at each step, -1 where it is not seen or on none.
        s: (n, T) distance along it, m.
        speed: (n, T) m/s.
        length: (n,) m.
        beside: (2, L) lanes to the left and right of each, -1 for none.

    Returns:
        How many changes, and the time gap from the vehicle behind on the new lane, s, of those
        that have one within `LONGEST_HEADWAY_S`.

    Examples:
        >>> lane = np.array([[0, 1], [1, 1]])
        >>> s = np.array([[30.0, 32.0], [10.0, 12.0]])
        >>> beside = np.array([[1, -1], [-1, 0]])
        >>> lane_changes(lane, s, np.full((2, 2), 10.0), np.full(2, 5.0), beside)
        (1, array([1.5]))
    """
    before, after = lane[:, :-1], lane[:, 1:]
    known = (before >= 0) & (after >= 0)
    side = np.zeros_like(known)
    for k in range(2):
        side |= beside[k, np.maximum(before, 0)] == after
    who, when = np.nonzero(known & side & (before != after))
    gaps: list[float] = []
    for i, t in zip(who.tolist(), (when + 1).tolist(), strict=True):
        behind = (lane[:, t] == lane[i, t]) & (s[:, t] < s[i, t])
        if behind.any():
            j = int(np.where(behind, s[:, t], -np.inf).argmax())
            gap = s[i, t] - s[j, t] - (length[i] + length[j]) / 2.0
            headway = max(gap, 0.0) / max(float(speed[j, t]), MOVING_MPS)
            if headway < LONGEST_HEADWAY_S:
                gaps.append(headway)
    return who.size, np.array(gaps)


def distances(recorded: FloatArray, simulated: FloatArray) -> dict[str, float]:
    """Two distances between samples of a quantity.

    Returns:
        ``wasserstein``: the mean distance that values have to be moved by, in the quantity's own
        unit; ``kolmogorov``: the largest difference of the distribution functions. NaN where one
        of them has no sample.

    Examples:
        >>> found = distances(np.array([0.0, 1.0]), np.array([1.0, 2.0]))
        >>> round(found["wasserstein"], 6), found["kolmogorov"]
        (1.0, 0.5)
    """
    if not recorded.size or not simulated.size:
        return {"wasserstein": float("nan"), "kolmogorov": float("nan")}
    return {
        "wasserstein": float(wasserstein_distance(recorded, simulated)),
        "kolmogorov": float(ks_2samp(recorded, simulated).statistic),
    }


def pooled(parts: Sequence[Mapping[str, FloatArray]], name: str) -> FloatArray:
    """All samples of one quantity."""
    return np.concatenate([part[name] for part in parts]) if parts else np.empty(0)
