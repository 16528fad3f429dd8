"""The one table of what contradicts itself in a recording, and of the likeliest causes.

Files are passed on in other units than their formats have, with other angles, or with sides
exchanged. Nothing is guessed: what was found is said, beside the cause that explains it best.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from sim.frames import PEDESTRIAN, AgentKind, FloatArray, Tracks
from sim.scenario import DIMENSIONS_M
from sim.units import FACTORS

STEPS_S: Final = (0.002, 20.0)
"""Times between two positions of an agent that recordings have, s."""

TIMES: Final = {
    1e-3: "milliseconds had been taken for seconds, or microseconds for milliseconds",
    1e-6: "microseconds had been taken for seconds",
    1e-9: "nanoseconds had been taken for seconds",
    1e3: "seconds had been taken for milliseconds, or milliseconds for microseconds",
    1e6: "seconds had been taken for microseconds",
    1e9: "seconds had been taken for nanoseconds",
}
"""Causes of steps that no recording has, by the factor that makes them usual."""

DEGREE_M: Final = 111_195.0
"""Length of a degree of latitude, m."""

PLACES: Final = {
    1e3: "kilometres had been taken for metres",
    DEGREE_M: "degrees of longitude and latitude had been taken for metres",
    0.01: "centimetres had been taken for metres",
    0.001: "millimetres had been taken for metres",
}
"""Causes of speeds that no traffic has, by the factor that makes them usual."""

SPEEDS_MPS, USUAL_MPS = (0.15, 90.0), (1.0, 70.0)
"""Speeds of the faster agents of recordings: what they have at least and at most, and what is
usual once the cause is undone, m/s."""

SIZES: Final = {
    0.3048: "metres had been taken for feet",
    1 / 0.3048: "feet had been taken for metres",
    100.0: "centimetres had been taken for metres",
    1000.0: "millimetres had been taken for metres",
    0.001: "kilometres had been taken for metres",
}
"""Causes of sizes that no vehicles have, over those that are usual."""

NEAR: Final = 1.35
"""How near to a cause's factor sizes have to come, as a factor."""

WIDER: Final = 1.3
"""A vehicle that is wider than long by this factor has its sides exchanged."""

HEADINGS: Final[Mapping[str, Callable[[FloatArray], FloatArray]]] = {
    "radians had been taken for degrees": np.degrees,
    "degrees had been taken for radians": np.radians,
    "they were counted clockwise from north": lambda angle: np.pi / 2 - angle,
    "they were counted from north": lambda angle: np.pi / 2 + angle,
    "they were counted clockwise": np.negative,
    "they pointed backwards": lambda angle: angle + np.pi,
}
"""Causes of headings that contradict the motion, and what undoes them."""

CONTRADICTS, AGREES, UNEXPLAINED = 0.7, 0.9, 0.3
"""Mean cosine between an agent's headings and its motion: below the first they contradict each
other, above the second they agree; below the third they are doubted without a cause, too."""

CONTRADICTING: Final = 0.3
"""Share of the moving agents that must contradict before headings are doubted."""

MOVING_MPS, MOVED_M, LEAST_STEPS, LEAST_M = 2.0, 0.15, 5, 5.0
"""Speed and step above which motion has a direction; how many such steps of an agent, and how many
metres, make it known."""

TURN_RAD: Final = 2.1 * np.pi
"""Larger angles than this are no radians, or count turns."""

TOLERATED: Final = 1.25
"""Displacement over speed times time may be off by this factor (noise, and speeds that are
filtered, stay below; the next usual rate is at least 1.25 away)."""

COMPARED_MPS, LEAST_COMPARED, LEAST_COMPARED_M = 2.0, 20, 20.0
"""Only faster agents are compared, m/s (noise hides what slower ones do); steps and metres of
motion below which times are not compared with it."""

BREAK_STEPS: Final = 3.0
"""A time between two frames is a break if it is more than this many times the usual one."""

UNIT_NEAR: Final = 0.03
"""How near, relatively, to a unit's factor a ratio of speeds is in that unit."""

VEHICLES: Final = (AgentKind.CAR.code, AgentKind.BUS.code, AgentKind.TRUCK.code)


def doubts_of(tracks: Tracks, heading: FloatArray, *, sizes: bool) -> list[str]:
    """What contradicts itself in a recording, in metres as the format's units say, a sentence each.

    Headings (m,), rad, are as the file states them; NaN where they are taken from the motion.
    ``sizes`` says whether the file has sizes.
    """
    steps = _Steps(tracks)
    found = [_time_doubt(steps), _place_doubt(tracks, steps)]
    if sizes:
        found += [size_doubt(tracks), _side_doubt(tracks)]
    return [doubt for doubt in (*found, _heading_doubt(tracks, steps, heading)) if doubt]


class _Steps:
    """The steps of agents from one time to the next at which they are seen."""

    def __init__(self, tracks: Tracks) -> None:
        self.row = np.flatnonzero(~tracks.index.begins[1:])
        self.agent = tracks.index.agent[self.row]
        self.moved = tracks.row_xy[self.row + 1] - tracks.row_xy[self.row]
        time_s = tracks.time_s[tracks.index.step]
        self.time_s = time_s[self.row + 1] - time_s[self.row]
        self.way = np.hypot(self.moved[:, 0], self.moved[:, 1])


def _time_doubt(steps: _Steps) -> str | None:
    """Steps that no recording has."""
    low, high = STEPS_S
    if not steps.row.size or low <= (usual := float(np.median(steps.time_s))) <= high:
        return None
    cause = next((text for by, text in TIMES.items() if low <= usual * by <= high / 10), None)
    return f"found steps of {usual:.3g} s" + (f", as if {cause}" if cause else "")


def _place_doubt(tracks: Tracks, steps: _Steps) -> str | None:
    """Speeds that no traffic has, of agents that go somewhere."""
    n = len(tracks.names)
    path, lasted, *net = (
        np.bincount(steps.agent, values, n) for values in (steps.way, steps.time_s, *steps.moved.T)
    )
    seen = (np.bincount(steps.agent, minlength=n) >= LEAST_STEPS) & (path > 0)
    goes = seen & (np.hypot(*net) > 0.5 * path) & (lasted > 0)
    if not goes.any() or goes.sum() < 0.5 * seen.sum():
        return None
    fast = float(np.quantile(path[goes] / lasted[goes], 0.8))
    if SPEEDS_MPS[0] <= fast <= SPEEDS_MPS[1]:
        return None
    extent = float(np.ptp(tracks.row_xy, axis=0).max())
    in_degrees = bool((np.abs(tracks.row_xy) <= (180.0, 90.0)).all())
    for by, cause in PLACES.items():
        fits = USUAL_MPS[0] <= fast * by <= USUAL_MPS[1] and (by < 1 or extent < 5.0)
        if fits and (by != DEGREE_M or in_degrees):
            return f"found agents that go {fast:.2g} m/s, as if {cause}"
    return None


def size_doubt(tracks: Tracks) -> str | None:
    """The size of vehicles with its likeliest cause, if no vehicles have it; None if it fits."""
    usual = np.array([DIMENSIONS_M[kind][:2] for kind in AgentKind])[tracks.kind].prod(axis=1)
    some = np.isin(tracks.kind, VEHICLES)
    some = some if some.any() else np.ones(some.size, dtype=bool)
    ratio = float(np.median(np.sqrt(tracks.length * tracks.width / usual)[some]))
    cause = next((text for by, text in SIZES.items() if 1 / NEAR < ratio / by < NEAR), None)
    length = float(np.median(tracks.length[some]))
    return cause and f"found vehicles that are {length:.3g} m long, as if {cause}"


def _side_doubt(tracks: Tracks) -> str | None:
    """Sides that are exchanged."""
    vehicles = tracks.kind != PEDESTRIAN
    wider = int(np.sum(vehicles & (tracks.width > WIDER * tracks.length)))
    cause = "as if lengths and widths had been exchanged"
    return f"found {wider} of {vehicles.sum()} vehicles wider than long, {cause}" if wider else None


def _heading_doubt(tracks: Tracks, steps: _Steps, heading: FloatArray) -> str | None:
    """Headings that contradict where agents go."""
    speed = steps.way / np.maximum(steps.time_s, 1e-9)
    used = (speed > MOVING_MPS) & (steps.way > MOVED_M) & np.isfinite(heading[steps.row])
    used &= tracks.kind[steps.agent] != PEDESTRIAN
    n, who = len(tracks.names), steps.agent[used]
    course = np.arctan2(steps.moved[used, 1], steps.moved[used, 0])
    stated = heading[steps.row[used]]
    count = np.bincount(who, minlength=n)
    known = (count >= LEAST_STEPS) & (np.bincount(who, steps.way[used], n) >= LEAST_M)

    def agreement(angle: FloatArray) -> FloatArray:
        return np.bincount(who, np.cos(angle - course), n)[known] / count[known]

    agrees = agreement(stated)
    against = int((agrees < CONTRADICTS).sum())
    turns = bool((np.abs(stated) > TURN_RAD).any()) and agrees.mean() < AGREES
    if not turns and against <= CONTRADICTING * agrees.size:
        return None
    causes = {text: float(agreement(undo(stated)).mean()) for text, undo in HEADINGS.items()}
    best = max(causes, key=lambda text: causes[text])
    if causes[best] <= AGREES and agrees.mean() > UNEXPLAINED:
        return None  # noise of slow agents
    as_if = f", as if {best}" if causes[best] > AGREES else ""
    return f"headings of {against} of {agrees.size} moving agents contradict the motion{as_if}"


def doubt_of_times(tracks: Tracks) -> str | None:
    """What contradicts the times of a recording, with the likeliest cause; None where they fit.

    Compared are how far agents go, and speed over time. Speeds that readers took from the motion
    fit by themselves.
    """
    if tracks.time_s.size < 2:
        return None
    steps, speed, n = _Steps(tracks), tracks.row_speed, len(tracks.names)
    before, after = speed[steps.row], speed[steps.row + 1]
    stated = (before + after) / 2 * steps.time_s
    # nobody knows how an agent went that was lost during a break
    used = (stated > 0) & (steps.time_s <= BREAK_STEPS * tracks.step_s)
    used &= np.minimum(before, after) > COMPARED_MPS
    who, way = steps.agent[used], steps.way[used]
    gone, said = np.bincount(who, way, n), np.bincount(who, stated[used], n)
    enough = (said > 0) & (gone > 0) & (np.bincount(who, minlength=n) >= 3)
    if who.size < LEAST_COMPARED or gone.sum() < LEAST_COMPARED_M or not enough.any():
        return None
    ratio = float(np.median(gone[enough] / said[enough]))
    if 1 / TOLERATED <= ratio <= TOLERATED:
        return None
    for unit in ("km/h", "mph", "ft/s"):
        if abs(ratio / FACTORS[unit] - 1) < UNIT_NEAR:
            return f"found speeds {1 / ratio:.3g} times what the motion shows, as in {unit}"
    return (
        f"found agents that go {ratio:.2f} times as far as their speeds say, at a step of "
        f"{tracks.step_s:.3g} s, as if it were {tracks.step_s * ratio:.3g} s"
    )
