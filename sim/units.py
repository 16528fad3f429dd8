"""The one table of units that files use, and the SI unit of each."""

from __future__ import annotations

import math
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", float, NDArray[np.float64])

FACTORS: Final = {
    "ft": 0.3048,
    "ft/s": 0.3048,
    "mph": 0.44704,
    "km/h": 1 / 3.6,
    "knots": 0.514444,
    "km": 1000.0,
    "deg": math.pi / 180,
}
"""How many of the SI unit (m, m/s, rad) one of each unit is."""

PARTS: Final = {"ms": 1e3, "us": 1e6, "ns": 1e9}
"""How many of each unit make one second."""


def in_si(values: Number, unit: str) -> Number:
    """Values in the SI unit of a quantity: m, s, m/s or rad.

    Args:
        values: numbers in the unit.
        unit: a key of ``FACTORS`` or ``PARTS``, or "" for the SI unit itself.

    Examples:
        >>> in_si(100.0, "ms"), in_si(36.0, "km/h"), in_si(2.0, "")
        (0.1, 10.0, 2.0)
    """
    if unit in PARTS:
        return values / PARTS[unit]
    return values * FACTORS[unit] if unit else values
