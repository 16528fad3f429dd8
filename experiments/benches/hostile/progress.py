"""What a run over hostile inputs has found so far, kept in a file so that it can be stopped."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final

from experiments.benches.hostile.trial import FAILURES
from experiments.benches.hostile.worker import Trial
from experiments.benches.progress import read_progress
from sim.files import write_whole

EVERY_S: Final = 30.0
"""How often the file is written, s (after a kill, inputs of this time are tried again)."""


@dataclass
class Family:
    """What became of one family's inputs.

    Attributes:
        inputs: how many were tried.
        states: how many became what.
        slowest_s: longest time for one of them, s.
        peak_gb: most memory for one of them, GB.
    """

    inputs: int = 0
    states: dict[str, int] = field(default_factory=dict)
    slowest_s: float = 0.0
    peak_gb: float = 0.0


@dataclass
class Progress:
    """What was tried.

    Attributes:
        work: which inputs, in words: another run's file is refused.
        done: how many inputs of the run were tried.
        spent_s: time that they took, s.
        families: what became of them, by family.
        failures: family, number, state and reason of each defect.
        path: the file; None to keep none.
    """

    work: str
    done: int = 0
    spent_s: float = 0.0
    families: dict[str, Family] = field(default_factory=dict)
    failures: list[tuple[str, int, str, str]] = field(default_factory=list)
    path: Path | None = None
    _written: float = field(default_factory=time.monotonic)

    @classmethod
    def begun(cls, path: Path | None, work: str) -> Progress:
        """The progress that a file tells, or none yet.

        Args:
            path: the file; None for none.
            work: which inputs are to be tried.

        Raises:
            InputError: if the file is of another run.
        """
        found = read_progress(
            path,
            work,
            lambda told: cls(
                told["work"], int(told["done"]), float(told["spent_s"]),
                {name: Family(**one) for name, one in told["families"].items()},
                [(f, n, state, why) for f, n, state, why in told["failures"]], path,
            ),
        )  # fmt: skip
        return cls(work, path=path) if found is None else found

    def add(self, trial: Trial) -> None:
        """Count one input; the file is written now and then."""
        of = self.families.setdefault(trial.family, Family())
        of.inputs += 1
        of.states[trial.state] = of.states.get(trial.state, 0) + 1
        of.slowest_s = max(of.slowest_s, trial.seconds)
        if trial.peak_gb == trial.peak_gb:
            of.peak_gb = max(of.peak_gb, trial.peak_gb)
        self.done += 1
        self.spent_s += trial.seconds
        if trial.state in FAILURES:
            self.failures.append((trial.family, trial.number, trial.state, trial.why[:300]))
        if time.monotonic() - self._written > EVERY_S:
            self.write()

    def write(self) -> None:
        """Write the file."""
        self._written = time.monotonic()
        if self.path is not None:
            told = {
                "work": self.work, "done": self.done, "spent_s": round(self.spent_s, 1),
                "families": {name: asdict(one) for name, one in self.families.items()},
                "failures": self.failures,
            }  # fmt: skip
            write_whole(self.path, json.dumps(told, indent=1).encode())
