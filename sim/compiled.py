"""The one way this package compiles a numerical kernel: numba, cached on disk.

Modules with kernels are imported on first use only, so that importing the package compiles and
loads nothing. The cache lies beside the source, or in numba's user cache folder when that is
read-only, and is as old as the newest Python file of the kernel's folder and of those that hold the
kernels it calls: numba itself looks at the kernel's own file only, and would go on using what a
kernel it calls was before an edit.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

from numba import njit
from numba.core import event
from numba.core.dispatcher import Dispatcher

F = TypeVar("F", bound=Callable[..., object])

_LEFT_OUT: Any = {"no_cfunc_wrapper": True, "no_rewrites": True}
"""Parts of a compilation that loops have no use for, a tenth of its time: an entry for C, and the
fusion of array expressions."""


def compiled(function: F) -> F:
    """Compile ``function`` on its first call, or load it from the cache.

    Args:
        function: a function in numba's subset of Python.

    Returns:
        The same function, compiled: divisions follow IEEE 754 and nothing is reassociated, so
        results equal those of the same arithmetic in numpy to the bit.
    """
    return _compiled(function, **_LEFT_OUT)


def inner(function: F) -> F:
    """Compile ``function`` for the calls of other kernels only.

    Without an entry for Python, which takes as long to compile as a short kernel does.

    Args:
        function: a function in numba's subset of Python.

    Returns:
        As `compiled`; not to be called from Python.
    """
    return _compiled(function, no_cpython_wrapper=True, **_LEFT_OUT)


def reordered(function: F) -> F:
    """Compile ``function`` as `compiled` does, but let sums and products be reordered.

    Args:
        function: a function in numba's subset of Python.

    Returns:
        The same function, compiled with LLVM's fast math: results differ in their last digits from
        those in the order written, and are the same on every run.
    """
    return _compiled(function, fastmath=True, **_LEFT_OUT)


def _compiled(function: F, **options: Any) -> F:
    kernel = njit(cache=True, error_model="numpy", **options)(function)
    index = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if index is not None:  # none where nothing is compiled (NUMBA_DISABLE_JIT)
        index._source_stamp = tuple(_stamp(folder) for folder in sorted(_folders(function)))
    return cast(F, kernel)


def _folders(function: Callable[..., object]) -> set[Path]:
    """The folder of a kernel and of every kernel, or module with kernels, that it names."""
    named = [function.__globals__.get(name) for name in function.__code__.co_names]
    modules = [value for value in named if isinstance(value, ModuleType)]
    kernels = [value for value in named if isinstance(value, Dispatcher)]
    kernels += [k for m in modules for k in vars(m).values() if isinstance(k, Dispatcher)]
    codes = [function.__code__, *(kernel.py_func.__code__ for kernel in kernels)]
    return {Path(code.co_filename).parent for code in codes}


class _Uncollected(event.Listener):
    """Pauses garbage collection while numba compiles: a fifth of the time would go into it.

    A compilation makes millions of objects that live until its end, and each full collection
    visits them all and finds nothing.
    """

    def __init__(self) -> None:
        self._nested = 0
        self._was_on = False

    def on_start(self, event: Any) -> None:
        if self._nested == 0:
            self._was_on = gc.isenabled()
            gc.disable()
        self._nested += 1

    def on_end(self, event: Any) -> None:
        self._nested -= 1
        if self._nested == 0 and self._was_on:
            gc.enable()


event.register("numba:compile", _Uncollected())  # type: ignore[no-untyped-call]


@lru_cache
def _stamp(folder: Path) -> tuple[tuple[str, int, int], ...]:
    files = sorted(folder.glob("*.py"))
    return tuple((file.name, file.stat().st_mtime_ns, file.stat().st_size) for file in files)
