"""Whether frames show a scene that can be believed, told from the frames alone.

Recordings are passed on in which actors of several scenes lie on top of each other, times were
rounded or made up, or ids were given to one agent after another. Nothing can be said about how
anybody drives there. Six things are looked at, and each counts only once there is enough evidence
that it is no noise of a sensor (up to half a metre) and no dense traffic:

- overlap: vehicles whose centres lie within each other;
- shaken clock: all vehicles together faster in one frame and slower in the next, by more than the
  differences between them explain;
- repeated frames: moving vehicles that all stay where they were for a frame;
- pace: displacements that do not fit the stated speeds;
- jumps: ids that go faster than any vehicle;
- unit: vehicles that are as large as if feet or millimetres were metres, or traffic that is faster
  than any.

`SceneMonitor` takes frame after frame, as a stream does; `check_scene` takes a recording.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.kinematics import align
from graphrqi.scene_evidence import JUMPED, MOVED, OVERLAPS, Roll, RunningMean
from graphrqi.units import size_ratio, unit_of
from sim.frames import Frame, Tracks

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LOOK_S: Final = 0.5
"""Time between looks at overlaps, s (who overlaps now mostly does so a step later)."""

ANCHORS: Final = 100
"""Most vehicles whose neighbours are looked at in one look, taken in turn (it bounds the cost among
thousands)."""

CORE: Final = 0.5
"""Vehicles overlap where outlines of this share of their sizes do: half, so that two cars are less
than half a length and half a width apart. A position error of half a metre on both makes that of
neighbours in adjacent lanes of 2.8 m once in 300 times."""

CORE_LENGTH_M: Final = 2.5
"""Longest core, m (less than a lane's width: headings may be wrong)."""

OVERLAPPING: Final = 0.02
"""No scene if more than this share of the vehicles overlaps (noisy simulated traffic with errors of
half a metre has 0.001, recordings of real roads less; actors of two scenes of a motorway put
together have 0.02, of three 0.08)."""

OVERLAPPING_UNSURE: Final = 0.2
"""The same where outlines are not known (riders and those behind one another in a video come to
0.15)."""

NEAREST_M: Final = 1.0
"""No scene, whatever the outlines, if half of the vehicles have another centre nearer than this, m
(no two vehicles fit there; a clip of I-80 that is passed on has 0.67)."""

OVERLAPPING_IDS: Final = 6
"""So many different vehicles have to overlap before it counts (a tracker sees one truck as two)."""

REFERENCE_S: Final = 1.0
"""Time over which the velocity is taken that the next displacement is compared with, s."""

LOST_S: Final = 2.0
"""After a longer gap comparisons begin anew, s."""

MOVING_MPS: Final = 3.0
"""Only faster vehicles tell anything about clocks (noise is slower over a second)."""

MOVERS: Final = 4
"""Fewest vehicles that move at one time and tell about clocks."""

SHAKEN: Final = 0.2
"""No scene if steps last longer or shorter than stated by more than this share, as a standard
deviation (an acceleration over a second is then off by 2 m/s2 at 10 Hz and 15 m/s)."""

CLOCK_FRAMES: Final = 20
"""Fewest frames that say that a clock is shaken or that frames repeat."""

PACE_LOOKS: Final = 10
"""Fewest looks that say that a pace is wrong (five seconds)."""

REPEATED: Final = 0.1
"""No scene if more than this share of the frames repeats the one before."""

PACE: Final = 1.3
"""No scene if displacements are this many times longer or shorter than stated speeds make them
(less than between m/s and any other unit of speed, more than any calibration error)."""

FASTEST_MPS: Final = 90.0
"""Faster ones jump, m/s (above the top speed of production cars but a few)."""

JUMP_M: Final = 5.0
"""And farther than this, m (ten times the largest noise)."""

JUMPING: Final = 0.1
"""No scene if more than this share of the ids jumps."""

SIZED: Final = 3
"""Fewest vehicles whose sizes say that a unit is wrong."""

JUMPING_IDS: Final = 3
"""So many different ids have to jump before it counts."""

SURE: Final = 3.0
"""Standard errors by which the evidence has to exceed a threshold."""

FAST_MPS: Final = 70.0
"""No traffic has a median speed above this, m/s (250 km/h)."""

CORE_LEAST_M: Final = 0.25
"""Least core, m (for sources without sizes)."""

JERK_MPS3: Final = 3.0
"""Change of acceleration that a whole scene may show, m/s3 (a platoon at a light)."""

_NEAR_BIN_M: Final = 0.1
_NEAR_BINS: Final = 500


@dataclass(frozen=True, slots=True)
class SceneCheck:
    """What was found.

    Attributes:
        is_scene: whether what the frames show can be believed; if not, no driver can be classified.
        findings: what was found amiss, a sentence each; also what is not enough to doubt a scene.
        overlapping: share of the vehicles that overlap another, over all looks.
        nearest_m: median distance from a vehicle to the next centre, m; NaN of lone vehicles.
        shaken: standard deviation of the steps' true length over the stated one; NaN if not known.
        repeated: share of the frames with traffic that repeat the one before; NaN if not known.
        pace: displacement over what stated speeds make it; NaN if not known.
        jumping: share of the ids that jump.
        still: share of the vehicles that never moved.
    """

    is_scene: bool
    findings: tuple[str, ...]
    overlapping: float
    nearest_m: float
    shaken: float
    repeated: float
    pace: float
    jumping: float
    still: float


@dataclass(frozen=True, slots=True)
class _Seen:
    """The vehicles of a frame; ``company`` is another number whenever they are others."""

    time_s: float
    ids: IntArray
    xy: FloatArray
    speed: FloatArray
    company: int


class SceneMonitor:
    """Gathers evidence frame by frame; `check` says what it amounts to so far.

    One update takes less than 0.1 ms among 100 vehicles, on average over frames.

    Args:
        outlines: whether lengths and widths are those of outlines on the ground. Boxes in an image
            overlap without touching: only many of them, or centres that coincide, are a reason for
            doubt then.
    """

    def __init__(self, outlines: bool = True) -> None:
        self._outlines = outlines
        self._recent: deque[_Seen] = deque()
        self._roll = Roll()
        self._look_s = -math.inf
        self._companies = self._turn = self._looked = self._hits = 0
        self._nearest = np.zeros(_NEAR_BINS, dtype=np.int64)
        self._last_gain: tuple[float, float] | None = None
        self._shake, self._pace, self._size, self._speed = (
            RunningMean(),
            RunningMean(),
            RunningMean(),
            RunningMean(),
        )
        self._moving_frames = self._repeats = 0

    def update(self, frame: Frame) -> bool:
        """Take the next frame.

        Args:
            frame: later than the one before.

        Returns:
            Whether what was seen so far can be believed, as `check` says.
        """
        drives = frame.driving
        whole = bool(drives.all())
        ids, xy = (frame.ids, frame.xy) if whole else (frame.ids[drives], frame.xy[drives])
        recent = self._recent
        if recent and frame.time_s - recent[-1].time_s > LOST_S:
            recent.clear()
            self._last_gain = None
        while len(recent) > 2 and recent[1].time_s < frame.time_s - REFERENCE_S - 1e-6:
            recent.popleft()
        same = bool(recent) and np.array_equal(recent[-1].ids, ids)
        self._companies += not same
        speed = frame.speed if whole else frame.speed[drives]
        now = _Seen(frame.time_s, ids, xy, speed, self._companies)
        looks = now.time_s >= self._look_s + LOOK_S - 1e-6
        if recent:
            self._follow(recent[0], recent[-1], now)
        if looks and ids.size:
            self._look_s = now.time_s
            if recent:
                self._compare_speeds(recent[0], now)
            rows = self._roll.call(now.time_s, ids, xy)
            self._roll.look(rows, xy)
            chosen = slice(None) if whole else drives
            sides = np.stack([frame.length[chosen], frame.width[chosen]], axis=1)
            if self._outlines:
                ratio = size_ratio(sides[:, 0], sides[:, 1], frame.kind[chosen])
                self._size.add(math.log(max(ratio, 1e-9)))
            self._look(rows, xy, frame.heading[chosen], sides)
        recent.append(now)
        return self._is_scene()

    def _follow(self, past: _Seen, before: _Seen, now: _Seen) -> None:
        """Find ids that jump, and how far all went together."""
        into: IntArray | slice = slice(None)
        source: IntArray | slice = slice(None)
        if now.company != before.company:
            into, source = align(before.ids, now.ids)
        moved = now.xy[into] - before.xy[source]
        if not moved.size:
            self._last_gain = None
            return
        far = FASTEST_MPS * (now.time_s - before.time_s) + JUMP_M
        if np.abs(moved).max() > 0.7 * far:
            rows = self._roll.call(now.time_s, now.ids, now.xy)
            self._roll.mark(JUMPED, rows[into][np.hypot(moved[:, 0], moved[:, 1]) > far])
        passed_s = before.time_s - past.time_s
        if passed_s < 0.4 * REFERENCE_S:
            return
        earliest = source
        if before.company != past.company:
            also, earliest = align(past.ids, before.ids[source])
            moved = moved[also]
            source = also if isinstance(source, slice) else source[also]
        velocity = (before.xy[source] - past.xy[earliest]) / passed_s
        self._clock(moved, velocity, passed_s, now.time_s - before.time_s)

    def _clock(
        self, moved: FloatArray, velocity: FloatArray, passed_s: float, step_s: float
    ) -> None:
        """Find how much farther or less far than before all went together.

        Args:
            moved: (n, 2) displacements since the frame before, m.
            velocity: (n, 2) over the time before that, m/s.
            passed_s: how long that time was, s.
            step_s: time since the frame before, s.
        """
        gain, self._last_gain = self._last_gain, None
        squared = np.einsum("ij,ij->i", velocity, velocity)
        moving = squared > MOVING_MPS**2
        count = int(np.count_nonzero(moving))
        if count < MOVERS:
            return
        if count < moving.size:
            moved, velocity, squared = moved[moving], velocity[moving], squared[moving]
        self._moving_frames += 1
        if not moved.any():
            self._repeats += 1
            return
        energy = float(squared.sum()) * step_s
        share = float(np.vdot(moved, velocity)) / energy
        missed = moved - (share * step_s) * velocity
        variance = float(np.vdot(missed, missed)) / (2 * count - 1) / (energy * step_s)
        if gain is not None:
            jerked = JERK_MPS3 * step_s * 0.5 * (passed_s + step_s)
            by_jerk = jerked * jerked * step_s * count / energy
            by_noise = 1.5 * (variance + gain[1])
            self._shake.add(min((share - gain[0]) ** 2, 1.0) - by_noise - by_jerk)
        self._last_gain = share, variance

    def _compare_speeds(self, past: _Seen, now: _Seen) -> None:
        """Find how displacements fit stated speeds."""
        passed_s = now.time_s - past.time_s
        into, source = align(past.ids, now.ids)
        moved = now.xy[into] - past.xy[source]
        travelled = np.hypot(moved[:, 0], moved[:, 1])
        stated = 0.5 * (now.speed[into] + past.speed[source]) * passed_s
        moving = travelled * stated > (MOVING_MPS * passed_s) ** 2
        if passed_s < 0.4 * REFERENCE_S:
            return
        fast = travelled > MOVING_MPS * passed_s
        if fast.any():
            self._speed.add(float(np.median(travelled[fast])) / passed_s)
        if moving.any():
            ratio = np.maximum(travelled[moving] / stated[moving], np.finfo(np.float64).tiny)
            self._pace.add(float(np.median(np.log(ratio))))

    def _look(self, rows: IntArray, xy: FloatArray, heading: FloatArray, sides: FloatArray) -> None:
        """Count the vehicles that overlap another."""
        n = rows.size
        anchors = np.arange(n)
        if n > ANCHORS:
            anchors = (self._turn + np.arange(ANCHORS)) % n
            self._turn = (self._turn + ANCHORS) % n
        self._looked += anchors.size
        if n < 2:
            return
        apart = xy[None, :, 0] - xy[anchors, None, 0]
        squared = apart * apart
        apart = xy[None, :, 1] - xy[anchors, None, 1]
        squared += apart * apart
        squared[np.arange(anchors.size), anchors] = np.inf
        nearest = np.sqrt(squared.min(axis=1))
        into = np.minimum(nearest / _NEAR_BIN_M, _NEAR_BINS - 1).astype(np.int64)
        self._nearest += np.bincount(into, minlength=_NEAR_BINS)
        one, other = np.nonzero(squared < CORE_LENGTH_M**2 + CORE_LENGTH_M**2)
        if not one.size:
            return
        one = anchors[one]
        away = xy[other] - xy[one]
        cos, sin = np.cos(heading[one]), np.sin(heading[one])
        along = np.abs(cos * away[:, 0] + sin * away[:, 1])
        across = np.abs(cos * away[:, 1] - sin * away[:, 0])
        cores = np.clip(0.5 * CORE * (sides[one] + sides[other]), CORE_LEAST_M, CORE_LENGTH_M)
        overlap = (along < cores[:, 0]) & (across < cores[:, 1])
        found = np.unique(one[overlap])
        self._hits += found.size
        self._roll.mark(OVERLAPS, rows[found])

    # --- what it amounts to -----------------------------------------------------------------------

    def _overlaps(self) -> bool:
        if self._roll.count < OVERLAPPING_IDS:
            return False
        within = int(self._nearest[: round(NEAREST_M / _NEAR_BIN_M)].sum())
        if 2 * within > max(self._looked, 2 * OVERLAPPING_IDS):
            return True
        limit = OVERLAPPING if self._outlines else OVERLAPPING_UNSURE
        many = self._roll.of[OVERLAPS] >= OVERLAPPING_IDS
        return many and self._hits > limit * self._looked

    def _shakes(self) -> bool:
        shake = self._shake
        return (
            shake.count >= CLOCK_FRAMES and shake.value - SURE * shake.error > 2.0 * SHAKEN * SHAKEN
        )

    def _repeating(self) -> bool:
        return self._repeats >= MOVERS and self._repeats > REPEATED * max(
            self._moving_frames, CLOCK_FRAMES
        )

    def _paces(self) -> bool:
        pace = self._pace
        return pace.count >= PACE_LOOKS and abs(pace.value) - SURE * pace.error > math.log(PACE)

    def _jumps(self) -> bool:
        return self._roll.of[JUMPED] >= JUMPING_IDS and self._roll.share(JUMPED) > JUMPING

    def _unit(self) -> str | None:
        """The unit that seems to be given as metres."""
        if self._size.count < PACE_LOOKS or self._roll.count < SIZED:
            return None
        return unit_of(math.exp(self._size.value))

    def _too_fast(self) -> bool:
        return self._speed.count >= PACE_LOOKS and self._speed.value > FAST_MPS

    def _is_scene(self) -> bool:
        return not (
            self._overlaps()
            or self._too_fast()
            or self._unit() is not None
            or self._shakes()
            or self._repeating()
            or self._paces()
            or self._jumps()
        )

    def check(self) -> SceneCheck:
        """What was found so far."""
        looked, frames = self._looked, self._moving_frames
        shaken = math.sqrt(max(self._shake.value, 0.0) / 2.0) if self._shake.count else math.nan
        seen = SceneCheck(
            is_scene=self._is_scene(),
            findings=(),
            overlapping=self._hits / looked if looked else 0.0,
            nearest_m=self._median_nearest(),
            shaken=shaken,
            repeated=self._repeats / frames if frames else math.nan,
            pace=math.exp(self._pace.value) if self._pace.count else math.nan,
            jumping=self._roll.share(JUMPED),
            still=1.0 - self._roll.share(MOVED) if self._roll.count else math.nan,
        )
        return dataclasses.replace(seen, findings=tuple(self._sentences(seen)))

    def _median_nearest(self) -> float:
        total = int(self._nearest.sum())
        if not total:
            return math.nan
        middle = int(np.searchsorted(np.cumsum(self._nearest), 0.5 * total))
        return (middle + 0.5) * _NEAR_BIN_M

    def _sentences(self, seen: SceneCheck) -> Iterator[str]:
        if self._overlaps():
            yield (
                f"{seen.overlapping:.0%} of the vehicles lie within another one (median distance "
                f"to the next centre {seen.nearest_m:.1f} m): actors are superimposed"
            )
        elif self._roll.of[OVERLAPS]:
            yield f"{self._roll.of[OVERLAPS]} of {self._roll.count} vehicles overlap another"
        if self._shakes():
            yield (
                f"the clock is shaken: steps last {seen.shaken:.0%} longer or shorter than stated"
            )
        if self._repeating():
            yield f"{seen.repeated:.0%} of the frames repeat the one before"
        if self._paces():
            yield (
                f"vehicles go {seen.pace:.2f} times as far as their stated speeds: the frame step "
                "or a unit is wrong"
            )
        if unit := self._unit():
            ratio = math.exp(self._size.value)
            yield f"vehicles are {ratio:.3g} times as large as usual: {unit} seem to be metres"
        if self._too_fast():
            yield f"the median speed is {self._speed.value:.0f} m/s: a unit or the clock is wrong"
        if self._roll.of[JUMPED]:
            yield f"{self._roll.of[JUMPED]} of {self._roll.count} ids jump from place to place"
        if self._roll.count and seen.still > 0.5:
            yield f"{seen.still:.0%} of the vehicles never move"


def check_scene(tracks: Tracks, outlines: bool = True) -> SceneCheck:
    """Whether a recording is a scene that can be believed.

    Args:
        tracks: positions in metres.
        outlines: as for `SceneMonitor`.

    Returns:
        The verdict, with what was found amiss.

    Examples:
        Eight cars, 20 m apart, and the same with eight more on top of them:

        >>> def cars(n, time_s):
        ...     x = 20.0 * (np.arange(n) % 8) + 15.0 * time_s
        ...     ones = np.ones(n)
        ...     xy = np.stack([x, 0.5 * (np.arange(n) > 7)], axis=1)
        ...     return Frame(time_s, np.arange(n), xy, 0 * ones, 15 * ones, 4.5 * ones, 1.8 * ones,
        ...                  np.zeros(n, np.int8))
        >>> times = 0.1 * np.arange(50)
        >>> check_scene(Tracks.from_frames(cars(8, t) for t in times)).is_scene
        True
        >>> check_scene(Tracks.from_frames(cars(16, t) for t in times))  # doctest: +ELLIPSIS
        SceneCheck(is_scene=False, findings=('100% of the vehicles lie within another one...
    """
    monitor = SceneMonitor(outlines)
    for frame in tracks.frames():
        monitor.update(frame)
    return monitor.check()
