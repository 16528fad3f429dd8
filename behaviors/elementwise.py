"""Exponentials and logarithms that are the same on every processor.

numpy computes them with the widest vector instructions that a processor has, and the last bit of
the result depends on which those are. The C library's are the same everywhere. Drivers and worlds
are drawn with these, so that the same seed gives the same bytes on another machine; they are too
slow for features of whole scenes.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray


def exponential(values: ArrayLike) -> NDArray[np.float64]:
    """The exponential of each value.

    Examples:
        >>> exponential([0.0, 1.0]).round(3)
        array([1.   , 2.718])
    """
    return _of_each(math.exp, values)


def logarithm(values: ArrayLike) -> NDArray[np.float64]:
    """The natural logarithm of each value, which is positive.

    Examples:
        >>> logarithm([1.0, 10.0]).round(3)
        array([0.   , 2.303])
    """
    return _of_each(math.log, values)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number from ``low`` to ``high``, both positive, whose logarithm is uniformly distributed.

    Examples:
        >>> 2.0 <= log_uniform(np.random.default_rng(0), 2.0, 8.0) <= 8.0
        True
    """
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _of_each(function: Callable[[float], float], values: ArrayLike) -> NDArray[np.float64]:
    given = np.asarray(values, dtype=np.float64)
    found = np.array([function(value) for value in given.ravel().tolist()], dtype=np.float64)
    return found.reshape(given.shape)
