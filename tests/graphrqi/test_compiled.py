"""What compiling a kernel does to the rest of the process."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from numba import njit
from numba.core import event

import sim.compiled


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


@pytest.mark.parametrize(
    ("named", "called"),
    [("import below.kernel as low", "low.more"), ("from below.kernel import more", "more")],
)
def test_an_edit_of_a_kernel_that_is_called_from_another_folder_is_noticed(
    tmp_path: Path, named: str, called: str
) -> None:
    for folder in ("below", "above"):
        (tmp_path / folder).mkdir()
    head = "from sim.compiled import compiled\n"
    kernel = "\n\n@compiled\ndef {}(x):\n    return {}\n"
    (tmp_path / "above" / "kernel.py").write_text(
        head + named + kernel.format("twice", f"2.0 * {called}(x)")
    )
    found = []
    for added in ("1.0", "10.0"):
        (tmp_path / "below" / "kernel.py").write_text(head + kernel.format("more", f"x + {added}"))
        said = subprocess.run(
            [sys.executable, "-c", "from above.kernel import twice; print(twice(3.0))"],
            cwd=tmp_path, capture_output=True, text=True, check=True,
        )  # fmt: skip
        found.append(float(said.stdout))
    assert found == [8.0, 26.0]


KERNEL = """
from sim.compiled import compiled


@compiled
def twice(x):
    return 2.0 * x
"""


def test_a_first_use_says_once_what_it_waits_for(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    program = (
        "from experiments.console.notices import show_notices; show_notices({quiet})\n"
        "from kernel import twice; twice(3.0); twice(3)"
    )
    said = [
        subprocess.run(
            [sys.executable, "-c", program.format(quiet=quiet)],
            cwd=tmp_path, capture_output=True, text=True, check=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / folder)},
        ).stderr
        for quiet, folder in ((False, "one"), (False, "one"), (True, "two"))
    ]  # fmt: skip
    assert said == [f"graphrqi: {sim.compiled.NOTICE}\n", "", ""]


def test_the_notice_is_for_our_kernels_only(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("DEBUG", logger="graphrqi"):
        njit(lambda x: x + x)(1.0)
    assert not caplog.messages


def test_a_cache_that_names_a_type_that_is_gone_is_written_anew(tmp_path: Path) -> None:
    kernel = """
from typing import Any, NamedTuple

import numpy as np

from sim.compiled import compiled


class {name}(NamedTuple):
    values: Any


@compiled
def total(given: Any) -> Any:
    return given.values.sum()


print(total({name}(np.ones(3))))
"""
    script = tmp_path / "kernel.py"
    environment = {
        **os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": os.getcwd()
    }  # fmt: skip
    for name in ("Given", "Other"):
        script.write_text(kernel.format(name=name))
        code = "import kernel"
        ran = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True,
            text=True, check=False,
        )  # fmt: skip
        assert ran.stdout == "3.0\n", ran.stderr


IN_PLACE = """
import numpy as np

from sim.compiled import in_place


@in_place(inner=True)
def halve(x, out):
    for i in range(x.size):
        out[i] = x[i] / 2.0


@in_place()
def add_half(x, room, out):
    halve(x, room)
    for i in range(x.size):
        out[i] = x[i] + room[i]


@in_place()
def make(x):
    return np.zeros(x.size)
"""


def test_a_kernel_in_place_writes_into_its_arguments_and_makes_no_array(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(IN_PLACE)
    program = """
import numpy as np
from numba.core.errors import NumbaError
from kernel import add_half, make
x, room, out = np.array([1.0, 3.0]), np.empty(2), np.empty(2)
assert add_half(x, room, out) is None
try:
    make(x)
except NumbaError:
    print(out.tolist())
"""
    said = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
    )  # fmt: skip
    assert said.stdout == "[1.5, 4.5]\n"
