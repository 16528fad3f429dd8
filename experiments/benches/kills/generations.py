"""Generations whose run, workers and object server are killed until they come through.

A run with two workers writes to a folder of this machine, or to an S3 server that is killed and
started again with what it kept. The process that is killed, and the time, are random; the same
command goes on until it ends by itself. The dataset must then have the bytes of an undisturbed one,
and nothing else may be left: no file, no staging folder, no process, no semaphore. Then it begins
anew.

Workers are forked (`experiments.benches.kills.forked`), where users' are started anew.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import importlib
import logging
import os
import random
import shutil
import signal
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from experiments.benches.kills import forked
from experiments.benches.kills.object_server import BUCKET, ObjectServer, environment

LOGGER = logging.getLogger(__name__)

PLACES: Final = ("disk", "s3")

SCENARIO: Final = "straight_road"

GENERATE: Final = (
    "generate", "--scenario", SCENARIO, "--episodes", "4", "--duration-s", "2", "--seed", "3",
    "--quiet",
)  # fmt: skip
"""Four episodes of a few vehicles in three shards: most of a run is starting, writing, sealing."""

LATEST: Final = 0.8
"""A run is left alone for at most this many times what the undisturbed one took (most runs are
killed)."""

PATIENCE: Final = 0.1
"""By which share of that the time grows with every kill on the way to one dataset (a machine that
has become busy would otherwise never let a run come through)."""

LOOK_S: Final = 0.02
"""How often is looked for workers, s."""

SOON_S: Final = 0.1
"""Within which time after workers are seen one of them is killed, s (they make an episode in about
that time)."""

EXPECTED: Final = (0, 2, -signal.SIGKILL)
"""Exit codes that a killed run, worker or server may lead to: 2 is that of an error told in a line,
for where the server is gone or a worker dies whenever an episode is tried."""

VANISHED_S: Final = 5.0
"""Within which time what belongs to a killed run must be gone, s; workers look for their run four
times a second."""

METRICS: Final = (
    "killed_runs", "killed_workers", "killed_servers", "datasets", "other_bytes", "left_behind",
    "wrong_code",
)  # fmt: skip


def kills(counts: Counter[str]) -> int:
    """How many runs, workers and servers were killed."""
    return sum(counts[metric] for metric in METRICS[:3])


def disturb(place: str, root: Path, wanted: int, seed: int, counts: Counter[str]) -> Iterator[None]:
    """Kill until enough have been killed and a run has come through.

    Args:
        place: one of `PLACES`.
        root: a folder to work in.
        wanted: how many kills, at least.
        seed: decides who is killed, and when.
        counts: of `METRICS` so far, also of earlier calls; what is found is added.

    Yields:
        After every dataset.

    Raises:
        RuntimeError: if the undisturbed generation fails.
    """
    if kills(counts) >= wanted:
        return
    root.mkdir(parents=True, exist_ok=True)
    _warm(root / "warm")
    trial = _Trial(place, root, f"{place}:{seed}", counts)
    try:
        trial.begin()
        while kills(counts) < wanted:
            trial.dataset()
            yield
    finally:
        trial.stop()
        gc.unfreeze()


def _warm(folder: Path) -> None:
    """Load the simulator and compile what episodes need, so that forked processes have it."""
    from experiments.data.configuration import GenerateConfig
    from experiments.data.episode import Task, make_episode

    config = GenerateConfig(scenarios=(SCENARIO,), episodes=1, duration_s=2.0)
    make_episode(folder, Task(config, SCENARIO, 0))
    shutil.rmtree(folder)
    gc.collect()
    gc.freeze()  # forked processes need not copy what is there already


class _Trial:
    """One place, and what has happened there."""

    def __init__(self, place: str, root: Path, seed: str, counts: Counter[str]) -> None:
        self.counts = counts
        self._root = root
        self._seed = seed
        self._choose = random.Random(seed)
        self._temporary = root / "temporary"
        self._cache = root / "cache"
        self._server = ObjectServer(root / "kept") if place == "s3" else None
        self._out = root / "data" if self._server is None else Path(f"s3://{BUCKET}/data")
        self._wanted: dict[str, str] = {}
        self._lasts_s = 0.0
        self._runs: list[int] = []
        self._kills = 0
        self._environment = contextlib.ExitStack()

    def begin(self) -> None:
        """Start the server, and make the dataset undisturbed."""
        given = {"XDG_CACHE_HOME": str(self._cache)}
        if self._server is not None:
            importlib.import_module("s3fs")  # before runs are forked
            given |= environment(self._server.port)
            self._server.start()
        before = {name: os.environ.get(name) for name in given}
        os.environ.update(given)
        self._environment.callback(_restore, before)
        began = time.monotonic()
        code, told = forked.run(self._words(), self._temporary)
        self._lasts_s = time.monotonic() - began
        if code:
            raise RuntimeError(f"generate ended with {code} when nobody disturbed it: {told}")
        self._wanted = self._content()
        self._clear()

    def stop(self) -> None:
        """End the server."""
        if self._server is not None:
            self._server.kill()
        self._environment.close()

    def dataset(self) -> None:
        """Run and kill until a run comes through, then look at everything."""
        self._choose = random.Random(f"{self._seed}:{self.counts['datasets']}")
        while not self._run():
            pass
        self.counts["datasets"] += 1
        found, left = self._content(), self._left()
        if found != self._wanted:
            names = {*found, *self._wanted}
            self._flaw(
                "other_bytes",
                ", ".join(sorted(n for n in names if found.get(n) != self._wanted.get(n))),
            )
        if left:
            self._flaw("left_behind", ", ".join(left))
        self._clear()

    def _run(self) -> bool:
        """One run; whether it came through."""
        begun, kills = time.monotonic(), self._kills
        process = forked.start(self._words(), self._temporary)
        assert process.pid is not None
        self._runs.append(process.pid)
        others = ["worker", "worker"] + ["server"] * (self._server is not None)
        while True:
            latest_s = LATEST * self._lasts_s * (1.0 + PATIENCE * self._kills)
            victim = self._choose.choice(["run", "run", *others])
            until = time.monotonic() + self._choose.uniform(0.0, latest_s)
            if victim == "worker":  # they live for a part of the run, or not at all
                victim = "run"
                while victim == "run" and process.exitcode is None and time.monotonic() < until:
                    process.join(LOOK_S)
                    victim = "worker" if _workers(process.pid) else "run"
                until = time.monotonic() + self._choose.uniform(0.0, SOON_S) * (victim == "worker")
            process.join(max(0.0, until - time.monotonic()))
            if process.exitcode is not None:
                break
            self._kills += 1
            self._kill(victim, process.pid)
        code, told = forked.ended(process, self._temporary)
        took_s = time.monotonic() - begun
        if self._kills == kills and (kills == 0 or took_s > self._lasts_s):
            self._lasts_s = took_s  # the machine has become quicker or slower
        if code not in EXPECTED:
            self._flaw("wrong_code", f"{code}: {told[-280:]}")
        return code == 0

    def _kill(self, victim: str, run: int) -> None:
        if victim == "server" and self._server is not None:
            self._server.kill()
            self._server.start()
            self.counts["killed_servers"] += 1
            return
        if victim == "worker":
            workers = _workers(run)
            if not workers:
                return
            killed = self._choose.choice(workers)
        else:
            killed = run
        with contextlib.suppress(ProcessLookupError):
            os.kill(killed, signal.SIGKILL)
            self.counts[f"killed_{victim}s"] += 1

    def _words(self) -> list[str]:
        return [*GENERATE, "--jobs", "2", "--out", str(self._out)]

    def _content(self) -> dict[str, str]:
        if self._server is None:
            return forked.content(self._out)
        objects = self._server.objects()
        return {name: hashlib.sha256(data).hexdigest() for name, data in objects.items()}

    def _left(self) -> list[str]:
        """What belongs to a run and is still there after a while."""
        begin = time.monotonic()
        while True:
            left = [f"process {pid}" for run in self._runs for pid in _workers(run)]
            semaphores = Path("/dev/shm")
            if semaphores.is_dir():
                left += [
                    str(p) for p in semaphores.iterdir()
                    for run in self._runs if f"-{run}-" in p.name
                ]  # fmt: skip
            if not left or time.monotonic() - begin > VANISHED_S:
                break
            time.sleep(0.05)
        for home in (self._temporary, self._cache):
            left += [str(p.relative_to(self._root)) for p in home.rglob("*") if p.is_file()]
        unfinished = self._cache / "graphrqi" / "unfinished"
        left += [str(p) for p in unfinished.iterdir()] if unfinished.is_dir() else []
        beside = {p.name for p in self._root.iterdir()}
        ours = {"data", "temporary", "cache", "kept", "told"}
        return left + sorted(beside - ours)

    def _clear(self) -> None:
        """Begin anew."""
        self._runs, self._kills = [], 0
        for folder in (self._root / "data", self._temporary):
            shutil.rmtree(folder, ignore_errors=True)
        if self._server is not None:
            self._server.clear()

    def _flaw(self, kind: str, why: str) -> None:
        self.counts[kind] += 1
        LOGGER.warning("%s: %s: %.300s", self._out, kind, why)


def _restore(before: dict[str, str | None]) -> None:
    for name, value in before.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


def _workers(run: int) -> list[int]:
    """Processes of a run's session beside the run itself, but for loky's resource tracker."""
    found = []
    for home in Path("/proc").iterdir():
        if not home.name.isdecimal() or int(home.name) == run:
            continue
        with contextlib.suppress(OSError, ValueError):
            words = (home / "stat").read_text().rpartition(")")[2].split()
            state, session = words[0], int(words[3])
            if (
                session == run
                and state != "Z"
                and b"tracker" not in (home / "cmdline").read_bytes()
            ):
                found.append(int(home.name))
    return found
