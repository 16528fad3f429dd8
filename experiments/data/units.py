"""How long a unit of length of a recording is: metres per pixel.

A video's boxes have no scale. Two things bound it: road agents have known sizes, and they move at
known speeds. Both give a scale with an uncertainty, and the estimate is their mean, weighted by how
certain each is. A camera shows near agents larger, so their sizes give the horizon. A pinhole
camera without roll then maps image positions to flat ground. How much it foreshortens the way
ahead of it in the middle of the image is not known and is assumed. Where sizes show no horizon,
the view is from above.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.ndimage import uniform_filter1d

from sim.formats.common.recording import with_motion
from sim.frames import FloatArray, Tracks

SIZE_M, SIZE_SPREAD = 2.2, 0.4
"""Typical root of width times height of a road agent's box in an image, m (chosen between a car
from the side, a motorcycle and a pedestrian), and the standard deviation of the logarithm of a
video's median size (from pedestrians and motorcycles to cars only)."""

PACE_MPS, PACE_SPREAD = 5.0, 0.8
"""Typical speed of those that move in a street that is filmed, m/s (18 km/h), and the standard
deviation of the logarithm of a street's median speed (from a jam's 2 to a main road's 11 m/s)."""

FORESHORTENED: Final = 1.5
"""Foreshortening of displacements along the view in the middle of the image, for a camera that
looks down at some 40 degrees."""

SMALLEST: Final = 0.25
"""Agents farthest away look at least this large, over those in the middle (our choice): nearer to
the horizon, a pixel is many metres."""

FARTHEST_HORIZON, HORIZONS, SHOWN = 100.0, 60, 0.95
"""Farthest horizon that is tried, over the nearest one; how many are tried in between; and the
factor to which one must reduce the variation of sizes to be accepted (our choice)."""

LENGTH_OF_SIZE, WIDTH_OF_SIZE = 0.85, 0.35
"""Length and width of an agent on the ground, over the root of its box's area in the image."""

MOVING, SPAN_S = 0.5, 1.0
"""Agents that cover this many of their own sizes in a second move (a walking pace); time over which
speeds are taken, s: whole pixels need it."""

SMOOTH_FRAMES: Final = 15
"""Length of the centred mean over positions; half a second of video."""


@dataclass(frozen=True, slots=True)
class Scale:
    """Metres per unit of a recording without scale, on the ground that a camera looks along.

    Attributes:
        metres: per unit, at the height ``middle``.
        middle: height in the image, in units.
        horizon: how far above ``middle`` the horizon is, in units; infinite for a view from above.
        spread: standard deviation of the logarithm of ``metres``.
    """

    metres: float
    middle: float
    horizon: float
    spread: float

    def at(self, height: FloatArray) -> FloatArray:
        """(n,) metres per unit at heights (n,) in the image."""
        return np.asarray(self.metres / self._nearness(height))

    def ground(self, xy: FloatArray) -> FloatArray:
        """(..., 2) places on the ground, m, of places (..., 2) in the image.

        The first axis is across the view, from the image's 0; the second leads away from the
        camera, from ``middle``.
        """
        nearness = self._nearness(xy[..., 1])
        away = xy[..., 1] - self.middle
        if math.isfinite(self.horizon):
            away = FORESHORTENED * away
        return np.asarray(self.metres * np.stack([xy[..., 0], away], axis=-1) / nearness[..., None])

    def _nearness(self, height: FloatArray) -> FloatArray:
        """(n,) size of agents in the image, over those at ``middle``."""
        return np.maximum(1.0 - (height - self.middle) / self.horizon, SMALLEST)

    def __str__(self) -> str:
        """One clause for a note."""
        return f"1 pixel is {self.metres:.3g} m, give or take {math.expm1(self.spread):.0%}"


def smoothed(xy: FloatArray) -> FloatArray:
    """Centred mean of positions (N, T, 2) over `SMOOTH_FRAMES`; NaN where unknown."""
    known = ~np.isnan(xy[..., :1])
    mean, share = (
        uniform_filter1d(part, SMOOTH_FRAMES, axis=1, mode="constant")
        for part in (np.where(known, xy, 0.0), known.astype(np.float64))
    )
    return np.where(known, mean / np.maximum(share, 0.5 / SMOOTH_FRAMES), np.nan)


def image_scale(tracks: Tracks) -> Scale:
    """Estimate the scale of a recording in pixels, y up, from sizes and speeds.

    Lengths and widths are the sides of boxes in the image. Sizes alone decide where no agent moves.
    """
    seen = tracks.valid.any(axis=1)
    size = np.sqrt(tracks.length * tracks.width)[seen]
    xy = tracks.xy[seen]
    height = np.nanmedian(xy[..., 1], axis=1)
    middle = float(np.median(height))
    horizon = _horizon(height - middle, size, float(np.nanmax(xy[..., 1])) - middle)
    in_units = Scale(1.0, middle, horizon, 0.0)
    typical = float(np.median(size * in_units.at(height)))
    total, weights = math.log(SIZE_M / typical) * SIZE_SPREAD**-2, SIZE_SPREAD**-2
    pace = _pace(in_units.ground(smoothed(xy)), tracks, typical)
    if pace > 0.0:
        total += math.log(PACE_MPS / pace) * PACE_SPREAD**-2
        weights += PACE_SPREAD**-2
    return Scale(math.exp(total / weights), middle, horizon, weights**-0.5)


def _horizon(above: FloatArray, size: FloatArray, top: float) -> float:
    """How far above the middle the horizon is; infinite where sizes do not show it."""
    nearest = top / (1.0 - SMALLEST)
    if not nearest > 0.0:
        return math.inf

    def left_over(horizon: float) -> float:
        true = np.log(size / (1.0 - above / horizon))
        return float(np.abs(true - np.median(true)).mean())

    candidates = nearest * np.geomspace(1.0, FARTHEST_HORIZON, HORIZONS)
    best = min(candidates.tolist(), key=left_over)
    return best if left_over(best) < SHOWN * left_over(math.inf) else math.inf


def _pace(ground: FloatArray, tracks: Tracks, size: float) -> float:
    """Median speed of those that move, in units per second; 0 if none moves."""
    if tracks.time_s.size < 2:
        return 0.0
    span = max(1, round(SPAN_S / tracks.step_s))
    moved = ground[:, span::span] - ground[:, :-span:span][:, : ground[:, span::span].shape[1]]
    passed = tracks.time_s[span::span] - tracks.time_s[:-span:span][: moved.shape[1]]
    speed = np.hypot(moved[..., 0], moved[..., 1]) / passed
    moving = speed[speed > MOVING * size]  # NaN where not seen at both ends
    return float(np.median(moving)) if moving.size else 0.0


def in_metres(tracks: Tracks, scale: Scale) -> Tracks:
    """The same recording in metres, as far as a scale says.

    Whole pixels are smoothed before headings and speeds are taken from them.
    """
    known = tracks.valid.any(axis=1)
    size = scale.metres * np.sqrt(tracks.length * tracks.width)
    size[known] *= scale.at(np.nanmedian(tracks.xy[known, :, 1], axis=1)) / scale.metres
    across = tracks.row_xy[:, 0]
    centre = 0.5 * (across.min() + across.max())
    xy = scale.ground(tracks.xy - np.array([centre, 0.0]))
    moved = with_motion(replace(tracks, row_xy=smoothed(xy)[tracks.valid]))
    length, width = LENGTH_OF_SIZE * size, WIDTH_OF_SIZE * size
    return replace(moved, row_xy=xy[tracks.valid], length=length, width=width)
