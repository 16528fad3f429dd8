"""What compiling a kernel does to the rest of the process."""

from __future__ import annotations

import gc
from typing import Any

import pytest
from numba import njit
from numba.core import event

import graphrqi.compiled  # noqa: F401  # what is tested


class _Watch(event.Listener):
    def __init__(self) -> None:
        self.collecting: list[bool] = []

    def on_start(self, event: Any) -> None:
        self.collecting.append(gc.isenabled())

    def on_end(self, event: Any) -> None:
        self.collecting.append(gc.isenabled())


@pytest.mark.parametrize("was_on", [True, False])
def test_garbage_collection_rests_while_kernels_compile(was_on: bool) -> None:
    watch = _Watch()
    event.register("numba:compile", watch)  # type: ignore[no-untyped-call]
    try:
        if not was_on:
            gc.disable()
        inner = njit(lambda x: x + x)
        outer = njit(lambda x: inner(x) * x)
        assert outer(3.0) == 18.0
        assert gc.isenabled() == was_on
    finally:
        gc.enable()
        event.unregister("numba:compile", watch)  # type: ignore[no-untyped-call]
    assert len(watch.collecting) >= 4
    assert not any(watch.collecting[:-1])


def test_garbage_collection_goes_on_after_a_kernel_that_does_not_compile() -> None:
    wrong = njit(lambda x: x.nothing_of_the_kind)
    with pytest.raises(Exception, match="nothing_of_the_kind"):
        wrong(3.0)
    assert gc.isenabled()
