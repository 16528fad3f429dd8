"""Statistics of a dataset or recording, per kilometre and hour driven.

Everything is summed over the drivers of a group and divided by the distance and time that they
drive. Intervals are by bootstrap over episodes. A conflict counts for both of its parties.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np
import pyarrow.compute as pc

from behaviors.errors import lookup
from behaviors.labels import BEHAVIORS
from behaviors.traits import ShownTrait
from experiments.score.metrics import ratio, row_of
from experiments.score.rows import Cell, Row, pivoted, tidy_row
from sim.episode.annotate import annotated_parts
from sim.formats import FORMATS
from sim.frames import KINDS, PEDESTRIAN, Event, EventKind, FloatArray, IntArray, Tracks
from sim.road import Road
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
    "[low, high]: 95 % interval over episodes, from three on. --json and --out have rates per hour."
)
"""Text below the table for people."""

_BASES: Final = ("drivers", "km", "hours", "headway", "follows", "close")
"""Sums that are no counts of what happened."""


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
    found: dict[str, dict[str, FloatArray]] = defaultdict(
        lambda: defaultdict(lambda: np.zeros(len(dataset)))
    )
    for number, entry in enumerate(dataset.manifest.episodes):
        episode = dataset.read(entry)
        counts = (episode.tracks.kind != PEDESTRIAN) | (by == "kind")
        named = np.array(groups(episode) if groups else ["all"] * counts.size, dtype=object)
        for metric, amount in _amounts(dataset, episode):
            for name in dict.fromkeys(named[counts].tolist()):
                found[name][metric][number] += float(amount[counts & (named == name)].sum())
    known = (*BEHAVIORS, *KINDS)
    order = {str(word): place for place, word in enumerate(known)}
    return [
        row
        for name in sorted(found, key=lambda name: (order.get(name, len(known)), name))
        for row in _rows({} if by is None else {by: name}, found[name])
    ]


def _rows(keys: dict[str, Cell], sums: dict[str, FloatArray]) -> Iterator[Row]:
    """The figures of one group from what was summed in each episode."""
    many = int((sums["drivers"] > 0).sum())
    for name in _BASES[:3]:
        yield tidy_row(keys, name, float(sums[name].sum()), n=many)
    shares = {"speed_mean_mps": (1000.0 * sums["km"], 3600.0 * sums["hours"])}
    if "follows" in sums:
        shares["headway_mean_s"] = sums["headway"], sums["follows"]
        shares["headway_close_share"] = sums["close"], sums["follows"]
    for metric in sorted(sums.keys() - set(_BASES)):
        for end, base in RATES.items():
            shares[metric + end] = sums[metric], sums[base]
    for metric, (top, below) in shares.items():
        seen = below > 0
        if not seen.any():
            yield tidy_row(keys, metric, None, n=0)
            continue
        yield row_of(keys, metric, ratio, np.stack([top, below], axis=1)[seen], int(seen.sum()))


def _amounts(dataset: Dataset, episode: Episode) -> Iterator[tuple[str, FloatArray]]:
    """By metric, (N,) how much of it each agent of an episode has."""
    tracks, entry = episode.tracks, episode.entry
    agent, n = tracks.index.agent, tracks.ids.size
    goes = ~tracks.index.begins
    moved = np.zeros(agent.size)
    moved[1:] = np.hypot(*np.diff(tracks.row_xy, axis=0).T)
    lasts = np.diff(tracks.time_s[tracks.index.step], prepend=0.0)
    yield "drivers", np.ones(n)
    yield "km", np.bincount(agent, np.where(goes, moved, 0.0), n) / 1000.0
    yield "hours", np.bincount(agent, np.where(goes, lasts, 0.0), n) / 3600.0
    yield from _conflicts(tracks.ids, dataset.conflicts(entry))
    road = dataset.road(entry)
    if road is None:
        return
    events: Sequence[Event]
    shown: Sequence[ShownTrait]
    if entry.engine in FORMATS:
        events, shown, gaps = _annotated(tracks, road)
    else:
        events, shown = tracks.events, episode.shown_traits
        own = dataset.rows(entry, "steps", ["agent", "speed_mps", "gap_m"])
        known = own.filter(pc.is_valid(own["gap_m"]))
        speed, gap = known["speed_mps"].to_numpy(), known["gap_m"].to_numpy()
        gaps = [(known["agent"].to_numpy(), speed, gap)]
    yield from _headways(tracks.ids, gaps)
    yield from _counts(tracks.ids, events, shown)


_Gaps = tuple[IntArray, FloatArray, FloatArray]


def _annotated(tracks: Tracks, road: Road) -> tuple[list[Event], list[ShownTrait], list[_Gaps]]:
    """Events, shown traits, and (ids, speeds, gaps) of the parts of a recording."""
    events, shown, gaps = list[Event](), list[ShownTrait](), list[_Gaps]()
    for part, found in annotated_parts(tracks, road):
        events += found.events
        shown += found.shown_traits
        gap = found.inputs.gap
        near = np.isfinite(gap)
        gaps.append((part.ids[part.index.agent][near], part.row_speed[near], gap[near]))
    return events, shown, gaps


def _headways(ids: IntArray, gaps: Sequence[_Gaps]) -> Iterator[tuple[str, FloatArray]]:
    """Sums of the headways of each agent that follows another one, and of how many are close."""
    total = np.zeros((3, ids.size))
    for agents, speed, gap in gaps:
        moves = speed > MOVES_MPS
        agent, headway = np.searchsorted(ids, agents[moves]), gap[moves] / speed[moves]
        kept = headway < FOLLOWS_S
        for row, weight in enumerate((headway, headway < CLOSE_S, headway >= 0.0)):
            total[row] += np.bincount(agent[kept], weight[kept].astype(float), ids.size)
    yield from zip(("headway", "close", "follows"), total, strict=True)


def _conflicts(ids: IntArray, met: Conflicts) -> Iterator[tuple[str, FloatArray]]:
    """Conflicts of each agent by kind and severity."""
    both = np.searchsorted(ids, np.concatenate([met.first, met.second]))
    severe = met.near_miss & (met.delta_v_mps > SEVERE_MPS)
    every = np.ones(len(met), dtype=bool)
    for name, some in (("conflicts", every), ("near_misses", met.near_miss), ("severe", severe)):
        for code, kind in enumerate(CONFLICT_KINDS):
            weight = np.tile(some & (met.kind == code), 2).astype(float)
            yield f"{name}_{kind.value}", np.bincount(both, weight, ids.size).astype(float)


def _counts(
    ids: IntArray, events: Sequence[Event], shown: Sequence[ShownTrait]
) -> Iterator[tuple[str, FloatArray]]:
    """Events and traits of each agent; near misses are among the conflicts."""
    counted: dict[str, FloatArray] = {"collisions_caused": np.zeros(ids.size)}
    row = {int(agent): number for number, agent in enumerate(ids.tolist())}
    named = [(trait.agent, f"trait {trait.trait.value}") for trait in shown]
    for event in events:
        if event.kind is EventKind.COLLISION:
            named.append((event.agent, "collisions_caused"))
        elif event.kind is not EventKind.NEAR_MISS:
            named.append((event.agent, f"event {event.kind.value}"))
    for agent, words in named:
        if agent in row:
            name = words.replace(" ", "_")
            counted.setdefault(name, np.zeros(ids.size))[row[agent]] += 1.0
    yield from counted.items()


def table(rows: Sequence[Row], by: str | None) -> list[dict[str, Cell]]:
    """A line for each figure, a column for each group.

    Rates per hour are left out, and figures that are 0 in every group.
    """

    def group(row: Row) -> str:
        return "all" if by is None else str(row[by])

    def cell(row: Row) -> str:
        if row["low"] is None or not row["value"]:
            return f"{row['value'] or 0.0:.3g}"
        return f"{row['value']:.3g} [{row['low']:.3g}, {row['high']:.3g}]"

    shown = [row for row in rows if not str(row["metric"]).endswith("_per_h")]
    some = {row["metric"] for row in shown if row["value"]}
    kinds = ("near", "severe", "collisions", "conflicts", "event", "trait")
    order = {kind: place for place, kind in enumerate(kinds)}
    shown = [row for row in shown if row["metric"] in some]
    shown.sort(key=lambda row: order.get(str(row["metric"]).split("_")[0], -1))
    lines = pivoted(shown, ["metric"], group, cell)
    return [{"figure": str(line.pop("metric")).replace("_", " "), **line} for line in lines]
