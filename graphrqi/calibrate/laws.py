"""The laws that are calibrated, and the numbers that each of them has.

Every driver has five numbers under either law. The rest of what is inferred of a driver describes
what the law leaves unexplained: residual acceleration that is autocorrelated, and, under Krauss's
law, the time in which the safe speed is reached.
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


NUISANCES: Final = ("residual_mps2", "correlation_s", "relaxation_s")
"""What is inferred besides: standard deviation of the residual acceleration, m/s2, the time in
which it is forgotten, s, and, under Krauss's law, the time in which a driver reaches its safe
speed, s (SUMO's drivers: one step)."""

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
    "residual_mps2": 0.2,
    "correlation_s": 1.3,
    "relaxation_s": 0.3,
}
"""The median driver before anything is seen (Treiber and Kesting 2013, Traffic Flow Dynamics, table
11.2, and fits to highD by Zhang and Sun 2024, Transportation Research Part C; noise and relaxation
are our choice)."""

PRIOR_SPREAD: Final[dict[str, float]] = {
    "desired_speed_mps": 0.3,
    "time_headway_s": 0.4,
    "min_gap_m": 0.4,
    "max_accel_mps2": 0.4,
    "comfort_decel_mps2": 0.4,
    "residual_mps2": 0.7,
    "correlation_s": 0.4,
    "relaxation_s": 0.7,
}
"""Spread of the logarithms between drivers before anything is seen (fits of single drivers: .3 to
.6; the others our choice)."""


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
