"""The one way this package compiles a numerical kernel: numba, cached on disk.

Modules with kernels are imported on first use only, so that importing the package compiles and
loads nothing. The cache lies beside the source, or in numba's user cache folder when that is
read-only, and is as old as the newest Python file of the kernel's folder and of those that hold the
kernels it calls: numba itself looks at the kernel's own file only, and would go on using what a
kernel it calls was before an edit. A compilation is announced through `LOGGER`.
"""

from __future__ import annotations

import functools
import gc
import logging
from collections.abc import Callable
from functools import cache, lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, Final, TypeVar, cast

from numba import config, njit
from numba.core import event
from numba.core.dispatcher import Dispatcher

F = TypeVar("F", bound=Callable[..., object])

LOGGER: Final = logging.getLogger("graphrqi")
"""Says at level INFO that kernels are being compiled, once in a process, and at level DEBUG which.
Python shows neither by itself, as befits a library; the command line shows the first."""

NOTICE: Final = (
    "compiling numerical kernels that are used for the first time, up to 20 s; later runs find "
    "them compiled ..."
)
"""What a first use waits for."""

_FOLDERS: dict[Callable[..., object], set[Path]] = {}
"""The folders whose Python files each kernel depends on."""

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


def inlined(function: F) -> F:
    """Make ``function`` a part of each kernel that calls it, under that kernel's options.

    For a function that one kernel calls, and for one that would round otherwise by itself: where
    sums and products may be reordered, they are so within one kernel.

    Args:
        function: a function in numba's subset of Python.

    Returns:
        The same function; not to be called from Python.
    """
    kernel = njit(inline="always")(function)
    _FOLDERS[kernel] = _folders(function)
    return cast(F, kernel)


def reordered(function: F) -> F:
    """Compile ``function`` as `compiled` does, but let sums and products be reordered.

    Args:
        function: a function in numba's subset of Python.

    Returns:
        The same function, compiled with LLVM's fast math: results differ in their last digits from
        those in the order written, and are the same on every run.
    """
    return _compiled(function, fastmath=True, **_LEFT_OUT)


def vectorised(function: F) -> F:
    """Compile ``function`` as `compiled` does, with vector instructions for tuples of numbers.

    The compiler then packs like operations on neighbouring numbers, also in the kernels that this
    one calls first. Numba leaves that out by default; nothing is reordered.

    Args:
        function: a function in numba's subset of Python.

    Returns:
        As `compiled`.
    """
    settings: Any = config
    kernel: Any = compiled(function)
    if not hasattr(kernel, "compile"):  # nothing is compiled (NUMBA_DISABLE_JIT)
        return cast(F, kernel)
    plain = kernel.compile

    def with_vectors(signature: Any) -> Any:
        before, settings.SLP_VECTORIZE = settings.SLP_VECTORIZE, 1
        try:
            return plain(signature)
        finally:
            settings.SLP_VECTORIZE = before

    kernel.compile = with_vectors
    return cast(F, kernel)


def in_place(*, inner: bool = False, reordered: bool = False) -> Callable[[F], F]:
    """Compile a function that makes no array and returns none, but writes into its arguments.

    No references to its arrays need to be counted, neither inside it nor in its calls of other such
    functions: it takes a third less time to compile, and short functions may be called with many
    arrays.

    Args:
        inner: whether only other kernels call it, as of `inner`.
        reordered: whether sums and products may be reordered, as of `reordered`.

    Returns:
        A decorator for functions in numba's subset of Python.
    """
    options = {"_nrt": False, "no_cpython_wrapper": inner, "fastmath": reordered, **_LEFT_OUT}

    def decorate(function: F) -> F:
        return _compiled(function, **options)

    return decorate


@cache
def shared(function: F) -> F:
    """Compile a scalar function that several kernels call, such as a driver model.

    It has no cache file of its own, because numba names that file after the function alone and
    would load what was compiled with other options. It becomes part of the kernels that call it,
    and their cache files.

    Args:
        function: a function in numba's subset of Python that calls no other one of this project.

    Returns:
        The same function, compiled.
    """
    options: dict[str, Any] = {"no_cpython_wrapper": True, **_LEFT_OUT}
    kernel = njit(error_model="numpy", **options)(function)
    _FOLDERS[kernel] = _folders(function)
    return cast(F, kernel)


def _compiled(function: F, **options: Any) -> F:
    kernel = njit(cache=True, error_model="numpy", **options)(function)
    _FOLDERS[kernel] = _folders(function)
    index = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if index is not None:  # none where nothing is compiled (NUMBA_DISABLE_JIT)
        index._source_stamp = tuple(_stamp(folder) for folder in sorted(_FOLDERS[kernel]))
        index._load_index = _forgiving(index._load_index)
    return cast(F, kernel)


def _forgiving(load_index: Callable[[], Any]) -> Callable[[], Any]:
    """Read a kernel's cache as empty if it names a type that has gone since it was written.

    Numba looks at the stamp of the source only after it has restored the types of the arguments,
    and named tuples among these are looked up in their modules.
    """

    @functools.wraps(load_index)
    def load() -> Any:
        try:
            return load_index()
        except (AttributeError, ImportError):
            return {}

    return load


def _folders(function: Callable[..., object]) -> set[Path]:
    """The folders of a function, of every kernel that it calls, and of those that these call.

    Kernels count that the function names itself or as attributes of a module that it names.
    """
    named = [function.__globals__.get(name) for name in function.__code__.co_names]
    named += [
        value
        for module in named
        if isinstance(module, ModuleType)
        for value in vars(module).values()
    ]
    called = (_FOLDERS.get(value, set()) for value in named if isinstance(value, Dispatcher))
    return {Path(function.__code__.co_filename).parent}.union(*called)


class _Compilation(event.Listener):
    """Says what a compilation is, and pauses garbage collection while it lasts.

    A compilation makes millions of objects that live until its end. Each full collection would
    visit them all and find nothing, which takes a fifth of the time.
    """

    def __init__(self) -> None:
        self._nested = 0
        self._was_on = False
        self._announced = False

    def on_start(self, event: Any) -> None:
        kernel = event.data["dispatcher"]
        if kernel in _FOLDERS:
            if not self._announced:
                self._announced = True
                LOGGER.info(NOTICE)
            LOGGER.debug("compiling %s", kernel.__qualname__)
        if self._nested == 0:
            self._was_on = gc.isenabled()
            gc.disable()
        self._nested += 1

    def on_end(self, event: Any) -> None:
        self._nested -= 1
        if self._nested == 0 and self._was_on:
            gc.enable()


event.register("numba:compile", _Compilation())  # type: ignore[no-untyped-call]


@lru_cache
def _stamp(folder: Path) -> tuple[tuple[str, int, int], ...]:
    files = sorted(folder.glob("*.py"))
    return tuple((file.name, file.stat().st_mtime_ns, file.stat().st_size) for file in files)
