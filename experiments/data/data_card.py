"""The data card: what a dataset holds, for people, as Markdown beside the data.

The Hugging Face Hub and ``datasets.load_dataset`` open the tables by its head: each table with
rows is a configuration with its splits.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Final, get_args

from sim.files import place_of
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import TABLES, Split

DATA_CARD: Final = "README.md"
"""Name of the card in a dataset's folder."""

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

Schema version {version}; the columns are described in `sim/store/schema.py`. Labels of simulated
drivers are what each driver was drawn to be.
{notes}
```json
{configuration}
```
"""

CARD_HEAD: Final = TEMPLATE.partition("license:")[0]
"""How every card begins."""


def write_data_card(path: Path) -> None:
    """Write the card of a dataset, in a folder or at a URL, beside its data."""
    dataset = open_dataset(path)
    options = [entry.options.get("notes") for entry in dataset.manifest.episodes]
    notes = sorted({str(note) for some in options if isinstance(some, list) for note in some})
    card = TEMPLATE.format(
        tables="\n".join(line for table in TABLES for line in _tables(dataset, table)),
        version=dataset.header.schema_version,
        notes="".join(f"\n- {note}" for note in notes) + "\n" * bool(notes),
        configuration=json.dumps(dataset.header.configuration, indent=2, sort_keys=True),
    )
    place_of(path).write(DATA_CARD, card.encode())


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
