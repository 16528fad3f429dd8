"""Statistics of a dataset or recording, per kilometre and hour driven.

Everything is summed over the drivers of a group and divided by the distance and time that they
drive. Intervals are by bootstrap over episodes. A conflict counts for both of its parties.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np
import pandas as pd

from behaviors.errors import lookup
from behaviors.labels import BEHAVIORS
from experiments.report.tables import with_interval
from experiments.score.metrics import ratio, row_of
from experiments.score.rows import Cell, Row, pivoted, tidy_row
from sim.episode.annotate import annotated_parts
from sim.formats import FORMATS
from sim.frames import KINDS, PEDESTRIAN, EventKind, IntArray
from sim.safety import CONFLICT_KINDS, Conflicts
from sim.store.dataset import Dataset, Episode

SEVERE_MPS: Final = 5.0
"""A near miss is severe if a collision would have changed a velocity by more, m/s (our choice)."""

CLOSE_S: Final = 1.0
"""A headway below this is close, s (half of the rule of two seconds)."""

FOLLOWS_S, MOVES_MPS = 5.0, 3.0
"""Headways count up to this many seconds and above this speed; others do not follow or crawl."""

RATES: Final = {"_per_km": "km", "_per_h": "hours"}
"""Denominator of counts, by the end of the metric's name."""

LEGEND: Final = (
    "Rates are counts over the kilometres that a group's drivers drove; a conflict counts for both "
    "parties. severe: a near miss whose collision would change a velocity by 5 m/s.\n"
    "Headways count below 5 s and above 3 m/s; close: below 1 s. -: nothing was seen.\n"
    "[low, high]: 95 % interval over episodes, from three on. --json and --out have rates per hour."
)
"""Text below the table for people."""

_EXPOSURE: Final = ("drivers", "km", "hours")
_HEADWAYS: Final = ("headway", "follows", "close")


def _behaviors(episode: Episode) -> Sequence[str]:
    codes, classes = episode.tracks.behavior, episode.tracks.classes
    if codes is None:
        return ["unknown"] * episode.tracks.ids.size
    return [str(classes[code]) if code >= 0 else "unknown" for code in codes.tolist()]


BY: Final[dict[str, Callable[[Episode], Sequence[str]]]] = {
    "behavior": _behaviors,
    "kind": lambda episode: [KINDS[code] for code in episode.tracks.kind.tolist()],
    "scenario": lambda episode: [episode.entry.scenario] * episode.tracks.ids.size,
}
"""By what drivers are grouped: from an episode to the group of each agent."""


def summary(dataset: Dataset, by: str | None = None) -> list[Row]:
    """How drivers drive, and how dangerously.

    Args:
        dataset: simulated episodes or recordings.
        by: "behavior", "kind" or "scenario"; None for all drivers together.

    Returns:
        Tidy rows with the key ``by``'s group: exposure (``km``, ``hours``, ``drivers``), mean
        speed and headway. Rates ``_per_km`` and ``_per_h`` follow, of each trait, event,
        collision, conflict and near miss. Rows that need a road are left out where none is known.
        Groups of pedestrians count what they do as if they drove.

    Raises:
        InputError: if ``by`` is not known, or an episode cannot be read.
    """
    groups = None if by is None else lookup(BY, by, "--by")
    parts = []
    for entry in dataset.manifest.episodes:
        episode = dataset.read(entry)
        amounts = _amounts(dataset, episode)
        amounts["group"] = groups(episode) if groups else "all"
        counts = (episode.tracks.kind != PEDESTRIAN) | (by == "kind")
        parts.append(amounts[counts].groupby("group").sum())
    sums = pd.concat(parts)  # a row for each group of each episode
    known = (*BEHAVIORS, *KINDS)
    order = {str(word): place for place, word in enumerate(known)}
    return [
        row
        for name in sorted({*sums.index}, key=lambda name: (order.get(name, len(known)), name))
        for row in _rows({} if by is None else {by: name}, sums.loc[[name]])
    ]


def _rows(keys: dict[str, Cell], sums: pd.DataFrame) -> Iterator[Row]:
    """The figures of one group from what was summed in each episode."""
    sums = sums.dropna(axis=1, how="all").fillna(0.0)
    for name in _EXPOSURE:
        yield tidy_row(keys, name, float(sums[name].sum()), n=len(sums))
    shares = {"speed_mean_mps": (1000.0 * sums["km"], 3600.0 * sums["hours"])}
    if "follows" in sums:
        shares["headway_mean_s"] = sums["headway"], sums["follows"]
        shares["headway_close_share"] = sums["close"], sums["follows"]
    for metric in sorted({*sums} - {*_EXPOSURE, *_HEADWAYS}):
        for end, base in RATES.items():
            shares[metric + end] = sums[metric], sums[base]
    for metric, (top, below) in shares.items():
        columns = np.stack([top, below], axis=1)[below > 0]
        yield row_of(keys, metric, ratio, columns, len(columns))


def _amounts(dataset: Dataset, episode: Episode) -> pd.DataFrame:
    """How much of each metric, in the columns, each agent of an episode has."""
    tracks, entry = episode.tracks, episode.entry
    road, n = dataset.road(entry), tracks.ids.size
    agent, goes = tracks.index.agent, ~tracks.index.begins
    moved = np.zeros(agent.size)
    moved[1:] = np.hypot(*np.diff(tracks.row_xy, axis=0).T)
    lasts = np.diff(tracks.time_s[tracks.index.step], prepend=0.0)
    found = pd.DataFrame({
        "drivers": np.ones(n),
        "km": np.bincount(agent, np.where(goes, moved, 0.0), n) / 1000.0,
        "hours": np.bincount(agent, np.where(goes, lasts, 0.0), n) / 3600.0,
        **_conflicts(tracks.ids, dataset.conflicts(entry)),
    }, index=tracks.ids)  # fmt: skip
    if road is None:
        return found
    if entry.engine in FORMATS:
        annotated = list(annotated_parts(tracks, road))
        events = [event for _, part in annotated for event in part.events]
        traits = [trait for _, part in annotated for trait in part.shown_traits]
        parts = [
            pd.DataFrame({"agent": part.ids[part.index.agent], "speed_mps": part.row_speed,
                          "gap_m": seen.inputs.gap})
            for part, seen in annotated
        ] or [pd.DataFrame(columns=["agent", "speed_mps", "gap_m"], dtype=float)]  # fmt: skip
        gaps = pd.concat(parts, ignore_index=True)
    else:
        events, traits = list(tracks.events), list(episode.shown_traits)
        gaps = dataset.rows(entry, "steps", ["agent", "speed_mps", "gap_m"]).to_pandas()
    headway = (gaps["gap_m"] / gaps["speed_mps"])[gaps["speed_mps"] > MOVES_MPS]
    headway = headway[headway < FOLLOWS_S].astype(float)
    follows = pd.DataFrame({
        "headway": headway, "close": (headway < CLOSE_S).astype(float), "follows": 1.0
    }).groupby(gaps["agent"]).sum()  # fmt: skip
    named = [(trait.agent, f"trait {trait.trait.value}") for trait in traits]
    for event in events:  # near misses are among the conflicts
        if event.kind is EventKind.COLLISION:
            named.append((event.agent, "collisions_caused"))
        elif event.kind is not EventKind.NEAR_MISS:
            named.append((event.agent, f"event {event.kind.value}"))
    who = pd.DataFrame(named, columns=["agent", "what"])
    counts = pd.crosstab(who["agent"], who["what"].str.replace(" ", "_")).astype(float)
    if "collisions_caused" not in counts:
        counts["collisions_caused"] = 0.0
    return found.join([part.reindex(tracks.ids, fill_value=0.0) for part in (follows, counts)])


def _conflicts(ids: IntArray, met: Conflicts) -> dict[str, np.ndarray]:
    """Conflicts of each agent by kind and severity."""
    both = np.searchsorted(ids, np.concatenate([met.first, met.second]))
    severe = met.near_miss & (met.delta_v_mps > SEVERE_MPS)
    every = np.ones(len(met), dtype=bool)
    return {
        f"{name}_{kind.value}": np.bincount(both[np.tile(some & (met.kind == code), 2)],
                                            minlength=ids.size).astype(float)
        for name, some in (("conflicts", every), ("near_misses", met.near_miss), ("severe", severe))
        for code, kind in enumerate(CONFLICT_KINDS)
    }  # fmt: skip


def table(rows: Sequence[Row], by: str | None) -> list[dict[str, Cell]]:
    """A line for each figure, a column for each group.

    Rates per hour are left out, and figures that are 0 in every group.
    """
    some = {row["metric"] for row in rows if row["value"]}
    kinds = ("near", "severe", "collisions", "conflicts", "event", "trait")
    order = {kind: place for place, kind in enumerate(kinds)}
    shown = [r for r in rows if r["metric"] in some and not str(r["metric"]).endswith("_per_h")]
    shown.sort(key=lambda row: order.get(str(row["metric"]).split("_")[0], -1))
    lines = pivoted(
        shown, ["metric"], lambda row: "all" if by is None else str(row[by]), with_interval
    )
    return [{"figure": str(line.pop("metric")).replace("_", " "), **line} for line in lines]
