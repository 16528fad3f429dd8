"""Does the map fit the recording? Before anything uses a map, moving vehicles must be in its lanes.

A position is inside if it is no farther from a lane's centre line than half the lane's width, and
drives in the lane's direction. Maps of another place, or in other coordinates, show at once. Where
one translation explains the difference, the map is shifted.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sim.frames import PEDESTRIAN, Tracks
from sim.road import Road

FloatArray = NDArray[np.float64]

MOVING_MPS: Final = 1.0
"""Slower agents do not count: parked cars stand beside lanes, m/s."""

MOST_POINTS: Final = 3_000
"""Positions that are looked at, evenly spread over all (1 % of standard error)."""

LEAST_POINTS: Final = 20
"""With fewer moving positions nothing can be told."""

TURN_M: Final = 1.5
"""How far a lane of the opposite direction counts as being away, half, m."""

SAMPLE_M: Final = 0.5
"""Distance of the points along centre lines that positions are compared with, m."""

ENOUGH: Final = 0.8
"""From this share inside on, a map fits as it is (good maps have .9 and more)."""

LEAST: Final = 0.6
"""Below this share a map is refused (of recordings on maps of other places, most have less than .3;
on their own all have .7 and more)."""

UNSURE_LEAST: Final = 0.3
"""The same where fewer than `SHIFT_VEHICLES` move: one may stray by itself."""

GAIN: Final = 0.1
"""Share that a translation must add to be made (ten standard errors)."""

NEAR_M: Final = 6.0
"""Up to this length a translation is an offset between two surveys, m."""

SHIFT_VEHICLES: Final = 8
"""Vehicles that must have moved for a translation: a few fit some lane anywhere."""

FAR_LEAST: Final = 0.9
"""Share inside after a longer translation: two coordinate systems of one place fit well, and roads
of two places may fit somewhere."""

FAR_BEYOND: Final = 0.1
"""How much more is inside than at any other place for a longer translation: straight roads fit
everywhere along themselves."""

OUT_M, CENTRED, PER_M = 3.0, 0.3, 0.001
"""Of translations with like shares inside, the one that leaves positions nearer to centre lines is
better, up to so many m, with this weight; and the shorter one, by so much per m."""

CELL_M: Final = 1.0
"""Cells in which translations are searched first, m."""

MOST_CELLS: Final = 2_048
"""Most cells along a side for that (2 km)."""

LIMIT_LOW, LIMIT_HIGH = 0.75, 1.35
"""Limits rule where the fastest speeds of vehicles, over the limits there, have their median in
this range (speeds in free traffic have .9 to 1.15 of the limit)."""

LEAST_VEHICLES: Final = 3
"""Vehicles that must have moved to tell whether limits rule."""


@dataclass(frozen=True)
class MapFit:
    """How a map fits a recording.

    Attributes:
        share: of moving positions inside lanes, of the map as it came; NaN where too few move.
        shifted_share: the same after the shift.
        shift_m: the translation of the map, m; (0, 0) where it stays.
        limit_ratio: median over vehicles of their highest speed over the limit there; NaN where
            no limits are known or too few vehicles move.
        vehicles: how many move.
    """

    share: float
    shifted_share: float
    shift_m: tuple[float, float]
    limit_ratio: float
    vehicles: int = 0

    @property
    def sure(self) -> bool:
        """Whether enough vehicles move to blame the map where they are not inside."""
        return self.vehicles >= SHIFT_VEHICLES

    @property
    def fits(self) -> bool:
        """Whether the map may be used; so it is where nothing can be told."""
        return not self.shifted_share < (LEAST if self.sure else UNSURE_LEAST)

    @property
    def limits_rule(self) -> bool:
        """Whether traffic drives as the limits say; so it is where nothing can be told."""
        return math.isnan(self.limit_ratio) or LIMIT_LOW <= self.limit_ratio <= LIMIT_HIGH

    def notes(self) -> tuple[str, ...]:
        """What was found, one sentence each."""
        if math.isnan(self.share):
            return ("too little moves to tell whether the map fits",)
        told = []
        if self.shift_m != (0.0, 0.0):
            x, y = self.shift_m
            told.append(
                f"the map is shifted by ({x:.1f}, {y:.1f}) m: then {self.shifted_share:.0%} of "
                f"moving positions are inside its lanes, and were {self.share:.0%}"
            )
        else:
            told.append(f"{self.share:.0%} of moving positions are inside the map's lanes")
        if not self.limits_rule:
            told.append(
                f"the map's limits do not rule: vehicles reach {self.limit_ratio:.0%} of them"
            )
        return tuple(told)


def map_fit(road: Road, tracks: Tracks) -> MapFit:
    """How a map fits a recording.

    Args:
        road: the map.
        tracks: the recording.

    Returns:
        The share inside, the shift that is needed, and how speeds compare with limits.
    """
    points = _moving(tracks)
    lanes = _Lanes.of(road)
    if len(points.xy) < LEAST_POINTS or lanes is None:
        return MapFit(math.nan, math.nan, (0.0, 0.0), math.nan)
    share = after = lanes.share(points.xy, points.heading)
    shift = np.zeros(2)
    if share < ENOUGH:
        shift, after = _translation(lanes, points, share)
    ratio = _limit_ratio(lanes, points, shift)
    moved = (float(shift[0]), float(shift[1]))
    return MapFit(share, after, moved, ratio, np.unique(points.agent).size)


def shifted(road: Road, shift_m: tuple[float, float]) -> Road:
    """A road moved by a translation, m."""
    if shift_m == (0.0, 0.0):
        return road
    by = np.array(shift_m)
    return dataclasses.replace(
        road,
        lanes=tuple(
            dataclasses.replace(lane, centerline=lane.centerline + by) for lane in road.lanes
        ),
        crossings=tuple(
            dataclasses.replace(c, centerline=c.centerline + by) for c in road.crossings
        ),
    )


@dataclass(frozen=True, eq=False)
class _Points:
    """Where vehicles move: position, m, heading, rad, speed, m/s, and whose it is."""

    xy: FloatArray
    heading: FloatArray
    speed: FloatArray
    agent: NDArray[np.int64]


def _moving(tracks: Tracks) -> _Points:
    rows = tracks.as_rows()
    drives = (tracks.kind != PEDESTRIAN)[rows.index.agent]
    moving = np.flatnonzero(drives & (rows.speed >= MOVING_MPS))
    if moving.size > MOST_POINTS:
        moving = moving[np.linspace(0, moving.size - 1, MOST_POINTS).astype(np.int64)]
    agent = rows.index.agent[moving]
    return _Points(rows.xy[moving], rows.heading[moving], rows.speed[moving], agent)


@dataclass(frozen=True, eq=False)
class _Lanes:
    """Points along the centre lines of all lanes for vehicles."""

    xy: FloatArray
    heading: FloatArray
    half_width: FloatArray
    limit: FloatArray
    tree: cKDTree

    @classmethod
    def of(cls, road: Road) -> _Lanes | None:
        """The points of a road; None where it has no lane of any length."""
        parts = [_sampled(lane.centerline) for lane in road.lanes if not lane.walking]
        driven = [lane for lane in road.lanes if not lane.walking]
        kept = [(lane, part) for lane, part in zip(driven, parts, strict=True) if len(part)]
        if not kept:
            return None
        table = np.concatenate([part for _, part in kept])
        sizes = [len(part) for _, part in kept]
        half = np.repeat([lane.width_m / 2 for lane, _ in kept], sizes)
        limit = np.repeat([lane.speed_limit_mps for lane, _ in kept], sizes)
        heading = table[:, 2]
        tree = cKDTree(_embedded(table[:, :2], heading))
        return cls(table[:, :2], heading, half, limit, tree)

    def nearest(self, xy: FloatArray, heading: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """(n,) the point that fits each position and heading best, and the distance to it, m."""
        at = np.asarray(self.tree.query(_embedded(xy, heading))[1], dtype=np.int64)
        return at, np.hypot(*(self.xy[at] - xy).T)

    def share(self, xy: FloatArray, heading: FloatArray) -> float:
        """The share of positions inside lanes."""
        at, away = self.nearest(xy, heading)
        same_way = np.cos(self.heading[at] - heading) > 0
        return float(np.mean((away <= self.half_width[at] + SAMPLE_M / 4) & same_way))

    def closeness(self, xy: FloatArray, heading: FloatArray) -> float:
        """The share of positions inside lanes, less how far all are from centre lines."""
        at, away = self.nearest(xy, heading)
        same_way = np.cos(self.heading[at] - heading) > 0
        inside = (away <= self.half_width[at] + SAMPLE_M / 4) & same_way
        return float(np.mean(inside - np.minimum(away, OUT_M) / OUT_M * CENTRED))


def _embedded(xy: FloatArray, heading: FloatArray) -> FloatArray:
    """(n, 4) places and directions, m: opposite directions are 2 `TURN_M` apart."""
    return np.column_stack([xy, TURN_M * np.cos(heading), TURN_M * np.sin(heading)])


def _sampled(line: FloatArray) -> FloatArray:
    """(n, 3) x, y and heading of points along a line, about every `SAMPLE_M`."""
    step = np.diff(line, axis=0)
    size = np.hypot(step[:, 0], step[:, 1])
    kept = size > 1e-9
    start, step, size = line[:-1][kept], step[kept], size[kept]
    if not size.size:
        return np.empty((0, 3))
    along = np.concatenate([[0.0], np.cumsum(size)])
    count = int(min(along[-1] / SAMPLE_M, 200_000)) + 1
    s = (np.arange(count) + 0.5) * (along[-1] / count)
    piece = np.clip(np.searchsorted(along, s, side="right") - 1, 0, size.size - 1)
    xy = start[piece] + (step / size[:, None])[piece] * (s - along[piece])[:, None]
    return np.column_stack([xy, np.arctan2(step[:, 1], step[:, 0])[piece]])


def _translation(lanes: _Lanes, points: _Points, share: float) -> tuple[FloatArray, float]:
    """The translation of the map that explains where vehicles move, and the share after it."""
    none = np.zeros(2)
    if np.unique(points.agent).size < SHIFT_VEHICLES:
        return none, share
    few = np.linspace(0, len(points.xy) - 1, min(len(points.xy), 600)).astype(np.int64)
    xy, heading = points.xy[few], points.heading[few]

    def best_of(candidates: FloatArray) -> FloatArray:
        scores = [lanes.closeness(xy - shift, heading) for shift in candidates]
        from_first = np.hypot(*(candidates - candidates.mean(axis=0)).T)
        return np.asarray(candidates[int(np.argmax(np.array(scores) - PER_M * from_first))])

    def refined(shift: FloatArray) -> FloatArray:
        for step_m in (0.5, 0.25, 0.1):
            shift = best_of(shift + _square(2 * step_m, step_m))
        return shift

    near = refined(best_of(_disc(NEAR_M, 1.0)))
    after = lanes.share(points.xy - near, points.heading)
    if after >= ENOUGH and after >= share + GAIN:
        return near, after
    if share >= LEAST:
        return none, share
    far = _far_translation(lanes, points)
    if far is None:
        return none, share
    far = refined(best_of(far + _square(2.0, 1.0)))
    after = lanes.share(points.xy - far, points.heading)
    return (far, after) if after >= FAR_LEAST else (none, share)


def _square(half_m: float, step_m: float) -> FloatArray:
    """(n, 2) shifts of a square grid around 0, m."""
    at = np.arange(-half_m, half_m + step_m / 2, step_m)
    return np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)


def _disc(radius_m: float, step_m: float) -> FloatArray:
    grid = _square(radius_m, step_m)
    return np.asarray(grid[np.hypot(*grid.T) <= radius_m])


def _far_translation(lanes: _Lanes, points: _Points) -> FloatArray | None:
    """The translation at which most positions meet lanes of their direction, if it is alone."""
    from scipy.signal import fftconvolve  # takes longer to import than most commands need to run

    lane_at, point_at = np.median(lanes.xy, axis=0), np.median(points.xy, axis=0)
    low = np.floor((lanes.xy - lane_at).min(axis=0) / CELL_M).astype(np.int64) - 3
    high = np.ceil((lanes.xy - lane_at).max(axis=0) / CELL_M).astype(np.int64) + 3
    first = np.floor((points.xy - point_at).min(axis=0) / CELL_M).astype(np.int64)
    last = np.ceil((points.xy - point_at).max(axis=0) / CELL_M).astype(np.int64)
    if max(int((high - low).max()), int((last - first).max())) > MOST_CELLS:
        return None
    total = None
    for quarter in range(4):
        direction = quarter * math.pi / 2
        on = np.cos(lanes.heading - direction) > math.cos(math.radians(70))
        by = np.cos(points.heading - direction) > math.cos(math.radians(45))
        if not by.any() or not on.any():
            continue
        painted = _painted(lanes.xy[on] - lane_at, lanes.half_width[on], low, high)
        counted = np.zeros(last - first + 1)
        cell = np.floor((points.xy[by] - point_at) / CELL_M).astype(np.int64) - first
        np.add.at(counted, (cell[:, 0], cell[:, 1]), 1.0)
        met = fftconvolve(counted, painted[::-1, ::-1])
        total = met if total is None else total + met
    if total is None:
        return None
    share = total / len(points.xy)
    i, j = np.unravel_index(int(np.argmax(share)), share.shape)
    away = np.hypot(
        *np.meshgrid(np.arange(share.shape[0]) - i, np.arange(share.shape[1]) - j, indexing="ij")
    )
    if share[i, j] < share[away * CELL_M > 2 * NEAR_M].max(initial=0.0) + FAR_BEYOND:
        return None
    # index k of the convolution: point cell minus lane cell = k - (lane cells - 1) + offsets
    cells = np.array([i, j]) - (np.array(painted.shape) - 1) + first - low
    return np.asarray(point_at - lane_at + cells * CELL_M, dtype=np.float64)


def _painted(
    xy: FloatArray, half_width: FloatArray, low: NDArray[np.int64], high: NDArray[np.int64]
) -> FloatArray:
    """Cells that lanes cover, 1 inside and 0 outside."""
    cells = np.zeros(high - low + 1)
    for dx, dy in _square(3.0, CELL_M / 2):
        near = np.hypot(dx, dy) <= half_width
        at = np.floor((xy[near] + (dx, dy)) / CELL_M).astype(np.int64) - low
        inside = ((at >= 0) & (at < cells.shape)).all(axis=1)
        cells[at[inside, 0], at[inside, 1]] = 1.0
    return cells


def _limit_ratio(lanes: _Lanes, points: _Points, shift: FloatArray) -> float:
    """Median over vehicles of the highest speed over the limit there."""
    at, _ = lanes.nearest(points.xy - shift, points.heading)
    ratio = points.speed / lanes.limit[at]
    known = np.isfinite(ratio)
    vehicles = np.unique(points.agent[known])
    if vehicles.size < LEAST_VEHICLES:
        return math.nan
    fastest = np.zeros(vehicles.size)
    np.maximum.at(fastest, np.searchsorted(vehicles, points.agent[known]), ratio[known])
    return float(np.median(fastest))
