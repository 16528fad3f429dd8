"""Exponentials and logarithms that are the same on every processor.

numpy computes them with the widest vector instructions that a processor has, and the last bit of
the result depends on which those are. The C library's are the same everywhere. Drivers and worlds
are drawn with these, so that the same seed gives the same bytes on another machine; they are too
slow for features of whole scenes.
"""

from __future__ import annotations

import math

import numpy as np

exponential = np.vectorize(math.exp, otypes=[np.float64], doc="The exponential of each value.")

logarithm = np.vectorize(
    math.log, otypes=[np.float64], doc="The natural logarithm of each value, which is positive."
)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number from ``low`` to ``high``, both positive, whose logarithm is uniformly distributed.

    Examples:
        >>> 2.0 <= log_uniform(np.random.default_rng(0), 2.0, 8.0) <= 8.0
        True
    """
    return math.exp(rng.uniform(math.log(low), math.log(high)))
