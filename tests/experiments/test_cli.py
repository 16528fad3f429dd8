"""The command line: quick to start, an example in every help, one line for every mistake."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.benches.registry import BENCHES
from experiments.cli.commands import app, main
from experiments.console.exit_codes import Interrupted
from sim.scenario import MAX_DURATION_S, MAX_PER_HOUR

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
        (["generate", "--out", "{tmp}/x", "--scenario", "straight", "--episodes", "1"], "straight"),
        (["generate", "--out", "{tmp}/x", "--config", "{tmp}/none.toml"], "No such file"),
        (["generate", "--out", "{tmp}/x", "--jobs", "many"], "--jobs"),
        ([*ONE, "--out", "{tmp}/file"], "found a file, expected a folder"),
        ([*ONE, "--out", "{tmp}/file/x"], "{tmp}/file/x: Not a directory"),
        ([*ONE, "--out", "{tmp}/x", "--jobs", "0"], "jobs: found 0"),
        (["verify", "{tmp}"], "episodes.parquet"),
        (["import", "{tmp}/file", "--out", "{tmp}/x"], "found no known format"),
        (["import", "{tmp}/file", "--format", "ngsmi", "--out", "{tmp}/x"], "did you mean 'ngsim'"),
        (["export", "{tmp}", "--format", "ngsim", "--out", "{tmp}/x"], "found no writer"),
        (
            ["run", "straight_road", "--net", "t.net.xml"],
            "t.net.xml beside the scenario straight_r",
        ),
        (["classify", "{tmp}/none", "--out", "{tmp}/l"], "none"),
        (["run", "straight_road", "--engine", "sumoo"], "did you mean 'sumo'"),
        (["run", "straight_road", "--mix", "timid=3"], "mix: found shares adding to 3"),
        (["run", "straight_road", "--seed", "-1"], "--seed: found '-1', expected at least 0"),
        (["run", "straight_road", "--seed", "x"], "--seed: found 'x', expected a valid integer"),
        (["generate", "--worlds", "0", "--out", "{tmp}/x"], "--worlds: found 0, expected at least"),
        (["bench", "spektrum"], "did you mean 'spectrum'"),
        (["train", "{tmp}/none", "--out", "{tmp}/m"], "none"),
        (["train", "{tmp}", "--out", "{tmp}/m"], "episodes.parquet"),
        (["train", "{tmp}/file", "--out", "{tmp}/m"], "found a file, expected a dataset"),
        (["classify", "{tmp}/none.csv", "--out", "{tmp}/l"], "found nothing there"),
        (["classify", "{tmp}", "--out", "{tmp}"], "is a directory"),
        (["list", "--json", "{tmp}"], "is a directory"),
        (["bench", "spectrum", "--solvers", "eig"], "did you mean 'eigh'"),
        (["bench", "spectrum", "--graphs", "road,x"], "graph: found 'x'"),
        (["bench", "spectrum", "--kinds", "x"], "kind: found 'x'"),
        (["bench", "spectrum", "--ends", "largest,x"], "end: found 'x'"),
        (["bench", "spectrum", "--sizes", "x"], "expected whole numbers"),
        (["bench", "spectrum", "--kinds", "x", "--kinds", "accumulated"], "kind: found 'x'"),
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


def test_bench_alone_shows_its_help(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = graphrqi(capsys, "bench")
    assert (code, err) == (0, "")
    assert "spectrum" in out
    assert out == graphrqi(capsys, "bench", "--help")[1]


def test_a_bug_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    import experiments.cli.doctor

    def bug() -> list[dict[str, str]]:
        raise ValueError("not the user's fault")

    monkeypatch.setattr(experiments.cli.doctor, "registered_names", bug)
    with pytest.raises(ValueError, match="not the user's fault"):
        main(["list"])


def test_list_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = graphrqi(capsys, "list", "--json", "-")
    rows = json.loads(out)
    names = {(row["what"], row["name"]) for row in rows}
    assert code == 0
    about = {(row["what"], row["name"]): row["about"] for row in rows}
    assert about["bench", "loop"] == BENCHES["loop"].summary
    assert about["engine", "sumo-idm"].startswith("Drive a scenario in SUMO; drivers follow by IDM")
    assert [key for key, said in about.items() if not said] == []
    assert {("scenario", "straight_road"), ("engine", "sumo"), ("solver", "graphrqi")} <= names
    assert {row["from"] for row in json.loads(out)} == {"graphrqi"}


def test_run_sums_up(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    code, out, _ = graphrqi(
        capsys, "run", "straight_road", "--duration-s", "15", "--flow", "dense", "--json", str(path)
    )
    rows = {row["what"]: row["value"] for row in json.loads(path.read_text())}
    assert code == 0
    assert rows["simulated, s"] == 15.0
    assert rows["agents that entered"] > 3
    assert "mean speed" in out


def test_bench_of_some_solvers_only(capsys: pytest.CaptureFixture[str]) -> None:
    names = "graphrqi,eigh"
    code, out, _ = graphrqi(
        capsys, "bench", "spectrum", "--solvers", names, "--graphs", "road", "--sizes", "25",
        "--kinds", "instantaneous", "--ends", "largest", "--steps", "3", "--study", "0",
        "--json", "-",
    )  # fmt: skip
    assert code == 0
    measured = {row["solver"] for row in json.loads(out) if row["metric"] == "missed_pairs"}
    assert measured == {"graphrqi", "eigh"}


def test_doctor_finds_what_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = graphrqi(capsys, "doctor", "--json", "-")
    rows = {row["what"]: row for row in json.loads(out)}
    assert rows["numpy"]["state"] == "ok"
    assert rows["scenarios"]["state"] == "ok"
    assert rows["sumo starts"]["state"] == "ok", rows["sumo starts"]


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
    import experiments.cli.doctor

    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(experiments.cli.doctor, "registered_names", interrupted)
    assert graphrqi(capsys, "list") == (130, "", "graphrqi: stopped\n")


def test_a_command_that_says_how_to_go_on_says_it_alone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import experiments.cli.doctor

    def interrupted() -> None:
        raise Interrupted("stopped: 1 of 2")

    monkeypatch.setattr(experiments.cli.doctor, "registered_names", interrupted)
    assert graphrqi(capsys, "list") == (130, "", "graphrqi: stopped: 1 of 2\n")


def test_help_says_the_limits_that_hold(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = graphrqi(capsys, "generate", "--help")
    said = " ".join(out.split())
    assert f"vehicles per hour, at most {MAX_PER_HOUR:g}" in said
    assert f"Length, s; at most {MAX_DURATION_S:g}" in said
