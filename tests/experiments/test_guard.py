"""What happens to a child process that reads a file is one line that names the file."""

from __future__ import annotations

import ctypes
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from behaviors.errors import InputError
from experiments import guard
from experiments.guard import guarded, guarding


def takes_memory(path: Path) -> Iterator[Any]:
    yield path
    yield np.ones(2**30).sum()


def hangs(path: Path) -> Iterator[Any]:
    yield path
    time.sleep(600)
    yield 1


def crashes(path: Path) -> Iterator[Any]:
    yield path
    yield ctypes.string_at(0)


def raises(path: Path) -> Iterator[Any]:
    yield path
    yield {}["speed"]


def refuses(path: Path) -> Iterator[Any]:
    raise InputError(f"{path}: found nothing, expected rows")
    yield 1


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a.csv"
    path.write_text("a,b\n")
    return path


@pytest.mark.parametrize(
    ("function", "told"),
    [
        (takes_memory, r"it needs more than [\d.]+ GB of memory"),
        (hangs, "reading took more than 5 s"),
        (crashes, "reading broke off .SIGSEGV."),
        (raises, "KeyError: 'speed'"),
        (refuses, "found nothing, expected rows$"),
    ],
)
def test_a_child_that_fails_is_one_line(
    file: Path, function: Any, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if function is hangs:
        monkeypatch.setattr(guard, "TIME_S", 5.0)
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    monkeypatch.setattr(function, "__module__", Path(__file__).stem)
    monkeypatch.setitem(sys.modules, Path(__file__).stem, sys.modules[__name__])
    with guarding(), pytest.raises(InputError, match=told) as caught:
        list(guarded(file, function, file))
    assert str(caught.value).startswith(f"{file}: ")
    assert "\n" not in str(caught.value)


def test_the_command_line_refuses_a_bomb_in_one_line(tmp_path: Path) -> None:
    bomb = tmp_path / "sd_bomb.pkl"
    bomb.write_bytes(b"\x80\x02cbuiltins\nbytearray\n(I17179869184\ntR.")  # 16 GiB
    command = [sys.executable, "-m", "experiments.cli", "import", str(bomb)]
    command += ["--format", "scenarionet", "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert f"{bomb}: found a broken file (it needs more than" in done.stderr
    assert not (tmp_path / "out").exists()
