"""A stopped command clears away what it was writing; one that was killed can be run again."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.data.exchange import import_recordings
from tests.experiments.shared import content, heed_signals

FCD = '<timestep time="{t}"><vehicle id="a" x="{t}" y="0" angle="90" speed="1"/></timestep>'

STOPPED_INSIDE = """
import sys, time
from pathlib import Path
from experiments.console.exit_codes import exit_on_user_error
from sim.files import new_folder, whole_file, whole_folder

folder = Path(sys.argv[1])
with exit_on_user_error(), new_folder(folder) as folder, whole_file(folder / "file") as file:
    with whole_folder(folder / "part") as part:
        file.write_text("half")
        (part / "x").write_text("half")
        print("writing", flush=True)
        time.sleep(60)
"""


def stopped(number: int, folder: Path, script: str = STOPPED_INSIDE) -> tuple[int, str]:
    """Exit code and message of a program that a signal stopped while it was writing."""
    with subprocess.Popen(
        [sys.executable, "-c", script, folder], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, preexec_fn=heed_signals,
    ) as run:  # fmt: skip
        assert run.stdout is not None
        assert run.stderr is not None
        assert run.stdout.readline() == "writing\n"
        run.send_signal(number)
        try:
            code = run.wait(10)
        except subprocess.TimeoutExpired:  # Python loses one that arrives inside a destructor
            run.send_signal(number)
            code = run.wait(20)
        return code, run.stderr.read()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_stopped_program_leaves_nothing_behind(tmp_path: Path, number: signal.Signals) -> None:
    code, message = stopped(number, tmp_path / "new")
    assert code == 128 + number
    assert message == "graphrqi: stopped: run the same command again to go on\n"
    assert list(tmp_path.iterdir()) == []


def test_an_import_that_was_killed_can_be_run_again(tmp_path: Path) -> None:
    source = tmp_path / "a.xml"
    source.write_text(f"<fcd-export>{''.join(FCD.format(t=t) for t in range(5))}</fcd-export>")
    killed = tmp_path / "killed"
    script = STOPPED_INSIDE.replace("exit_on_user_error(), ", "")
    assert stopped(signal.SIGKILL, killed, script)[0] == -signal.SIGKILL
    assert not killed.exists()
    for folder in (killed, tmp_path / "whole"):
        import_recordings(source, folder, quiet=True)
    assert content(killed) == content(tmp_path / "whole")
