"""The data card: what a dataset holds, for people, as Markdown beside the data."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.console.notices import LOGGER
from experiments.data.cards.croissant import CROISSANT, CROISSANT_HEAD, croissant
from experiments.data.cards.hub import HEAD, PRETTY_NAME, card_head
from sim.frames import KINDS
from sim.store.catalogue import is_dataset
from sim.store.dataset import Dataset, open_dataset
from sim.store.places import Folder, place_of
from sim.store.schema import Split

DATA_CARD: Final = "README.md"
"""Name of the card in a dataset's folder."""

_TITLE: Final = f"# {PRETTY_NAME}"
"""First line of every card, below its head."""

LIMITS: Final = (
    "Labels are what each driver was drawn to be. What a driver had the chance to show in the"
    " time it was seen may be less.",
    "Behaviours are those of a simulator's drivers with the profile numbers in"
    " the table of agents; they are not measured from people.",
    "Positions and speeds are rounded to 2^-10 m and m/s, headings to 2^-13 rad.",
)
"""What everyone who uses the data should know."""


def _cards(dataset: Dataset) -> Iterator[tuple[str, bytes]]:
    """Everything that describes a dataset beside its data, by name."""
    yield CROISSANT, croissant(dataset)
    yield DATA_CARD, data_card(dataset).encode()


def write_data_card(path: Path, edited: Collection[str] = ()) -> None:
    """Write the card of a dataset and its Croissant description beside its data.

    Args:
        path: the dataset, a folder or a URL.
        edited: names of those that somebody has changed; they are kept, and a line on the log says
            so.

    Raises:
        OSError: if one cannot be written.
    """
    for name, content in _cards(open_dataset(path)):
        if name in edited:
            LOGGER.warning("%s: kept, since it was edited", path / name)
        else:
            place_of(path).write(name, content)


def cards_in(folder: Path) -> set[str]:
    """Names of the files in a folder that begin as cards and descriptions of datasets do."""
    found = set()
    for name, begins in ((DATA_CARD, (HEAD, _TITLE)), (CROISSANT, (CROISSANT_HEAD,))):
        if (folder / name).is_file():
            with (folder / name).open("rb") as file:
                head = file.read(max(map(len, begins))).decode(errors="replace")
            if head.startswith(begins):
                found.add(name)
    return found


def edited_cards(path: Path) -> frozenset[str]:
    """Names of what describes a dataset, but not as its catalogue says.

    Where a file is damaged, nothing can be compared; what is there counts as edited, so that it is
    kept: a repair brings back the files that it describes.
    """
    place = place_of(path)
    if not is_dataset(path):
        return frozenset()
    found = set()
    for name in (CROISSANT, DATA_CARD):
        if isinstance(place, Folder):
            card = place.path / name
            if card.exists() and not card.is_file():
                found.add(name)
    names = [n for n in (CROISSANT, DATA_CARD) if n not in found and place.size(n) is not None]
    try:
        for name, content in _cards(open_dataset(path)) if names else ():
            if name in names and place.read(name) != content:
                found.add(name)
    except (InputError, OSError):
        return frozenset({*found, *names})
    return frozenset(found)


BRANCHED: Final = (
    "Episodes whose options have a `branch` begin at its instant: before it, they are the episode"
    " without one, which is the factual one."
)
"""What everyone who uses a what-if should know."""

SEEN: Final = (
    "Positions are as a sensor saw them, with its noise and losses; speeds and headings follow from"
    " them. Some episodes are in pixels or have no map: `options` of each episode says so."
)
"""What everyone who uses random worlds should know, too."""


def _table(header: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    lines = [header, tuple("---" for _ in header), *rows]
    return ["| " + " | ".join(cells) + " |" for cells in lines]


def _limits(dataset: Dataset) -> list[str]:
    """What is known to be missing or assumed."""
    if "what_if" in dataset.header.configuration:
        return [*LIMITS, BRANCHED]
    if "worlds" in dataset.header.configuration:
        return [*LIMITS, SEEN]
    if "format" not in dataset.header.configuration:
        return list(LIMITS)
    notes = [e.options.get("notes", []) for e in dataset.manifest.episodes]
    return sorted({str(note) for some in notes if isinstance(some, list) for note in some})


def data_card(dataset: Dataset) -> str:
    """Describe a dataset: counts, configuration, columns, known limits.

    Args:
        dataset: what to describe.

    Returns:
        Markdown. Equal datasets have equal cards.

    Raises:
        InputError: if an episode's agents cannot be read.
    """
    summed = (*BEHAVIORS, *KINDS, "agent_steps")
    counts: dict[str, Counter[str]] = {}
    episodes = Counter[tuple[str, str]]()
    for row in dataset.totals.to_pylist():
        episodes[row["scenario"], row["split"]] = row["episodes"]
        counts.setdefault(row["scenario"], Counter()).update({w: row[w] for w in summed})
    configuration = json.dumps(dataset.header.configuration, indent=2, sort_keys=True)
    splits: tuple[Split, ...] = ("train", "validation", "test")
    names = dataset.scenarios
    kinds = [k for k in KINDS if any(counts[n][k] for n in names)]
    return card_head(dataset) + "\n".join(
        [
            _TITLE,
            "",
            f"Schema version {dataset.header.schema_version}; the columns are described in"
            " `sim/store/schema.py`.",
            "",
            "## Episodes by split",
            "",
            *_table(
                ("scenario", *splits, "agent-steps"),
                [
                    (n, *(str(episodes[n, s]) for s in splits), str(counts[n]["agent_steps"]))
                    for n in names
                ],
            ),
            "",
            "## Agents drawn, by behaviour and kind",
            "",
            *_table(
                ("scenario", *BEHAVIORS, *kinds),
                [(n, *(str(counts[n][w]) for w in (*BEHAVIORS, *kinds))) for n in names],
            ),
            "",
            "## Known limits",
            "",
            *(f"- {limit}" for limit in _limits(dataset)),
            "",
            "## Made with",
            "",
            "```json",
            configuration,
            "```",
            "",
        ]
    )
