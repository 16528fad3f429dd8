"""Rows of the spectrum bench: medians with intervals, reasons, and slopes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, TypeAlias

import numpy as np

from experiments.score.rows import tidy_row

Row: TypeAlias = dict[str, Any]


SLOPE_FROM: Final = 400
"""Smallest graph that counts for the slopes: below, fixed costs rule."""


def plain_row(key: dict[str, Any], metric: str, value: float, n: int) -> Row:
    """A figure without an interval."""
    return dict(tidy_row(key, metric, value, None, None, n)) | {"reason": None}


def skipped_row(key: dict[str, Any], reason: str) -> Row:
    """What stands for a solver that was not run, with the reason."""
    return dict(tidy_row(key, "cpu_ms", None, None, None, 0)) | {"reason": reason}


def median_row(key: dict[str, Any], metric: str, values: Sequence[float]) -> Row:
    """A median with the 95 % interval of its order statistics."""
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    n = ordered.size
    reach = 0.98 * np.sqrt(n)
    row = plain_row(key, metric, float(np.median(ordered)), n)
    if n >= 6:
        row["low"] = float(ordered[max(int(np.floor(n / 2 - reach)), 0)])
        row["high"] = float(ordered[min(int(np.ceil(n / 2 + reach)), n - 1)])
    return row


def slope_rows(rows: Sequence[Row]) -> list[Row]:
    """Slopes of cost and memory against the number of vehicles, both in logarithms."""
    out = []
    for metric, name in (("cpu_ms", "slope"), ("peak_memory_mb", "memory_slope")):
        groups: dict[tuple[str, ...], list[tuple[int, float]]] = {}
        for row in rows:
            if row["metric"] == metric and row["d"] >= SLOPE_FROM and (row["value"] or 0.0) > 0.0:
                key = (row["solver"], row["graph"], row["kind"], row["end"])
                groups.setdefault(key, []).append((row["d"], row["value"]))
        for (solver, layout, kind, end), points in groups.items():
            if len(points) < 2:
                continue
            d, value = np.log(np.array(points)).T
            slope = float(np.polyfit(d, value, 1)[0])
            key_of = {"solver": solver, "d": None, "graph": layout, "kind": kind, "end": end}
            out.append(plain_row(key_of, name, slope, len(points)))
    return out
