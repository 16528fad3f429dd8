"""The same command gives the same bytes whatever else is installed and whoever runs it.

Child processes drive, import, classify and predict: one with the runtime requirements alone, one
with everything that is installed here, one in other surroundings.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parent.parent
FINGERPRINT = ROOT / "tests" / "fingerprint.py"


def runtime_distributions() -> dict[str, Distribution]:
    """This project, what it requires to run, and what that requires, by name."""
    found: dict[str, Distribution] = {}
    wanted = [Requirement("graphrqi")]
    while wanted:
        requirement = wanted.pop()
        key = requirement.name.lower().replace("_", "-")
        if key in found and not requirement.extras:
            continue
        found[key] = distribution(requirement.name)
        for line in found[key].requires or []:
            needed = Requirement(line)
            extras = ("", *sorted(requirement.extras))
            if needed.marker is None or any(needed.marker.evaluate({"extra": e}) for e in extras):
                wanted.append(needed)
    return found


def link_runtime(folder: Path) -> None:
    """Fill a folder with links to what the runtime distributions installed, and to nothing else."""
    for found in runtime_distributions().values():
        for file in found.files or []:
            top = file.parts[0]
            source = Path(str(found.locate_file(top)))
            if top not in ("..", "__pycache__") and source.exists():
                link = folder / top
                if not link.is_symlink():
                    link.symlink_to(source)


def hashes(*python: str, **surroundings: str) -> dict[str, str]:
    """What ``tests/fingerprint.py quick`` prints in a child process."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", **surroundings}
    run = subprocess.run(
        [sys.executable, *python],
        cwd=surroundings.get("HOME", str(ROOT)),
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    found: dict[str, str] = json.loads(run.stdout)
    return found


@pytest.fixture(scope="module")
def with_everything() -> dict[str, str]:
    return hashes(str(FINGERPRINT), "quick", PYTHONPATH=str(ROOT))


def test_runtime_requirements_alone_give_the_same_bytes(
    with_everything: dict[str, str], tmp_path: Path
) -> None:
    link_runtime(tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert {"numpy", "libsumo", "highway_env"} <= names
    assert not {"lxml", "hypothesis", "duckdb"} & names
    script = (
        f"import runpy, sys; sys.path[:0] = [{str(ROOT)!r}, {str(tmp_path)!r}];"
        f"sys.argv = ['fingerprint', 'quick'];"
        f"runpy.run_path({str(FINGERPRINT)!r}, run_name='__main__')"
    )
    assert hashes("-S", "-c", script) == with_everything


def test_other_surroundings_give_the_same_bytes(
    with_everything: dict[str, str], tmp_path: Path
) -> None:
    """Another home and working folder, time zone, language, order of hashes, number of threads."""
    other = hashes(
        str(FINGERPRINT),
        "quick",
        PYTHONPATH=str(ROOT),
        HOME=str(tmp_path),
        TZ="Asia/Kathmandu",
        LC_ALL="tr_TR.UTF-8",
        PYTHONHASHSEED="77",
        OMP_NUM_THREADS="2",
    )
    assert other == with_everything
