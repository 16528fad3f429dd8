"""The conflicts of an episode or recording: every encounter of two road users, and how near it was.

References:
    Laureshyn, Svensson, Hydén (2010), Accident Analysis and Prevention 42(6), 1637 (encounters).
    Gettman, Pu, Sayed, Shelby (2008), Surrogate safety assessment model and validation,
    FHWA-HRT-08-051 (kinds by the angle between headings, change of velocity).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.checked_arrays import frozen
from sim.frames import (
    KINDS,
    PEDESTRIAN,
    AgentKind,
    BoolArray,
    CodeArray,
    EventKind,
    FloatArray,
    IntArray,
    Tracks,
)
from sim.geometry import GRAZE_M, Outlines, separation
from sim.road import Road
from sim.safety.encounters import SAME_WAY_RAD, Driven, Shared, areas_ahead, shared_places, wrapped
from sim.safety.measures import Bodies, is_near_miss, pair_measures
from sim.safety.priority import priorities

MASS_KG: Final = {
    AgentKind.CAR: 1500.0,
    AgentKind.BUS: 12000.0,
    AgentKind.TRUCK: 4500.0,
    AgentKind.MOTORCYCLE: 270.0,
    AgentKind.BICYCLE: 80.0,
    AgentKind.PEDESTRIAN: 70.0,
}
"""Masses by kind, kg: those of SUMO 1.28's vehicle classes (``vehicletype.getMass``); two-wheelers
carry a rider, as heavy as its pedestrian."""

ONCOMING_RAD: Final = math.radians(150.0)
"""Bodies whose headings differ by more come towards each other."""


class ConflictKind(StrEnum):
    """How two road users meet; the members' order is the code order.

    The angle is between the headings at the shared position with the least time between the two.
    Without a shared position, it is that of their nearest approach to a collision.

    - following: below 30 degrees, one behind the other when they first share a place
    - merging: below 30 degrees there or in the end, but one came in from aside
    - crossing: 30 to 150 degrees
    - oncoming: above 150 degrees
    - side: below 30 degrees, beside each other, and they share no place
    - pedestrian: one of them walks, whatever the angle
    """

    FOLLOWING = "following"
    MERGING = "merging"
    CROSSING = "crossing"
    ONCOMING = "oncoming"
    SIDE = "side"
    PEDESTRIAN = "pedestrian"


CONFLICT_KINDS: Final = tuple(ConflictKind)
"""The code order: code c means ``CONFLICT_KINDS[c]``."""

FOLLOWING, MERGING, CROSSING, ONCOMING, SIDE, WALKING = range(len(CONFLICT_KINDS))
DECIDED: Final = (MERGING, CROSSING, ONCOMING, WALKING)
"""Kinds in which one party has to yield."""


@dataclass(frozen=True, eq=False)
class Conflicts:
    """The k encounters of an episode, by begin, then by ids. Ids are -1 where there is none.

    Times to collision count only while each body's present turn keeps it within half its width of
    its straight path.

    Attributes:
        first: (k,) id of one agent, the smaller one.
        second: (k,) id of the other.
        kind: (k,) codes into ``CONFLICT_KINDS``.
        begin_s: (k,) time at which the encounter begins, s.
        end_s: (k,) time at which it ends, s.
        ttc_s: (k,) least time to collision, s; inf if they were never on a collision course.
        ttc_time_s: (k,) when, s; nan if never.
        mttc_s: (k,) least modified time to collision, s; inf if there was none.
        drac_mps2: (k,) largest deceleration rate to avoid the crash before contact, m/s2.
        pet_s: (k,) post-encroachment time, s: the least time between one's leaving a shared
            position and the other's arrival. nan where they share none within an encounter's time.
        pet_time_s: (k,) when the later one came there, s; nan where there is none.
        gap_m: (k,) least distance between the outlines, m; nan if never seen at one time.
        closing_mps: (k,) rate at which it shrank then, m/s.
        delta_v_mps: (k,) change of velocity of the lighter one in an inelastic collision at their
            least time to collision, else at their nearest, m/s.
        passed_first: (k,) id of the one that was first at the place of ``pet_s``.
        priority: (k,) id of the one with priority, as far as the map gives it.
        near_miss: (k,) whether they nearly collided (`sim.safety.is_near_miss`). Post-encroachment
            time counts where one does not follow the other: the later one comes in from aside.
    """

    first: IntArray
    second: IntArray
    kind: CodeArray
    begin_s: FloatArray
    end_s: FloatArray
    ttc_s: FloatArray
    ttc_time_s: FloatArray
    mttc_s: FloatArray
    drac_mps2: FloatArray
    pet_s: FloatArray
    pet_time_s: FloatArray
    gap_m: FloatArray
    closing_mps: FloatArray
    delta_v_mps: FloatArray
    passed_first: IntArray
    priority: IntArray
    near_miss: BoolArray

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for field in fields(self):
            object.__setattr__(self, field.name, frozen(getattr(self, field.name)))

    def __len__(self) -> int:
        """How many encounters there are."""
        return int(self.first.size)

    def to_pandas(self) -> Any:
        """A pandas table with a row for each encounter.

        Returns:
            A data frame with the attributes as columns: kinds as words, missing ids as null.
        """
        import pandas

        columns = {field.name: getattr(self, field.name) for field in fields(self)}
        columns["kind"] = np.array([str(kind) for kind in CONFLICT_KINDS], dtype=object)[self.kind]
        for name in ("passed_first", "priority"):
            ids = columns[name]
            columns[name] = pandas.array(ids, dtype="Int64")
            columns[name][ids < 0] = pandas.NA
        return pandas.DataFrame(columns)


def conflicts(tracks: Tracks, road: Road | None = None, within_s: float = 5.0) -> Conflicts:
    """Every encounter of two road users.

    An encounter lasts while the areas overlap that the two would sweep within ``within_s`` at
    constant velocity. For bodies on the same way it lasts while a collision is that near. It also
    lasts between one's leaving a position and the other's arrival, up to ``within_s``. A body
    follows only the last of those on the same way. Encounters of a pair are one if no more than
    that lies between them. Pedestrians do not meet each other.

    Args:
        tracks: an episode or a recording.
        road: its map with the priorities; None if unknown.
        within_s: how near in time an encounter is, s.

    Returns:
        The encounters.

    Raises:
        InputError: if ``within_s`` is not positive.

    Examples:
        One car crosses 1.1 s behind another one:

        >>> time_s = np.arange(0.0, 6.0, 0.1)
        >>> east = np.stack([10.0 * time_s - 20.0, 0.0 * time_s], axis=1)
        >>> still = np.zeros((2, 60))
        >>> tracks = Tracks.of_dense(
        ...     ids=[3, 8], names=("3", "8"), kind=[0, 0], length=[5.0, 5.0], width=[2.0, 2.0],
        ...     time_s=time_s, xy=[east, (east - [18.0, 0.0])[:, ::-1]],
        ...     heading=still + [[0.0], [np.pi / 2]], speed=still + 10.0, valid=still == 0.0,
        ...     signals=np.zeros((0, 60)))
        >>> found = conflicts(tracks)
        >>> CONFLICT_KINDS[found.kind[0]].value, found.pet_s.round(2), found.passed_first
        ('crossing', array([1.1]), array([3]))
    """
    if not within_s > 0.0:
        raise InputError(f"within_s: found {within_s}, expected a positive number of seconds")
    driven = Driven.of(tracks)
    places, ahead = shared_places(driven, within_s), areas_ahead(driven, within_s)
    agents, begin, end, of_place = _encounters(driven, tracks.time_s, places, ahead, within_s)
    k = begin.size
    number, rows = _moments(tracks, agents, begin, end)
    one, other = (Bodies(*(each[r] for each in driven.bodies)) for r in rows)
    found = pair_measures(one, other)
    until_s = np.where(np.isfinite(found.ttc_s), found.ttc_s, 0.0)
    holds = np.ones(number.size, bool)  # whether both stay on their straight paths until they meet
    for bodies, row in ((one, rows[0]), (other, rows[1])):
        holds &= np.abs(bodies.speed * driven.turning[row]) * until_s**2 <= bodies.width
    ttc = np.where(holds, found.ttc_s, np.inf)
    mttc = np.where(holds & ~np.isnan(found.mttc_s), found.mttc_s, np.inf)
    drac = np.where(holds & (found.gap_m > 0.0), found.drac_mps2, 0.0)
    outlines = driven.outlines(driven.bodies.heading)
    velocity = driven.bodies.speed[:, None] * outlines.forward
    approach = np.hypot(*(velocity[rows[0]] - velocity[rows[1]]).T)
    at_ttc, at_gap = _least(ttc, number, k), _least(found.gap_m, number, k)
    at_pet = _least(places.gap_s, of_place, k)
    ttc_s, pet_s = _taken(ttc, at_ttc, np.inf), _taken(places.gap_s, at_pet, np.nan)
    moment = np.where(ttc_s < np.inf, at_ttc, at_gap)
    nearest = np.stack([_taken(each, moment, 0) for each in rows])

    kind, aside = _kinds(driven, outlines, places, of_place, at_pet, nearest)
    kind[(tracks.kind == PEDESTRIAN)[agents].any(axis=0)] = WALKING
    touch = np.flatnonzero(found.gap_m == 0.0)
    depth = -separation(outlines.rows(rows[0, touch]), outlines.rows(rows[1, touch]))
    contact = np.bincount(number[touch[depth > GRAZE_M]], minlength=k) > 0
    begin_s, end_s = tracks.time_s[begin], tracks.time_s[end]
    for event in tracks.events:  # encounters of a pair are more than ``within_s`` apart
        if event.kind is EventKind.COLLISION and event.other is not None:
            pair = np.sort([event.agent, event.other])[:, None]
            soon = (begin_s - within_s <= event.time_s) & (event.time_s <= end_s + within_s)
            contact |= (tracks.ids[agents] == pair).all(axis=0) & soon
    aside_s = np.where(aside & (kind != FOLLOWING)[of_place], places.gap_s, np.inf)
    aside_s = np.maximum(aside_s, np.finfo(float).tiny)  # a graze is not a contact
    close = np.bincount(number[is_near_miss(ttc, approach)], minlength=k)
    close += np.bincount(of_place[is_near_miss(np.inf, 0.0, aside_s)], minlength=k)
    mass = np.array([MASS_KG[each] for each in KINDS])[tracks.kind[agents]]
    passed = _taken(places.earlier, at_pet, -1), _taken(places.later, at_pet, -1)
    priority = np.full(k, -1)
    if road is not None:
        decided = np.flatnonzero(np.isin(kind, DECIDED))
        at = np.where(at_pet < 0, nearest, passed)[:, decided]
        priority[decided] = priorities(driven, tracks, road, *at)
    first_id = np.append(tracks.ids[driven.index.agent], -1)[np.where(pet_s > 0.0, passed[0], -1)]
    return Conflicts(
        first=tracks.ids[agents[0]],
        second=tracks.ids[agents[1]],
        kind=kind,
        begin_s=begin_s,
        end_s=end_s,
        ttc_s=ttc_s,
        ttc_time_s=np.where(ttc_s < np.inf, _taken(driven.time_s[rows[0]], at_ttc, np.nan), np.nan),
        mttc_s=_taken(mttc, _least(mttc, number, k), np.inf),
        drac_mps2=_taken(drac, _least(-drac, number, k), 0.0),
        pet_s=pet_s,
        pet_time_s=_taken(places.time_s, at_pet, np.nan),
        gap_m=_taken(found.gap_m, at_gap, np.nan),
        closing_mps=_taken(found.closing_mps, at_gap, np.nan),
        delta_v_mps=_taken(approach, moment, np.nan) * mass.max(axis=0) / mass.sum(axis=0),
        passed_first=first_id,
        priority=priority,
        near_miss=(close > 0) & ~contact,
    )


def _encounters(
    driven: Driven, time_s: FloatArray, places: Shared, ahead: IntArray, within_s: float
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """(2, k) agents, (k,) first and last step, and the encounter of each shared place."""
    agent, step = driven.index.agent, driven.index.step
    ends = np.concatenate([np.stack([places.earlier, places.later]), ahead.T], axis=1)
    low, high = np.sort(agent[ends], axis=0)
    begin, end = np.sort(step[ends], axis=0)
    order = np.lexsort((begin, high, low))
    low, high, begin, end = low[order], high[order], begin[order], end[order]
    another = np.ones(order.size, dtype=bool)
    another[1:] = (np.diff(low) != 0) | (np.diff(high) != 0)
    rank = np.cumsum(another) * time_s.size
    latest = np.maximum.accumulate(rank + end) - rank  # of this pair up to here
    another[1:] |= time_s[begin[1:]] - time_s[latest[:-1]] > within_s
    first = np.flatnonzero(another)
    last = np.append(first[1:], order.size)[: first.size] - 1
    sequence = np.lexsort((high[first], low[first], begin[first]))
    number = np.empty(order.size, np.int64)
    number[order] = np.argsort(sequence)[np.cumsum(another) - 1]
    first, last = first[sequence], last[sequence]
    agents = np.stack([low[first], high[first]])
    return agents, begin[first], latest[last], number[: places.later.size]


def _moments(
    tracks: Tracks, agents: IntArray, begin: IntArray, end: IntArray
) -> tuple[IntArray, IntArray]:
    """(n,) encounters and (2, n) rows of all moments at which both of a pair are seen."""
    count = end - begin + 1
    number = np.repeat(np.arange(count.size), count)
    step = np.arange(number.size) - np.repeat(np.cumsum(count) - count - begin, count)
    rows, there = zip(*(tracks.index.find(each[number], step) for each in agents), strict=True)
    both = there[0] & there[1]
    return number[both], np.stack(rows)[:, both]


def _kinds(
    driven: Driven,
    outlines: Outlines,
    places: Shared,
    of_place: IntArray,
    at_pet: IntArray,
    nearest: IntArray,
) -> tuple[CodeArray, BoolArray]:
    """(k,) the kinds, as `ConflictKind` says, and to which shared places one comes from aside."""
    k = at_pet.size
    turn = np.abs(wrapped(*np.diff(driven.piece_heading[[places.earlier, places.later]], axis=0)))
    aside, _, wide, _ = _beside(outlines, places.earlier, places.later)
    enters = (turn > SAME_WAY_RAD) | (aside > wide / 2.0)
    at_first = _least(places.time_s, of_place, k)
    at_last = _least(-places.time_s, of_place, k)
    in_the_end = _taken(turn, at_last, np.inf) < SAME_WAY_RAD
    behind = np.where(_taken(enters, at_first, False), MERGING, FOLLOWING)

    facing = np.abs(wrapped(*np.diff(driven.bodies.heading[nearest], axis=0)))
    aside, along, wide, long = _beside(outlines, *nearest)
    predicted = np.where(aside < wide, FOLLOWING, np.where(along < long, SIDE, MERGING))
    angle = np.where(at_pet < 0, facing, _taken(turn, at_pet, 0.0))
    kind = np.where(angle > ONCOMING_RAD, ONCOMING, CROSSING)
    same_way = (angle < SAME_WAY_RAD) | in_the_end
    kind = np.where(same_way, np.where(at_pet < 0, predicted, behind), kind)
    return kind.astype(np.int8), enters


def _beside(outlines: Outlines, rows: IntArray, others: IntArray) -> tuple[FloatArray, ...]:
    """How far others are beside and ahead of or behind bodies, and how far if they touched, m."""
    dx, dy = (outlines.centre[others] - outlines.centre[rows]).T
    cosine, sine = outlines.forward[rows].T
    long, wide = (outlines.half[rows] + outlines.half[others]).T
    return np.abs(dy * cosine - dx * sine), np.abs(dx * cosine + dy * sine), wide, long


def _least(values: FloatArray, number: IntArray, k: int) -> IntArray:
    """(k,) index of the first least value with each number; -1 where there is none."""
    least = np.full(k, np.inf)
    np.minimum.at(least, number, values)
    hits = np.flatnonzero(values == least[number])[::-1]
    found = np.full(k, -1, dtype=np.int64)
    found[number[hits]] = hits
    return found


def _taken(values: NDArray[Any], at: IntArray, empty: Any) -> NDArray[Any]:
    """Values at some indices; ``empty`` at index -1."""
    return np.append(values, np.asarray(empty, values.dtype))[at]
