"""The likelihood of what was recorded under simulated futures, as sim-agents challenges measure it.

32 futures of 8 s are simulated from a recorded second. Of every vehicle, each feature's values over
all futures and steps make a histogram, and the recorded values are looked up in it: the likelihood
of a feature is the exponential of the mean logarithm. For collisions and driving off the road the
share of futures in which it happens stands for the histogram. The meta metric is the weighted mean.

Ours differ from the challenge in the following. Steps at the end of which a central difference has
no next step are left out; there is no height; the road's edge is found on a grid of `CELL_M`, from
the lanes' widths, because maps here have lanes and no edges; where there is no map, the meta metric
is the mean of the other features, by their weights.

References:
    Montali et al. (2023), The Waymo Open Sim Agents Challenge, NeurIPS Datasets and Benchmarks,
        arXiv 2305.12032, sections 4.2 and 4.3; histograms and weights as in its 2024 edition.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, map_coordinates

from sim.road import Road

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Histogram:
    """How a feature's likelihood is estimated.

    Attributes:
        low: where the first bin begins; smaller values count there.
        high: where the last one ends; larger values count there.
        bins: how many.
        weight: in the meta metric.
        smoothing: added to every bin's count.
    """

    low: float
    high: float
    bins: int
    weight: float
    smoothing: float = 0.1


FEATURES: Final[dict[str, Histogram]] = {
    "linear_speed": Histogram(0.0, 25.0, 10, 0.05),
    "linear_acceleration": Histogram(-12.0, 12.0, 11, 0.05),
    "angular_speed": Histogram(-0.628, 0.628, 11, 0.05),
    "angular_acceleration": Histogram(-3.14, 3.14, 11, 0.05),
    "distance_to_nearest_object": Histogram(-5.0, 40.0, 10, 0.1),
    "collision_indication": Histogram(-0.5, 1.5, 2, 0.25, 0.001),
    "time_to_collision": Histogram(0.0, 5.0, 10, 0.1),
    "distance_to_road_edge": Histogram(-20.0, 40.0, 10, 0.1),
    "offroad_indication": Histogram(-0.5, 1.5, 2, 0.25, 0.001),
}
"""Every feature of the challenge: m, s, rad; the two indications are 0 or 1 for a whole future."""

CELL_M: Final = 0.5
"""Size of the cells by which the road's edge is found, m."""

MARGIN_M: Final = 45.0
"""The grid goes so far beyond the road, m: farther off than the last bin counts alike."""

SEAM_M: Final = 1.0
"""Gaps up to twice as wide are road: between lanes whose widths do not quite reach each other."""

ROUGH_M: Final = 0.1
"""Depths are found by the nearest cell, which is exact to so much, m."""

BEYOND_M: Final = 300.0
"""Where lanes end without a next one, the road goes straight on for so long, m: maps are cut from
the world, and who drives on for 8 s leaves them."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Vehicles over some steps: recorded, or one simulated future.

    Attributes:
        xy: (n, T, 2) centres, m.
        heading: (n, T) rad.
        valid: (n, T) who is there.
        length: (n,) m.
        width: (n,) m.
        step_s: time between steps, s.
        past: how many of the steps come before the future; only later ones are scored.
    """

    xy: FloatArray
    heading: FloatArray
    valid: BoolArray
    length: FloatArray
    width: FloatArray
    step_s: float
    past: int


def differences(values: FloatArray, step_s: float) -> FloatArray:
    """Central differences along the last axis; NaN at both ends.

    Examples:
        >>> differences(np.array([0.0, 1.0, 4.0, 9.0]), 1.0).tolist()
        [nan, 2.0, 4.0, nan]
    """
    out = np.full(values.shape, np.nan)
    out[..., 1:-1] = (values[..., 2:] - values[..., :-2]) / (2.0 * step_s)
    return out


def _turned(values: FloatArray, step_s: float) -> FloatArray:
    """Central differences of angles, rad/s: of the two ways to turn, the shorter."""
    out = np.full(values.shape, np.nan)
    change = values[..., 2:] - values[..., :-2]
    out[..., 1:-1] = ((change + np.pi) % (2.0 * np.pi) - np.pi) / (2.0 * step_s)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Kinematics:
    """What the features and the distributions are made of, each (n, T).

    Attributes:
        speed: m/s.
        accel: of the speed, m/s2.
        jerk: m/s3.
        turn: rad/s.
        turn_accel: rad/s2.
        nearest: distance to the nearest other outline, m; below 0 if they overlap.
        ahead: gap to the vehicle ahead, m; +inf without one.
        ttc: time to collision with it, s.
    """

    speed: FloatArray
    accel: FloatArray
    jerk: FloatArray
    turn: FloatArray
    turn_accel: FloatArray
    nearest: FloatArray
    ahead: FloatArray
    ttc: FloatArray


def kinematics(motion: Motion) -> Kinematics:
    """Speeds, accelerations and distances of everybody."""
    from experiments.benches.realism.kernels import neighbours

    there, h = motion.valid, motion.step_s
    xy = np.where(there[..., None], motion.xy, np.nan)
    heading = np.where(there, motion.heading, np.nan)
    velocity = np.stack([differences(xy[..., k], h) for k in range(2)])
    speed = np.hypot(velocity[0], velocity[1])
    accel = differences(speed, h)
    turn = _turned(heading, h)
    nearest, ahead, ttc = neighbours(
        np.ascontiguousarray(motion.xy), np.ascontiguousarray(motion.heading), speed,
        motion.length, motion.width, np.ascontiguousarray(there),
    )  # fmt: skip
    return Kinematics(
        speed, accel, differences(accel, h), turn, differences(turn, h), nearest, ahead, ttc
    )


@dataclass(frozen=True, slots=True, eq=False)
class RoadEdge:
    """Signed distance to the edge of the road on a grid.

    Attributes:
        corner: (2,) centre of the first cell, m.
        distance: (W, H) m; below 0 on the road.
    """

    corner: FloatArray
    distance: FloatArray

    def of(self, xy: FloatArray) -> FloatArray:
        """(...) signed distance of (..., 2) places, m; NaN where a place is unknown."""
        cells = np.moveaxis((xy - self.corner) / CELL_M, -1, 0)
        known = np.isfinite(cells).all(axis=0)
        filled = np.where(known, cells, 0.0)
        found = map_coordinates(self.distance, filled, order=1, mode="nearest")
        return np.where(known, found, np.nan)


def road_edge(road: Road) -> RoadEdge:
    """The edge of the area that a road's lanes for vehicles cover.

    Args:
        road: its lanes' widths count.
    """
    lanes = [lane for lane in road.lanes if not lane.walking]
    onward = {link.from_lane for link in road.connections}
    lines = [
        (lane.centerline[:, :2] if lane.id in onward else _longer(lane.centerline[:, :2]))
        for lane in lanes
    ]
    points = np.concatenate(lines)
    corner = np.floor(points.min(axis=0) - MARGIN_M)
    size = np.ceil((points.max(axis=0) + MARGIN_M - corner) / CELL_M).astype(int) + 1
    beside = np.full(size, MARGIN_M)
    for lane, line in zip(lanes, lines, strict=True):
        _approach(beside, corner, line, lane.width_m / 2.0)
    seam = _depth(beside - SEAM_M) - SEAM_M
    beside = np.where(seam > ROUGH_M, -seam, beside)
    off = distance_transform_edt(beside > 0.0) * CELL_M
    return RoadEdge(corner, np.where(beside > 0.0, np.minimum(beside, off), -_depth(beside)))


def _depth(beside: FloatArray) -> FloatArray:
    """How deep every cell lies within what others lie beside by so much, m; 0 in these."""
    away, nearest = distance_transform_edt(beside <= 0.0, return_indices=True)
    return np.asarray(np.where(beside <= 0.0, away * CELL_M - beside[tuple(nearest)], 0.0))


def _longer(line: FloatArray) -> FloatArray:
    """A line that goes straight on by `BEYOND_M` in parts of 10 m."""
    last = line[-1] - line[-2]
    ahead = last / max(float(np.hypot(*last)), 1e-9)
    beyond = np.arange(10.0, BEYOND_M + 1.0, 10.0)
    return np.concatenate([line, line[-1] + beyond[:, None] * ahead])


def _approach(beside: FloatArray, corner: FloatArray, line: FloatArray, half_m: float) -> None:
    """Lower the cells near a line to their distance from half a width around it, m."""
    reach = half_m + 2.0 * SEAM_M
    for begin, end in pairwise(line):
        low = np.floor((np.minimum(begin, end) - reach - corner) / CELL_M).astype(int)
        high = np.ceil((np.maximum(begin, end) + reach - corner) / CELL_M).astype(int) + 1
        rows, columns = np.mgrid[low[0] : high[0], low[1] : high[1]]
        xy = np.stack([rows, columns], axis=-1) * CELL_M + corner - begin
        along = end - begin
        share = np.clip(xy @ along / max(float(along @ along), 1e-9), 0.0, 1.0)
        away = np.hypot(*np.moveaxis(xy - share[..., None] * along, -1, 0)) - half_m
        cells = beside[low[0] : high[0], low[1] : high[1]]
        np.minimum(cells, away, out=cells)


def features(motion: Motion, moved: Kinematics, edge: RoadEdge | None) -> dict[str, FloatArray]:
    """(n, H) features at every step of the future, by name, without the two indications.

    Args:
        motion: with the past, which speeds at the first steps need.
        moved: of the same.
        edge: of the road; None where there is no map: then there is no distance to it.
    """
    found = {
        "linear_speed": moved.speed,
        "linear_acceleration": moved.accel,
        "angular_speed": moved.turn,
        "angular_acceleration": moved.turn_accel,
        "distance_to_nearest_object": moved.nearest,
        "time_to_collision": moved.ttc,
    }
    if edge is not None:
        forward = np.stack([np.cos(motion.heading), np.sin(motion.heading)], axis=-1)
        left = np.stack([-forward[..., 1], forward[..., 0]], axis=-1)
        long = forward * motion.length[:, None, None] / 2.0
        wide = left * motion.width[:, None, None] / 2.0
        corners = [motion.xy + p * long + q * wide for p in (-1, 1) for q in (-1, 1)]
        found["distance_to_road_edge"] = np.max([edge.of(corner) for corner in corners], axis=0)
    return {name: values[:, motion.past :] for name, values in found.items()}


def log_likelihood(recorded: FloatArray, simulated: FloatArray, how: Histogram) -> FloatArray:
    """(n, H) logarithms of the likelihood of recorded values, by each vehicle's own histogram.

    Args:
        recorded: (n, H) values; NaN gives NaN.
        simulated: (R, n, H) values of R futures; NaN counts nowhere.
        how: the histogram.

    Examples:
        >>> how = Histogram(0.0, 2.0, 2, 1.0, smoothing=0.0)
        >>> simulated = np.array([[[0.5]], [[0.5]], [[0.5]], [[1.5]]])
        >>> np.exp(log_likelihood(np.array([[0.2]]), simulated, how)).tolist()
        [[0.75]]
    """
    n = recorded.shape[0]
    width = (how.high - how.low) / how.bins

    def bins_of(values: FloatArray) -> NDArray[np.int64]:
        clipped = np.clip(np.nan_to_num(values, nan=how.low), how.low, how.high)
        return np.minimum((clipped - how.low) / width, how.bins - 1).astype(np.int64)

    counts = np.full((n, how.bins), how.smoothing)
    known = np.isfinite(simulated) | np.isinf(simulated)
    vehicle = np.broadcast_to(np.arange(n)[None, :, None], simulated.shape)
    np.add.at(counts, (vehicle[known], bins_of(simulated)[known]), 1.0)
    share = counts / counts.sum(axis=1, keepdims=True)
    found = np.log(share[np.arange(n)[:, None], bins_of(recorded)])
    return np.where(np.isnan(recorded), np.nan, found)


def likelihoods(
    recorded: Mapping[str, FloatArray],
    simulated: Mapping[str, FloatArray],
    valid: BoolArray,
    scored: BoolArray,
) -> dict[str, float]:
    """The likelihood of every feature and the ``meta`` metric, of one recorded instant.

    Args:
        recorded: (n, H) features.
        simulated: (R, n, H) features of R futures.
        valid: (n, H) who was recorded when; other steps do not count, in futures neither.
        scored: (n,) whose features are scored.

    Returns:
        By the names of `FEATURES`, 0 to 1, and ``meta``; NaN where nothing could be scored.
    """
    found: dict[str, float] = {}
    for name, how in FEATURES.items():
        if name.endswith("_indication"):
            source = (
                "distance_to_nearest_object" if name.startswith("coll") else "distance_to_road_edge"
            )
            if source not in recorded:
                continue
            sign = 1.0 if name.startswith("off") else -1.0
            happened, happens = (
                np.asarray(((sign * one > 0.0) & valid).any(axis=-1, keepdims=True), np.float64)
                for one in (recorded[source], simulated[source])
            )
            values = log_likelihood(happened, happens, how)
            counts = scored[:, None]
        elif name in recorded:
            values = log_likelihood(recorded[name], simulated[name], how)
            counts = valid & scored[:, None] & ~np.isnan(values)
        else:
            continue
        found[name] = float(np.exp(values[counts].mean())) if counts.any() else float("nan")
    weights = {name: FEATURES[name].weight for name in found}
    total = sum(weights.values())
    found["meta"] = sum(weights[name] * found[name] for name in weights) / total
    return found
