"""How programs end: one line for what users do wrong, a traceback for what the program does."""

from __future__ import annotations

import errno
import subprocess
import sys
from pathlib import Path

import pytest

from behaviors.errors import InputError
from experiments.console.exit_codes import Interrupted, exit_on_user_error


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (InputError("a.csv: found 2\nlines"), 2, "graphrqi: error: a.csv: found 2 lines\n"),
        (OSError(errno.ENOSPC, "No room", "a"), 2, "graphrqi: error: a: No room\n"),
        (OSError(errno.ENOSPC, "No room"), 2, "graphrqi: error: No room\n"),
        (Interrupted("stopped: 1 of 2"), 130, "graphrqi: stopped: 1 of 2\n"),
        (KeyboardInterrupt(), 130, "graphrqi: stopped: run the same command again to go on\n"),
    ],
)
def test_what_users_do_ends_in_one_line(
    capsys: pytest.CaptureFixture[str], error: BaseException, code: int, line: str
) -> None:
    with pytest.raises(SystemExit) as ended, exit_on_user_error():
        raise error
    assert ended.value.code == code
    assert capsys.readouterr().err == line


@pytest.mark.parametrize("error", [ValueError("a bug"), OSError("no reason"), KeyError("x")])
def test_defects_keep_their_traceback(error: Exception) -> None:
    with pytest.raises(type(error)) as raised, exit_on_user_error():
        raise error
    assert raised.value is error


@pytest.mark.parametrize("program", ["demo", "model"])
def test_programs_say_in_one_line_where_they_cannot_write(tmp_path: Path, program: str) -> None:
    (tmp_path / "runs").touch()
    run = subprocess.run(
        [sys.executable, "-m", f"experiments.{program}"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 2
    assert run.stderr.startswith("graphrqi: error: runs/")
    assert run.stderr.count("\n") == 1
