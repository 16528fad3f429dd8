"""Every command and snippet of the README and of the documentation runs as it stands there.

Left out are ``make`` and ``pip``, which install, and benchmarks, of which
only the names and options are looked up here. The cluster of
the documentation has two workers, on this machine, and large datasets are made small. A shell runs
the scripts of the README and those that need one; in others, ``graphrqi`` runs in this process,
which has its libraries imported already.
"""

from __future__ import annotations

import ast
import os
import re
import runpy
import shlex
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
import typer
from sybil import Example, Sybil
from sybil.parsers.markdown import CodeBlockParser, PythonCodeBlockParser

from experiments.cli.bench import bench
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from tests.experiments.shared import call

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted(
    path.relative_to(ROOT).as_posix() for path in [ROOT / "README.md", *ROOT.glob("docs/**/*.md")]
)
INSTALLS = re.compile(r"^(make|pip|source) .*\n", flags=re.MULTILINE)
BENCH = re.compile(r"^graphrqi bench (\S+)(.*)\n", flags=re.MULTILINE)
SMALL_CLUSTER = {"head:": "127.0.0.1:", "/shared/": "", "--nworkers 16": "--nworkers 2",
                 "--episodes 5000": "--episodes 2 --duration-s 20"}  # fmt: skip

LONG = re.compile(r"(?<=--duration-s )(?:[3-9]\d|\d{3,})")
SMALL = {
    "--episodes 40 ": "--episodes 1 ",
    "--episodes 5 ": "--episodes 3 ",
    "--at-s 20 ": "--at-s 10 ",
    "drive --quick ": "drive --policy planner-classified --crowd mixed --episodes 1 --quick ",
    "--policy idm-mobil --quick ": "--crowd timid --episodes 1 --quick ",
}
"""Shorter commands; durations (`LONG`) become 20 s."""
LONGEST_S = 240.0


def run_commands(example: Example) -> None:
    script = INSTALLS.sub("", str(example.parsed))
    for name, options in BENCH.findall(script):
        parameters = typer.main.get_command(bench).commands[name].params
        known = {option for parameter in parameters for option in parameter.opts}
        assert set(re.findall(r"--[a-z-]+", options)) <= known, f"{name} {options}"
    script = BENCH.sub("", script)
    for shown, here in SMALL.items():
        script = script.replace(shown, here)
    script = LONG.sub("20", script)
    if "--cluster" in script:
        for shown, here in SMALL_CLUSTER.items():
            assert shown in script
            script = script.replace(shown, here)
    if written := re.fullmatch(r"bash (\S+)\n", script):
        script = Path(written[1]).read_text()
    commands = graphrqi_commands(script)
    if commands is None or Path(example.path).name == "README.md":
        run_in_a_shell(script)
    else:
        for arguments in commands:
            assert call(*arguments) == 0, arguments


def graphrqi_commands(script: str) -> list[list[str]] | None:
    """The arguments of each ``graphrqi`` command; None if there is more than such commands."""
    if re.search(r"[$|&;<>*]", script):
        return None
    lines = script.replace("\\\n", " ").splitlines()
    commands = [words for line in lines if (words := shlex.split(line, comments=True))]
    alone = all(words[0] == "graphrqi" for words in commands)
    return [words[1:] for words in commands] if alone else None


def run_in_a_shell(script: str) -> None:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    said = Path("said.txt")
    with said.open("w") as file:
        shell = subprocess.Popen(
            ["bash", "-euo", "pipefail", "-c", script],
            env={**os.environ, "PATH": path, "OMP_NUM_THREADS": "1"},
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            code = shell.wait(LONGEST_S)
        finally:
            with suppress(ProcessLookupError):  # what it left running
                os.killpg(shell.pid, signal.SIGKILL)
    assert code == 0, f"{script}\n{said.read_text()}"


SYBIL = Sybil(
    parsers=[
        PythonCodeBlockParser(),
        CodeBlockParser(language="bash", evaluator=run_commands),
    ],
    path=str(ROOT),
)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What pages call ``data`` that do not make it themselves."""
    folder = tmp_path_factory.mktemp("docs") / "data"
    config = GenerateConfig(scenarios=("straight_road",), episodes=3, duration_s=25.0)
    generate(config, folder, jobs=1, quiet=True)
    return folder


@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_says_runs(
    page: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    document = SYBIL.parse(ROOT / page)
    code = [str(example.parsed) for example in document.examples()]
    if not re.search(r"--out \S*data\s", document.text) and re.search(r"\bdata\b", str(code)):
        shutil.copytree(request.getfixturevalue("dataset"), tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    for example in document.examples():
        if "s3://" not in example.parsed:  # test_foreign_readers runs those, beside a server
            example.evaluate()


def test_the_readmes_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\((?!https?:)([\w./-]+)\)", (ROOT / "README.md").read_text()):
        assert (ROOT / target).exists(), target


@pytest.mark.slow
def test_the_pages_build_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("material", reason="pip install 'graphrqi[docs]'")
    run = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    home = (tmp_path / "index.html").read_text()
    assert "fonts.googleapis" not in home
    assert not missing_in_reference(tmp_path)


def missing_in_reference(site: Path) -> list[str]:
    """The public functions and classes that the reference does not describe."""
    script = runpy.run_path(str(ROOT / "docs" / "reference_pages.py"))
    missing = []
    for name, files in [part for each in script["PACKAGES"] for part in script["parts"](each)]:
        shown = site / script["file_name"](name).replace(".md", ".html")
        described = set(re.findall(r'id="([\w.]+)"', shown.read_text()))
        for path in files:
            body = ast.parse(path.read_text()).body
            named = [node.name for node in body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
            public = [f"{script['module_name'](path)}.{n}" for n in named if not n.startswith("_")]
            missing += [each for each in public if each not in described]
    return missing
