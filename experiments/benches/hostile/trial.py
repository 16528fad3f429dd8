"""One hostile input, tried: what was made of it, and whether that is right."""

from __future__ import annotations

import math
import random
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from experiments.benches.hostile import grammars
from experiments.benches.hostile.calls import CALLS
from experiments.benches.hostile.mutations import altered
from experiments.benches.hostile.oracles import Rows, differ, oracle
from experiments.benches.hostile.samples import Sample, samples
from sim.formats import get_reader

GROWN: Final = tuple(f"{name}-grown" for name in grammars.FILES)
"""Families whose inputs are grown from a grammar and compared with an independent reader."""

ASKED_EVERY: Final = {"argoverse2-grown": 20}
"""Of these families the oracle, which is a process, looks at one input in so many."""

LONGEST_MESSAGE: Final = 1000
"""Most characters of a message that are not the path's (our choice: it is to be one line)."""


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
        if family in GROWN:
            return _compared(family, number, folder)
        return _tried(lambda: _samples()[family].read(folder), folder)[:2]
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
    if len(why.replace(str(folder), "")) > LONGEST_MESSAGE:
        return "disagree", f"a message of {len(why)} characters: {why}", None
    return "refused", why, None


def _compared(family: str, number: int, folder: Path) -> tuple[str, str]:
    name = family.removesuffix("-grown")
    path = folder / grammars.FILES[name]
    data = path.read_bytes()
    state, why, mine = _tried(lambda: rows_read(name, path), folder)
    if state in ("crash", "disagree") or number % ASKED_EVERY.get(family, 1):
        return state, why
    theirs = oracle(name, data)
    if not isinstance(mine, dict):
        if theirs is None:
            return "refused", why
        return ("stricter" if name == "argoverse2" else "disagree"), f"refused: {why}"
    if theirs is None:
        if name == "traf" and any("-" in agent[1:] for agent, _ in mine):
            return "read", ""  # of two boxes with one id the oracle knows no names
        return "disagree", "read, the oracle refuses"
    difference = differ(mine, theirs)
    return ("read", "") if difference is None else ("disagree", difference)


def rows_read(name: str, path: Path) -> Rows:
    """Place of each agent at each time, as graphrqi reads a recording.

    Args:
        name: key of its format.
        path: the file.
    """
    found: Rows = {}
    for recording in get_reader(name)(path):
        tracks = recording.tracks
        seen = tracks.as_rows()
        for row in range(seen.speed.size):
            agent, step = seen.index.agent[row], seen.index.step[row]
            x, y = seen.xy[row].tolist()
            if name == "sumo-fcd":  # back to the front of the vehicle
                x += 0.5 * tracks.length[agent] * math.cos(seen.heading[row])
                y += 0.5 * tracks.length[agent] * math.sin(seen.heading[row])
            found[tracks.names[agent], float(tracks.time_s[step])] = (x, y)
    return found
