"""The data card: what a dataset holds, for people, as Markdown beside the data.

The Hugging Face Hub and ``datasets.load_dataset`` open the tables by its head: each table with
rows is a configuration with its splits.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Final, get_args

from behaviors.labels import BEHAVIORS
from sim.files import place_of
from sim.frames import KINDS
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import TABLES, Split

DATA_CARD: Final = "README.md"
"""Name of the card in a dataset's folder."""

CARD_HEAD: Final = "---\npretty_name: Traffic episodes with labelled driver behaviour\n"
"""How every card begins."""

TEMPLATE: Final = """\
---
pretty_name: Traffic episodes with labelled driver behaviour
license: other
task_categories: [tabular-classification, time-series-forecasting]
tags: [traffic, trajectories, driver-behavior]
configs:
{tables}
- config_name: episodes
  data_files:
  - split: catalogue
    path: episodes.parquet
---
# Traffic episodes with labelled driver behaviour

Schema version {version}; the columns are described in `sim/store/schema.py`.

{counts}

## Known limits

{limits}

## Made with

```json
{configuration}
```
"""

SIMULATED: Final = (
    "Labels are what each driver was drawn to be. What a driver had the chance to show in the"
    " time it was seen may be less.",
    "Behaviours are those of a simulator's drivers with the profile numbers in"
    " the table of agents; they are not measured from people.",
    "Positions and speeds are rounded to 2^-10 m and m/s, headings to 2^-13 rad.",
    "Episodes whose options have a `branch` begin at its instant; before it, they are the episode"
    " without one.",
    "Episodes of `random_world` are as a sensor saw them, with its noise and losses; some are in"
    " pixels or have no map, as their `options` say.",
)
"""Notes that every user of simulated data should know."""


def write_data_card(path: Path) -> None:
    """Write the card of a dataset beside its data.

    Args:
        path: the dataset, a folder or a URL.

    Raises:
        OSError: if it cannot be written.
    """
    place_of(path).write(DATA_CARD, data_card(open_dataset(path)).encode())


def data_card(dataset: Dataset) -> str:
    """Describe a dataset: counts, configuration, known limits.

    Args:
        dataset: what to describe.

    Returns:
        Markdown. Equal datasets have equal cards.
    """
    configuration = dataset.header.configuration
    return TEMPLATE.format(
        tables="\n".join(line for table in TABLES for line in _tables(dataset, table)),
        version=dataset.header.schema_version,
        counts="\n".join(_counts(dataset)),
        limits="\n".join(f"- {limit}" for limit in _limits(dataset)),
        configuration=json.dumps(configuration, indent=2, sort_keys=True),
    )


def _tables(dataset: Dataset, table: str) -> Iterator[str]:
    """The lines of one table; none where it has no rows, which the library cannot open."""
    files = dataset.header.files.items()
    found = [
        split
        for split in get_args(Split)
        if any(f.rows and n.startswith(f"{table}/") and f"/split={split}/" in n for n, f in files)
    ]
    if found:
        yield f"- config_name: {table}"
        yield from ("  default: true",) if table == TABLES[0] else ()
        yield "  data_files:"
    for split in found:
        yield f"  - split: {split}"
        yield f"    path: {table}/scenario=*/split={split}/*.parquet"


def _counts(dataset: Dataset) -> Iterator[str]:
    """A table of episodes, agent-steps and drawn agents by scenario and split."""
    rows = sorted(dataset.totals.to_pylist(), key=lambda row: (row["scenario"], row["split"]))
    drawn = [word for word in (*BEHAVIORS, *KINDS) if any(row[word] for row in rows)]
    names = ("scenario", "split", "episodes", "agent_steps", *drawn)
    yield f"| {' | '.join(names)} |"
    yield f"|{'---|' * len(names)}"
    yield from (f"| {' | '.join(str(row[name]) for name in names)} |" for row in rows)


def _limits(dataset: Dataset) -> list[str]:
    """Known gaps and assumptions."""
    if "format" not in dataset.header.configuration:
        return list(SIMULATED)
    notes = [e.options.get("notes", []) for e in dataset.manifest.episodes]
    return sorted({str(note) for some in notes if isinstance(some, list) for note in some})
