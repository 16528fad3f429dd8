"""What each change of one driver would have caused: incidents, rules broken, delay of others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from behaviors.errors import InputError
from experiments.score.rows import Row
from experiments.what_if.branches import branch_of, change_of
from sim.frames import Event, EventKind, FloatArray, Tracks
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


def same_incident(one: Event, other: Event) -> bool:
    """Whether two events are the same incident of the same two agents.

    Args:
        one: an event.
        other: an event of another continuation.

    Examples:
        >>> before = Event(EventKind.NEAR_MISS, 20.0, agent=4, other=7)
        >>> same_incident(before, Event(EventKind.NEAR_MISS, 21.5, agent=7, other=4))
        True
    """
    return (
        one.kind is other.kind
        and {one.agent, one.other} == {other.agent, other.other}
        and abs(one.time_s - other.time_s) <= SAME_S
    )


def new_incidents(events: Iterable[Event], known: Sequence[Event]) -> list[Event]:
    """The incidents among some events that are not among the known ones."""
    return [
        event
        for event in events
        if event.kind in INCIDENTS and not any(same_incident(event, old) for old in known)
    ]


def delays(factual: Tracks, other: Tracks, since_s: float) -> dict[int, float]:
    """How much later everyone reaches the farthest point that it reaches in both continuations.

    The way is measured along each agent's own path: from where it is at the instant of the branch,
    or from where it first appears.

    Args:
        factual: one continuation, from ``since_s`` or earlier on.
        other: the other one.
        since_s: the instant of the branch, s.

    Returns:
        By agent id, s; negative for those who are earlier in the other one. An agent that enters in
        one of them only is later by at least the time that is left: that much is counted.
    """
    found = {}
    end_s = float(min(factual.time_s[-1], other.time_s[-1]))
    for agent in np.union1d(factual.ids, other.ids).tolist():
        start = _place(factual, agent, since_s)
        (one_s, one_m), (two_s, two_m) = (
            _travelled(tracks, agent, since_s, start) for tracks in (factual, other)
        )
        if not one_s.size and not two_s.size:
            continue
        if not one_s.size or not two_s.size:
            left_s = end_s - float((one_s if one_s.size else two_s)[0])
            found[int(agent)] = left_s if one_s.size else -left_s
            continue
        reached_m = min(one_m[-1], two_m[-1])
        found[int(agent)] = _when(two_s, two_m, reached_m) - _when(one_s, one_m, reached_m)
    return found


def _row(tracks: Tracks, agent: int) -> int:
    """The row of an agent; -1 if it is never there."""
    row = int(np.searchsorted(tracks.ids, agent))
    return row if row < tracks.ids.size and tracks.ids[row] == agent else -1


def _place(tracks: Tracks, agent: int, time_s: float) -> FloatArray | None:
    """(2,) where an agent is at a time, m; None if it is not there."""
    row, column = _row(tracks, agent), int(np.searchsorted(tracks.time_s, time_s - 1e-6))
    if row < 0 or column >= tracks.time_s.size:
        return None
    if abs(float(tracks.time_s[column]) - time_s) > 1e-6:
        return None
    place = tracks.positions(np.array(row), np.array(column))
    return None if np.isnan(place[0]) else place


def _travelled(
    tracks: Tracks, agent: int, since_s: float, start: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """(k,) times after the branch, s, and (k,) the way gone until then, m."""
    row = _row(tracks, agent)
    if row < 0:
        return np.empty(0), np.empty(0)
    rows = tracks.rows
    own = rows.index.rows(row)
    time_s, xy = tracks.time_s[rows.index.step[own]], rows.xy[own]
    later = time_s > since_s + 1e-6
    time_s, xy = time_s[later], xy[later]
    if start is not None:
        time_s, xy = np.append(since_s, time_s), np.concatenate([start[None], xy])
    if not time_s.size:
        return time_s, np.empty(0)
    moved = np.diff(xy, axis=0, prepend=xy[:1])
    return time_s, np.cumsum(np.hypot(moved[:, 0], moved[:, 1]))


def _when(time_s: FloatArray, way_m: FloatArray, reached_m: float) -> float:
    """When a way was first gone, s."""
    after = int(np.searchsorted(way_m, reached_m - 1e-6))
    if after == 0:
        return float(time_s[0])
    share = (reached_m - way_m[after - 1]) / max(way_m[after] - way_m[after - 1], 1e-9)
    return float(time_s[after - 1] + share * (time_s[after] - time_s[after - 1]))


def factual_of(dataset: Dataset, branched: EpisodeEntry | None = None) -> EpisodeEntry:
    """The episode of a dataset in which nothing was changed.

    Args:
        dataset: as ``what-if`` writes it.
        branched: a counterfactual episode of it; None for the only factual one.

    Raises:
        InputError: if there is no such episode, or more than one.
    """
    found = [
        entry
        for entry in dataset.manifest.episodes
        if branch_of(entry) is None
        and (
            branched is None
            or (entry.scenario, entry.engine, entry.seed)
            == (branched.scenario, branched.engine, branched.seed)
        )
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
    asked = dataset.header.configuration.get("what_if")
    if isinstance(asked, dict):
        order = [str(w) for key in ("behaviors", "actions") for w in _listed(asked.get(key))]
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
    known = _later(happened, since_s)
    rows = [_counted("factual", known, known, agent, {})]
    for entry in branched:
        tracks = dataset.read(entry).tracks
        late = delays(happened, tracks, since_s)
        rows.append(_counted(change_of(entry), _later(tracks, since_s), known, agent, late))
    return rows


def _listed(value: object) -> list[object]:
    return value if isinstance(value, list) else []


def _later(tracks: Tracks, since_s: float) -> list[Event]:
    return [event for event in tracks.events if event.time_s > since_s + 1e-6]


def _counted(
    change: str, events: Sequence[Event], known: Sequence[Event], agent: int,
    late: dict[int, float],
) -> Row:  # fmt: skip
    def count(kind: EventKind, *, own: bool = False) -> int:
        return sum(
            event.kind is kind and (not own or agent in (event.agent, event.other))
            for event in events
        )

    return {
        "change": change,
        "collisions": count(EventKind.COLLISION),
        "near_misses": count(EventKind.NEAR_MISS),
        "own_collisions": count(EventKind.COLLISION, own=True),
        "own_near_misses": count(EventKind.NEAR_MISS, own=True),
        "rules_broken": sum(e.kind in RULES and e.agent == agent for e in events),
        "caused": len(new_incidents(events, known)),
        "prevented": len(new_incidents(known, events)),
        "others_delay_s": round(sum(s for one, s in late.items() if one != agent), 2),
        "own_delay_s": round(late.get(agent, 0.0), 2),
    }
