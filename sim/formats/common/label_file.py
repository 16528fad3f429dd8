"""Labels of drivers from a table that somebody wrote, for recordings of any format.

The file has the column ``name`` (the recording's own id of the driver) and one of ``label`` (a
behaviour or a style), ``behavior`` or ``style``; both of the latter may be there. With a column
``recording`` (the name of the recording, or of its file) a row speaks of that recording only.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior, Style
from sim.formats.common.tables import read_table, words_in


@dataclass(frozen=True, slots=True)
class DriverLabel:
    """What is known of one driver: its style, and its behaviour or None."""

    style: Style
    behavior: Behavior | None = None

    @property
    def allowed(self) -> tuple[bool, ...]:
        """(6,) which of ``BEHAVIORS`` the driver may be of."""
        return tuple(
            b is self.behavior if self.behavior else b.style is self.style for b in BEHAVIORS
        )


_STYLES: Final = {style.value: DriverLabel(style) for style in Style}
_BEHAVIORS: Final = {str(one): DriverLabel(one.style, one) for one in BEHAVIORS}
_WORDS: Final = {"label": _STYLES | _BEHAVIORS, "behavior": _BEHAVIORS, "style": _STYLES}
"""Columns that may say what a driver is, and what each word of them stands for."""


@dataclass(slots=True)
class DriverLabels:
    """Labels of drivers of one or several recordings, by name.

    It keeps account of the rows that were used, so that a mistyped name is noticed.

    Attributes:
        path: the file that they come from, for messages.
        labels: by recording ("": the row names none) and name of the driver.
        used: the recording in which each row was used.
    """

    path: Path
    labels: Mapping[tuple[str, str], DriverLabel]
    used: dict[tuple[str, str], str]

    def of(self, names: Sequence[str], *called: str | None) -> list[DriverLabel | None]:
        """A label for each name of a recording's drivers; None where the file has none.

        The recording is called by its own name first, then by its file's. A row that names no
        recording and fits the drivers of two is refused.
        """
        own = {part for word in called if word for part in (word, re.split("[/\\\\]", word)[-1])}
        first = next((word for word in called if word), "")
        found: list[DriverLabel | None] = [None] * len(names)
        for place in ("", *sorted(own)):
            for row, name in enumerate(names):
                label = self.labels.get((place, name))
                if label is None:
                    continue
                before = self.used.setdefault((place, name), first)
                if not place and before != first:
                    raise InputError(
                        f"{self.path}: name {name!r:.60}: found it in the recordings {before} and "
                        f"{first}, expected a column recording that says which is meant"
                    )
                found[row] = label
        return found

    def check(self) -> None:
        """Refuse labels of drivers that no recording has."""
        missing = [key for key in self.labels if key not in self.used]
        if missing:
            place, name = missing[0]
            where = f" of recording {place}" if place else ""
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            raise InputError(
                f"{self.path}: found a label of {name!r:.60}{where}{more}, which no driver is "
                "called, expected names in the recordings"
            )


def read_driver_labels(path: Path) -> DriverLabels:
    """Read a file of labels, as the module says."""
    optional = (*_WORDS, "behaviour", "recording")
    table = read_table(path, (), ("name", *optional), optional)
    table = table.rename(columns={"behaviour": "behavior"})
    columns = [column for column in _WORDS if column in table]
    if not columns or ("label" in columns and len(columns) > 1):
        raise InputError(
            f"{path}: found the columns {', '.join(table)!r:.200}, expected name and label "
            "(or behavior, or style), and at most recording"
        )
    cells = {column: [(word or "").strip() for word in words_in(table[column])] for column in table}
    found: dict[tuple[str, str], DriverLabel] = {}
    for row, name in enumerate(cells["name"]):
        where = f"{path}: line {row + 2}"
        key = cells["recording"][row] if "recording" in cells else "", name
        if not name:
            raise InputError(f"{where}: name: found none, expected the driver's")
        if key in found:
            raise InputError(f"{where}: found {name!r:.60} twice, expected it once")
        stated = {column: cells[column][row].lower() for column in columns}
        labels = []
        for column in [column for column in columns if stated[column]] or columns[:1]:
            label = _WORDS[column].get(stated[column])
            if label is None:
                raise InputError(
                    f"{where}: {column}: found {stated[column]!r:.60}, expected one of "
                    f"{', '.join(_WORDS[column])}"
                )
            labels.append(label)
        if len({label.style for label in labels}) > 1:
            raise InputError(
                f"{where}: style: found {stated['style']!r}, expected that of {stated['behavior']}"
            )
        found[key] = labels[0]
    return DriverLabels(path, found, {})
