"""What is published: the claimed Python versions, the container, the files of `make release`."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def claimed_versions() -> list[str]:
    """Python versions that the package's classifiers name."""
    found = (re.fullmatch(r".*Python :: (3\.\d+)", line) for line in PROJECT["classifiers"])
    return [match[1] for match in found if match]


def test_the_checks_run_on_every_claimed_python() -> None:
    yaml = pytest.importorskip("yaml")
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())["jobs"]
    assert jobs["test"]["strategy"]["matrix"]["python"] == claimed_versions()
    assert "continue-on-error" not in jobs["test"], "a claimed version may not fail"
    least, *_, most = (int(version.partition(".")[2]) for version in claimed_versions())
    assert PROJECT["requires-python"] == f">=3.{least},<3.{most + 1}"
    commands = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    targets = {target for line in commands for target in re.findall(r"make (\w+)", line)}
    assert targets == {"test", "release"}


def test_the_container_is_built_from_what_the_package_is_made_of() -> None:
    text = (ROOT / "Dockerfile").read_text()
    (base,) = set(re.findall(r"FROM python:(3\.\d+)", text))
    assert base in claimed_versions()
    copied = [
        path for line in re.findall(r"^COPY (?!--)(.*)$", text, re.M) for path in line.split()
    ]
    packages = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    for pattern in packages["packages"]["find"]["include"]:
        assert pattern.rstrip("*") in copied
    ignored = (ROOT / ".dockerignore").read_text().split()
    assert not {path for path in copied if path in ignored}
    assert "RUN graphrqi doctor" in text


@pytest.mark.skipif("GRAPHRQI_SLOW" not in os.environ, reason="minutes; set GRAPHRQI_SLOW=1")
def test_a_release_is_whole(tmp_path: Path) -> None:
    source = tmp_path / "source"
    tracked = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    for name in tracked:
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, source / name)
    subprocess.run(["make", "release", f"PYTHON={sys.executable}"], cwd=source, check=True)
    made = source / "dist"
    version = PROJECT["version"]
    assert {path.name for path in made.iterdir()} == {
        f"graphrqi-{version}.tar.gz", f"graphrqi-{version}-py3-none-any.whl", "SHA256SUMS",
        "licences.md", "requirements.lock", "sbom.cdx.json",
    }  # fmt: skip
    bill = json.loads((made / "sbom.cdx.json").read_text())
    named = {component["name"].lower() for component in bill["components"]}
    lock = (made / "requirements.lock").read_text()
    locked = set(re.findall(r"^([\w.-]+)==", lock, flags=re.M))
    assert locked == named
    assert len(re.findall(r"--hash=sha256:", lock)) >= len(locked)
    assert "http" not in lock
    check = ["-m", "pip", "install", "--dry-run", "--quiet", "--require-hashes", "--no-deps"]
    environment = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
    python = str(environment / "bin" / "python")
    subprocess.run([python, *check, "-r", str(made / "requirements.lock")], check=True)
