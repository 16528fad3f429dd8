"""The wheel alone, in an environment of its own and away from the source, works."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("behaviors", "sim", "graphrqi", "scenarios", "experiments")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy, so that nothing is left in the source tree."""
    source = tmp_path_factory.mktemp("source")
    for package in PACKAGES:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, source / package, ignore=ignored)
    for file in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / file, source)
    shutil.copytree(ROOT / "tests", source / "tests", ignore=shutil.ignore_patterns("__pycache__"))
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", str(source)],
        check=True,
        capture_output=True,
    )
    (built,) = (source / "dist").glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bin folder of an environment with the wheel; dependencies are borrowed, not copied.

    A path file makes this environment's packages visible there. Python does not follow the path
    files inside, so an editable installation of the source stays out of sight.
    """
    home = tmp_path_factory.mktemp("clean") / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(home)], check=True)
    python = home / "bin" / "python"
    subprocess.run(
        [
            *(sys.executable, "-m", "pip", "--python", str(python)),
            *("install", "--quiet", "--no-deps", "--no-index", str(wheel)),
        ],
        check=True,
    )
    (site,) = (home / "lib").glob("python*/site-packages")
    (site / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return home / "bin"


def run(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    environment["NUMBA_DISABLE_JIT"] = "1"  # a new place has no compiled kernels
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_what_the_wheel_holds(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert tops == {*PACKAGES, next(t for t in tops if t.endswith(".dist-info"))}
    assert "scenarios/networks/straight_road/road.net.xml" in names
    assert "graphrqi/models/graphrqi-plus/model.safetensors" in names
    assert not [n for n in names if "test_" in n or n.endswith(".pyc")]
    assert sum(i.file_size for i in zipfile.ZipFile(wheel).infolist()) < 20e6


def test_the_installed_command_works_anywhere(installed: Path, tmp_path: Path) -> None:
    where = run([str(installed / "python"), "-c", "import sim; print(sim.__file__)"], tmp_path)
    assert str(installed.parent) in where.stdout

    listed = run([str(installed / "graphrqi"), "list"], tmp_path)
    assert listed.returncode == 0, listed.stdout + listed.stderr

    command = [str(installed / "graphrqi"), "generate", "--scenario", "straight_road"]
    generated = run(
        [*command, "--episodes", "1", "--duration-s", "5", "--out", "data", "--quiet"], tmp_path
    )
    assert generated.returncode == 0, generated.stderr
    assert (tmp_path / "data" / "episodes.parquet").is_file()


GPU = re.compile(r"(cuda|nvidia|triton)\b")
"""What torch's builds for GPUs bring along, in versions that torch itself says."""


def test_every_dependency_is_pinned_to_what_is_tested_here() -> None:
    pins = dict(
        line.split("==")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if not line.startswith("#")
    )
    pinned = {canonicalize_name(name): version for name, version in pins.items()}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"].values()
    todo = [*project["dependencies"], *(line for lines in extras for line in lines)]
    seen: set[str] = set()
    while todo:
        requirement = Requirement(todo.pop())
        name = canonicalize_name(requirement.name)
        wanted = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
        if name in seen or not wanted:
            continue
        seen.add(name)
        assert name in pinned, f"{name} is not in constraints.txt"
        with contextlib.suppress(metadata.PackageNotFoundError):
            found = Version(metadata.version(name)).public
            assert found == pinned[name], f"{name}: found {found}, expected {pinned[name]}"
            needs = metadata.requires(name) or []
            todo += [line for line in needs if name != "torch" or not GPU.match(line)]
    assert len(seen) > 40
