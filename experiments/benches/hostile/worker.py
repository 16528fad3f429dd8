"""Processes that try inputs, with limits on their memory and time, so that no input ends a run.

An abort in native code, a leak or a hang ends one worker; the input is noted and another worker
goes on with the next. Needs ``fork`` and ``resource``: Linux or macOS.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import multiprocessing
import os
import resource
import signal
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

from experiments.benches.hostile.trial import FAILURES, check, families

WORKER_INPUTS: Final = 20_000
"""Inputs after which a worker is replaced (what leaks then shows as its peak, and loading compiled
code takes a hundredth of the time)."""

WAITS: Final = 4.0
"""An input that waits without computing is given up after this many times its time limit."""

PEAK: Final = Path("/proc/self/clear_refs")
"""Linux forgets the peak of a process's memory when 5 is written here."""

STATUS: Final = Path("/proc/self/status")


@dataclass(frozen=True)
class Trial:
    """What became of one input.

    Attributes:
        family: of the input.
        number: of the input.
        state: as `experiments.benches.hostile.trial.check`, or "abort", "slow" or "large".
        why: in words.
        seconds: that it took.
        peak_gb: most memory that the worker held while it tried this input, GB (where the system
            is not Linux: so far).
    """

    family: str
    number: int
    state: str
    why: str
    seconds: float
    peak_gb: float


def try_all(inputs: Iterable[tuple[str, int]], limit_gb: float, limit_s: float) -> Iterator[Trial]:
    """Try inputs one after another.

    Args:
        inputs: families and numbers.
        limit_gb: memory that one input may take, GB; a worker can have twice as much address space
            beyond what it starts with, since libraries set space aside that they never use.
        limit_s: longest time for one input, s: of the processor, where the system tells a
            process's (Linux), so that a busy machine makes no input slow; at most `WAITS` times
            as long by the clock.

    Yields:
        One for each input, in their order.
    """
    families()  # samples are made once, before workers are forked
    with tempfile.TemporaryDirectory(prefix="graphrqi-hostile-") as scratch:
        yield from _try_all(inputs, limit_gb, limit_s, Path(scratch))


def _try_all(
    inputs: Iterable[tuple[str, int]], limit_gb: float, limit_s: float, scratch: Path
) -> Iterator[Trial]:
    context = multiprocessing.get_context("fork")
    coming = iter(inputs)
    while part := list(itertools.islice(coming, WORKER_INPUTS)):
        told, tell = context.Pipe(duplex=False)
        worker = context.Process(target=_work, args=(part, tell, limit_gb, scratch))
        worker.start()
        tell.close()
        done, state = 0, "stopped"
        began, spent = time.monotonic(), 0.0
        try:
            while done < len(part):
                if not told.poll(limit_s):
                    waited = time.monotonic() - began
                    if waited < WAITS * limit_s and _cpu_s(worker.pid) - spent < limit_s:
                        continue
                    state = "slow"
                    break
                try:
                    yield Trial(**json.loads(told.recv_bytes()))
                except EOFError:
                    state = "abort"
                    break
                done, began, spent = done + 1, time.monotonic(), _cpu_s(worker.pid)
        finally:  # also when whoever asks is stopped: a worker that nobody hears would wait
            if done < len(part) and state != "abort":
                worker.kill()
            worker.join()
            told.close()
        if done < len(part):
            family, number = part[done]
            why = f"over {limit_s:g} s" if state == "slow" else f"exit code {worker.exitcode}"
            seconds = time.monotonic() - began
            yield Trial(family, number, state, why, seconds, float("nan"))
            coming = itertools.chain(part[done + 1 :], coming)


def _work(
    inputs: Sequence[tuple[str, int]], tell: Connection, limit_gb: float, scratch: Path
) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    limit = _address_space() + int(2e9 * limit_gb)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    _forget_peak()
    had_gb = _peak_gb()  # what was there when the process was forked is no input's
    for family, number in inputs:
        _forget_peak()
        began = time.perf_counter()
        state, why = check(family, number, scratch / f"{family}-{number}")
        seconds, peak_gb = time.perf_counter() - began, _peak_gb()
        if peak_gb - had_gb > limit_gb and state not in FAILURES:
            state, why = "large", f"{peak_gb:.2f} GB, {why}"
        trial = Trial(family, number, state, why[:500], seconds, peak_gb)
        tell.send_bytes(json.dumps(trial.__dict__).encode())
    tell.close()
    os._exit(0)  # the parent's clean-up is not ours


def _cpu_s(process: int | None) -> float:
    """Time of the processor that a process has had, s; infinite where the system does not say."""
    try:
        told = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return (int(told[11]) + int(told[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return float("inf")


def _forget_peak() -> None:
    with contextlib.suppress(OSError):
        PEAK.write_bytes(b"5")


def _peak_gb() -> float:
    """Most memory that this process has held since its peak was forgotten, GB."""
    try:
        told = STATUS.read_bytes().partition(b"VmHWM:")[2].split(maxsplit=1)
        return int(told[0]) / 1e6
    except (OSError, IndexError, ValueError):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def _address_space() -> int:
    """Bytes of address space that this process has; 0 where the system does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except OSError:
        return 0
    return pages * resource.getpagesize()
