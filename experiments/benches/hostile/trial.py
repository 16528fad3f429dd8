"""One hostile input, tried: what was made of it, and whether that is right."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Final

from behaviors.errors import LONGEST, InputError
from experiments.benches.hostile import grammars
from experiments.benches.hostile.calls import CALLS
from experiments.benches.hostile.mutations import altered
from experiments.benches.hostile.oracles.grown import Refused, Unsure
from experiments.benches.hostile.oracles.recordings import other_rows, rows_told
from experiments.benches.hostile.sample import Sample
from experiments.benches.hostile.samples import samples
from sim.formats import get_reader

STATES: Final = ("read", "refused", "stricter", "disagree", "crash", "abort", "slow", "large")
"""What may become of an input."""

FAILURES: Final = ("disagree", "crash", "abort", "slow", "large")
"""What of that is a defect."""

GROWN: Final = tuple(f"{name}-grown" for name in grammars.FILES)
"""Families whose inputs are grown from a grammar and compared with an independent reader."""

TWO_SIDED: Final = (*(f"{name}-grown" for name in grammars.FILES if name != "argoverse2"),)
"""Families whose oracle knows all rules: what it reads, a reader must read. Of the others a reader
may be stricter: it also checks ranges, references and limits of what is well formed."""

LONGEST_MESSAGE: Final = LONGEST
"""Most characters of a message: it is to be one line."""


@cache
def _samples() -> dict[str, Sample]:
    return samples()


def families() -> tuple[str, ...]:
    """Every family of inputs."""
    return (*_samples(), *GROWN, *CALLS)


def files_of(family: str, number: int) -> dict[str, bytes]:
    """The input of a family and number: the same wherever and whenever it is made.

    Args:
        family: one of `families` that are files.
        number: which.
    """
    if family in GROWN:
        name = family.removesuffix("-grown")
        return {grammars.FILES[name]: grammars.grow(name, number)}
    return altered(_samples()[family].files, random.Random(f"{family}:{number}"))


def check(family: str, number: int, folder: Path) -> tuple[str, str]:
    """Try one input.

    Args:
        family: one of `families`.
        number: which of its inputs.
        folder: where its files are written; made, and removed at the end.

    Returns:
        "read", "refused", "stricter" (Arrow reads a forged file that we refuse), "disagree" or
        "crash", and why.
    """
    if family in CALLS:
        try:
            CALLS[family](number)
        except Exception as error:  # whatever it is: errors that nobody foresaw are looked for
            return "crash", f"{type(error).__name__}: {error}"
        return "read", ""
    for name, data in files_of(family, number).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    try:
        return _compared(family, number, folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _tried(read: Callable[[], object], folder: Path) -> tuple[str, str, object]:
    try:
        return "read", "", read()
    except (InputError, FileNotFoundError) as error:  # commands tell both in one line
        why = str(error)
    except Exception as error:  # as above
        return "crash", f"{type(error).__name__}: {error}", None
    if "\n" in why:
        return "disagree", f"a message of several lines: {why!r}", None
    if len(why) > LONGEST_MESSAGE:
        return "disagree", f"a message of {len(why)} characters: {why}", None
    return "refused", why, None


def _compared(family: str, number: int, folder: Path) -> tuple[str, str]:
    """What a reader makes of an input, beside what an independent one makes of it."""
    sample = sample_of(family)
    state, why, mine = _tried(lambda: sample.read(folder), folder)
    if state in FAILURES:
        return state, why
    try:
        theirs = sample.oracle(folder)
        if state == "refused":
            return ("disagree" if family in TWO_SIDED else "stricter"), f"refused: {why}"
        difference = sample.differs(mine, theirs)
    except Unsure:
        return state, why
    except Refused as error:
        return ("refused", why) if state == "refused" else ("disagree", f"the oracle: {error}")
    except Exception as error:  # an oracle reads nothing that it does not expect
        return ("refused", why) if state == "refused" else ("disagree", f"the oracle: {error!r}")
    return ("read", "") if difference is None else ("disagree", difference)


def sample_of(family: str) -> Sample:
    """The sample of a family that is files; one that is grown is read as its format."""
    if family not in GROWN:
        return _samples()[family]
    key = family.removesuffix("-grown")
    file = grammars.FILES[key]
    return Sample(
        {}, lambda folder: list(get_reader(key)(folder / file)),
        lambda folder: rows_told(key, folder / file), partial(other_rows, key), key,
    )  # fmt: skip
