"""What each change of one driver would have caused: incidents, rules broken, delay of others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from operator import attrgetter
from typing import Any, Final

import numpy as np
import pandas as pd

from behaviors.errors import InputError
from experiments.score.rows import Row
from experiments.what_if.branches import branch_of, change_of
from sim.frames import Event, EventKind, Tracks
from sim.store.dataset import Dataset
from sim.store.schema import EpisodeEntry

INCIDENTS: Final = (EventKind.COLLISION, EventKind.NEAR_MISS)
"""What counts as an incident."""

RULES: Final = (
    EventKind.RED_RUN, EventKind.STOP_ROLLED, EventKind.NOT_YIELDED, EventKind.WRONG_WAY,
)  # fmt: skip
"""What counts as a rule broken."""

SAME_S: Final = 3.0
"""Incidents of one pair of agents that begin so close in time are the same one (as two touches are
of one collision)."""


def new_incidents(events: Iterable[Event], known: Sequence[Event]) -> list[Event]:
    """The incidents among some events that are not among the known ones, by pair and time."""
    return [
        event
        for event in events
        if event.kind in INCIDENTS
        and not any(
            event.kind is old.kind
            and {event.agent, event.other} == {old.agent, old.other}
            and abs(event.time_s - old.time_s) <= SAME_S
            for old in known
        )
    ]


def paths_since(since_s: float, factual: Tracks, tracks: Tracks) -> pd.DataFrame:
    """Where everyone goes from the instant of a branch on, by agent, then by time.

    Returns:
        Columns ``id``, ``time_s`` (s), ``x``, ``y`` (m) and ``way_m`` (m), the way since the
        instant. It begins where the agent is then, in the factual tracks, or where it first
        appears.
    """
    columns = ["id", "time_s", "x", "y"]
    before, after = factual.to_pandas()[columns], tracks.to_pandas()[columns]
    before = before[np.abs(before["time_s"] - since_s) < 1e-6]
    paths = pd.concat([before, after[after["time_s"] > since_s + 1e-6]], ignore_index=True)
    paths = paths.sort_values(["id", "time_s"], ignore_index=True)
    moved = paths.groupby("id")[["x", "y"]].diff().fillna(0.0)
    paths["way_m"] = np.hypot(moved["x"], moved["y"]).groupby(paths["id"]).cumsum()
    return paths


def delays(factual: Tracks, other: Tracks, since_s: float) -> dict[int, float]:
    """How much later everyone reaches the farthest point that it reaches in both continuations, s.

    The way is measured along each agent's own path, see `paths_since`. Delays are by agent id,
    negative for those who are earlier in the other one. An agent that enters in one of them only is
    later by at least the time that is left: that much is counted.
    """
    found = {}
    end_s = float(min(factual.time_s[-1], other.time_s[-1]))
    one, two = (
        dict(list(paths_since(since_s, factual, tracks).groupby("id")))
        for tracks in (factual, other)
    )
    for agent in sorted({*one, *two}):
        if agent not in two:
            found[agent] = end_s - float(one[agent]["time_s"].iloc[0])
        elif agent not in one:
            found[agent] = float(two[agent]["time_s"].iloc[0]) - end_s
        else:
            reached_m = min(one[agent]["way_m"].iloc[-1], two[agent]["way_m"].iloc[-1])
            found[agent] = _first_s(two[agent], reached_m) - _first_s(one[agent], reached_m)
    return found


def _first_s(path: pd.DataFrame, reached_m: float) -> float:
    """When a way was first gone, s."""
    way_m = path["way_m"].to_numpy()
    after = int(np.searchsorted(way_m, reached_m - 1e-6))
    some = slice(max(after - 1, 0), after + 1)
    return float(np.interp(reached_m, way_m[some], path["time_s"].to_numpy()[some]))


def factual_of(dataset: Dataset, branched: EpisodeEntry | None = None) -> EpisodeEntry:
    """The episode of a dataset in which nothing was changed: of a branched one, or the only."""
    made = attrgetter("scenario", "engine", "seed")
    found = [
        entry
        for entry in dataset.manifest.episodes
        if branch_of(entry) is None and (branched is None or made(entry) == made(branched))
    ]
    if len(found) != 1:
        raise InputError(
            f"{dataset.path}: found {len(found)} factual episodes, expected 1: a dataset that "
            "what-if wrote"
        )
    return found[0]


def branches_of(dataset: Dataset) -> list[EpisodeEntry]:
    """The counterfactual episodes of a dataset, in the order in which they were asked for.

    Raises:
        InputError: if there is none.
    """
    found = [entry for entry in dataset.manifest.episodes if branch_of(entry) is not None]
    if not found:
        raise InputError(f"{dataset.path}: found no branch, expected a dataset that what-if wrote")
    asked: Any = dataset.header.configuration.get("what_if")
    if asked:
        order = [*asked["behaviors"], *asked["actions"]]
        found.sort(key=lambda entry: order.index(change_of(entry)))
    return found


def outcomes(dataset: Dataset) -> list[Row]:
    """What each change would have caused.

    Args:
        dataset: as ``what-if`` writes it.

    Returns:
        A row for the factual continuation and one for each change. Everything is counted after the
        instant of the branch: ``collisions`` and ``near_misses`` of everybody, ``own_collisions``
        and ``own_near_misses`` that the driver is a party of, ``rules_broken`` by the driver,
        ``caused`` incidents that did not happen, ``prevented`` ones that did, ``others_delay_s``
        summed over everybody else, and ``own_delay_s``.

    Raises:
        InputError: if the dataset is not one that ``what-if`` wrote.
    """
    factual, branched = factual_of(dataset), branches_of(dataset)
    branch = branch_of(branched[0]) or {}
    since_s, agent = float(branch["at_s"]), int(branch["agent"])
    happened = dataset.read(factual).tracks
    known = [event for event in happened.events if event.time_s > since_s + 1e-6]
    rows: list[Row] = []
    for entry in (factual, *branched):
        tracks = happened if entry is factual else dataset.read(entry).tracks
        late = {} if entry is factual else delays(happened, tracks, since_s)
        events = [event for event in tracks.events if event.time_s > since_s + 1e-6]
        kinds = Counter(event.kind for event in events)
        own = Counter(event.kind for event in events if agent in (event.agent, event.other))
        rows.append({
            "change": change_of(entry),
            "collisions": kinds[EventKind.COLLISION],
            "near_misses": kinds[EventKind.NEAR_MISS],
            "own_collisions": own[EventKind.COLLISION],
            "own_near_misses": own[EventKind.NEAR_MISS],
            "rules_broken": sum(e.kind in RULES and e.agent == agent for e in events),
            "caused": len(new_incidents(events, known)),
            "prevented": len(new_incidents(known, events)),
            "others_delay_s": round(sum(s for one, s in late.items() if one != agent), 2),
            "own_delay_s": round(late.get(agent, 0.0), 2),
        })  # fmt: skip
    return rows
