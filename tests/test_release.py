"""What is published: the claimed Python versions, the container, the files of `make release`."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


@pytest.mark.slow
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
