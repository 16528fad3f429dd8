"""Makes the table of ``docs/behaviors.md`` from the rows of ``graphrqi bench behaviors``.

``python docs/behaviors_table.py ROWS.json`` keeps the rows that the table shows in
``docs/behaviors.json`` and writes the table into the page.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

PAGE = Path(__file__).parent / "behaviors.md"
ROWS = Path(__file__).parent / "behaviors.json"
BEHAVIORS = ("impatient", "reckless", "threatening", "careful", "cautious", "timid")
HEAD = "| trait | where | " + " | ".join(BEHAVIORS) + " |\n|---|---|---|---|---|---|---|---|\n"

LINES: tuple[tuple[str, str, str, int], ...] = (
    ("red lights run, share of those faced first in line", "all", "red_run_share", 2),
    ("let pedestrians go first, share of encounters", "all", "yield_share", 2),
    ("median headway, s", "straight_road", "headway_median_s", 2),
    ("lane changes per km", "straight_road", "lane_changes_per_km", 2),
    ("cut-ins per km (new follower left < 1 s)", "straight_road", "cut_ins_per_km", 2),
    ("over the limit on a free road, share of time", "all", "over_limit_share", 2),
    ("unprovoked stops per km", "all", "unprovoked_stops_per_km", 2),
    ("wait per encounter, s", "straight_road", "wait_per_encounter_s", 1),
    ("the same at the signals, s", "four_way_intersection", "wait_per_encounter_s", 1),
    ("the same everywhere, s", "all", "wait_per_encounter_s", 1),
    ("on the wrong side, m per driver", "two_way_road", "wrong_way_m", 0),
    ("collisions with vehicles caused", "all", "collisions_caused", 0),
    ("pedestrians hit", "all", "pedestrians_hit", 0),
    ("shown traits resolve to the intended behaviour, share", "all", "label_agreement", 2),
)
"""Trait, scenario, metric and decimals of each line of the table."""


def cell(row: dict[str, Any], decimals: int) -> str:
    """A value with its interval; without one where nothing varies."""
    value = f"{row['value']:.{decimals}f}"
    if row["low"] is None or row["low"] == row["high"]:
        return value
    return f"{value} [{row['low']:.{decimals}f}, {row['high']:.{decimals}f}]"


def shown(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows that the table shows."""
    wanted = {(scenario, metric) for _, scenario, metric, _ in LINES}
    return [
        {key: row[key] for key in ("scenario", "behavior", "metric", "value", "low", "high", "n")}
        for row in rows
        if (row["scenario"], row["metric"]) in wanted and row["behavior"] in BEHAVIORS
    ]


def table(rows: list[dict[str, Any]]) -> str:
    """The table in Markdown."""
    found = {(row["scenario"], row["metric"], row["behavior"]): row for row in rows}
    lines = [
        " | ".join(
            [f"| {trait}", scenario.replace("_", " ")]
            + [cell(found[scenario, metric, name], decimals) for name in BEHAVIORS]
        )
        + " |\n"
        for trait, scenario, metric, decimals in LINES
    ]
    return HEAD + "".join(lines)


def main(path: Path) -> None:
    """Write the rows and the table of the page."""
    rows = shown(json.loads(path.read_text()))
    page = PAGE.read_text()
    begin = page.index("| trait | where |")
    end = page.index("\n\n", begin) + 1
    PAGE.write_text(page[:begin] + table(rows) + page[end:])
    ROWS.write_text("[\n" + ",\n".join(json.dumps(row) for row in rows) + "\n]\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
