"""Whether a recording's times fit its motion: how far agents go, over their stated speeds.

Files that were resampled, or written by a tool that assumes a rate, state a wrong step: everything
then seems to drive several times faster or slower than its own speed. Where a format has no speeds,
readers take them from the motion, and both agree by themselves.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from sim.formats.common.recording import SHORTEST_S, row_motion
from sim.frames import Tracks

TOLERATED: Final = 1.25
"""Displacement over speed times time may be off by this factor (noise, and speeds that are
filtered, stay below; the next usual rate is at least 1.25 away)."""

MOVING_MPS: Final = 2.0
"""Only faster agents are compared, m/s (noise hides what slower ones do)."""

LEAST_STEPS, LEAST_M = 20, 20.0
"""Steps and metres of motion below which nothing can be told."""

USUAL_STEPS_S: Final = (0.02, 1 / 30, 0.04, 0.05, 0.08, 0.1, 0.12, 0.2, 0.25, 0.4, 0.5, 1.0)
"""Steps at which traffic is recorded, s."""

NEAR: Final = 0.08
"""A step this close, relatively, to a usual one is that one."""

UNITS: Final = {"km/h": 1 / 3.6, "miles/h": 0.44704, "feet/s": 0.3048}
"""Speeds in these units look like a wrong step; they are recognised by their exact factor."""

BREAK_STEPS: Final = 3.0
"""A time between two frames is a break if it is more than this many times the usual one."""

LEAST_STEP_S, MOST_STEP_S = 1e-3, 10.0
"""Steps that a recording may have; where the motion shows another, it is only said."""

UNIT_NEAR: Final = 0.03
"""How near, relatively, to a unit's factor."""


def displacement_over_speed(tracks: Tracks) -> float:
    """How far moving agents go, over speed times time; 1 where times are right.

    Args:
        tracks: any recording.

    Returns:
        The median over the agents; NaN where too little moves to tell.
    """
    rows = tracks.as_rows()
    agent, step = rows.index.agent, rows.index.step
    at = np.flatnonzero((agent[1:] == agent[:-1]) & (step[1:] == step[:-1] + 1))
    who, speed, speed_then = agent[at], rows.speed[at], rows.speed[at + 1]
    step_s = tracks.time_s[step[at + 1]] - tracks.time_s[step[at]]
    told = (speed + speed_then) / 2 * step_s
    # an agent moves by its own account or by its positions: a wrong step may hide either
    # and nobody knows how an agent went that was lost during a break
    going_on = (step_s > SHORTEST_S) & (step_s <= BREAK_STEPS * tracks.step_s)
    used = going_on & (told > 0) & (np.minimum(speed, speed_then) > MOVING_MPS)
    way = np.hypot(*(rows.xy[at + 1] - rows.xy[at])[used].T)
    n, who = tracks.ids.size, who[used]
    gone = np.bincount(who, way, n)
    said = np.bincount(who, told[used], n)
    if who.size < LEAST_STEPS or gone.sum() < LEAST_M:
        return float("nan")
    enough = (said > 0) & (gone > 0) & (np.bincount(who, minlength=n) >= 3)
    return float(np.median(gone[enough] / said[enough])) if enough.any() else float("nan")


def with_true_times(tracks: Tracks, clock: bool = False) -> tuple[Tracks, tuple[str, ...]]:
    """The tracks with times, or speeds, that fit the motion, and what was found.

    Args:
        tracks: as read.
        clock: whether the times are a clock's: then they stay, and what is found is only said.

    Returns:
        The same tracks where everything fits; else with times stretched to the step that the
        motion shows, or with speeds taken from the motion where they are in another unit; and one
        sentence about it.
    """
    if tracks.time_s.size < 2:
        return tracks, ()
    ratio = displacement_over_speed(tracks)
    if not np.isfinite(ratio) or 1 / TOLERATED <= ratio <= TOLERATED:
        return tracks, ()
    if clock or not LEAST_STEP_S <= tracks.step_s * ratio <= MOST_STEP_S:
        return tracks, (f"agents go {ratio:.2f} times as far as their speeds say",)
    for unit, factor in UNITS.items():
        if abs(ratio / factor - 1) < UNIT_NEAR:
            return _with_own_speeds(tracks), (
                f"speeds are {1 / ratio:.3g} times what the motion shows, as in {unit}: they are "
                "taken from the motion",
            )
    stated_s = tracks.step_s
    true_s = stated_s * ratio
    usual_s = min(USUAL_STEPS_S, key=lambda s: abs(np.log(s / true_s)))
    if abs(usual_s / true_s - 1) < NEAR:
        true_s = usual_s
    first = tracks.time_s[0]
    times = first + (tracks.time_s - first) * (true_s / stated_s)
    return tracks.changed(time_s=times), (
        f"the step is said to be {stated_s:.3g} s, and agents go {ratio:.2f} times as far as their "
        f"speeds say: taken to be {true_s:.3g} s",
    )


def _with_own_speeds(tracks: Tracks) -> Tracks:
    rows = tracks.as_rows()
    index = rows.index
    _, speed = row_motion(index.agent, rows.xy, tracks.time_s[index.step], 0.0)
    return tracks.changed(rows=dataclasses.replace(rows, speed=speed))
