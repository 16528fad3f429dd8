"""What positions tell of motion: headings and speeds."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim.frames import FloatArray, Tracks

MOVING_MPS: Final = 0.5
"""From this speed on, the direction of motion is taken for the heading (noise of some centimetres
at 10 Hz is slower)."""

SHORTEST_S: Final = 1e-6
"""Times closer than this give no velocity, s (far below any sampling interval)."""


def motion(
    xy: FloatArray, time_s: FloatArray, rest_heading: float
) -> tuple[FloatArray, FloatArray]:
    """Heading and speed from positions, as `row_motion` has them.

    Args:
        xy: (n, t, 2) m; NaN where not valid.
        time_s: (t,) s.
        rest_heading: rad.

    Returns:
        (n, t) heading, rad, and (n, t) speed, m/s; NaN where not valid.
    """
    agent, step = np.nonzero(np.isfinite(xy[..., 0]))
    found = row_motion(agent, xy[agent, step], time_s[step], rest_heading)
    heading, speed = np.full(xy.shape[:2], np.nan), np.full(xy.shape[:2], np.nan)
    heading[agent, step], speed[agent, step] = found
    return heading, speed


def row_motion(
    agent: NDArray[np.int64], xy: FloatArray, time_s: FloatArray, rest_heading: float
) -> tuple[FloatArray, FloatArray]:
    """(m,) heading, rad, and (m,) speed, m/s, from positions.

    The velocity at each time is the difference of the neighbouring positions of the agent
    (one-sided at the ends). Below ``MOVING_MPS`` the heading is held, see `hold_heading`.

    Args:
        agent: (m,) ascending.
        xy: (m, 2) m.
        time_s: (m,) s, ascending for each agent.
        rest_heading: rad.
    """
    row = np.arange(agent.size)
    same = agent[1:] == agent[:-1]
    before, after = row.copy(), row.copy()
    before[1:][same] -= 1
    after[:-1][same] += 1
    passed = time_s[after] - time_s[before]
    moved = xy[after] - xy[before]
    velocity = np.divide(
        moved, passed[:, None], out=np.zeros_like(moved), where=passed[:, None] > SHORTEST_S
    )
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    direction = np.arctan2(velocity[:, 1], velocity[:, 0])
    return hold_heading(agent, direction, speed >= MOVING_MPS, rest_heading), speed


def hold_heading(
    agent: NDArray[np.int64],
    direction: FloatArray,
    moving: NDArray[np.bool_],
    rest_heading: float,
) -> FloatArray:
    """(m,) directions, rad, in which times without motion have that of the last time in motion.

    Before the first such time it is that of the first, and ``rest_heading`` for agents that never
    move. The agents of the rows are ascending.
    """
    m = agent.size
    row = np.arange(m)
    begin = np.searchsorted(agent, agent)  # of its agent's rows
    last = np.maximum.accumulate(np.where(moving, row, -1))
    following = np.minimum.accumulate(np.where(moving, row, m)[::-1])[::-1]
    source = np.where(last >= begin, last, following)
    end = np.searchsorted(agent, agent, side="right")
    return np.where(source < end, direction[np.minimum(source, m - 1)], rest_heading)


def at_rate(tracks: Tracks, rate_hz: float) -> Tracks:
    """The tracks, of two times at least, with times stretched to another rate.

    Speeds that are those of the motion are taken from it again; stated ones stay.
    """
    first, index = tracks.time_s[0], tracks.index
    time_s = first + (tracks.time_s - first) / (rate_hz * tracks.step_s)
    before, after = (
        row_motion(index.agent, tracks.row_xy, clock[index.step], 0.0)[1]
        for clock in (tracks.time_s, time_s)
    )
    speed = np.where(np.isclose(tracks.row_speed, before, rtol=1e-9), after, tracks.row_speed)
    return replace(tracks, row_speed=speed, time_s=time_s)
