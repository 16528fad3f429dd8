"""Hostile files by the thousand, over every family of files that graphrqi reads.

    graphrqi bench hostile --inputs 1000000 --json hostile.json

Some families are grown from the grammar of their format and compared with slow independent readers
(`grammars`, `oracles`); of all, small valid inputs are altered (`samples`, `mutations`). Streams,
solvers and environments are called with what no caller should give (`calls`). Workers have limits
of memory and time (`worker`). A file is read or refused by an `InputError` of one line; anything
else is a failure and is told by its family and number, which make it again:

    graphrqi bench hostile --only net:1234
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from behaviors.errors import InputError
from experiments.benches.contract import Bench, option
from experiments.benches.hostile.trial import families
from experiments.benches.hostile.worker import Trial, try_all
from experiments.rows import Cell, Row, tidy_row

LOGGER = logging.getLogger(__name__)

STATES: Final = ("read", "refused", "stricter", "disagree", "crash", "abort", "slow")
FAILURES: Final = ("disagree", "crash", "abort", "slow")

COSTLY: Final = {
    "model": 300, "dataset": 10, "sheet": 5, "labels": 5, "argoverse2-grown": 2, "solver": 20,
    "stream": 100, "environment": 400,
}  # fmt: skip
"""Families of which one input is tried for so many of the others: each takes that much longer."""

FAILED_BEFORE: Final[dict[str, tuple[int, ...]]] = {
    "sumo-fcd-grown": (46, 279),
    "argoverse1-grown": (500099, 500155, 508922),
    "interaction-grown": (500214, 500943, 502973, 505132, 506890, 507527),
    "ind-grown": (223, 501108, 501113, 501226, 502351),
    "net": (16, 64, 66),
    "net.gz": (16, 72),
    "study": (150,),
    "ind": (470,),
    "environment": (2,),
    "stream": (97,),
}
"""Inputs on which readers once failed or differed; they are tried first, whatever the seed."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How many inputs are tried, and within what limits."""

    inputs: int = option(200_000, "How many inputs, over all families.")
    seed: int = option(0, "The number of each family's first input.")
    families: tuple[str, ...] = option((), "Only these families.")
    only: str = option("", "Try this input alone.", "FAMILY:NUMBER")
    limit_gb: float = option(4.0, "Address space that one input may take, GB.")
    limit_s: float = option(60.0, "Longest time for one input, s.")


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Counts of each state, peak memory and the slowest input of every family.

    Yields:
        The rows of all inputs that were tried since the part before.

    Raises:
        InputError: if a family does not exist.
    """
    counts: dict[str, Counter[str]] = {}
    slowest: dict[str, float] = {}
    peak: dict[str, float] = {}
    for trial in try_all(_inputs(settings), settings.limit_gb, settings.limit_s):
        counts.setdefault(trial.family, Counter())[trial.state] += 1
        slowest[trial.family] = max(slowest.get(trial.family, 0.0), trial.seconds)
        if trial.peak_gb == trial.peak_gb:
            peak[trial.family] = max(peak.get(trial.family, 0.0), trial.peak_gb)
        _say(trial, settings)
    yield [
        tidy_row({"family": family}, metric, value, None, None, count.total())
        for family, count in counts.items()
        for metric, value in (
            *((state, float(count[state])) for state in STATES),
            ("slowest_s", round(slowest[family], 4)),
            ("worker_peak_gb", round(peak.get(family, 0.0), 3)),
        )
    ]


def _inputs(settings: Settings) -> list[tuple[str, int]]:
    """Families in turn, the inputs that failed before first."""
    known = families()
    if settings.only:
        family, _, number = settings.only.rpartition(":")
        if family not in known or not number.isdecimal():
            raise InputError(f"--only: found {settings.only!r}, expected FAMILY:NUMBER")
        return [(family, int(number))]
    for family in settings.families:
        if family not in known:
            raise InputError(f"--families: found {family!r}, expected some of {', '.join(known)}")
    chosen = settings.families or known
    found = [(f, n) for f in chosen for n in FAILED_BEFORE.get(f, ())][: settings.inputs]
    turn = 0
    while len(found) < settings.inputs:
        for family in chosen:
            costly = 1 if settings.families else COSTLY.get(family, 1)
            if turn % costly == 0:
                found.append((family, settings.seed + turn // costly))
        turn += 1
    return found[: settings.inputs]


def _say(trial: Trial, settings: Settings) -> None:
    if trial.state in FAILURES:
        LOGGER.warning("%s:%d: %s: %.300s", trial.family, trial.number, trial.state, trial.why)
    elif settings.only:
        LOGGER.warning("%s: %s %.300s", settings.only, trial.state, trial.why)


def _table(rows: Sequence[Row]) -> list[Row]:
    """One line per family."""
    lines: dict[Cell, dict[str, Cell]] = {}
    for row in rows:
        line = lines.setdefault(row["family"], {"family": row["family"], "inputs": row["n"]})
        line[str(row["metric"])] = row["value"]
    return list(lines.values())


BENCH: Final = Bench(
    name="hostile",
    summary="Files made to break readers: how many are read, refused, or fail, and what they cost.",
    keys=("family",),
    full=Settings(),
    quick=Settings(inputs=200),
    measure=measure,
    table=_table,
)
