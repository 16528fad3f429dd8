"""The Croissant description of a dataset: which files there are, and what their columns are.

Croissant is a vocabulary (JSON-LD) by which catalogues find datasets and loaders open them.

References:
    MLCommons (2024), Croissant Format Specification 1.0.
"""

from __future__ import annotations

import json
from typing import Any, Final, cast

import pyarrow as pa

from sim.store.dataset import Dataset
from sim.store.entries import EPISODES
from sim.store.places import file_checksum, place_of
from sim.store.schema import CATALOGUE, TABLES, FileName, shard_schema

CROISSANT: Final = "croissant.json"
"""Name of the description in a dataset's folder."""

PUBLISHED: Final = "2026-11-23"
"""The format wants a date. This one is of the layout: with the day on which a dataset is made,
equal commands would not give equal bytes. Who publishes a dataset replaces it."""

CITE_AS: Final = (
    "Chandra, Bhattacharya, Mittal, Li, Bera, Manocha (2020): GraphRQI: Classifying Driver "
    "Behaviors Using Graph Spectrums. ICRA. https://arxiv.org/abs/1910.00049"
)
"""The paper whose behaviours the labels are."""

UNKNOWN_LICENCE: Final = "unknown"
"""Nothing is known of the licence under which somebody publishes a dataset, or under which
recordings were published."""

CROISSANT_HEAD: Final = '{\n "name": "graphrqi-traffic-episodes",'
"""How every description begins."""

_PARQUET: Final = "application/x-parquet"

_PREFIXED: Final = (
    "citeAs", "column", "equivalentProperty", "extract", "field", "fileProperty", "fileObject",
    "fileSet", "format", "includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField",
    "path", "recordSet", "references", "regex", "repeated", "replace", "samplingRate", "separator",
    "source", "subField", "transform",
)  # fmt: skip

_CONTEXT: Final[dict[str, Any]] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
    **{word: f"cr:{word}" for word in _PREFIXED},
}
"""The terms of the specification."""

TOLD: Final = {
    "episodes": "The catalogue: one row per episode.",
    "steps": "One row per road-agent and time step: centre, m, heading, rad, and speed, m/s.",
    "agents": "One row per road-agent: kind, size, the behaviour it was drawn or labelled with.",
    "frames": "One row per time step.",
    "signals": "One row per change of a traffic light.",
    "events": "One row per event: collisions, rules kept and broken.",
    "traits": "One row per interval in which a road-agent showed a trait of the paper's table.",
}
"""What the rows of each table are."""


def croissant(dataset: Dataset) -> bytes:
    """Describe a dataset.

    Args:
        dataset: what to describe.

    Returns:
        JSON-LD. Equal datasets have equal descriptions.

    Raises:
        OSError: if its catalogue cannot be read.
    """
    episodes = {"@id": "episodes-file"}
    records = [_record_set("episodes", CATALOGUE, {"fileObject": episodes}, partitions=False)]
    for table in TABLES:
        name = cast("FileName", f"{table}.parquet")
        source = {"fileSet": {"@id": f"{table}-files"}}
        records.append(_record_set(table, shard_schema(name), source, partitions=True))
    return (json.dumps(_described(dataset, records), indent=1) + "\n").encode()


def _described(dataset: Dataset, records: list[dict[str, Any]]) -> dict[str, Any]:
    scenarios = ", ".join(dataset.scenarios)
    return {
        "name": "graphrqi-traffic-episodes",
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "description": (
            f"Traffic episodes with labelled driver behaviour: {len(dataset)} of {scenarios}."
        ),
        "license": UNKNOWN_LICENCE,
        "version": f"{dataset.header.schema_version}.0.0",
        "datePublished": PUBLISHED,
        "citeAs": CITE_AS,
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": "episodes-file",
                "name": "episodes-file",
                "contentUrl": EPISODES,
                "encodingFormat": _PARQUET,
                "sha256": file_checksum(place_of(dataset.path), EPISODES),
            },
            *(
                {
                    "@type": "cr:FileSet",
                    "@id": f"{table}-files",
                    "name": f"{table}-files",
                    "description": "The table's shards.",
                    "encodingFormat": _PARQUET,
                    "includes": f"{table}/*/*/*.parquet",
                }
                for table in TABLES
            ),
        ],
        "recordSet": records,
    }


def _record_set(
    name: str, schema: pa.Schema, source: dict[str, Any], partitions: bool
) -> dict[str, Any]:
    """One table; scenario and split of a partitioned one are in the paths of its files."""
    fields = []
    for column in schema:
        item = column.type.value_type if pa.types.is_list(column.type) else column.type
        field = _field(
            name, column.name, _type_of(item), {**source, "extract": {"column": column.name}}
        )
        fields.append({**field, "repeated": True} if pa.types.is_list(column.type) else field)
    for word in ("scenario", "split") if partitions else ():
        path = {**source, "extract": {"fileProperty": "fullpath"}}
        path["transform"] = {"regex": f".*{word}=([^/]+)/.*"}
        fields.append(_field(name, word, "sc:Text", path))
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "description": TOLD[name],
        "field": fields,
    }


def _field(table: str, column: str, kind: str, source: dict[str, Any]) -> dict[str, Any]:
    identity = f"{table}/{column}"
    return {
        "@type": "cr:Field", "@id": identity, "name": identity, "dataType": kind, "source": source,
    }  # fmt: skip


def _type_of(kind: pa.DataType) -> str:
    if pa.types.is_boolean(kind):
        return "sc:Boolean"
    if pa.types.is_integer(kind):
        return "sc:Integer"
    return "sc:Float" if pa.types.is_floating(kind) else "sc:Text"
