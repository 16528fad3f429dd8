"""The one way this package compiles a numerical kernel: numba, cached on disk.

Modules with kernels are imported on first use only, so that importing the package compiles and
loads nothing. A kernel's cache is as old as the newest Python file of its folder and of the
kernels' folders that it calls. By default, numba checks the kernel's own file only.
``NUMBA_CACHE_DIR`` says where caches lie, ``NUMBA_DISABLE_JIT=1`` runs the same functions
uncompiled.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Final, TypeVar, cast

from numba import config, njit
from numba.core import event
from numba.core.dispatcher import Dispatcher

F = TypeVar("F", bound=Callable[..., object])

LOGGER: Final = logging.getLogger("graphrqi")

NOTICE: Final = (
    "compiling numerical kernels that are used for the first time, up to 20 s; later runs find "
    "them compiled ..."
)
"""Notice of the wait at a first use, given once in a process at level INFO."""

_FOLDERS: dict[Callable[..., object], set[Path]] = {}
"""The folders whose Python files each kernel depends on."""


def _kernel(function: F, *, kept: bool = True, **options: Any) -> F:
    """A kernel without what loops have no use for: an entry for C, fusion of array expressions."""
    unused: dict[str, Any] = {"no_cfunc_wrapper": True, "no_rewrites": True}
    return _noted(function, njit(cache=kept, error_model="numpy", **unused, **options)(function))


def compiled(function: F) -> F:
    """Compile a function on its first call, or load it from the cache.

    Divisions follow IEEE 754 and nothing is reassociated, so results equal those of the same
    arithmetic in numpy to the bit.
    """
    return _kernel(function)


def inner(function: F) -> F:
    """As `compiled`, for the calls of other kernels only: without an entry for Python."""
    return _kernel(function, no_cpython_wrapper=True)


def inlined(function: F) -> F:
    """Make a function a part of each kernel that calls it, under that kernel's options."""
    return _noted(function, njit(inline="always")(function))


def vectorised(function: F) -> F:
    """As `compiled`, with vector instructions for tuples of numbers; nothing is reordered.

    The compiler packs like operations on neighbouring numbers, also in the kernels that this one
    calls first. Numba leaves that out by default.
    """
    kernel: Any = compiled(function)
    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return cast(F, kernel)
    plain, settings = kernel.compile, cast(Any, config)

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

    References to its arrays are not counted, so it compiles faster. Only other kernels may call it
    if ``inner``. Sums and products may be ``reordered``, in the same way on every run.
    """
    options = {"_nrt": False, "no_cpython_wrapper": inner, "fastmath": reordered}
    return lambda function: _kernel(function, **options)


@cache
def shared(function: F) -> F:
    """Compile a scalar function that several kernels call, into whose cache files it goes."""
    return _kernel(function, kept=False, no_cpython_wrapper=True)


def _noted(function: F, kernel: Any) -> F:
    """Note the folders of a kernel and of those that it names, itself or through modules.

    Its cache is stale when a file in one of them changes.
    """
    named = [function.__globals__.get(name) for name in function.__code__.co_names]
    for module in [one for one in named if isinstance(one, ModuleType)]:
        named += vars(module).values()
    called = (_FOLDERS.get(value, set()) for value in named if isinstance(value, Dispatcher))
    folders = {Path(function.__code__.co_filename).parent}.union(*called)
    _FOLDERS[kernel] = folders
    index = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if index is not None:  # none where nothing is kept
        index._source_stamp = tuple(_stamp(folder) for folder in sorted(folders))
        load = index._load_index

        def load_index() -> Any:
            try:
                return load()
            except (AttributeError, ImportError):  # it names a type that is gone
                return {}

        index._load_index = load_index
    return cast(F, kernel)


@cache
def _stamp(folder: Path) -> tuple[tuple[str, int, int], ...]:
    """Name, time and size of each Python file of a folder."""
    files = [(file.name, file.stat()) for file in sorted(folder.glob("*.py"))]
    return tuple((name, stat.st_mtime_ns, stat.st_size) for name, stat in files)


class _Compilation(event.Listener):
    """Says that kernels are being compiled, once, and at level DEBUG which."""

    announced = False

    def on_start(self, event: Any) -> None:
        kernel = event.data["dispatcher"]
        if kernel in _FOLDERS:
            if not self.announced:
                LOGGER.info(NOTICE)
            self.announced = True
            LOGGER.debug("compiling %s", kernel.__qualname__)

    def on_end(self, event: Any) -> None:
        """Nothing is left to do."""


event.register("numba:compile", _Compilation())  # type: ignore[no-untyped-call]
