"""Labels of the GraphRQI paper's Argoverse sequences: ``id,code``.

Codes 3, 4 and 5 are careful, timid and cautious. Codes 0, 1 and 2 are the aggressive classes, but
the release does not say which is which, so nothing but the aggressive style of such agents is
known.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from behaviors.labels import Behavior, Style
from sim.formats.common.csv_columns import read_columns
from sim.formats.common.label_file import DriverLabel

CODES: Final[dict[int, DriverLabel]] = {
    **{code: DriverLabel(Style.AGGRESSIVE) for code in (0, 1, 2)},
    3: DriverLabel(Style.CONSERVATIVE, Behavior.CAREFUL),
    4: DriverLabel(Style.CONSERVATIVE, Behavior.TIMID),
    5: DriverLabel(Style.CONSERVATIVE, Behavior.CAUTIOUS),
}
"""The label of each code."""


def read_labels(path: Path) -> dict[str, DriverLabel]:
    """Read one label file.

    Args:
        path: ``argo<k>_labels.csv``.

    Returns:
        Labels by the source's own agent ids.

    Raises:
        InputError: if the file is broken, a code is unknown, or an agent is listed twice.
    """
    columns = read_columns(path, ["code"], ["id"])
    agent, names = columns.names("id")
    if len(names) != len(columns):
        raise InputError(f"{path}: found {len(columns)} rows for {len(names)} agents, expected one")
    found = {}
    for row, code in zip(agent, columns.numbers("code"), strict=True):
        if code not in CODES:
            raise InputError(f"{path}: agent {names[row]}: found code {code:g}, expected 0 to 5")
        found[names[row]] = CODES[int(code)]
    return found
