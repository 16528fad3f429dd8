"""How a world is seen: rate, noise, and what the sensor loses."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np

from experiments.data.disturbances import correlated_noise, position_noise
from sim.formats.common.recording import motion
from sim.frames import Tracks

STEPS_S: Final = (0.04, 0.05, 0.1, 0.1, 0.1, 0.2, 0.25, 0.3, 0.4)
"""Time between frames, drawn with equal chances, s: 25 to 2.5 Hz, mostly 10."""

NOISE_M: Final = (0.01, 0.5)
"""Smallest and largest standard deviation of positions, m, where there is noise."""

NOISE_CORRELATION_S: Final = (0.0, 0.2, 0.5, 1.0)
"""Time in which an error of position falls to 1/e, s; 0: white."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """What sees the traffic.

    Attributes:
        step_s: time between frames, s.
        noise_m: standard deviation of positions in x and in y, m.
        noise_correlation_s: time in which an error falls to 1/e, s; 0 for white noise.
    """

    step_s: float
    noise_m: float
    noise_correlation_s: float

    def seen(self, tracks: Tracks, rng: np.random.Generator) -> Tracks:
        """What the sensor records of the traffic.

        Headings and speeds are not measured: they follow from the positions, as in most
        recordings (`sim.formats.common.recording.motion`).

        Args:
            tracks: where everyone was, at the sensor's frame rate.
            rng: source of the errors.

        Returns:
            The recording, with the same labels.
        """
        noisy = tracks
        if self.noise_m and self.noise_correlation_s:
            noisy = correlated_noise(tracks, self.noise_m, rng, self.noise_correlation_s)
        elif self.noise_m:
            noisy = position_noise(tracks, self.noise_m, rng)
        heading, speed = motion(noisy.xy, noisy.time_s, 0.0)
        return dataclasses.replace(
            noisy,
            heading=np.where(noisy.valid, heading, np.nan),
            speed=np.where(noisy.valid, speed, np.nan),
            events=(),
        )


def draw_sensor(rng: np.random.Generator) -> Sensor:
    """Draw what sees the traffic; one in five measures positions exactly."""
    low, high = np.log(NOISE_M)
    noise = 0.0 if rng.random() < 0.2 else float(np.exp(rng.uniform(low, high)))
    correlation = float(rng.choice(NOISE_CORRELATION_S))
    return Sensor(
        step_s=float(rng.choice(STEPS_S)),
        noise_m=round(noise, 3),
        noise_correlation_s=correlation if noise else 0.0,
    )
