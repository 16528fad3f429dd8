"""The states of CommonRoad's trajectories, read from the bytes instead of as elements of a tree.

Nine tenths of a scenario are states of one form: a tree of them costs four times as long as
matching them. Trajectories all of whose states have exactly the form of the file's first one are
emptied, and an element that names the run stands for the states; all others stay in the tree.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim.written_numbers import real

RUN: Final = "stateRun"
"""The element that stands for a run; its ``number`` is the index into `StateRuns.tables`."""

COLUMNS: Final = ("time", "x", "y", "orientation", "velocity")
MAX_TAGS: Final = 16
"""Most parts of a state whose form is matched (the format knows some ten)."""

_FIRST: Final = re.compile(rb"<([A-Za-z]+)>\s*<(?:exact|point)>")
_NUMBER: Final = rb"[-+.\deE]+"
_OPENED: Final = b"<trajectory>"
_TWO: Final = re.compile(rb"</state>([ \t\r\n]*)<state>")
_SPACE: Final = b" \t\r\n"


@dataclass
class StateRuns:
    """Gathers the runs of states of one file.

    Attributes:
        most: largest absolute number that is taken; a file with a larger one is left as it is.
        tables: per run (k, 5) time, as the file has it, x, y, orientation and velocity; NaN for
            what the states lack.

    Examples:
        >>> runs = StateRuns(most=1e9)
        >>> point = b"<position><point><x>3</x><y>4</y></point></position>"
        >>> state = b"<state>" + point + b"<time><exact>2</exact></time></state>"
        >>> runs.cut(b"<trajectory>" + state + state + b"</trajectory>")
        b'<trajectory><stateRun number="0"/></trajectory>'
        >>> runs.tables[0][0]
        array([ 2.,  3.,  4., nan, nan])
    """

    most: float
    tables: list[NDArray[np.float64]] = field(default_factory=list)

    def cut(self, data: bytes) -> bytes:
        """The file without its runs of states; the same bytes where it has none of this form."""
        self.tables.clear()
        form = None if RUN.encode() in data or b"<![CDATA[" in data else _form(data)
        if form is None:
            return data
        kept, at = list[bytes](), 0
        rows, firsts = list[tuple[bytes, ...]](), list[int]()
        begin = data.find(_OPENED)
        while begin >= 0:
            begin += len(_OPENED)
            end = data.find(b"</trajectory>", begin)
            found = form.states(data[begin:end].strip(_SPACE)) if end >= 0 else []
            if found:
                kept += [data[at:begin], f'<{RUN} number="{len(firsts)}"/>'.encode()]
                firsts.append(len(rows))
                rows += found
                at = end
            begin = data.find(_OPENED, begin)
        table = self._numbers(rows, form)
        if not rows or table is None:
            return data
        self.tables += np.split(table, firsts[1:])
        return b"".join([*kept, data[at:]])

    def _numbers(self, found: list[tuple[bytes, ...]], form: _Form) -> NDArray[np.float64] | None:
        """(k, 5) the states' numbers; None where one is no number, or too large."""
        table = np.full((len(found), len(COLUMNS)), np.nan)
        try:
            for texts, name in zip(zip(*found, strict=True), form.names, strict=False):
                if name in COLUMNS:
                    table[:, COLUMNS.index(name)] = list(map(real, texts))
        except ValueError:
            return None
        return None if (np.abs(table) > self.most).any() else table


@dataclass(frozen=True)
class _Form:
    """How a file writes its states.

    Attributes:
        names: what each number of a state is.
        pattern: a state, its numbers as groups.
        fixed: bytes of a state that are no numbers.
        between: what is between two states.
    """

    names: tuple[str, ...]
    pattern: re.Pattern[bytes]
    fixed: int
    between: int

    def states(self, block: bytes) -> list[tuple[bytes, ...]]:
        """The numbers of each state; none where anything else is among the states."""
        found: list[tuple[bytes, ...]] = self.pattern.findall(block)
        told = sum(map(len, map(b"".join, found)))
        whole = len(found) * (self.fixed + self.between) - self.between + told
        return found if found and whole == len(block) else []


def _form(data: bytes) -> _Form | None:
    """The form of the file's first state; None where it is not a place and exact values."""
    begin = data.find(b"<state>")
    end = data.find(b"</state>", begin)
    if begin < 0 or end < 0:
        return None
    tags = tuple(_FIRST.findall(data[begin:end]))
    if len(tags) > MAX_TAGS or len(set(tags)) < len(tags) or {b"x", b"y"} & set(tags):
        return None
    if b"position" not in tags or b"time" not in tags:
        return None
    first = _pattern(tags).match(data, begin)
    if first is None:
        return None
    literal, at = list[bytes](), begin
    for group in range(1, len(first.groups()) + 1):
        literal.append(re.escape(data[at : first.start(group)]))
        at = first.end(group)
    literal.append(re.escape(data[at : first.end()]))
    two = _TWO.search(data, begin)
    between = two.group(1) if two else b""
    return _Form(
        names=tuple(first.re.groupindex),
        pattern=re.compile((b"(%b)" % _NUMBER).join(literal) + b"(?:%b|$)" % re.escape(between)),
        fixed=first.end() - begin - sum(map(len, first.groups())),
        between=len(between),
    )


def _pattern(tags: tuple[bytes, ...]) -> re.Pattern[bytes]:
    """A state whose parts are these, each with one exact value; groups in order of the parts."""
    parts = list[bytes]()
    for tag in tags:
        if tag == b"position":
            parts.append(b"<position>_<point>_<x>(?P<x>#)</x>_<y>(?P<y>#)</y>_</point>_</position>")
        else:
            parts.append(b"<%b>_<exact>(?P<%b>#)</exact>_</%b>" % (tag, tag, tag))
    whole = b"_".join([b"<state>", *parts, b"</state>"])
    return re.compile(whole.replace(b"_", b"[ \\t\\r\\n]*").replace(b"#", _NUMBER))
