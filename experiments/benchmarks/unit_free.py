"""Features of a recording whose units are not known, such as a video in pixels.

Every feature is a ratio, an angle, or in the size of agents at the same height of the image.
Standardising each feature within its recording removes the units that remain. Positions are whole
pixels, so they are smoothed, and velocities are differenced over many frames. These are features
of a whole track, not of a stream: the whole recording is needed.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd

from experiments.data.units import smoothed
from sim.frames import CodeArray, FloatArray, IntArray

SPAN_FRAMES: Final = 10
"""Frames over which velocities are differenced, and between the instants that are evaluated."""

STANDING: Final = 0.15
"""Agents slower than this share of the recording's median speed count as standing."""

NEIGHBORS: Final = 4
"""Nearest neighbours that an agent is compared with; the paper's graph joins as many."""

FLOW_RADIUS: Final = 1.5
"""Radius, in agent sizes, within which velocities at any time are averaged to the local flow."""

FRONT: Final = (8.0, 0.7)
"""Somebody is in front within this far ahead and to the side, in agent sizes."""

BESIDE: Final = 5.0
"""Agents within this distance, in agent sizes, can pass each other."""


def unit_free_features(xy: FloatArray, sides: FloatArray) -> FloatArray:
    """Features of whole tracks.

    Args:
        xy: (N, T, 2) centres of bounding boxes, in any unit, y up; NaN where unknown.
        sides: (N, 2) width and height of each bounding box.

    Returns:
        (N, F) features, each standardised within the recording; zero (the mean) where a track is
        too short.
    """
    n, known = len(xy), ~np.isnan(xy[..., 0])
    place, size = smoothed(xy), np.sqrt(sides.prod(axis=1))
    way = [place[i, known[i]] for i in range(n)]
    middle = np.array([np.median(w[:, 1]) if len(w) else 0.0 for w in way])
    level, slope = scale_at(middle, size)
    seen = _instants(place, level, slope)
    agent = seen.groupby("agent")
    going = seen[seen["speed"] > STANDING * seen["speed"][seen["speed"] > 0].median()]
    moving = going.groupby("agent")
    change = agent["speed"].diff().groupby(seen["agent"])
    angle = pd.Series(np.arctan2(going["vy"], going["vx"]), index=going.index)
    turned = angle.groupby(going["agent"]).diff()
    turned = ((turned + np.pi) % (2 * np.pi) - np.pi).abs()
    against = (going["along_flow"] < 0).where(going["along_flow"].notna())
    length = np.array([np.hypot(*np.diff(w, axis=0).T).sum() for w in way])
    net = np.array([np.hypot(*(w[-1] - w[0])) if len(w) else 0.0 for w in way])
    evaluated = np.isin(np.arange(n), seen["agent"])
    features = {
        "speed": agent["speed"].mean(),
        "top speed": agent["speed"].quantile(0.9),
        "variation of speed": agent["speed"].std(ddof=0),
        "share standing": 1.0
        - (moving.size() / agent.size()).reindex(agent.size().index).fillna(0),
        "acceleration": change.apply(lambda one: one.clip(lower=0.0).mean()),
        "braking": change.apply(lambda one: (-one).clip(lower=0.0).mean()),
        "speed over neighbours": agent["over"].mean(),
        "top speed over neighbours": agent["over"].quantile(0.9),
        "speed rank": agent["rank"].mean(),
        "along neighbours": moving["along_neighbors"].mean(),
        "along flow": moving["along_flow"].mean(),
        "share against flow": against.groupby(going["agent"]).mean(),
        "across flow": moving["across_flow"].mean(),
        "nearest": agent["nearest"].mean(),
        "nearest at the least": agent["nearest"].quantile(0.1),
        "front gap": agent["gap"].quantile(0.1),
        "share with one in front": seen["gap"].notna().groupby(seen["agent"]).mean(),
        "closing": agent["closing"].quantile(0.9),
        "passed": agent["passed"].mean(),
        "was passed": agent["was_passed"].mean(),
        "turning": turned.groupby(going["agent"]).mean(),
        "straightness": np.where(evaluated, net / np.where(length > 0, length, 1.0), np.nan),
        "way": np.where(evaluated, np.log1p(length / size), np.nan),
        "duration": np.log1p(known.sum(axis=1)),
        "aspect": np.log(sides[:, 0] / sides[:, 1]),
        "size": np.log(size) - level - slope * middle,
    }
    return standardised(pd.DataFrame(features, index=range(n)).to_numpy(dtype=np.float64))


def scale_at(y: FloatArray, size: FloatArray) -> tuple[float, float]:
    """Size of agents as a function of the height in the image.

    Args:
        y: (N,) median height of each agent.
        size: (N,) its size.

    Returns:
        Level and slope of a straight line through log sizes, fitted to the least absolute error
        because large and small kinds of agents occur at all heights.
    """
    from scipy.optimize import least_squares

    wanted = np.log(size)
    if y.size < 3 or np.ptp(y) == 0:
        return float(np.median(wanted)), 0.0
    high = (y - y.mean()) / y.std()

    def missed(line: FloatArray) -> FloatArray:
        return np.asarray(wanted - line[0] - line[1] * high)

    begin = [float(np.median(wanted)), 0.0]
    found = least_squares(missed, begin, loss="soft_l1", f_scale=1e-3).x
    slope = float(found[1] / y.std())
    return float(found[0]) - slope * float(y.mean()), slope


def standardised(values: FloatArray) -> FloatArray:
    """Standardised columns, clipped at 4; zero where unknown."""
    table = pd.DataFrame(values)
    scaled = (table - table.mean()) / (table.std(ddof=0) + 1e-9)
    return np.asarray(scaled.clip(-4.0, 4.0).fillna(0.0), dtype=np.float64)


def _instants(place: FloatArray, level: float, slope: float) -> pd.DataFrame:
    """A line for each agent at each evaluated instant: what it does beside those around it."""
    half = SPAN_FRAMES // 2
    found = []
    for t in range(half, place.shape[1] - half, SPAN_FRAMES):
        rows = np.flatnonzero(~np.isnan(place[:, [t - half, t, t + half], 0]).any(axis=1))
        scale = np.exp(level + slope * place[rows, t, 1])
        velocity = (place[rows, t + half] - place[rows, t - half]) / scale[:, None]
        found.append((rows, place[rows, t], velocity, scale))
    columns = [np.concatenate(column) for column in zip(*found, strict=True)]
    flow = _local_flow(*columns)
    ahead = np.full((len(place), len(place)), -1, dtype=np.int8)
    lines, begin = [], 0
    for rows, xy, velocity, scale in found:
        now = flow[begin : begin + rows.size]
        begin += rows.size
        lines.append(_beside_others(rows, xy, velocity, scale, now, ahead))
    return pd.concat(lines, ignore_index=True)


def _local_flow(
    agent: FloatArray, xy: FloatArray, velocity: FloatArray, scale: FloatArray
) -> FloatArray:
    """(m, 2) mean velocity of other agents near each place at any time; zero without any."""
    from scipy.spatial import cKDTree

    moves = np.flatnonzero(np.hypot(*velocity.T) > 1e-6)
    flow = np.zeros_like(velocity)
    if moves.size:
        for at, near in enumerate(cKDTree(xy[moves]).query_ball_point(xy, FLOW_RADIUS * scale)):
            others = moves[near][agent[moves[near]] != agent[at]]
            if others.size:
                flow[at] = velocity[others].mean(axis=0)
    return flow


def _beside_others(
    rows: IntArray, xy: FloatArray, velocity: FloatArray, scale: FloatArray, flow: FloatArray,
    ahead: CodeArray,
) -> pd.DataFrame:  # fmt: skip
    """The agents of one instant; ``ahead`` (N, N) remembers who was in front of whom."""
    n, speed, pace = rows.size, np.hypot(*velocity.T), np.hypot(*flow.T)
    direction = velocity / np.where(speed > 0, speed, 1.0)[:, None]
    in_flow = np.where((pace > 0) & (speed > 0), pace, np.nan)
    line = pd.DataFrame({
        "agent": rows, "speed": speed, "vx": velocity[:, 0], "vy": velocity[:, 1],
        "along_flow": (direction * flow).sum(axis=1) / in_flow,
        "across_flow": np.abs(direction[:, 0] * flow[:, 1] - direction[:, 1] * flow[:, 0])
        / in_flow,
    })  # fmt: skip
    names = ["nearest", "over", "rank", "along_neighbors", "gap", "closing"]
    line[names], line[["passed", "was_passed"]] = np.nan, 0.0
    if n < 2:
        return line
    relative = (xy[None] - xy[:, None]) / scale[:, None, None]
    distance = np.hypot(relative[..., 0], relative[..., 1])
    np.fill_diagonal(distance, np.inf)
    near = np.argsort(distance, axis=1, kind="stable")[:, : min(NEIGHBORS, n - 1)]
    forward = np.einsum("kji,ki->kj", relative, direction)
    left = direction[:, None, 0] * relative[..., 1] - direction[:, None, 1] * relative[..., 0]
    front = (forward > 0) & (forward < FRONT[0]) & (np.abs(left) < FRONT[1])
    gap = np.where(front, forward, np.inf)
    leader, follows = gap.argmin(axis=1), front.any(axis=1)
    alike = direction @ direction.T
    line["nearest"] = distance.min(axis=1)
    line["over"] = speed - speed[near].mean(axis=1)
    line["rank"] = (speed[:, None] > speed[near]).mean(axis=1)
    along = np.take_along_axis(alike, near, axis=1).mean(axis=1)
    line["along_neighbors"] = np.where(speed > 0, along, np.nan)
    line["gap"] = np.where(follows, gap.min(axis=1), np.nan)
    closing = speed - (velocity[leader] * direction).sum(axis=1)
    line["closing"] = np.where(follows, closing, np.nan)
    with_me = (alike > 0.5) & (distance < BESIDE)
    here = np.ix_(rows, rows)
    now = np.where(with_me, forward > 0, ahead[here]).astype(np.int8)
    changed = (ahead[here] >= 0) & (now != ahead[here])
    line["passed"] = (changed & (now == 0)).sum(axis=1)
    line["was_passed"] = (changed & (now == 1)).sum(axis=1)
    ahead[here] = now
    return line
