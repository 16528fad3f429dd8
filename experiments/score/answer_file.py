"""Files of answers of any other model; a child process reads them, so little is imported here."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from sim.formats.common.tables import read_table

PROBABILITIES: Final = tuple(f"p_{b.value}" for b in BEHAVIORS)
"""Columns of a file of answers that give probabilities; all of them or none."""


def read_answers(path: Path) -> pd.DataFrame:
    """The last answer about each driver in a file.

    Args:
        path: CSV or Parquet with the columns ``episode``, ``agent`` and ``label``, a behaviour.
            ``time_s`` orders several answers about one driver; `PROBABILITIES` may be given, too.

    Returns:
        Probabilities (n, 6) by episode and agent; without such columns the label has 1.

    Raises:
        InputError: if a column is missing or broken, or a label is no behaviour.
    """
    numbers = ("agent", "time_s", *PROBABILITIES)
    optional = ("time_s", *PROBABILITIES)
    table = read_table(path, numbers, ("episode", "label"), optional).columns.to_pandas()
    table = table.astype({"episode": str, "label": str, "agent": np.int64})
    codes = pd.Categorical(table["label"], [str(b) for b in BEHAVIORS]).codes
    if (codes < 0).any():
        wrong = table["label"][codes < 0].iloc[0]
        known = ", ".join(BEHAVIORS)
        raise InputError(f"{path}: label: found {wrong[:60]!r}, expected one of {known}")
    if not set(PROBABILITIES) <= set(table):
        table[list(PROBABILITIES)] = np.eye(len(BEHAVIORS))[codes]
    if "time_s" in table:
        table = table.sort_values("time_s", kind="stable")
    last: pd.DataFrame = table.groupby(["episode", "agent"])[list(PROBABILITIES)].last()
    return last
