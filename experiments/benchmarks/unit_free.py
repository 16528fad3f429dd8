"""Features of a recording whose units are not known, such as a video in pixels.

Every feature is a ratio, an angle, or in the size of agents at the same height of the image.
Standardising each feature within its recording removes the units that remain. Positions are whole
pixels, so they are smoothed, and velocities are differenced over many frames. These are features
of a whole track, not of a stream: the whole recording is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from experiments.data.units import smoothed

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

SPAN_FRAMES: Final = 10
"""Frames over which velocities are differenced, and between the instants that are evaluated."""

STANDING: Final = 0.15
"""Agents slower than this share of the recording's median speed count as standing."""

NEIGHBORS: Final = 4
"""Nearest neighbours that an agent is compared with; the paper's graph joins as many."""

FLOW_RADIUS: Final = 1.5
"""Radius, in agent sizes, within which velocities at any time are averaged to the local flow."""

NAMES: Final = (
    "speed",
    "top speed",
    "unrest of speed",
    "share standing",
    "acceleration",
    "braking",
    "speed over neighbours",
    "top speed over neighbours",
    "speed rank",
    "along neighbours",
    "along flow",
    "share against flow",
    "across flow",
    "nearest",
    "nearest at the least",
    "front gap",
    "share with one in front",
    "closing",
    "passed",
    "was passed",
    "turning",
    "straightness",
    "way",
    "life",
    "aspect",
    "size",
)
"""Columns of `unit_free_features`."""


@dataclass(frozen=True, slots=True)
class _Instant:
    """Positions, velocities and sizes of the agents at one time."""

    rows: IntArray
    xy: FloatArray
    velocity: FloatArray
    scale: FloatArray


def scale_at(y: FloatArray, size: FloatArray) -> tuple[float, float]:
    """Size of agents as a function of the height in the image.

    Args:
        y: (N,) median height of each agent.
        size: (N,) its size.

    Returns:
        Level and slope of a straight line through log sizes, fitted to the least absolute error
        because large and small kinds of agents occur at all heights.
    """
    level, slope = float(np.median(np.log(size))), 0.0
    weight = np.ones(y.size)
    if y.size < 3 or np.ptp(y) == 0:
        return level, slope
    middle = y.mean()
    for _ in range(30):  # iteratively reweighted least squares
        design = np.stack([np.ones(y.size), y - middle], axis=1) * np.sqrt(weight)[:, None]
        found = np.linalg.lstsq(design, np.log(size) * np.sqrt(weight), rcond=None)[0]
        missed = np.abs(np.log(size) - found[0] - found[1] * (y - middle))
        weight = 1.0 / np.maximum(missed, 1e-3)
    return float(found[0] - found[1] * middle), float(found[1])


def _instants(xy: FloatArray, level: float, slope: float) -> list[_Instant]:
    out = []
    half = SPAN_FRAMES // 2
    for t in range(half, xy.shape[1] - half, SPAN_FRAMES):
        rows = np.flatnonzero(~np.isnan(xy[:, [t - half, t, t + half], 0]).any(axis=1))
        here = xy[rows, t]
        scale = np.exp(level + slope * here[:, 1])
        velocity = (xy[rows, t + half] - xy[rows, t - half]) / scale[:, None]
        out.append(_Instant(rows, here, velocity, scale))
    return out


def unit_free_features(xy: FloatArray, sides: FloatArray) -> FloatArray:
    """Features of whole tracks.

    Args:
        xy: (N, T, 2) centres of bounding boxes, in any unit, y up; NaN where unknown.
        sides: (N, 2) width and height of each bounding box.

    Returns:
        (N, F) columns named by ``NAMES``, each standardised within the recording; zero (the mean)
        where a track is too short.
    """
    n = len(xy)
    known = ~np.isnan(xy[..., 0])
    place = smoothed(xy)
    size = np.sqrt(sides.prod(axis=1))
    middle = np.array(
        [np.median(place[i, known[i], 1]) if known[i].any() else 0.0 for i in range(n)]
    )
    level, slope = scale_at(middle, size)
    instants = _instants(place, level, slope)
    rows: list[list[tuple[float, ...]]] = [[] for _ in range(n)]
    flow = _Flow(instants)
    passed = np.zeros((n, 2))
    before: dict[tuple[int, int], bool] = {}
    for at in instants:
        found, ahead = _instant_features(at, flow)
        for k, row in enumerate(at.rows):
            rows[int(row)].append(tuple(found[k]))
        for (one, other), in_front in ahead.items():
            if before.get((one, other), in_front) != in_front:
                passed[one, int(in_front)] += 1.0
        before |= ahead
    moving = [s[0] for track in rows for s in track if s[0] > 0]
    slow = STANDING * float(np.median(moving)) if moving else 0.0
    out = np.full((n, len(NAMES)), np.nan)
    for i, track in enumerate(rows):
        if track:
            out[i] = _summary(np.array(track), slow, passed[i], place[i, known[i]], size[i])
    life = known.sum(axis=1)
    out[:, NAMES.index("life")] = np.log1p(life)
    out[:, NAMES.index("aspect")] = np.log(sides[:, 0] / sides[:, 1])
    out[:, NAMES.index("size")] = np.log(size) - level - slope * middle
    return standardised(out)


def standardised(values: FloatArray) -> FloatArray:
    """Standardised columns, clipped at 4; zero where unknown."""
    out = np.zeros_like(values)
    for column in range(values.shape[1]):
        known = ~np.isnan(values[:, column])
        if not known.any():
            continue
        part = values[known, column]
        out[known, column] = np.clip((part - part.mean()) / (part.std() + 1e-9), -4.0, 4.0)
    return out


class _Flow:
    """Velocities of other agents at a place, at any time of the recording."""

    def __init__(self, instants: list[_Instant]) -> None:
        from scipy.spatial import cKDTree

        moving = [np.hypot(*at.velocity.T) > 1e-6 for at in instants]
        self._rows = np.concatenate(
            [a.rows[m] for a, m in zip(instants, moving, strict=True)] or [np.empty(0, np.int64)]
        )
        places = np.concatenate(
            [a.xy[m] for a, m in zip(instants, moving, strict=True)] or [np.empty((0, 2))]
        )
        self._velocity = np.concatenate(
            [a.velocity[m] for a, m in zip(instants, moving, strict=True)] or [np.empty((0, 2))]
        )
        self._tree = cKDTree(places) if len(places) else None

    def at(self, row: int, xy: FloatArray, radius: float) -> FloatArray:
        """Mean velocity near a place of all agents but one; zero if there is none."""
        if self._tree is None:
            return np.zeros(2)
        near = np.asarray(self._tree.query_ball_point(xy, radius), dtype=np.int64)
        near = near[self._rows[near] != row]
        return self._velocity[near].mean(axis=0) if near.size else np.zeros(2)


def _instant_features(at: _Instant, flow: _Flow) -> tuple[FloatArray, dict[tuple[int, int], bool]]:
    """(n, 11) features of each agent at one time, and which agent is in front of which."""
    n = at.rows.size
    out = np.full((n, 11), np.nan)
    speed = np.hypot(at.velocity[:, 0], at.velocity[:, 1])
    direction = at.velocity / np.where(speed > 0, speed, 1.0)[:, None]
    ahead_of: dict[tuple[int, int], bool] = {}
    out[:, 0] = speed
    out[:, 1:3] = at.velocity
    for k in range(n):
        current = flow.at(int(at.rows[k]), at.xy[k], FLOW_RADIUS * at.scale[k])
        pace = float(np.hypot(*current))
        if pace > 0 and speed[k] > 0:
            out[k, 3] = float(direction[k] @ current) / pace
            out[k, 4] = (
                abs(float(direction[k, 0] * current[1] - direction[k, 1] * current[0])) / pace
            )
        others = np.flatnonzero(np.arange(n) != k)
        if not others.size:
            continue
        relative = (at.xy[others] - at.xy[k]) / at.scale[k]
        distance = np.hypot(relative[:, 0], relative[:, 1])
        nearest = np.argsort(distance, kind="stable")[:NEIGHBORS]
        near = others[nearest]
        out[k, 5] = distance[nearest[0]]
        out[k, 6] = speed[k] - speed[near].mean()
        out[k, 7] = (speed[k] > speed[near]).mean()
        if speed[k] > 0:
            out[k, 8] = (direction[near] @ direction[k]).mean()
            forward = relative @ direction[k]
            left = direction[k, 0] * relative[:, 1] - direction[k, 1] * relative[:, 0]
            front = (forward > 0) & (np.abs(left) < 0.7) & (forward < 8.0)
            if front.any():
                first = others[front][np.argmin(forward[front])]
                out[k, 9] = forward[front].min()
                out[k, 10] = speed[k] - float(at.velocity[first] @ direction[k])
            with_me = (direction[others] @ direction[k] > 0.5) & (distance < 5.0)
            for j in np.flatnonzero(with_me):
                ahead_of[int(at.rows[k]), int(at.rows[others[j]])] = bool(forward[j] > 0)
    return out, ahead_of


def _summary(
    track: FloatArray, slow: float, passed: FloatArray, way: FloatArray, size: float
) -> FloatArray:
    """One row of features from the features of each instant."""

    def over(values: FloatArray, quantile: float | None = None) -> float:
        values = values[~np.isnan(values)]
        if not values.size:
            return float("nan")
        return float(values.mean() if quantile is None else np.quantile(values, quantile))

    speed, going = track[:, 0], track[:, 0] > slow
    change = np.diff(speed)
    angle = np.unwrap(np.arctan2(track[going, 2], track[going, 1]))
    path = float(np.hypot(*np.diff(way, axis=0).T).sum())
    net = float(np.hypot(*(way[-1] - way[0])))
    instants = len(track)
    return np.array(
        [
            over(speed),
            over(speed, 0.9),
            float(speed.std()),
            float((~going).mean()),
            over(np.maximum(change, 0.0)),
            over(np.maximum(-change, 0.0)),
            over(track[:, 6]),
            over(track[:, 6], 0.9),
            over(track[:, 7]),
            over(np.where(going, track[:, 8], np.nan)),
            over(np.where(going, track[:, 3], np.nan)),
            over(np.where(going & ~np.isnan(track[:, 3]), track[:, 3] < 0, np.nan)),
            over(np.where(going, track[:, 4], np.nan)),
            over(track[:, 5]),
            over(track[:, 5], 0.1),
            over(track[:, 9], 0.1),
            float((~np.isnan(track[:, 9])).mean()),
            over(track[:, 10], 0.9),
            passed[0] / instants,
            passed[1] / instants,
            float(np.abs(np.diff(angle)).mean()) if angle.size > 1 else float("nan"),
            net / path if path > 0 else 0.0,
            np.log1p(path / size),
            float("nan"),
            float("nan"),
            float("nan"),
        ]
    )
