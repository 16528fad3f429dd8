"""Collisions, and which party caused each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from behaviors.traits import DetectorInputs, cutting_in
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

    Yields:
        Both agents, the smaller first, and the time, as indices.
    """
    index, far_m = tracks.index, float(np.hypot(tracks.length, tracks.width).max(initial=0.0))
    step, walking = index.step, tracks.walking
    length, width = tracks.length[index.agent], tracks.width[index.agent]
    for rows, _, _ in index.time_blocks():
        # rows of different times are too far apart to meet
        apart = 2.0 * far_m * (step[rows] - step[rows[:1]])
        tree = cKDTree(
            np.column_stack([tracks.row_xy[rows], apart]), balanced_tree=False, compact_nodes=False
        )
        pairs = rows[np.sort(tree.query_pairs(far_m, output_type="ndarray"), axis=1)]
        pairs = pairs[~walking[pairs].all(axis=1)]
        first, second = (
            Outlines.of(tracks.row_xy[r], tracks.row_heading[r], length[r], width[r])
            for r in pairs.T
        )
        for one, two in pairs[separation(first, second) < -GRAZE_M].tolist():
            yield int(index.agent[one]), int(index.agent[two]), int(step[one])


def collisions(
    tracks: Tracks,
    road: Road,
    observed: Observables,
    inputs: DetectorInputs,
    events: Sequence[Event],
    *,
    recorded: bool,
) -> list[Event]:
    """The collisions of an episode or recording, with their causes; ``events`` are rules broken.

    A pair collides by the engine's word or by its outlines, but recorded outlines are too inexact.
    A pedestrian counts as hit only if the engine reports it, because a turning vehicle's outline
    sweeps over the kerb where pedestrians wait.
    """
    reported: dict[tuple[int, int], tuple[int, int]] = {}
    touching: dict[tuple[int, int], set[int]] = {}
    for event in tracks.events:
        if event.kind in (EventKind.COLLISION, EventKind.CONTACT) and event.other is not None:
            pair = (min(event.agent, event.other), max(event.agent, event.other))
            reported.setdefault(pair, (event.agent, event.other))
            column = int(np.searchsorted(tracks.time_s, event.time_s - 1e-6))
            touching.setdefault(pair, set()).add(min(column, tracks.time_s.size - 1))
    for one, two, column in () if recorded else contacts(tracks):
        pair = (int(tracks.ids[one]), int(tracks.ids[two]))
        if pair in reported or PEDESTRIAN not in (tracks.kind[one], tracks.kind[two]):
            touching.setdefault(pair, set()).add(column)
    cuts = [
        (int(tracks.ids[cut.agent]), int(tracks.ids[cut.other]), cut)
        for cut in reversed(cutting_in(inputs) if touching else [])
    ]
    found = []
    for pair, touch in touching.items():
        columns = np.array(sorted(touch))
        anew = np.flatnonzero(np.diff(columns) > round(APART_S / tracks.step_s)) + 1
        for part in np.split(columns, anew):
            time_s, end_s = tracks.time_s[part[[0, -1]]].tolist()
            ids = reported.get(pair, pair)
            parties = [_Party(tracks, road, observed, id, int(part[0])) for id in ids]
            party, rule = _rule_broken(parties, inputs, events, time_s)
            headway_s = None
            if party is None:
                for cutter, victim, cut in cuts:
                    if {cutter, victim} == set(pair) and -0.5 <= time_s - cut.begin_s <= CUT_IN_S:
                        party, rule = parties[ids.index(cutter)], "cut in"
                        headway_s = float(cut.value)
                        break
            if party is None:
                party, rule = _between_vehicles(parties[0], parties[1], road)
            other = ids[0] if party.id == ids[1] else ids[1]
            event = Event(
                EventKind.COLLISION, time_s, party.id, other, rule, end_s,
                cut_in_headway_s=headway_s,
            )  # fmt: skip
            found.append((int(part[0]), ids, event))
    return [event for _, _, event in sorted(found, key=lambda one: one[:2])]


class _Party:
    """One of the two parties of a collision, at the column in which they first touch.

    Attributes:
        id: its id.
        rows: its rows at this time and the one before.
        speed, xy: (column + 1,) m/s, and (column + 1, 2) m; NaN where it was not seen.
        connection: the one that it drives at a junction; -1 if no part of it is inside.
        entered: the column in which its front entered the junction that it is in.
        between_lanes: whether its outline reaches over the marking of the lane that it is on.
    """

    def __init__(
        self, tracks: Tracks, road: Road, observed: Observables, id: int, column: int
    ) -> None:
        index, agent = tracks.index, int(np.searchsorted(tracks.ids, id))

        def until_now(values: FloatArray, empty: float = np.nan) -> FloatArray:
            return index.over(values, agent, 0, column + 1, empty)

        self.id, self.step_s = id, tracks.step_s
        self.is_pedestrian = bool(tracks.kind[agent] == PEDESTRIAN)
        self.rows = index.rows(agent, column - 1, column + 1)
        self.speed, self.xy = until_now(tracks.row_speed), until_now(tracks.row_xy)
        self.heading = float(until_now(tracks.row_heading)[-1])
        now = index.rows(agent, column, column + 1)
        row = now.start if now.stop > now.start else -1  # where it was not seen
        inside = row >= 0 and observed.stop_distance[row] < 0
        soon = column + 1 + (round(RECENT_S / tracks.step_s) if inside else 0)
        links = road.connection_of_lane[observed.lane[index.rows(agent, column, soon)]]
        self.connection = int(next(iter(links[links >= 0]), -1))
        outside = np.flatnonzero(until_now(observed.stop_distance, np.inf) >= 0)
        self.entered = int(outside[-1]) + 1 if outside.size else 0
        length, width = tracks.length[agent], tracks.width[agent]
        lane = road.lanes[observed.lane[row]] if row >= 0 and observed.lane[row] >= 0 else None
        self.between_lanes = False
        if lane is not None and not lane.internal and observed.s[row] >= length / 2 + TURNED_M:
            half = (width + length * abs(float(np.sin(observed.lane_heading[row])))) / 2
            reach = abs(float(observed.offset[row])) + float(half)
            self.between_lanes = reach > lane.width_m / 2 + BETWEEN_LANES_M

    def could_have_stopped(self, other: _Party) -> bool:
        """Whether it ran into the other, which had stood there long enough to be braked for."""
        last = self.speed.size - 1
        if last == 0 or not self.speed[-2] > other.speed[-2]:
            return False
        away = other.xy - other.xy[-1]
        stood = np.isfinite(self.speed) & (np.hypot(away[:, 0], away[:, 1]) < STOOD_M)
        before = np.flatnonzero(~stood)
        braked = (int(before[-1]) + 1 if before.size else 0) + round(REACTION_S / self.step_s)
        if braked >= last:
            return False
        left_m = float(self.speed[braked:-1].sum()) * self.step_s
        return could_stop(float(self.speed[braked]), left_m)


def _rule_broken(
    parties: Sequence[_Party], inputs: DetectorInputs, events: Sequence[Event], time_s: float
) -> tuple[_Party | None, str]:
    """The party that broke a rule that still applied, and which; or nobody.

    In this order: red light, stop sign, direction, where and when to walk, yielding to a
    pedestrian.
    """
    of = {party.id: party for party in parties}
    for kind, rule, recent_s in BROKEN_RULES:
        for event in reversed(events):
            if event.kind is kind and event.agent in of and event.time_s <= time_s + 0.5:
                party = of[event.agent]
                if party.connection >= 0 or time_s - event.time_s <= recent_s:
                    return party, rule
    for party, other in (parties, parties[::-1]):
        if party.is_pedestrian:
            if (inputs.off_crossing | inputs.on_red)[party.rows].any():
                return party, "walked where or when one may not"
            if (other.speed[-1 - round(1.0 / other.step_s) :] < ROLLING_MPS).all():
                return party, "walked into a vehicle that stood"
            return other, "did not yield to a pedestrian"
    return None, ""


def _between_vehicles(one: _Party, two: _Party, road: Road) -> tuple[_Party, str]:
    """The cause that lies in how two vehicles stand to each other: the first that applies."""
    ways = one.connection, two.connection
    meet = min(ways) >= 0 and ways[0] != ways[1]
    if meet and road.first_come(*ways):
        later = two if two.entered > one.entered else one
        return later, "entered a junction not yet clear"
    if one.between_lanes != two.between_lanes:
        return (two if two.between_lanes else one), "was between lanes"
    for party, other in ((one, two), (two, one)):
        if party.could_have_stopped(other):
            return party, "ran into somebody who stood"
    for party, other in ((one, two), (two, one)):
        if meet and other.connection in road.connections[party.connection].yields_to:
            return party, "took another's priority"
    stands, other_stands = (party.speed[-1] < ROLLING_MPS for party in (one, two))
    if stands != other_stands:
        return (two if stands else one), "ran into somebody who stood"
    facing = np.array([np.cos(one.heading), np.sin(one.heading)])
    is_behind = float((two.xy[-1] - one.xy[-1]) @ facing) < 0  # False if one was not seen
    return (two if is_behind else one), "followed too closely"
