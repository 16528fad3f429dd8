"""Compiled kernels notice edits, and a cache that is out of date is written anew."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


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
