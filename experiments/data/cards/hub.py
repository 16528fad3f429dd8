"""The head of a data card by which the Hugging Face Hub and ``datasets.load_dataset`` open it.

It is YAML between two lines of dashes. Every table is a configuration with its splits; the
catalogue is a configuration, too.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from typing import Final, get_args

import pyarrow as pa
import pyarrow.parquet as pq

from behaviors.errors import InputError
from experiments.data.cards.croissant import UNKNOWN_LICENCE
from sim.store.dataset import Dataset
from sim.store.entries import EPISODES
from sim.store.places import place_of
from sim.store.schema import TABLES, Split

PRETTY_NAME: Final = "Traffic episodes with labelled driver behaviour"

HEAD: Final = f"---\npretty_name: {PRETTY_NAME}\n"
"""How every card begins."""

MAYBE_EMPTY_BYTES: Final = 8192
"""Only files up to this size are looked into for rows: without any, a file has nothing but its
schema, of at most 4 kB."""

_SIZES: Final = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"),
                 (10**6, "100K<n<1M"), (10**7, "1M<n<10M"), (10**8, "10M<n<100M"),
                 (10**9, "100M<n<1B"))  # fmt: skip
"""The Hub's words for the number of rows."""


def card_head(dataset: Dataset) -> str:
    """The YAML at the top of a dataset's card.

    Args:
        dataset: what the card is about.

    Returns:
        Lines, the dashes included; "" for a dataset without shards. Equal datasets have equal
        heads.

    Raises:
        InputError: if the catalogue or a shard is broken.
        OSError: if a file cannot be read.
    """
    if dataset.header.schema_version == 1:
        return ""
    rows = sum(dataset.totals.column("agent_steps").to_pylist())
    size = next((word for most, word in _SIZES if rows < most), "n>1B")
    lines = [
        *HEAD.splitlines(),
        f"license: {UNKNOWN_LICENCE}",
        "task_categories: [tabular-classification, time-series-forecasting]",
        "tags: [traffic, trajectories, driver-behavior]",
        f"size_categories: [{size}]",
        "configs:",
    ]
    for table in TABLES:
        lines += _configuration(dataset, table)
    lines += ["- config_name: episodes", "  data_files:", "  - split: catalogue",
              f"    path: {EPISODES}", "---", ""]  # fmt: skip
    return "\n".join(lines)


def _configuration(dataset: Dataset, table: str) -> Iterator[str]:
    """The lines of one table; none where it has no rows: the library cannot read empty files."""
    place = place_of(dataset.path)
    files: dict[str, list[str]] = {}
    empty = set()
    for name, file in sorted(dataset.header.files.items()):
        if not name.startswith(f"{table}/"):
            continue
        if file.size <= MAYBE_EMPTY_BYTES:
            try:
                layout = pq.read_metadata(io.BytesIO(place.read(name)))
            except pa.ArrowException as error:
                raise InputError(f"{dataset.path}: {name}: found no Parquet ({error})") from None
            if layout.num_rows == 0:
                empty.add(name)
        split = next((s for s in get_args(Split) if f"/split={s}/" in name), "train")
        files.setdefault(split, []).append(name)
    parts = {split: [n for n in names if n not in empty] for split, names in files.items()}
    if not any(parts.values()):
        return
    yield f"- config_name: {table}"
    if table == TABLES[0]:
        yield "  default: true"
    yield "  data_files:"
    for split in (s for s in get_args(Split) if parts.get(s)):
        yield f"  - split: {split}"
        if len(parts[split]) == len(files[split]):
            yield f"    path: {table}/scenario=*/split={split}/*.parquet"
        else:
            yield "    path:"
            yield from (f"    - {json.dumps(name)}" for name in parts[split])
