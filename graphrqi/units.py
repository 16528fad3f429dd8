"""How long a unit of length of a recording is: metres per pixel, and metres that are none.

A video's boxes have no scale. Two things bound it: road agents have known sizes, and they move at
known speeds. Both give a scale with an uncertainty, and the estimate is their mean, weighted by how
certain each is. A camera shows near agents larger; the size of agents as a function of the height
in the image (`graphrqi.features.unit_free.scale_at`) takes that out: heights are stretched so that
one metre is as long everywhere. How much a camera foreshortens the way ahead of it is not known and
is assumed.

Where a recording says that it is in metres, the sizes of its vehicles tell whether it is: feet and
millimetres that are given as metres make lorries of cars.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.features.unit_free import SMOOTH_FRAMES, scale_at, smoothed
from sim.frames import AgentKind, Tracks
from sim.scenario import DIMENSIONS_M

FloatArray = NDArray[np.float64]

SIZE_M: Final = 2.2
"""Typical root of width times height of a road agent's box in an image, m: 2.6 for a car from the
side (4.5 by 1.5 m), 1.7 for a motorcycle with its rider, 0.9 for a pedestrian (chosen between
them)."""

SIZE_SPREAD: Final = 0.4
"""Standard deviation of the logarithm of a video's median size (from pedestrians and motorcycles to
cars only)."""

PACE_MPS: Final = 5.0
"""Typical speed of those that move in a street that is filmed, m/s (18 km/h)."""

PACE_SPREAD: Final = 0.8
"""Standard deviation of the logarithm of a street's median speed (from a jam's 2 to a main road's
11 m/s)."""

FORESHORTENED: Final = 1.5
"""Displacements towards the camera or away from it are longer by this than they look (it looks down
at some 40 degrees, as from a bridge or a mast)."""

LENGTH_OF_SIZE: Final = 0.85
WIDTH_OF_SIZE: Final = 0.35
"""Length and width of an agent's outline on the ground, over the root of the area of its box in the
image: half those of a car that is seen from the side, since a box shows height, too."""

MOVING: Final = 0.5
"""Agents that cover this many of their own sizes in a second move (a walking pace)."""

SPAN_S: Final = 1.0
"""Time over which speeds are taken, s: whole pixels need it."""

FACTORS: Final = {
    "feet": 1 / 0.3048, "centimetres": 100.0, "millimetres": 1000.0, "kilometres": 0.001,
}  # fmt: skip
"""Units that may be given as metres, and how much larger vehicles then look."""

NEAR: Final = 1.25
"""A size is off by such a factor if it is this near to it (kinds that are mixed up differ by more,
but not by 3.3 nor by 100)."""

_SIZES_M: Final = np.array(
    [math.sqrt(DIMENSIONS_M[kind][0] * DIMENSIONS_M[kind][1]) for kind in AgentKind]
)


@dataclass(frozen=True, slots=True)
class Scale:
    """Metres per unit of a recording without scale.

    Attributes:
        metres: per unit, at the height ``middle``.
        slope: by how much the logarithm of that falls with a unit of height, 1/unit; 0 for a view
            from above.
        middle: height in the image, in units.
        spread: standard deviation of the logarithm of ``metres``.
    """

    metres: float
    slope: float
    middle: float
    spread: float

    def at(self, height: FloatArray) -> FloatArray:
        """(n,) metres per unit at heights (n,) in the image."""
        return np.asarray(self.metres * np.exp(-self.slope * (height - self.middle)))

    def __str__(self) -> str:
        """One clause for a note."""
        return f"1 pixel is {self.metres:.3g} m, give or take {math.expm1(self.spread):.0%}"


def image_scale(tracks: Tracks) -> Scale:
    """Estimate the scale of a recording in pixels, from sizes and speeds.

    Args:
        tracks: in pixels, y up; lengths and widths are the sides of boxes in the image.

    Returns:
        The scale; sizes alone decide where nobody moves.
    """
    size = np.sqrt(tracks.length * tracks.width)
    place = smoothed(np.where(tracks.valid[..., None], tracks.xy, np.nan), SMOOTH_FRAMES)
    seen = tracks.valid.any(axis=1)
    height = np.array([np.median(place[i, tracks.valid[i], 1]) for i in np.flatnonzero(seen)])
    level, slope = scale_at(height, size[seen])
    middle = float(np.median(height))
    by_size = math.log(SIZE_M) - (level + slope * middle)
    weight = SIZE_SPREAD**-2
    total, weights = weight * by_size, weight
    pace = _pace(place, tracks, level, slope)
    if pace > 0.0:
        by_pace = math.log(PACE_MPS / pace) - (level + slope * middle)
        total, weights = total + by_pace * PACE_SPREAD**-2, weights + PACE_SPREAD**-2
    return Scale(math.exp(total / weights), slope, middle, weights**-0.5)


def _pace(place: FloatArray, tracks: Tracks, level: float, slope: float) -> float:
    """Median speed of those that move, in sizes of an agent per second; 0 where nobody does."""
    if tracks.time_s.size < 2:
        return 0.0
    span = max(1, round(SPAN_S / tracks.step_s))
    moved = place[:, span::span] - place[:, :-span:span][:, : place[:, span::span].shape[1]]
    passed = tracks.time_s[span::span] - tracks.time_s[:-span:span][: moved.shape[1]]
    size = np.exp(level + slope * place[:, span::span, 1])
    speed = np.hypot(moved[..., 0], moved[..., 1]) / size / passed
    moving = speed[speed > MOVING]  # NaN where not seen at both ends
    return float(np.median(moving)) if moving.size else 0.0


def in_metres(tracks: Tracks, scale: Scale) -> Tracks:
    """The same recording in metres, as far as a scale says.

    Args:
        tracks: in pixels, y up.
        scale: as from `image_scale`.

    Returns:
        Tracks with places, headings, speeds, lengths and widths in metres. Every place is stretched
        as the scale is there, so that displacements anywhere are in metres. Whole pixels are
        smoothed before headings and speeds are taken from them.
    """
    from sim.formats.common.recording import motion

    height = tracks.xy[..., 1]
    here = scale.at(height)
    away = height - scale.middle
    if scale.slope:
        away = -np.expm1(-scale.slope * away) / scale.slope
    seen = np.where(tracks.valid, height, np.nan)
    known = tracks.valid.any(axis=1)
    size = np.sqrt(tracks.length * tracks.width)
    size[known] *= scale.at(np.nanmedian(seen[known], axis=1))
    size[~known] *= scale.metres
    middle = 0.5 * (np.nanmin(tracks.xy[..., 0]) + np.nanmax(tracks.xy[..., 0]))
    xy = np.stack(
        [(tracks.xy[..., 0] - middle) * here, FORESHORTENED * scale.metres * away], axis=2
    )
    heading, speed = motion(smoothed(xy), tracks.time_s, 0.0)
    return dataclasses.replace(
        tracks,
        xy=xy,
        heading=np.where(tracks.valid, heading, np.nan),
        speed=np.where(tracks.valid, speed, np.nan),
        length=LENGTH_OF_SIZE * size,
        width=WIDTH_OF_SIZE * size,
    )


def size_ratio(length: FloatArray, width: FloatArray, kind: NDArray[np.int8]) -> float:
    """How much larger agents are than agents of their kinds.

    Args:
        length: (n,) m.
        width: (n,) m.
        kind: (n,) codes into ``sim.frames.KINDS``.

    Returns:
        The median ratio; NaN of nobody.

    Examples:
        >>> round(size_ratio(np.array([14.5, 16.0]), np.array([5.9, 6.2]), np.zeros(2, np.int8)), 1)
        3.3
    """
    if not length.size:
        return math.nan
    return float(np.median(np.sqrt(np.abs(length * width)) / _SIZES_M[kind]))


def unit_of(ratio: float) -> str | None:
    """The unit that is given as metres if agents are so much too large; None if none is.

    Examples:
        >>> unit_of(3.4), unit_of(1.2), unit_of(980.0)
        ('feet', None, 'millimetres')
    """
    if not ratio > 0.0:
        return None
    near = {unit: abs(math.log(ratio / factor)) for unit, factor in FACTORS.items()}
    unit = min(near, key=lambda name: near[name])
    return unit if near[unit] < math.log(NEAR) else None
