"""Are branches of a running SUMO episode exact, quick, and harmless to the episode they leave?

An episode is driven to an instant and branched many times without a change. Every branch must give
the next frames of the episode to the bit, with their pedestrians, signals and events. Then the rate
of forks is measured, and branches are killed to see that the episode drives on as if nothing had
happened and that no dead process is left behind.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from experiments.benches.contract import Bench, option
from experiments.score.rows import Cell, Row, tidy_row
from scenarios import get_scenario
from sim.frames import PEDESTRIAN, Frame
from sim.scenario import sample_agents
from sim.sumo.branches import Trunk

AT_ONCE: Final = 20
"""Branches that run beside each other."""

KILLED: Final = 20
"""Branches that are killed."""

PATIENCE_S: Final = 10.0
"""Dead processes have to be gone within this time, s of the clock on the wall."""

MARGIN_S: Final = 5.0
"""The episode is this much longer than what is compared, s."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How many branches of which scenarios are compared.

    Attributes:
        scenarios: registered names.
        branches: how many of each.
        at_s: the instant at which they leave, s.
        seconds: for how long they are compared, s.
        seed: of the agents and of the simulator.
    """

    scenarios: tuple[str, ...] = option(
        ("straight_road", "four_way_intersection"), "Registered names."
    )
    branches: int = option(1000, "How many branches of each.")
    at_s: float = option(50.0, "The instant at which they leave, s.")
    seconds: float = option(10.0, "For how long they are compared, s.")
    seed: int = option(1, "Of the agents and of the simulator.")


def identical(one: Sequence[Frame], other: Sequence[Frame]) -> bool:
    """Whether two continuations are equal to the bit: every array, signal and event."""
    return len(one) == len(other) and all(map(_same, one, other))


def _same(one: Frame, other: Frame) -> bool:
    pairs = ((getattr(one, n), getattr(other, n)) for n in one.__dataclass_fields__)
    return all(
        np.array_equal(a, b) and a.dtype == b.dtype if isinstance(a, np.ndarray) else a == b
        for a, b in pairs
    )


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Branch an episode of each scenario.

    Yields:
        Rows of each scenario: the share of branches that are ``identical`` and the ``branches``;
        how many ``agents``, ``pedestrians`` and ``signal_changes`` were compared; ``forks_per_s``
        by the clock on the wall, and ``fork_cpu_ms``, the processor time that each costs the
        process that is copied, which other work on the machine does not lengthen; and after
        branches were killed, whether the trunk drove on identically (``trunk_unharmed``) and how
        many ``dead_processes`` were left.
    """
    for name in settings.scenarios:
        at_s, until_s = settings.at_s, settings.at_s + settings.seconds
        scenario = get_scenario(name)(flow="dense", duration_s=until_s + MARGIN_S)
        agents = sample_agents(scenario, settings.seed)
        with Trunk(scenario, agents, settings.seed) as plain:
            plain.advance(at_s)
            after = plain.advance(until_s)
        with Trunk(scenario, agents, settings.seed) as trunk:
            trunk.advance(at_s)
            exact = _identical_branches(trunk, after, settings.branches)
            spent_s = processor_s(trunk.process_id)
            rate = _forks_per_s(trunk, at_s + scenario.step_s, settings.branches)
            spent_s = processor_s(trunk.process_id) - spent_s
            left = _dead_after_kill(trunk, until_s)
            unharmed = identical(trunk.advance(until_s), after)
        signals = np.stack([frame.signals for frame in after])
        keys: dict[str, Cell] = {"scenario": name}
        n = settings.branches
        figures = {
            "identical": (exact / n, n),
            "branches": (float(n), n),
            "agents": (float(np.mean([len(frame) for frame in after])), len(after)),
            "pedestrians": (
                float(np.mean([(frame.kind == PEDESTRIAN).sum() for frame in after])), len(after)
            ),
            "signal_changes": (float((np.diff(signals, axis=0) != 0).sum()), len(after)),
            "forks_per_s": (rate, n),
            "fork_cpu_ms": (1e3 * spent_s / n, n),
            "trunk_unharmed": (float(unharmed), KILLED),
            "dead_processes": (float(left), KILLED),
        }  # fmt: skip
        yield [tidy_row(keys, key, value, None, None, n) for key, (value, n) in figures.items()]


def _identical_branches(trunk: Trunk, after: Sequence[Frame], count: int) -> int:
    """How many of so many branches give exactly these frames."""
    exact = 0
    for first in range(0, count, AT_ONCE):
        together = [
            trunk.branch(after[-1].time_s) for _ in range(first, min(first + AT_ONCE, count))
        ]
        for branch in together:
            with branch:
                exact += identical(tuple(branch), after)
    return exact


def _forks_per_s(trunk: Trunk, until_s: float, count: int) -> float:
    """Branches per second of the clock on the wall, each until its first frame has arrived."""
    begin = time.perf_counter()
    for first in range(0, count, AT_ONCE):
        together = [trunk.branch(until_s) for _ in range(first, min(first + AT_ONCE, count))]
        for branch in together:
            with branch:
                next(iter(branch))
    return count / (time.perf_counter() - begin)


def _dead_after_kill(trunk: Trunk, until_s: float) -> int:
    """How many processes are left after branches were killed in the middle."""
    branches = [trunk.branch(until_s) for _ in range(KILLED)]
    for branch in branches:
        next(iter(branch))
    for process in children(trunk.process_id):
        os.kill(process, signal.SIGKILL)
    for branch in branches:
        branch.close()
    late = time.monotonic() + PATIENCE_S
    while children(trunk.process_id) and time.monotonic() < late:
        time.sleep(0.05)
    return len(children(trunk.process_id))


def processor_s(process: int) -> float:
    """Processor time that a process has taken, s, without that of its children."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def children(process: int) -> list[int]:
    """Numbers of a process's children, dead ones that nobody waited for included."""
    listed = Path(f"/proc/{process}/task/{process}/children").read_text(encoding="ascii")
    return [int(number) for number in listed.split()]


BENCH: Final = Bench(
    name="branches",
    summary="Branch running episodes, and compare every branch with the episode to the bit.",
    keys=("scenario",),
    full=Settings(),
    quick=Settings(branches=25, at_s=10.0, seconds=3.0),
    measure=measure,
)
