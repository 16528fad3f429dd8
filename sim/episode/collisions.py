"""Collisions, and which party caused each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from behaviors.traits import DetectorInputs, ShownTrait, cutting_in
from sim.episode.detector_inputs import detector_inputs
from sim.episode.observables import Observables
from sim.episode.yielding import ROLLING_MPS, could_stop
from sim.frames import PEDESTRIAN, Event, EventKind, FloatArray, Tracks
from sim.geometry import GRAZE_M, Outlines, separation
from sim.road import Road

RECENT_S: Final = 8.0
"""A rule broken at a junction this long before a collision caused it (the time to cross the
junction)."""

BROKEN_RULES: Final = (
    (EventKind.RED_RUN, "ran a red light", RECENT_S),
    (EventKind.STOP_ROLLED, "rolled over a stop line", RECENT_S),
    (EventKind.WRONG_WAY, "drove the wrong way", 2 * RECENT_S),
)
"""Events by which an agent counts as the cause, and for how long, s."""

CUT_IN: Final = "cut in"
"""The cause of a collision after a cut-in."""

CUT_IN_S: Final = 3.0
"""A cut-in causes a collision within this time (the time to restore a headway)."""

TURNED_M: Final = 6.0
"""A vehicle whose rear is within this distance beyond a junction may still be straightening up (a
car's length and more)."""

STOOD_M: Final = 0.5
"""A vehicle that was never farther than this from where it was hit stood there."""

REACTION_S: Final = 1.0
"""Reaction time to a standing vehicle, s (Green 2000, Transportation Human Factors 2(3))."""

APART_S: Final = 3.0
"""Two agents that touch again within this time are still in the same collision."""

BETWEEN_LANES_M: Final = 0.2
"""A vehicle whose outline reaches this far over its lane's marking is between lanes (cars that keep
their lane stay 0.7 m from it)."""


def contacts(tracks: Tracks) -> Iterator[tuple[int, int, int]]:
    """Pairs of agents whose outlines overlap, pedestrians with each other aside.

    An outline is a rectangle of an agent's length and width about its centre, turned by its
    heading.

    Yields:
        Both agents, the smaller first, and the time, as indices.

    Examples:
        >>> xy = np.array([[[0.0, 0.0]] * 3, [[9.0, 0.0], [4.0, 0.0], [9.0, 0.0]]])
        >>> still = np.zeros((2, 3))
        >>> list(contacts(Tracks.of_dense(
        ...     ids=np.arange(2), names=("a", "b"), kind=np.zeros(2), length=np.full(2, 5.0),
        ...     width=np.full(2, 2.0), time_s=np.arange(3.0), xy=xy, heading=still, speed=still,
        ...     valid=np.ones((2, 3)), signals=np.zeros((0, 3)))))
        [(0, 1, 1)]
    """
    index, far_m = tracks.index, float(np.hypot(tracks.length, tracks.width).max(initial=0.0))
    agent, step, walking = index.agent, index.step, tracks.walking
    for rows, _, _ in index.time_blocks():
        # rows of different times are too far apart to meet
        apart = 2.0 * far_m * (step[rows] - step[rows[:1]])
        tree = cKDTree(
            np.column_stack([tracks.row_xy[rows], apart]), balanced_tree=False, compact_nodes=False
        )
        pairs = rows[np.sort(tree.query_pairs(far_m, output_type="ndarray"), axis=1)]
        pairs = pairs[~walking[pairs].all(axis=1)]
        first, second = (
            Outlines.of(
                tracks.row_xy[r],
                tracks.row_heading[r],
                tracks.length[agent[r]],
                tracks.width[agent[r]],
            )
            for r in pairs.T
        )
        for one, two in pairs[separation(first, second) < -GRAZE_M].tolist():
            yield int(agent[one]), int(agent[two]), int(step[one])


def collisions(
    tracks: Tracks,
    road: Road,
    observed: Observables,
    inputs: DetectorInputs | None,
    events: Sequence[Event],
    *,
    recorded: bool,
) -> list[Event]:
    """The collisions of an episode or recording, with their causes.

    A pair collides by the engine's word or by its outlines, but recorded outlines are too inexact.
    A pedestrian counts as hit only if the engine reports it, because a turning vehicle's outline
    sweeps over the kerb where pedestrians wait.

    Args:
        tracks: the trajectories, with the engine's events.
        road: where it happened.
        observed: its observables.
        inputs: what the trait detectors read, if the caller has it.
        events: rules broken, in any order.
        recorded: whether it is a recording.
    """
    reported: dict[tuple[int, int], tuple[int, int]] = {}
    touching: dict[tuple[int, int], set[int]] = {}
    for event in tracks.events:
        if event.kind in (EventKind.COLLISION, EventKind.CONTACT) and event.other is not None:
            pair = (min(event.agent, event.other), max(event.agent, event.other))
            reported.setdefault(pair, (event.agent, event.other))
            touching.setdefault(pair, set()).add(_column(tracks, event.time_s))
    for one, two, column in () if recorded else contacts(tracks):
        pair = (int(tracks.ids[one]), int(tracks.ids[two]))
        if pair in reported or PEDESTRIAN not in (tracks.kind[one], tracks.kind[two]):
            touching.setdefault(pair, set()).add(column)
    if not touching:
        return []
    inputs = detector_inputs(tracks, road, observed) if inputs is None else inputs
    causes, found = _Causes(tracks, road, observed, inputs, events), []
    for pair, touch in touching.items():
        columns = np.array(sorted(touch))
        anew = np.flatnonzero(np.diff(columns) > round(APART_S / tracks.step_s)) + 1
        for part in np.split(columns, anew):
            parties = reported.get(pair, pair)
            event = causes.collision(parties, *tracks.time_s[part[[0, -1]]].tolist())
            found.append((int(part[0]), parties, event))
    return [event for _, _, event in sorted(found, key=lambda one: one[:2])]


def _column(tracks: Tracks, time_s: float) -> int:
    """The column of a time, or the last."""
    return min(int(np.searchsorted(tracks.time_s, time_s - 1e-6)), tracks.time_s.size - 1)


class _Party:
    """One of the two parties of a collision, at the column in which they first touch."""

    def __init__(self, causes: _Causes, id: int, column: int) -> None:
        tracks = causes.tracks
        self.id, self.index = id, int(np.searchsorted(tracks.ids, id))
        seen = tracks.index.rows(self.index, column, column + 1)
        self.row = seen.start if seen.stop > seen.start else -1  # where it was not seen
        self.is_pedestrian = bool(tracks.kind[self.index] == PEDESTRIAN)
        self._tracks, self._road, self._observed = tracks, causes.road, causes.observed
        self._column = column

    def until_now(self, values: FloatArray, empty: float = np.nan) -> FloatArray:
        """(column + 1, ...) its values at each time, ``empty`` where it was not seen."""
        return self._tracks.index.over(values, self.index, 0, self._column + 1, empty)

    @cached_property
    def speed(self) -> FloatArray:
        """(column + 1,) its speed at each time, m/s."""
        return self.until_now(self._tracks.row_speed)

    @cached_property
    def connection(self) -> int:
        """The connection that it drives at a junction; -1 if no part of it is inside."""
        inside = self.row >= 0 and self._observed.stop_distance[self.row] < 0
        soon = round(RECENT_S / self._tracks.step_s) if inside else 0
        rows = self._tracks.index.rows(self.index, self._column, self._column + soon + 1)
        links = self._road.connection_of_lane[self._observed.lane[rows]]
        at = np.flatnonzero(links >= 0)
        return int(links[at[0]]) if at.size else -1

    @property
    def entered(self) -> int:
        """The column in which its front entered the junction that it is in."""
        outside = np.flatnonzero(self.until_now(self._observed.stop_distance, np.inf) >= 0)
        return int(outside[-1]) + 1 if outside.size else 0

    @property
    def between_lanes(self) -> bool:
        """Whether its outline reaches over the marking of the lane that it is on."""
        row, observed = self.row, self._observed
        lane = int(observed.lane[row]) if row >= 0 else -1
        if lane < 0 or self._road.lanes[lane].internal:
            return False
        length, width = self._tracks.length[self.index], self._tracks.width[self.index]
        if observed.s[row] < length / 2 + TURNED_M:
            return False
        half = (width + length * abs(float(np.sin(observed.lane_heading[row])))) / 2
        reach = abs(float(observed.offset[row])) + float(half)
        return reach > self._road.lanes[lane].width_m / 2 + BETWEEN_LANES_M

    def could_have_stopped(self, other: _Party) -> bool:
        """Whether it ran into the other, which had stood there long enough to be braked for."""
        if self._column == 0 or not self.speed[-2] > other.speed[-2]:
            return False
        away = (xy := other.until_now(self._tracks.row_xy)) - xy[-1]
        stood = np.isfinite(self.speed) & (np.hypot(away[:, 0], away[:, 1]) < STOOD_M)
        before = np.flatnonzero(~stood)
        reaction = round(REACTION_S / self._tracks.step_s)
        braked = (int(before[-1]) + 1 if before.size else 0) + reaction
        if braked >= self._column:
            return False
        left_m = float(self.speed[braked:-1].sum()) * self._tracks.step_s
        return could_stop(float(self.speed[braked]), left_m)


@dataclass(frozen=True)
class _Causes:
    """Finds the causes of an episode's collisions; arguments are as of `collisions`."""

    tracks: Tracks
    road: Road
    observed: Observables
    inputs: DetectorInputs
    events: Sequence[Event]

    @cached_property
    def cuts(self) -> list[ShownTrait]:
        """Cut-ins, the latest first."""
        return list(reversed(cutting_in(self.inputs)))

    def collision(self, pair: tuple[int, int], time_s: float, end_s: float) -> Event:
        """A collision of two ids, whose ``agent`` caused it, and whose ``rule`` says why."""
        column = _column(self.tracks, time_s)
        parties, ids = [_Party(self, id, column) for id in pair], self.tracks.ids
        for cut in self.cuts:
            cutter, victim = int(ids[cut.agent]), int(ids[cut.other])
            if {cutter, victim} == set(pair) and -0.5 <= time_s - cut.begin_s <= CUT_IN_S:
                break
        else:
            cut = None
        party, rule = self._cause(parties, time_s, column, cut)
        other = pair[0] if party.id == pair[1] else pair[1]
        headway_s = float(cut.value) if cut is not None and rule == CUT_IN else None
        return Event(
            EventKind.COLLISION, time_s, party.id, other, rule, end_s, cut_in_headway_s=headway_s
        )

    def _cause(
        self, parties: list[_Party], time_s: float, column: int, cut: ShownTrait | None
    ) -> tuple[_Party, str]:
        """The party that caused a collision, and why: the first of the following that applies.

        A party broke a rule that still applied: red light or stop sign, direction, walking,
        yielding to a pedestrian, or cutting in (``cut``). Otherwise `_between_vehicles` decides.
        """
        of = {party.id: party for party in parties}
        for kind, rule, recent_s in BROKEN_RULES:
            for event in reversed(self.events):
                if event.kind is kind and event.agent in of and event.time_s <= time_s + 0.5:
                    party = of[event.agent]
                    if party.connection >= 0 or time_s - event.time_s <= recent_s:
                        return party, rule
        for party, other in (parties, parties[::-1]):
            if party.is_pedestrian:
                rows = self.tracks.index.rows(party.index, column - 1, column + 1)
                if (self.inputs.off_crossing | self.inputs.on_red)[rows].any():
                    return party, "walked where or when one may not"
                if (other.speed[-1 - round(1.0 / self.tracks.step_s) :] < ROLLING_MPS).all():
                    return party, "walked into a vehicle that stood"
                return other, "did not yield to a pedestrian"
        if cut is not None:
            return of[int(self.tracks.ids[cut.agent])], CUT_IN
        return self._between_vehicles(*parties)

    def _between_vehicles(self, one: _Party, two: _Party) -> tuple[_Party, str]:
        """The cause that lies in how two vehicles stand to each other."""
        ways = one.connection, two.connection
        meet = min(ways) >= 0 and ways[0] != ways[1]
        if meet and self.road.first_come(*ways):
            later = two if two.entered > one.entered else one
            return later, "entered a junction not yet clear"
        if one.between_lanes != two.between_lanes:
            return (two if two.between_lanes else one), "was between lanes"
        for party, other in ((one, two), (two, one)):
            if party.could_have_stopped(other):
                return party, "ran into somebody who stood"
        for party, other in ((one, two), (two, one)):
            if meet and other.connection in self.road.connections[party.connection].yields_to:
                return party, "took another's priority"
        stands, other_stands = (party.speed[-1] < ROLLING_MPS for party in (one, two))
        if stands != other_stands:
            return (two if stands else one), "ran into somebody who stood"
        is_behind = False  # as it is where one of the two was not seen
        if one.row >= 0 and two.row >= 0:
            heading, xy = self.tracks.row_heading[one.row], self.tracks.row_xy
            facing = np.array([np.cos(heading), np.sin(heading)])
            is_behind = float((xy[two.row] - xy[one.row]) @ facing) < 0
        return (two if is_behind else one), "followed too closely"
