"""Plausibility of a recording as a scene, by its positions and sizes.

Some recordings overlay actors of several scenes, have invented times, or reuse ids. Their drivers
cannot be classified. A finding counts only with enough evidence against sensor noise (up to half a
metre) and dense traffic.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from experiments.data.units import size_ratio, unit_of
from sim.frames import PEDESTRIAN, BoolArray, FloatArray, Tracks

LOOK_S: Final = 0.5
"""Time between looks at overlaps and speeds, s."""

CORE: Final = 0.5
"""Vehicles overlap where outlines of this share of their sizes do."""

LONGEST_CORE_M, LEAST_CORE_M = 2.5, 0.25
"""Longest core, m, less than a lane's width as headings may be wrong; and least core, m, for
sources without sizes."""

OVERLAPPING, OVERLAPPING_BOXES = 0.02, 0.2
"""A recording is not plausible if more than this share of its vehicles overlaps; the second value
holds where outlines are unknown."""

NEAREST_M: Final = 1.0
"""No scene, whatever the outlines, if half of the vehicles have another centre nearer than this."""

OVERLAPPING_IDS: Final = 6
"""Least number of different vehicles that overlap; a tracker may see one truck as two."""

MOVING_MPS: Final = 3.0
"""Only faster vehicles count for speeds."""

LOOKS: Final = 10
"""Fewest looks that say that a speed or a size is wrong."""

PACE: Final = 1.3
"""No scene if displacements are this many times longer or shorter than stated speeds make them."""

FAST_MPS: Final = 70.0
"""No traffic has a median speed above this, m/s."""

FASTEST_MPS, JUMP_M = 90.0, 5.0
"""Vehicles jump that go faster than this, m/s, and farther than this, m."""

JUMPING, JUMPING_IDS = 0.1, 3
"""A recording is not plausible if more than this share of the ids jumps, and this many different
ones."""

SIZED: Final = 3
"""Fewest vehicles whose sizes say that a unit is wrong."""

STILL_M: Final = 2.0
"""Vehicles that stay nearer to where they were first seen never moved, m."""


@dataclass(frozen=True, slots=True)
class SceneCheck:
    """Findings of the check.

    Attributes:
        is_scene: whether the recording is plausible.
        findings: what was found amiss, a sentence each; also what is not enough to doubt a scene.
        overlapping: share of the vehicles that overlap another, over all looks.
        nearest_m: median distance from a vehicle to the next centre, m; NaN of lone vehicles.
        pace: displacement over what stated speeds make it; NaN if not known.
        jumping: share of the ids that jump.
        still: share of the vehicles that never moved.
    """

    is_scene: bool
    findings: tuple[str, ...]
    overlapping: float
    nearest_m: float
    pace: float
    jumping: float
    still: float


@dataclass(frozen=True, slots=True)
class _Overlaps:
    """Findings of looks at a recording.

    Attributes:
        nearest_m: of every vehicle at every look, to the next centre.
        hits: how often a vehicle overlapped another.
        who: (N,) which did.
    """

    nearest_m: FloatArray
    hits: int
    who: BoolArray


def check_scene(tracks: Tracks, outlines: bool = True) -> SceneCheck:
    """Whether a recording is plausible as a scene.

    Args:
        tracks: positions in metres.
        outlines: whether lengths and widths are those of outlines on the ground. Boxes in an image
            overlap without touching.

    Returns:
        The verdict, with what was found amiss.

    Examples:
        Sixteen cars that drive on top of each other in pairs:

        >>> time_s, n = 0.1 * np.arange(50), np.arange(16)
        >>> x = 20.0 * (n % 8)[:, None] + 15.0 * time_s
        >>> xy = np.stack([x, 0.0 * x + 0.5 * (n > 7)[:, None]], axis=2)
        >>> ones = np.ones_like(x)
        >>> tracks = Tracks.of_dense(
        ...     ids=n, names=tuple(map(str, n)), kind=0 * n, length=4.5 * ones[:, 0],
        ...     width=1.8 * ones[:, 0], time_s=time_s, xy=xy, heading=0 * ones, speed=15 * ones,
        ...     valid=ones > 0, signals=np.empty((0, 50)))
        >>> check_scene(tracks).is_scene, check_scene(tracks.part(n[:8], slice(None))).is_scene
        (False, True)
    """
    tracks = tracks.part(np.flatnonzero(tracks.kind != PEDESTRIAN), slice(None))
    rows = tracks.rows
    seen: BoolArray = np.diff(rows.index.first) > 0
    count = int(seen.sum())
    if not count:
        return SceneCheck(True, (), 0.0, math.nan, math.nan, 0.0, math.nan)
    looks = _looks(tracks.time_s)
    overlaps = _overlaps(tracks, looks)
    looked = max(int(np.isin(rows.index.step, looks).sum()), 1)
    jumps = int(_jumps(tracks).sum())
    paces, speeds = _speeds(tracks, looks)
    pace = math.exp(float(np.mean(paces))) if paces.size else math.nan
    agent = rows.index.agent
    away = np.hypot(*(rows.xy - rows.xy[np.searchsorted(agent, agent)]).T)
    still = (count - np.unique(agent[away > STILL_M]).size) / count
    doubts, remarks = [], []
    of_overlap = overlaps.hits / looked
    nearest_m = float(np.median(overlaps.nearest_m)) if overlaps.nearest_m.size else math.nan
    overlapping = int(overlaps.who.sum())
    limit = OVERLAPPING if outlines else OVERLAPPING_BOXES
    near = 2 * int((overlaps.nearest_m < NEAREST_M).sum()) > max(looked, 2 * OVERLAPPING_IDS)
    if count >= OVERLAPPING_IDS and (
        near or (overlapping >= OVERLAPPING_IDS and of_overlap > limit)
    ):
        doubts.append(
            f"{of_overlap:.0%} of the vehicles lie within another one (median distance to the next "
            f"centre {nearest_m:.1f} m): actors are superimposed"
        )
    elif overlapping:
        remarks.append(f"{overlapping} of {count} vehicles overlap another")
    if paces.size >= LOOKS and abs(float(np.median(paces))) > math.log(PACE):
        doubts.append(
            f"vehicles go {pace:.2f} times as far as their stated speeds: the frame step or a unit "
            "is wrong"
        )
    doubts += _sizes(tracks, seen, outlines and len(looks) >= LOOKS)
    if speeds.size >= LOOKS and float(np.median(speeds)) > FAST_MPS:
        doubts.append(
            f"the median speed is {np.median(speeds):.0f} m/s: a unit or the clock is wrong"
        )
    if jumps:
        jumped = f"{jumps} of {count} ids jump from place to place"
        many = jumps >= JUMPING_IDS and jumps > JUMPING * count
        (doubts if many else remarks).append(jumped)
    if still > 0.5:
        remarks.append(f"{still:.0%} of the vehicles never move")
    return SceneCheck(
        not doubts, (*doubts, *remarks), of_overlap, nearest_m, pace, jumps / count, still
    )


def _looks(time_s: FloatArray) -> list[int]:
    """The frames that are looked at, `LOOK_S` apart."""
    looks: list[int] = []
    for step, time in enumerate(time_s.tolist()):
        if not looks or time >= time_s[looks[-1]] + LOOK_S - 1e-6:
            looks.append(step)
    return looks


def _overlaps(tracks: Tracks, looks: list[int]) -> _Overlaps:
    """Find which vehicles lie within others, and how near centres are."""
    nearest: list[FloatArray] = []
    hits, who = 0, np.zeros(tracks.ids.size, dtype=bool)
    sides = np.stack([tracks.length, tracks.width], axis=1)
    seen = tracks.rows
    for step in looks:
        here = seen.index.at(step)
        if here.size < 2:
            continue
        rows, xy = seen.index.agent[here], seen.xy[here]
        tree = cKDTree(xy)
        nearest.append(np.asarray(tree.query(xy, k=2)[0])[:, 1])
        pairs = tree.query_pairs(LONGEST_CORE_M * math.sqrt(2.0), output_type="ndarray")
        one, other = np.concatenate([pairs, pairs[:, ::-1]]).T
        away, heading = xy[other] - xy[one], seen.heading[here[one]]
        cos, sin = np.cos(heading), np.sin(heading)
        along = np.abs(cos * away[:, 0] + sin * away[:, 1])
        across = np.abs(cos * away[:, 1] - sin * away[:, 0])
        core = 0.5 * CORE * (sides[rows[one]] + sides[rows[other]])
        core = np.clip(core, LEAST_CORE_M, LONGEST_CORE_M)
        found = np.unique(one[(along < core[:, 0]) & (across < core[:, 1])])
        hits += found.size
        who[rows[found]] = True
    return _Overlaps(np.concatenate([np.empty(0), *nearest]), hits, who)


def _jumps(tracks: Tracks) -> BoolArray:
    """(N,) which agents go faster than any vehicle from one frame to the next."""
    rows = tracks.rows
    agent, step = rows.index.agent, rows.index.step
    at = np.flatnonzero(~rows.index.begins[1:])
    moved = np.hypot(*(rows.xy[at + 1] - rows.xy[at]).T)
    far = FASTEST_MPS * np.diff(tracks.time_s)[step[at]] + JUMP_M
    return np.bincount(agent[at[moved > far]], minlength=tracks.ids.size) > 0


def _speeds(tracks: Tracks, looks: list[int]) -> tuple[FloatArray, FloatArray]:
    """Logarithms of displacements over what stated speeds make them, and speeds, look by look."""
    paces, speeds = [], []
    rows = tracks.rows
    for first, last in itertools.pairwise(looks):
        then, before = rows.index.at(last), rows.index.at(first)
        _, one, other = np.intersect1d(
            rows.index.agent[before], rows.index.agent[then], return_indices=True
        )
        before, then = before[one], then[other]
        passed_s = tracks.time_s[last] - tracks.time_s[first]
        travelled = np.hypot(*(rows.xy[then] - rows.xy[before]).T)
        stated = 0.5 * (rows.speed[before] + rows.speed[then]) * passed_s
        moving = travelled * stated > (MOVING_MPS * passed_s) ** 2
        if moving.any():
            paces.append(float(np.median(np.log(travelled[moving] / stated[moving]))))
        fast = travelled > MOVING_MPS * passed_s
        if fast.any():
            speeds.append(float(np.median(travelled[fast])) / passed_s)
    return np.array(paces), np.array(speeds)


def _sizes(tracks: Tracks, seen: BoolArray, known: bool) -> list[str]:
    """Whether vehicles are as large as if feet or millimetres were metres."""
    if not known or seen.sum() < SIZED:
        return []
    ratio = size_ratio(tracks.length[seen], tracks.width[seen], tracks.kind[seen])
    unit = unit_of(ratio)
    if unit is None:
        return []
    return [f"vehicles are {ratio:.3g} times as large as usual: {unit} seem to be metres"]
