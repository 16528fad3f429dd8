"""The one way this package compiles a numerical kernel: numba, cached on disk.

Modules with kernels are imported on first use only, so that importing the package compiles and
loads nothing. The cache lies beside the source, or in numba's user cache folder when that is
read-only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Compile ``function`` on its first call, or load it from the cache.

    Args:
        function: a function in numba's subset of Python.

    Returns:
        The same function, compiled: divisions follow IEEE 754 and nothing is reassociated, so
        results equal those of the same arithmetic in numpy to the bit.
    """
    return cast(F, njit(cache=True, error_model="numpy")(function))
