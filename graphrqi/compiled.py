"""The one way this package compiles a numerical kernel: numba, cached on disk.

Modules with kernels are imported on first use only, so that importing the package compiles and
loads nothing. The cache lies beside the source, or in numba's user cache folder when that is
read-only, and is as old as the newest Python file of the kernel's folder: numba itself looks at the
kernel's own file only, and would go on using what a kernel it calls was before an edit.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
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
    kernel = njit(cache=True, error_model="numpy")(function)
    index = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if index is not None:  # none where nothing is compiled (NUMBA_DISABLE_JIT)
        index._source_stamp = _stamp(Path(function.__code__.co_filename).parent)
    return cast(F, kernel)


@lru_cache
def _stamp(folder: Path) -> tuple[tuple[str, int, int], ...]:
    files = sorted(folder.glob("*.py"))
    return tuple((file.name, file.stat().st_mtime_ns, file.stat().st_size) for file in files)
