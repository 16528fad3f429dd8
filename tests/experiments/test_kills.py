"""Slow checks: killed at random moments, again and again, a dataset ends up the same.

Workers are those that users have, started anew by loky or by Dask, which takes seconds; ``graphrqi
bench kills`` forks them, and a sample of it is in ``test_kills_bench.py``. Set GRAPHRQI_SLOW=1 to
run these; GRAPHRQI_KILLS says how many kills per pool (100 if not set).
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from experiments.benches.kills.object_server import BUCKET, ObjectServer, environment
from experiments.data.configuration import GenerateConfig
from experiments.data.generate import generate
from tests.experiments.shared import content

pytestmark = pytest.mark.skipif(
    "GRAPHRQI_SLOW" not in os.environ, reason="takes minutes; set GRAPHRQI_SLOW=1 to run it"
)

KILLS = int(os.environ.get("GRAPHRQI_KILLS", "100"))
LATEST_S = 5.0
CONFIG = GenerateConfig(
    scenarios=("straight_road", "four_way_intersection"), episodes=6, seed=3, duration_s=30.0
)
COMMAND = [
    sys.executable, "-m", "experiments.cli", "generate", "--scenario", "straight_road",
    "--scenario", "four_way_intersection", "--episodes", "6", "--seed", "3", "--duration-s", "30",
    "--quiet",
]  # fmt: skip


def children(process: int) -> list[psutil.Process]:
    with suppress(psutil.NoSuchProcess):
        return [
            child
            for child in psutil.Process(process).children()
            if "resource_tracker" not in " ".join(child.cmdline())
        ]
    return []


class Loky:
    """Workers are the run's own children."""

    options: tuple[str, ...] = ("--jobs", "2")

    def __enter__(self) -> Loky:
        return self

    def __exit__(self, *ended: object) -> None:
        return None

    def workers(self, run: int) -> list[int]:
        return [child.pid for child in children(run)]


class Dask:
    """Workers of Dask's own commands, which start them again when they die.

    Those that are just starting are left alone: Dask gives a place up whose worker dies then.
    """

    ADDRESS = "tcp://127.0.0.1:18786"
    STARTED_S = 6.0
    options: tuple[str, ...] = ("--cluster", ADDRESS)

    def __enter__(self) -> Dask:
        dask = str(Path(sys.executable).parent / "dask")
        scheduler = [dask, "scheduler", "--host", "127.0.0.1", "--port", "18786", "--no-dashboard"]
        worker = [dask, "worker", self.ADDRESS, "--nthreads", "1", "--nworkers", "2"]
        self._processes = [
            subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            for command in (scheduler, [*worker, "--no-dashboard"])
        ]
        return self

    def __exit__(self, *ended: object) -> None:
        for process in reversed(self._processes):
            process.terminate()
            process.wait()

    def workers(self, run: int) -> list[int]:
        now = time.time()
        there = children(self._processes[1].pid)
        return [child.pid for child in there if now - child.create_time() > self.STARTED_S]


@pytest.mark.parametrize("pool", ["loky", "dask"])
def test_whatever_is_killed_the_bytes_are_the_same(pool: str, tmp_path: Path) -> None:
    generate(CONFIG, tmp_path / "undisturbed", jobs=1, quiet=True)
    wanted = content(tmp_path / "undisturbed")
    rng = random.Random(pool)
    kills = {"run": 0, "worker": 0}
    finished = 0
    with Loky() if pool == "loky" else Dask() as workers:
        while sum(kills.values()) < KILLS:
            folder = tmp_path / f"data-{finished}"
            run = subprocess.Popen([*COMMAND, *workers.options, "--out", str(folder)])
            try:
                run.wait(rng.uniform(0.3, LATEST_S))
            except subprocess.TimeoutExpired:
                victims = workers.workers(run.pid)
                if victims and rng.random() < 0.5:
                    with suppress(ProcessLookupError):
                        os.kill(rng.choice(victims), signal.SIGKILL)
                        kills["worker"] += 1
                    try:
                        run.wait(rng.uniform(0.3, LATEST_S))
                    except subprocess.TimeoutExpired:
                        run.kill()
                        kills["run"] += 1
                else:
                    run.kill()
                    kills["run"] += 1
                run.wait()
            if run.returncode == 0:
                assert content(folder) == wanted, f"after {kills}"
                finished += 1
        folder = tmp_path / f"data-{finished}"
        time.sleep(1.0)  # workers of a run that was killed end by themselves
        subprocess.run([*COMMAND, *workers.options, "--out", str(folder)], check=True)
        assert content(folder) == wanted, f"after {kills}"
    print(f"{pool}: {kills}, {finished + 1} datasets")


def test_whatever_is_killed_the_objects_are_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run, its workers, and a server that remembers what it had answered."""
    server = ObjectServer(tmp_path / "kept")
    given = {**environment(server.port), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    generate(CONFIG, tmp_path / "undisturbed", jobs=1, quiet=True)
    wanted = content(tmp_path / "undisturbed")
    rng = random.Random("s3")
    kills = {"run": 0, "worker": 0, "server": 0}
    finished = 0
    server.start()
    try:
        while sum(kills.values()) < KILLS or not finished:
            out = f"s3://{BUCKET}/data-{finished}"
            run = subprocess.Popen(
                [*COMMAND, "--jobs", "2", "--out", out], stderr=subprocess.DEVNULL
            )
            while run.poll() is None:
                with suppress(subprocess.TimeoutExpired):
                    run.wait(rng.uniform(0.3, 2 * LATEST_S))
                    break
                victim = rng.choice(["run", "run", "worker", "worker", "server"])
                workers = Loky().workers(run.pid)
                if victim == "server":
                    server.kill()
                    server.start()
                elif victim == "run":
                    run.kill()
                elif workers:
                    with suppress(ProcessLookupError):
                        os.kill(rng.choice(workers), signal.SIGKILL)
                kills[victim] += victim != "worker" or bool(workers)
            assert run.wait() in (0, 2, -signal.SIGKILL)
            if run.returncode == 0:
                assert server.objects(f"data-{finished}/") == wanted, f"after {kills}"
                assert not list((tmp_path / "cache" / "graphrqi" / "unfinished").iterdir())
                finished += 1
    finally:
        server.kill()
    print(f"s3: {kills}, {finished} datasets")
