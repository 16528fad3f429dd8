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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, count, islice
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from experiments.benches.contract import Bench, option
from experiments.benches.hostile.progress import Progress
from experiments.benches.hostile.trial import FAILURES, STATES, families
from experiments.benches.hostile.worker import Trial, try_all
from experiments.score.rows import Cell, Row, tidy_row

LOGGER = logging.getLogger(__name__)

COSTLY: Final = {
    "model": 150, "dataset": 10, "sheet": 4, "labels": 3, "predictions": 3, "net": 4, "net.gz": 4,
    "net-small": 2, "argoverse2-map": 2, "solver": 5, "stream": 40, "environment": 80,
}  # fmt: skip
"""Families whose inputs take longer, and how many inputs of another family are tried for one of
theirs."""

FAILED_BEFORE: Final[dict[str, tuple[int, ...]]] = {
    "sumo-fcd-grown": (46, 279),
    "argoverse1-grown": (500099, 500155, 508922),
    "interaction-grown": (500214, 500943, 502973, 505132, 506890, 507527),
    "ind-grown": (223, 501108, 501113, 501226, 502351),
    "net.gz": (16, 72),
    "scenarionet": (10004177, 10004750, 30002427, 30004783, 30007423, 30017742, 41003504, 46003765),
    "lanelet2": (10009863,),
    "study": (150, 2000366, 2001288, 4000364, 10000296, 10001667),
    "ind": (470,),
    "environment": (2,),
    "stream": (97, 10000199),
    "dataset": (800376,),
    "labels": (800226,),
    "scenario": (801065, 801131, 1000028, 10009933),
    "commonroad": (10002175,),
    "commonroad-map": (10005704, 90032051),
    "commonroad.gz": (1000052, 10002368),
    "highd": (30013825,),
    "highd-grown": (2001246,),
    "ngsim-text": (2001227,),
    "kitti": (32, 2000202, 4000561),
    "argo": (2000890,),
    "argoverse2": (10001370,),
    "argoverse2-log": (1104310,),
    "argoverse2-grown": (3000285, 10002153, 10004656, 10006914),
    "pairs": (2002139,),
    "population": (30003344,),
    "net": (16, 64, 66, 800213, 800370),
    "net-small": (800119, 800183, 2000302),
    "run": (800199, 30016821),
    "stored-road": (800387,),
}
"""Inputs on which readers once failed or differed; they are tried first, whatever the seed."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How many inputs are tried, and within what limits."""

    inputs: int = option(200_000, "How many inputs, over all families.")
    seed: int = option(0, "The number of each family's first input.")
    families: tuple[str, ...] = option((), "Only these families.")
    only: str = option("", "Try this input alone.", "FAMILY:NUMBER")
    limit_gb: float = option(2.0, "Memory that one input may take, GB.")
    limit_s: float = option(60.0, "Longest time for one input, s.")
    progress: str = option("", "Keep the counts here; the same command then goes on.", "FILE")


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Counts of each state, peak memory and the slowest input of every family.

    Yields:
        The rows of all inputs, also of those that earlier runs with the same file tried.

    Raises:
        InputError: if a family does not exist, or the progress is another run's.
    """
    inputs = _inputs(settings)
    chosen = ",".join(settings.families or families())
    work = f"{settings.seed}:{settings.only}:{settings.limit_gb}:{settings.limit_s}:{chosen}"
    progress = Progress.begun(Path(settings.progress) if settings.progress else None, work)
    try:
        todo = islice(inputs, progress.done, settings.inputs)
        for trial in try_all(todo, settings.limit_gb, settings.limit_s):
            progress.add(trial)
            _say(trial, settings)
    finally:
        progress.write()
    yield [
        tidy_row({"family": family}, metric, value, None, None, of.inputs)
        for family, of in progress.families.items()
        for metric, value in (
            *((state, float(of.states.get(state, 0))) for state in STATES),
            ("slowest_s", round(of.slowest_s, 4)),
            ("peak_gb", round(of.peak_gb, 3)),
        )
    ]


def _inputs(settings: Settings) -> Iterator[tuple[str, int]]:
    """Families in turn without end, the inputs that failed before first."""
    known = families()
    if settings.only:
        family, _, number = settings.only.rpartition(":")
        if family not in known or not number.isdecimal():
            raise InputError(f"--only: found {settings.only!r}, expected FAMILY:NUMBER")
        return iter([(family, int(number))])
    for family in settings.families:
        if family not in known:
            raise InputError(f"--families: found {family!r}, expected some of {', '.join(known)}")
    chosen = settings.families or known
    before = ((f, n) for f in chosen for n in FAILED_BEFORE.get(f, ()))
    costly: dict[str, int] = {} if settings.families else COSTLY
    turns = (
        (family, settings.seed + turn // costly.get(family, 1))
        for turn in count()
        for family in chosen
        if turn % costly.get(family, 1) == 0
    )
    return chain(before, turns)


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
