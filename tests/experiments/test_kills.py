"""Killed at random moments, again and again, `generate` ends with the same bytes."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from contextlib import nullcontext, suppress
from pathlib import Path

import psutil
import pytest

from tests.experiments.shared import call, content, object_store

pytestmark = pytest.mark.slow

KILLS = 20
LATEST_S = 6.0
BUCKET = "kills"
COMMAND = (
    "generate", "--scenario", "straight_road", "--scenario", "four_way_intersection",
    "--episodes", "6", "--seed", "3", "--duration-s", "30", "--quiet",
)  # fmt: skip


def workers(run: int) -> list[int]:
    """The children of a run that make episodes."""
    with suppress(psutil.NoSuchProcess):
        return [
            child.pid
            for child in psutil.Process(run).children()
            if "resource_tracker" not in " ".join(child.cmdline())
        ]
    return []


def kill_one(run: subprocess.Popen[bytes], rng: random.Random) -> None:
    """Kill the run or one of its workers."""
    victims = workers(run.pid)
    if victims and rng.random() < 0.5:
        with suppress(ProcessLookupError):
            os.kill(rng.choice(victims), signal.SIGKILL)
    else:
        run.kill()


def objects(folder: str) -> dict[str, bytes]:
    """The bytes of every object of a dataset on the server, by its name there."""
    import s3fs

    files = s3fs.S3FileSystem(skip_instance_cache=True)
    return {name.removeprefix(f"{folder}/"): files.cat(name) for name in files.find(folder)}


@pytest.mark.parametrize("place", ["disk", "s3"])
def test_whatever_is_killed_the_bytes_are_the_same(place: str, tmp_path: Path) -> None:
    assert call(*COMMAND, "--jobs", "1", "--out", tmp_path / "undisturbed") == 0
    wanted = content(tmp_path / "undisturbed")
    rng = random.Random(place)
    kills = finished = 0
    with object_store(BUCKET) if place == "s3" else nullcontext():
        while kills < KILLS or not finished:
            name = f"data-{finished}"
            out = str(tmp_path / name) if place == "disk" else f"s3://{BUCKET}/{name}"
            command = [sys.executable, "-m", "experiments.cli", *COMMAND, "--jobs", "2"]
            run = subprocess.Popen([*command, "--out", out], stderr=subprocess.DEVNULL)
            while run.poll() is None and kills < KILLS:
                try:
                    run.wait(rng.uniform(0.3, LATEST_S))
                except subprocess.TimeoutExpired:
                    kill_one(run, rng)
                    kills += 1
            assert run.wait() in (0, 2, -signal.SIGKILL)
            if run.returncode == 0:
                made = content(Path(out)) if place == "disk" else objects(f"{BUCKET}/{name}")
                assert made == wanted
                finished += 1
