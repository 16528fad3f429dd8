"""How a world is seen: rate, noise, and what the sensor loses."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from behaviors.elementwise import log_uniform
from experiments.data.disturbances import (
    correlated_noise,
    dropped_frames,
    frame_rate,
    lost_detections,
    lost_tracks,
    position_noise,
    renamed_tracks,
)
from sim.formats.common.motion import motion
from sim.formats.common.recording import CAR_LENGTH_M, CAR_WIDTH_M
from sim.frames import Tracks

STEPS_S: Final = (0.04, 0.05, 0.1, 0.1, 0.1, 0.2, 0.25, 0.3, 0.4)
"""Time between frames, drawn with equal chances, s: 25 to 2.5 Hz, mostly 10."""

NOISE_M: Final = (0.01, 0.5)
"""Smallest and largest standard deviation of positions, m, where there is noise."""

NOISE_CORRELATION_S: Final = (0.0, 0.2, 0.5, 1.0)
"""Time in which an error of position falls to 1/e, s; 0: white."""

LOSSES: Final = (0.0, 0.0, 0.05, 0.15, 0.3)
"""Shares of frames, and of single detections, that are missing, drawn with equal chances."""

LOST_PER_MIN: Final = (0.0, 0.0, 0.5, 2.0)
"""How often an agent is lost and found again, per minute, drawn with equal chances."""

SAME, NEW = "same", "new"
"""Whether an agent that is found again has its old id."""

MAP_SHARE: Final = 0.6
"""Chance that the recording comes with the map."""

PIXEL_SHARE: Final = 0.35
"""Chance that a recording without a map is in pixels of an unknown scale."""

PIXELS_PER_M: Final = (2.0, 30.0)
"""Smallest and largest scale (TRAF's videos have some 6 to 30)."""

PIXEL_STEP: Final = 0.5
"""Positions in an image are multiples of this, pixels: centres of boxes with whole corners."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """Sensor that records the traffic.

    Attributes:
        step_s: time between frames, s.
        noise_m: standard deviation of positions in x and in y, m.
        noise_correlation_s: time in which an error falls to 1/e, s; 0 for white noise.
        lost_frames: share of whole frames that are missing.
        lost_detections: share of single detections that are missing.
        lost_per_min: how often an agent is lost for some 1.5 s, per minute.
        found_as: ``same`` or ``new``: the id of an agent that is found again.
        has_map: whether the recording comes with the map.
        has_sizes: whether sizes are measured; otherwise all are cars of 4.5 m.
        pixels_per_m: scale of an image, hidden from the reader; 0 for metres.
        left_hand: whether the recording is mirrored and without a map.
        turned_rad: by how much the axes are turned; 0 with a map.
    """

    step_s: float
    noise_m: float = 0.0
    noise_correlation_s: float = 0.0
    lost_frames: float = 0.0
    lost_detections: float = 0.0
    lost_per_min: float = 0.0
    found_as: str = SAME
    has_map: bool = True
    has_sizes: bool = True
    pixels_per_m: float = 0.0
    left_hand: bool = False
    turned_rad: float = 0.0

    def seen(self, tracks: Tracks, rng: np.random.Generator) -> Tracks:
        """Recording of traffic by the sensor at its frame rate, with the same labels.

        Headings and speeds follow from the positions, as in most recordings. Names begin with the
        agent's id; behind a slash follows the number of the track where an agent has several.
        """
        seen = tracks
        if self.noise_m and self.noise_correlation_s:
            seen = correlated_noise(seen, self.noise_m, rng, self.noise_correlation_s)
        elif self.noise_m:
            seen = position_noise(seen, self.noise_m, rng)
        if self.lost_per_min:
            lose = renamed_tracks if self.found_as == NEW else lost_tracks
            seen = lose(seen, self.lost_per_min, rng)
        if self.lost_detections:
            seen = lost_detections(seen, self.lost_detections, rng)
        if self.lost_frames:
            seen = dropped_frames(seen, self.lost_frames, rng)
        seen = self._in_its_axes(seen)
        seen = seen.part(np.flatnonzero(seen.valid.any(axis=1)), slice(None))
        heading, speed = motion(seen.xy, seen.time_s, 0.0)
        return seen.with_dense(
            heading=heading,
            speed=speed,
            signals=seen.signals if self.has_map else seen.signals[:0],
            events=(),
        )

    def _in_its_axes(self, tracks: Tracks) -> Tracks:
        """Positions and sizes in the sensor's axes and unit."""
        if self.has_map:
            return tracks
        cos, sin = math.cos(self.turned_rad), math.sin(self.turned_rad)
        axes = np.array([[cos, sin], [-sin, cos]])
        if self.left_hand:
            axes = np.diag([1.0, -1.0]) @ axes
        scale = self.pixels_per_m or 1.0
        xy = scale * (tracks.xy @ axes)
        if self.pixels_per_m:
            xy = np.round(xy / PIXEL_STEP) * PIXEL_STEP
        length, width = tracks.length, tracks.width
        if not self.has_sizes:
            length, width = np.full_like(length, CAR_LENGTH_M), np.full_like(width, CAR_WIDTH_M)
        return tracks.with_dense(xy=xy, length=scale * length, width=scale * width)


def draw_sensor(rng: np.random.Generator) -> Sensor:
    """Draw what sees the traffic; one in five measures positions exactly."""
    noise = 0.0 if rng.random() < 0.2 else log_uniform(rng, *NOISE_M)
    correlation = float(rng.choice(NOISE_CORRELATION_S))
    step_s = float(rng.choice(STEPS_S))
    lost_frames, lost_detections = float(rng.choice(LOSSES)), float(rng.choice(LOSSES))
    lost_per_min, found_as = float(rng.choice(LOST_PER_MIN)), str(rng.choice([SAME, NEW]))
    has_map, pixels = bool(rng.random() < MAP_SHARE), bool(rng.random() < PIXEL_SHARE)
    scale = log_uniform(rng, *PIXELS_PER_M)
    left, turned = bool(rng.random() < 0.3), float(rng.uniform(-np.pi, np.pi))
    sizes = bool(rng.random() < 0.6)
    return Sensor(
        step_s=step_s,
        noise_m=round(noise, 3),
        noise_correlation_s=correlation if noise else 0.0,
        lost_frames=lost_frames,
        lost_detections=lost_detections,
        lost_per_min=lost_per_min,
        found_as=found_as,
        has_map=has_map,
        has_sizes=has_map or sizes,
        pixels_per_m=round(scale, 2) if pixels and not has_map else 0.0,
        left_hand=left and not has_map,
        turned_rad=0.0 if has_map else round(turned, 4),
    )


def seen_badly(tracks: Tracks, rng: np.random.Generator) -> Tracks:
    """Tracks at a steady frame rate as a sensor that is drawn at random sees them, in metres.

    They have the sensor's frame rate or one near to it; frames between those of the tracks lie on
    splines.
    """
    sensor = dataclasses.replace(draw_sensor(rng), pixels_per_m=0.0)
    every = round(sensor.step_s / tracks.step_s)
    step_s = every * tracks.step_s if every else sensor.step_s
    return sensor.seen(frame_rate(tracks, 1.0 / step_s, rng), rng)
