"""Who collided, and which party caused it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from behaviors.detector_inputs import ShownTrait
from sim.episode.contacts import Contact
from sim.episode.observables import Observables
from sim.episode.rows import TrajectoryRows
from sim.episode.yielding import ROLLING_MPS, could_stop
from sim.frames import PEDESTRIAN, BoolArray, Event, EventKind, FloatArray, IntArray
from sim.road import Road

RECENT_S: Final = 8.0
"""A rule broken at a junction this long before a collision caused it (the time to cross the
junction)."""

CUT_IN_S: Final = 3.0
"""A cut-in causes a collision within this time (the time to restore a headway)."""

TURNED_M: Final = 6.0
"""A vehicle whose rear is no farther than this beyond a junction may still be straightening up (a
car's length and more)."""

STOOD_M: Final = 0.5
"""A vehicle that was never farther than this from where it was hit stood there."""

REACTION_S: Final = 1.0
"""A driver reacts to a standing vehicle after this time (Green 2000, Transportation Human Factors
2(3): 0.7 s when expected, 1.25 s when not)."""

APART_S: Final = 3.0
"""Two agents that touch again within this time are still in the same collision."""

BETWEEN_LANES_M: Final = 0.2
"""A vehicle whose outline reaches this far over its lane's marking is between lanes (cars that keep
their lane stay 0.7 m from it)."""


def collisions(
    steps: TrajectoryRows, touches: Sequence[Contact]
) -> list[tuple[tuple[int, int], IntArray]]:
    """The pairs that collided, and the columns in which they touch.

    A pair touches by the engine's word or by its outlines. Outlines alone do not tell that a
    pedestrian was hit, because a turning vehicle's outline sweeps over the kerb where pedestrians
    wait: only the engine's word counts for them.

    Args:
        steps: an episode or a recording, with the engine's events.
        touches: overlaps of outlines.

    Returns:
        Ids of both parties and (k,) columns, in order of the first column.
    """
    flags: dict[tuple[int, int], BoolArray] = {}
    pairs: dict[tuple[int, int], tuple[int, int]] = {}
    for event in steps.events:
        if event.kind in (EventKind.COLLISION, EventKind.CONTACT) and event.other is not None:
            pair = (min(event.agent, event.other), max(event.agent, event.other))
            pairs.setdefault(pair, (event.agent, event.other))
            at = _column(steps, event.time_s)
            flags.setdefault(pair, np.zeros(steps.time_s.size, dtype=bool))[at] = True
    for contact in touches:
        pair = (int(steps.ids[contact.agents[0]]), int(steps.ids[contact.agents[1]]))
        if pair not in flags and PEDESTRIAN in steps.kind[list(contact.agents)]:
            continue
        flags.setdefault(pair, np.zeros(steps.time_s.size, dtype=bool))
        flags[pair][contact.begin : contact.end] = True
    found = []
    for pair, touch in flags.items():
        columns = np.flatnonzero(touch)
        anew = np.flatnonzero(np.diff(columns) > round(APART_S / steps.step_s)) + 1
        found += [(pairs.get(pair, pair), part) for part in np.split(columns, anew)]
    return sorted(found, key=lambda one: (int(one[1][0]), one[0]))


def _column(steps: TrajectoryRows, time_s: float) -> int:
    """The column of a time, or the last."""
    return min(int(np.searchsorted(steps.time_s, time_s - 1e-6)), steps.time_s.size - 1)


@dataclass(frozen=True, slots=True)
class Crash:
    """A collision and what is needed to find its cause.

    Attributes:
        steps: the episode or recording.
        road: where it happened.
        observed: its observables.
        event: the collision, whose parties stand in any order.
    """

    steps: TrajectoryRows
    road: Road
    observed: Observables
    event: Event

    @property
    def pair(self) -> tuple[int, int]:
        """Ids of the two parties."""
        assert self.event.other is not None
        return self.event.agent, self.event.other

    @property
    def column(self) -> int:
        """The column in which they first touch."""
        return _column(self.steps, self.event.time_s)

    def index(self, agent: int) -> int:
        """Index of an agent, from its id."""
        return int(np.searchsorted(self.steps.ids, agent))

    def row(self, agent: int) -> int:
        """Row of an agent at the time of the collision; -1 where it was not seen."""
        return self.steps.row_index.row(self.index(agent), self.column)

    def speeds(self, agent: int, begin: int, end: int) -> FloatArray:
        """(end - begin,) speeds of an agent, m/s, NaN where it was not seen."""
        return self.steps.row_index.over(self.steps.speed, self.index(agent), begin, end, np.nan)

    def caused_by(self, agent: int, rule: str) -> Event:
        """The collision with its cause."""
        other = self.pair[0] if agent == self.pair[1] else self.pair[1]
        return Event(EventKind.COLLISION, self.event.time_s, agent, other, rule)

    def connection(self, agent: int) -> int | None:
        """The connection that a vehicle drives at a junction; None if no part of it is inside."""
        row, column = self.row(agent), self.column
        inside = row >= 0 and self.observed.stop_distance[row] < 0
        soon = round(RECENT_S / self.steps.step_s) if inside else 0
        rows = self.steps.row_index.rows(self.index(agent), column, column + soon + 1)
        links = self.road.connection_of_lane[self.observed.lane[rows]]
        at = np.flatnonzero(links >= 0)
        return int(links[at[0]]) if at.size else None

    def entered(self, agent: int) -> int:
        """The column in which a vehicle's front entered the junction that the vehicle is in."""
        distance = self.observed.stop_distance
        row_index = self.steps.row_index
        inside = row_index.over(distance, self.index(agent), 0, self.column + 1, np.inf) < 0
        outside = np.flatnonzero(~inside)
        return int(outside[-1]) + 1 if outside.size else 0

    def between_lanes(self, agent: int) -> bool:
        """Whether a vehicle's outline reaches over the marking of the lane that it is on."""
        row = self.row(agent)
        lane = int(self.observed.lane[row]) if row >= 0 else -1
        if lane < 0 or self.road.lanes[lane].internal:
            return False
        index = self.index(agent)
        length, width = self.steps.length[index], self.steps.width[index]
        if self.observed.s[row] < length / 2 + TURNED_M:
            return False
        half = (width + length * abs(float(np.sin(self.observed.lane_heading[row])))) / 2
        reach = abs(float(self.observed.offset[row])) + float(half)
        return reach > self.road.lanes[lane].width_m / 2 + BETWEEN_LANES_M

    def could_have_stopped(self, agent: int, other: int) -> bool:
        """Whether an agent ran into another that had stood there long enough to be braked for."""
        column = self.column
        speed = self.speeds(agent, 0, column + 1)
        if column == 0 or not speed[-2] > self.speeds(other, column - 1, column)[0]:
            return False
        row_index = self.steps.row_index
        xy = row_index.over(self.steps.xy, self.index(other), 0, column + 1, np.nan)
        away = xy - xy[-1]
        there = np.isfinite(speed) & (np.hypot(away[:, 0], away[:, 1]) < STOOD_M)
        before = np.flatnonzero(~there)
        reaction = round(REACTION_S / self.steps.step_s)
        braked = (int(before[-1]) + 1 if before.size else 0) + reaction
        if braked >= column:
            return False
        left_m = float(speed[braked:column].sum()) * self.steps.step_s
        return could_stop(float(speed[braked]), left_m)


def cause(
    crash: Crash, events: Sequence[Event], cuts: Sequence[ShownTrait], forbidden: BoolArray
) -> Event:
    """The collision with its cause.

    The first of these that applies: a party ran a red light or a stop sign and has not left the
    junction; drove the wrong way; walked where pedestrians may not, or into a standing vehicle; did
    not yield to a pedestrian; cut in just before. Then the causes that lie in how two vehicles
    stand to each other (`_between_vehicles`).

    Args:
        crash: the collision.
        events: what was found before, in any order.
        cuts: the cut-ins of the episode.
        forbidden: (m,) where pedestrians walk though they may not.

    Returns:
        The collision; ``agent`` caused it, ``rule`` says why.
    """
    pair, time_s, steps = crash.pair, crash.event.time_s, crash.steps
    for kind, rule, recent_s in (
        (EventKind.RED_RUN, "ran a red light", RECENT_S),
        (EventKind.STOP_ROLLED, "rolled over a stop line", RECENT_S),
        (EventKind.WRONG_WAY, "drove the wrong way", 2 * RECENT_S),
    ):
        for event in reversed(events):
            if event.kind is not kind or event.agent not in pair or event.time_s > time_s + 0.5:
                continue
            if crash.connection(event.agent) is not None or time_s - event.time_s <= recent_s:
                return crash.caused_by(event.agent, rule)
    column = crash.column
    for agent, other in (pair, pair[::-1]):
        index = crash.index(agent)
        if steps.kind[index] == PEDESTRIAN:
            if forbidden[steps.row_index.rows(index, column - 1, column + 1)].any():
                return crash.caused_by(agent, "walked where or when one may not")
            second = max(column - round(1.0 / steps.step_s), 0), column + 1
            if (crash.speeds(other, *second) < ROLLING_MPS).all():
                return crash.caused_by(agent, "walked into a vehicle that stood")
            return crash.caused_by(other, "did not yield to a pedestrian")
    for cut in reversed(cuts):
        cutter, victim = int(steps.ids[cut.agent]), int(steps.ids[cut.other])
        if {cutter, victim} == set(pair) and -0.5 <= time_s - cut.begin_s <= CUT_IN_S:
            collision = crash.caused_by(cutter, "cut in")
            return dataclasses.replace(collision, cut_in_headway_s=float(cut.value))
    return _between_vehicles(crash)


def _between_vehicles(crash: Crash) -> Event:
    """The cause that lies in how two vehicles stand to each other.

    The first of these that applies: a party entered a junction that the other was still clearing
    (where signals never let both go, or each yields to the other); was between lanes (who changes
    lanes answers for it: German road traffic act, section 7(5)); ran into a standing vehicle though
    there was room to stop; took the other's priority; ran into a standing vehicle. Otherwise the
    follower caused it.
    """
    pair, column, steps = crash.pair, crash.column, crash.steps
    links = {agent: crash.connection(agent) for agent in pair}
    one, two = (links[agent] for agent in pair)
    if one is not None and two is not None and one != two and crash.road.first_come(one, two):
        entered = [crash.entered(agent) for agent in pair]
        later = pair[int(entered[1] > entered[0])]
        return crash.caused_by(later, "entered a junction not yet clear")
    outside = [crash.between_lanes(agent) for agent in pair]
    if outside[0] != outside[1]:
        return crash.caused_by(pair[int(outside[1])], "was between lanes")
    for agent, other in (pair, pair[::-1]):
        if crash.could_have_stopped(agent, other):
            return crash.caused_by(agent, "ran into somebody who stood")
    for agent, other in (pair, pair[::-1]):
        mine, theirs = links[agent], links[other]
        if mine is None or theirs is None or mine == theirs:
            continue
        if theirs in crash.road.connections[mine].yields_to:
            return crash.caused_by(agent, "took another's priority")
    standing = [crash.speeds(agent, column, column + 1)[0] < ROLLING_MPS for agent in pair]
    if standing[0] != standing[1]:
        return crash.caused_by(pair[int(standing[0])], "ran into somebody who stood")
    a, b = (crash.row(agent) for agent in pair)
    behind = False  # as it is where one of the two was not seen
    if a >= 0 and b >= 0:
        facing = np.array([np.cos(steps.heading[a]), np.sin(steps.heading[a])])
        behind = float((steps.xy[b] - steps.xy[a]) @ facing) < 0
    return crash.caused_by(pair[int(behind)], "followed too closely")
