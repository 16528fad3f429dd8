"""The data card: what a dataset holds, for people, as Markdown beside the data."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.console.notices import LOGGER
from sim.frames import KINDS
from sim.store.atomic import write_whole
from sim.store.catalogue import MANIFEST
from sim.store.dataset import Dataset, open_dataset
from sim.store.parquet import check_budget, opened, read_packed
from sim.store.schema import MAX_OBJECTS, Split

DATA_CARD: Final = "README.md"
"""Name of the card in a dataset's folder."""

_TITLE: Final = "# Traffic episodes with labelled driver behaviour"
"""First line of every card."""

_COUNTED: Final = ("kind", "behavior")
"""The columns of ``agents.parquet`` that are counted."""

LIMITS: Final = (
    "Labels are what each driver was drawn to be. What a driver had the chance to show in the"
    " time it was seen may be less.",
    "Behaviours are those of a simulator's drivers with the profile numbers in"
    " `agents.parquet`; they are not measured from people.",
    "Positions and speeds are rounded to 2^-10 m and m/s, headings to 2^-13 rad.",
)
"""What everyone who uses the data should know."""


def write_data_card(folder: Path, edited: bool = False) -> None:
    """Write the card of a dataset into its folder.

    Args:
        folder: of the dataset.
        edited: whether somebody has changed the card that is there; it is kept, and a line on
            the log says so.

    Raises:
        OSError: if it cannot be written.
    """
    if edited:
        LOGGER.warning("%s: kept, since it was edited", folder / DATA_CARD)
        return
    write_whole(folder / DATA_CARD, data_card(open_dataset(folder)).encode())


def is_data_card(path: Path) -> bool:
    """Whether a file begins as the cards of datasets do."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_TITLE)) == _TITLE.encode()


def card_was_edited(folder: Path) -> bool:
    """Whether a dataset's card is not the one that its manifest gives."""
    path = folder / DATA_CARD
    if not path.exists() or not (folder / MANIFEST).exists():
        return False
    try:
        return not path.is_file() or path.read_bytes() != data_card(open_dataset(folder)).encode()
    except (InputError, OSError):  # an episode is damaged: no card to compare
        return False


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
    if "what_if" in dataset.manifest.configuration:
        return [*LIMITS, BRANCHED]
    if "worlds" in dataset.manifest.configuration:
        return [*LIMITS, SEEN]
    if "format" not in dataset.manifest.configuration:
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
    counts: dict[str, Counter[str]] = {}
    for entry in dataset.manifest.episodes:
        path = dataset.path / "episodes" / entry.id / "agents.parquet"
        with opened(path) as (layout, source):
            texts = check_budget(path, layout, _COUNTED, MAX_OBJECTS)
            table = read_packed(source, texts, list(_COUNTED))
        scenario = counts.setdefault(entry.scenario, Counter())
        for column in _COUNTED:
            scenario.update(word for word in table.column(column).to_pylist() if word is not None)
    episodes = Counter((e.scenario, e.split) for e in dataset.manifest.episodes)
    steps = Counter[str]()
    for entry in dataset.manifest.episodes:
        steps[entry.scenario] += entry.agent_steps
    configuration = json.dumps(dataset.manifest.configuration, indent=2, sort_keys=True)
    splits: tuple[Split, ...] = ("train", "validation", "test")
    names = dataset.scenarios
    kinds = [k for k in KINDS if any(counts[n][k] for n in names)]
    return "\n".join(
        [
            _TITLE,
            "",
            f"Schema version {dataset.manifest.schema_version}; the columns are described in"
            " `sim/store/schema.py`.",
            "",
            "## Episodes by split",
            "",
            *_table(
                ("scenario", *splits, "agent-steps"),
                [(n, *(str(episodes[n, s]) for s in splits), str(steps[n])) for n in names],
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
