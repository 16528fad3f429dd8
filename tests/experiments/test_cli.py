"""The command line: quick to start, an example in every help, one line for every mistake."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.cli.commands import app, main

COMMANDS = sorted(command.name or command.callback.__name__ for command in app.registered_commands)  # type: ignore[union-attr]


ONE = ("generate", "--scenario", "straight_road", "--episodes", "1")


def graphrqi(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    said = capsys.readouterr()
    assert isinstance(ended.value.code, int)
    return ended.value.code, said.out, said.err


@pytest.mark.parametrize("command", COMMANDS)
def test_every_help_shows_an_example(capsys: pytest.CaptureFixture[str], command: str) -> None:
    code, out, _ = graphrqi(capsys, command, "--help")
    assert code == 0
    assert f"example: graphrqi {command}" in " ".join(out.split())


def test_help_imports_nothing_heavy() -> None:
    heavy = ("numpy", "scipy", "torch", "pyarrow", "numba", "sklearn", "sumolib", "sim")
    code = (
        "import sys, contextlib\n"
        "from experiments.cli.commands import main\n"
        "with contextlib.suppress(SystemExit): main(['generate', '--help'])\n"
        f"print([m for m in {heavy!r} if m in sys.modules], file=sys.stderr)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stderr.strip() == "[]"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["generat"], "No such command 'generat'"),
        (["generate"], "Missing option '--out'"),
        (["generate", "--out", "{tmp}/x"], "--scenario: found none, expected one"),
        (["generate", "--out", "{tmp}/x", "--config", "{tmp}/none.toml"], "No such file"),
        ([*ONE, "--out", "{tmp}/file"], "found a file, expected a folder"),
        (["import", "{tmp}/file", "--out", "{tmp}/x"], "found nothing in it"),
        (["import", "{tmp}/file", "--format", "ngsmi", "--out", "{tmp}/x"], "did you mean 'ngsim'"),
        (["export", "{tmp}", "--format", "ngsim", "--out", "{tmp}/x"], "found no writer"),
        (["run", "straight_road", "--net", "t.net.xml"], "beside the scenario straight_road"),
        (["run", "straight_road", "--set", "flow=dense"], "found flow, expected --flow"),
        (["run", "straight_road", "--set", "lanes"], "expected NAME=VALUE"),
        (["run", "straight_road", "--engine", "sumoo"], "did you mean 'sumo'"),
        (["run", "straight_road", "--seed", "x"], "--seed"),
        (["bench", "spektrum"], "Did you mean 'spectrum'"),
        (["train", "{tmp}", "--out", "{tmp}/m", "--labels", "{tmp}/file"], "found no --from"),
        (["train", "{tmp}/file", "--out", "{tmp}/m"], "found a file, expected a dataset"),
        (["classify", "{tmp}/none.csv", "--out", "{tmp}/l"], "found nothing there"),
        (["classify", "{tmp}", "--out", "{tmp}/l.xlsx"], "expected .parquet or .csv"),
        (["evaluate", "m", "{tmp}/file", "--json", "{tmp}/file"], "found the same file twice"),
        (["list", "--json", "{tmp}/nowhere/x"], "found no folder"),
        (["report", "{tmp}/nowhere"], "found nothing there"),
        (["report", "{tmp}/file"], "found no JSON"),
    ],
)
def test_every_mistake_is_one_line_and_exit_code_2(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], message: str
) -> None:
    (tmp_path / "file").touch()
    filled = [a.format(tmp=tmp_path) for a in arguments]
    code, out, err = graphrqi(capsys, *filled)
    assert code == 2
    assert err.startswith("graphrqi: error: ")
    assert err.count("\n") == 1
    assert message.format(tmp=tmp_path) in err
    assert out == ""


def test_a_bug_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    import experiments.cli.names

    def bug() -> list[dict[str, str]]:
        raise ValueError("not the user's fault")

    monkeypatch.setattr(experiments.cli.names, "registered_names", bug)
    with pytest.raises(ValueError, match="not the user's fault"):
        main(["list"])


def test_run_sums_up(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    code, out, _ = graphrqi(
        capsys, "run", "straight_road", "--duration-s", "15", "--flow", "dense", "--json", str(path)
    )
    rows = {row["metric"]: row["value"] for row in json.loads(path.read_text())}
    assert code == 0
    assert rows["simulated_s"] == 15.0
    assert rows["agents"] >= 3
    assert "mean_speed" in out


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("run straight", "straight_road"),
        ("run straight_road --engine h", "highway"),
        ("train data --method graphrqi-p", "graphrqi-plus"),
        ("bench spec", "spectrum"),
    ],
)
def test_the_shell_completes_names(typed: str, offered: str) -> None:
    words = f"graphrqi {typed}"
    run = subprocess.run(
        [sys.executable, "-m", "experiments.cli"],
        env={
            **os.environ,
            "_GRAPHRQI_COMPLETE": "complete_bash",
            "COMP_WORDS": words,
            "COMP_CWORD": str(len(words.split()) - 1),
        },
        capture_output=True,
        text=True,
        check=True,
    )
    assert offered in run.stdout.split()


def test_ctrl_c_ends_it_with_130_and_no_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import experiments.cli.names

    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(experiments.cli.names, "registered_names", interrupted)
    assert graphrqi(capsys, "list") == (130, "", "graphrqi: stopped\n")
