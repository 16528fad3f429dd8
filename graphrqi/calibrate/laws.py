"""The laws that are calibrated, and the numbers that each of them has.

Every driver has five numbers under either law. The rest of what is inferred of a driver describes
what the law leaves unexplained: residual acceleration that is autocorrelated, and, under Krauss's
law, the time in which the safe speed is reached, and random dawdling.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.populations import NUMBERS

FloatArray = NDArray[np.float64]


class Law(StrEnum):
    """A car-following law; the members' order is the code order of the kernels."""

    IDM = "idm"
    KRAUSS = "krauss"

    @property
    def code(self) -> int:
        """Position among the laws."""
        return tuple(Law).index(self)


NUISANCES: Final = ("residual_mps2", "correlation_s", "relaxation_s", "imperfection")
"""What is inferred besides: standard deviation of the residual acceleration, m/s2, the time in
which it is forgotten, s, and, under Krauss's law, the time in which a driver reaches its safe
speed, s (SUMO's drivers: one step), and the largest share of its acceleration that it randomly
loses in a step (SUMO's sigma)."""

FIELDS: Final[dict[Law, tuple[str, ...]]] = {
    Law.IDM: (*NUMBERS, *NUISANCES[:2]),
    Law.KRAUSS: (*NUMBERS, *NUISANCES),
}
"""Columns of a driver's logarithms under each law."""

PRIOR_MEDIAN: Final[dict[str, float]] = {
    "desired_speed_mps": 20.0,
    "time_headway_s": 1.3,
    "min_gap_m": 2.5,
    "max_accel_mps2": 1.5,
    "comfort_decel_mps2": 2.0,
    "residual_mps2": 0.19,
    "correlation_s": 1.3,
    "relaxation_s": 0.003,
    "imperfection": 0.001,
}
"""The median driver before anything is seen (Treiber and Kesting 2013, Traffic Flow Dynamics, table
11.2, and fits to highD by Zhang and Sun 2024, Transportation Research Part C, the residual's among
them; relaxation and imperfection begin at hardly any, which is our choice: where there is none,
drivers tell only that it is small)."""

PRIOR_SPREAD: Final[dict[str, float]] = {
    "desired_speed_mps": 0.3,
    "time_headway_s": 0.4,
    "min_gap_m": 0.4,
    "max_accel_mps2": 0.4,
    "comfort_decel_mps2": 0.4,
    "residual_mps2": 0.7,
    "correlation_s": 0.4,
    "relaxation_s": 1.5,
    "imperfection": 1.5,
}
"""Spread of the logarithms between drivers before anything is seen (fits of single drivers: .3 to
.6; the others our choice: next to none up to all that SUMO allows)."""

PLACE_SPREAD: Final[dict[str, float]] = {
    "desired_speed_mps": 0.35,
    "time_headway_s": 0.3,
    "min_gap_m": 0.25,
    "max_accel_mps2": 0.3,
    "comfort_decel_mps2": 0.25,
    "residual_mps2": 1.0,
    "correlation_s": 0.4,
    "relaxation_s": 3.0,
    "imperfection": 3.0,
}
"""Spread of the logarithms of places' medians around `PRIOR_MEDIAN`. Published fits of IDM lie at
17 to 33 m/s, 1.1 to 1.8 s, 2 to 3.7 m, 0.7 to 2 m/s2 and 1.7 to 3 m/s2 (Treiber, Hennecke, Helbing
2000; Kesting, Treiber 2008; Zhang, Sun 2024), which is about two spreads up and down; the others
are our choice."""


def place_spread(law: Law) -> FloatArray:
    """(D,) spreads of places' medians, see `PLACE_SPREAD`."""
    return np.array([PLACE_SPREAD[name] for name in FIELDS[law]])


def prior(law: Law) -> tuple[FloatArray, FloatArray]:
    """(D,) mean and (D, D) covariance of a driver's logarithms before anything is seen.

    Examples:
        >>> mean, covariance = prior(Law.IDM)
        >>> round(float(np.exp(mean[1])), 6), covariance.shape
        (1.3, (7, 7))
    """
    names = FIELDS[law]
    mean = np.log([PRIOR_MEDIAN[name] for name in names])
    return mean, np.diag([PRIOR_SPREAD[name] ** 2 for name in names])
