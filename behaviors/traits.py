"""Detectors of the traits in the paper's trait table, on plain arrays.

Every detector looks only at what was seen (positions, speeds, lanes, gaps), never at a profile, so
it works on simulated and on recorded traffic alike. It returns when who showed the trait and the
number behind it. Thresholds stand at the top, each with its source.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import Trait
from behaviors.row_index import RowIndex

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]

OVER_LIMIT: Final = 1.10
"""Over-speeding: above the limit by this factor; the usual tolerance of enforcement (National
Police Chiefs' Council 2013: 10 % and 2 mph)."""

TAILGATING_HEADWAY_S: Final = 1.0
"""Tailgating: closer than drivers find comfortable, 0.98 s (Taieb-Maimon and Shinar 2001)."""

CLOSE_HEADWAY_S: Final = 0.66
"""Driving extremely close: closer than drivers find the least safe (the same source)."""

FOLLOWING_MPS: Final = 5.0
"""Headways mean something above this speed (our choice)."""

CUT_IN_HEADWAY_S: Final = 1.0
"""Cutting in: the new follower is left less than this when the box touches the lane (Vogel 2003
calls headways under 1 s dangerous)."""

WEAVING_CHANGES, WEAVING_S = 2, 20.0
"""Weaving: so many lane changes within so long (our choice)."""

OVERTAKING_S: Final = 20.0
"""Overtaking: the former leader is behind within this after the lane change (our choice)."""

UNIFORM_S, UNIFORM_VARIATION = 15.0, 0.05
"""Uniform speed: for so long the speed varies by less than this share of its mean (our choice)."""

KEEPING_S: Final = 30.0
"""Maintaining neighbours: the same lane and the same leader for so long (our choice)."""

STANDING_MPS: Final = 0.3
"""Below this a vehicle stands (our choice: the noise of differenced positions)."""

NOT_MOVING_S: Final = 2.0
"""Not moving: standing so long without a reason (our choice)."""

SLOWING_SHARE, SLOWING_S = 0.6, 4.0
"""Slowing down: to this share of the own speed within so long, without a reason (our choice)."""

REASON_GAP_S, REASON_GAP_M = 4.0, 15.0
"""A leader is a reason to slow within this headway or gap (our choice: farther ones do not bind
even those who keep 3 s)."""

REASON_JUNCTION_M, REASON_STOP_M = 40.0, 60.0
"""Any junction within the first, and one where one must stop or a crossing in use within the
second, is a reason to slow (our choice)."""

WAITING_S: Final = 3.0
"""Waiting: standing so long before a free way on, for others who go first (our choice)."""

CROSSING_S: Final = 15.0
"""A junction is crossed within this, standing in it included (our choice)."""

WRONG_WAY_S: Final = 1.0
"""Wrong direction: facing against the lane for so long (our choice)."""

JAYWALKING_S: Final = 1.0
"""Jaywalking: on the carriageway, off any crossing, for so long (our choice)."""


@dataclass(frozen=True, slots=True)
class Exhibit:
    """A trait that somebody showed.

    Attributes:
        trait: which.
        agent: row of who showed it.
        begin_s: from when, s.
        end_s: until when, s.
        value: the number behind it; its meaning and unit are the detector's.
        other: row of the second party, -1 if none.
    """

    trait: Trait
    agent: int
    begin_s: float
    end_s: float
    value: float
    other: int = -1


@dataclass(frozen=True, slots=True)
class RuleEncounter:
    """A rule that somebody met and kept or broke.

    Attributes:
        agent: row of who met it.
        time_s: when, s.
        kept: whether it was kept.
    """

    agent: int
    time_s: float
    kept: bool


@dataclass(frozen=True, slots=True)
class Seen:
    """What was seen of N agents, one row per agent and time (`RowIndex`).

    Distances are +inf and rows -1 where nothing is.

    Attributes:
        row_index: the m rows: which agent, when.
        time_s: (T,) s, evenly spaced.
        drives: (N,) whether it is a vehicle.
        length: (N,) m.
        width: (N,) m.
        speed: (m,) m/s.
        limit: (m,) speed limit, m/s; +inf where unknown.
        edge: (m,) number of the stretch of road.
        lane: (m,) number of the lane.
        offset: (m,) signed distance to the left of the lane's centre line, m.
        lane_width: (m,) m.
        lane_heading: (m,) heading relative to the lane's, rad.
        leader: (m,) row of the vehicle ahead at that time.
        follower: (m,) row of the vehicle behind at that time.
        gap: (m,) bumper to bumper to the leader, m.
        closing: (m,) own speed minus the leader's, m/s.
        stop_distance: (m,) front bumper to the next junction, m; negative inside one.
        stop_ahead: (m,) whether a red signal, a stop sign or a lack of priority holds there.
        crossing_distance: (m,) front bumper to the next crossing, m.
        crossing_used: (m,) whether somebody is on that crossing or about to be.
        off_crossing: (m,) whether a pedestrian is on the carriageway, off any crossing.
        on_red: (m,) whether a pedestrian is on a crossing entered on red.
        encounters: rules met, kept or broken.
    """

    row_index: RowIndex
    time_s: FloatArray
    drives: BoolArray
    length: FloatArray
    width: FloatArray
    speed: FloatArray
    limit: FloatArray
    edge: IntArray
    lane: IntArray
    offset: FloatArray
    lane_width: FloatArray
    lane_heading: FloatArray
    leader: IntArray
    follower: IntArray
    gap: FloatArray
    closing: FloatArray
    stop_distance: FloatArray
    stop_ahead: BoolArray
    crossing_distance: FloatArray
    crossing_used: BoolArray
    off_crossing: BoolArray
    on_red: BoolArray
    encounters: tuple[RuleEncounter, ...] = ()

    @property
    def step_s(self) -> float:
        """Time between two columns, s."""
        return float(self.time_s[-1] - self.time_s[0]) / (self.time_s.size - 1)

    @property
    def headway(self) -> FloatArray:
        """(m,) gap over own speed, s; +inf without leader or below ``FOLLOWING_MPS``."""
        headway = np.full(self.gap.shape, np.inf)
        np.divide(self.gap, self.speed, out=headway, where=self.speed > FOLLOWING_MPS)
        return headway

    @property
    def driving(self) -> BoolArray:
        """(m,) whether the agent is a vehicle."""
        return self.drives[self.row_index.agent]

    def when(self, row: int) -> float:
        """The time of a row, s."""
        return float(self.time_s[self.row_index.step[row]])


def lane_changes(seen: Seen) -> IntArray:
    """Who changed lanes and when.

    Returns:
        (k,) rows in which a centre was first on the new lane. Going from one stretch of road to
        the next is no lane change.
    """
    rows = np.flatnonzero(seen.lane[1:] != seen.lane[:-1]) + 1
    changed = (seen.edge[rows - 1] == seen.edge[rows]) & ~seen.row_index.begins[rows]
    changed &= (seen.lane[rows - 1] >= 0) & (seen.lane[rows] >= 0) & seen.driving[rows]
    return np.asarray(rows[changed], dtype=np.int64)


def _exhibits(
    seen: Seen,
    trait: Trait,
    flags: BoolArray,
    shortest_s: float,
    value: Callable[[slice], float],
) -> list[Exhibit]:
    """One exhibit for every long enough stretch of ``flags``; its value is that of its rows."""
    shortest = max(1, round(shortest_s / seen.step_s))
    return [
        Exhibit(
            trait=trait,
            agent=int(seen.row_index.agent[run.start]),
            begin_s=seen.when(run.start),
            end_s=seen.when(run.stop - 1),
            value=value(run),
        )
        for run in seen.row_index.runs(flags, shortest)
    ]


def over_speeding(seen: Seen) -> list[Exhibit]:
    """Faster than the limit allows for 3 s; the value is the largest speed over the limit."""
    flags = seen.driving & (seen.speed > OVER_LIMIT * seen.limit)
    return _exhibits(
        seen, Trait.OVER_SPEEDING, flags, 3.0,
        lambda at: float(np.max(seen.speed[at] / seen.limit[at])),
    )  # fmt: skip


def tailgating(seen: Seen) -> list[Exhibit]:
    """Following at a headway that is too short, for 3 s; the value is the median headway, s."""
    headway = seen.headway
    flags = (headway < TAILGATING_HEADWAY_S) & (headway >= CLOSE_HEADWAY_S)
    return _exhibits(seen, Trait.TAILGATING, flags, 3.0, lambda at: float(np.median(headway[at])))


def driving_close(seen: Seen) -> list[Exhibit]:
    """Following extremely close for 2 s; the value is the median headway, s."""
    headway = seen.headway
    return _exhibits(
        seen, Trait.DRIVING_CLOSE, headway < CLOSE_HEADWAY_S, 2.0,
        lambda at: float(np.median(headway[at])),
    )  # fmt: skip


def weaving(seen: Seen) -> list[Exhibit]:
    """Several lane changes in a short time; the value is how many."""
    rows = lane_changes(seen)
    who, when_s = seen.row_index.agent[rows], seen.time_s[seen.row_index.step[rows]]
    found = []
    for agent in np.unique(who):
        times = when_s[who == agent]
        first = 0
        while first < times.size:
            last = first
            while last + 1 < times.size and times[last + 1] - times[last] <= WEAVING_S:
                last += 1
            count = last - first + 1
            if count >= WEAVING_CHANGES:
                found.append(
                    Exhibit(
                        Trait.WEAVING, int(agent), float(times[first]), float(times[last]), count
                    )
                )
            first = last + 1
    return found


def overtaking(seen: Seen) -> list[Exhibit]:
    """Leaving a lane and passing the former leader; the value is the speed difference, m/s.

    The distance passed is the former gap made up by the difference of the speeds, so it needs no
    common coordinate along the road.
    """
    row_index, speed = seen.row_index, seen.speed
    ahead = round(OVERTAKING_S / seen.step_s)
    found = []
    for row in lane_changes(seen).tolist():
        leader = int(seen.leader[row - 1])
        if leader < 0:
            continue
        agent, other = int(row_index.agent[row]), int(row_index.agent[leader])
        begin = int(row_index.step[row])
        end = min(begin + ahead, seen.time_s.size)
        faster = row_index.over(speed, agent, begin, end, np.nan) - row_index.over(
            speed, other, begin, end, np.nan
        )
        both = np.isfinite(faster)
        faster = np.where(both, faster, 0.0)
        to_pass = seen.gap[row - 1] + seen.length[agent] + seen.length[other]
        passed = np.flatnonzero((np.cumsum(faster) * seen.step_s > to_pass) & both)
        if passed.size:
            found.append(
                Exhibit(
                    trait=Trait.OVERTAKING,
                    agent=agent,
                    begin_s=float(seen.time_s[begin]),
                    end_s=float(seen.time_s[begin + int(passed[0])]),
                    value=float(faster[: passed[0] + 1].mean()),
                    other=other,
                )
            )
    return found


def cutting_in(seen: Seen) -> list[Exhibit]:
    """Entering a lane close in front of somebody; the value is the headway left to them, s.

    The headway is the new follower's when the box of the one who changes first touches the new
    lane: from then on others must react (UN Regulation 157 sets its reference point there too).
    """
    begins, agent = seen.row_index.begins, seen.row_index.agent
    found = []
    for row in lane_changes(seen).tolist():
        follower = int(seen.follower[row])
        if follower < 0 or begins[follower]:
            continue
        back = 1  # how many times ago the box touched the new lane
        reach = seen.lane_width[row - 1] / 2 - seen.width[agent[row]] / 2
        while (
            not begins[row - back]
            and seen.lane[row - back - 1] == seen.lane[row - 1]
            and abs(seen.offset[row - back - 1]) >= reach
            and not begins[follower - back]
        ):
            back += 1
        mine, theirs = slice(row - back, row), slice(follower - back, follower)
        gained = float(np.sum(seen.speed[mine] - seen.speed[theirs])) * seen.step_s
        gap = float(seen.gap[follower]) - gained
        speed = float(seen.speed[follower - back])
        if speed > FOLLOWING_MPS and gap / speed < CUT_IN_HEADWAY_S:
            found.append(
                Exhibit(
                    trait=Trait.CUTTING_IN,
                    agent=int(agent[row]),
                    begin_s=seen.when(row - back),
                    end_s=seen.when(row),
                    value=max(gap, 0.0) / speed,
                    other=int(agent[follower]),
                )
            )
    return found


def wrong_direction(seen: Seen) -> list[Exhibit]:
    """Driving against the lane's direction; the value is the distance driven so, m."""
    flags = seen.driving & (seen.lane >= 0) & (np.abs(seen.lane_heading) > np.pi / 2)
    flags &= seen.speed > STANDING_MPS
    return _exhibits(
        seen, Trait.WRONG_DIRECTION, flags, WRONG_WAY_S,
        lambda at: float(seen.speed[at].sum()) * seen.step_s,
    )  # fmt: skip


def jaywalking(seen: Seen) -> list[Exhibit]:
    """Walking on the road where or when one may not; the value is for how long, s."""
    flags = ~seen.driving & (seen.off_crossing | seen.on_red)
    return _exhibits(seen, Trait.JAYWALKING, flags, JAYWALKING_S, _how_long(seen))


def _how_long(seen: Seen) -> Callable[[slice], float]:
    """The value of a stretch that is its length, s."""
    step_s = seen.step_s
    return lambda at: (at.stop - at.start) * step_s


def breaking_rules(seen: Seen) -> list[Exhibit]:
    """A red light, a stop line or somebody's priority disregarded; the value is 1."""
    return [
        Exhibit(Trait.BREAKING_RULES, e.agent, e.time_s, e.time_s, 1.0)
        for e in seen.encounters
        if not e.kept
    ]


def following_rules(seen: Seen) -> list[Exhibit]:
    """Every rule met was kept, the limit included; the value is how many rules were met."""
    fast = seen.speed > OVER_LIMIT * seen.limit
    found = []
    for agent in sorted({e.agent for e in seen.encounters}):
        met = [e for e in seen.encounters if e.agent == agent]
        if all(e.kept for e in met) and not fast[seen.row_index.rows(agent)].any():
            times = [e.time_s for e in met]
            found.append(
                Exhibit(Trait.FOLLOWING_RULES, agent, min(times), max(times), float(len(met)))
            )
    return found


def keeping_neighbors(seen: Seen) -> list[Exhibit]:
    """Staying on the lane behind the same leader; the value is for how long, s."""
    lead, row_index = seen.leader, seen.row_index
    follows = (lead >= 0) & (seen.gap < 4.0 * np.maximum(seen.speed, 5.0))
    whom = np.where(lead >= 0, row_index.agent[lead], -1)
    same = follows & ~row_index.begins
    same[1:] &= whom[1:] == whom[:-1]
    same[lane_changes(seen)] = False
    return _exhibits(seen, Trait.KEEPING_NEIGHBORS, same, KEEPING_S, _how_long(seen))


def uniform_speed(seen: Seen) -> list[Exhibit]:
    """Driving at an even speed; the value is the coefficient of variation."""
    row_index, steps = seen.row_index, round(UNIFORM_S / seen.step_s)
    at = np.flatnonzero(seen.driving)
    if at.size < steps:
        return []
    speed = seen.speed[at]
    total = np.concatenate([[0.0], np.cumsum(speed)])
    square = np.concatenate([[0.0], np.cumsum(speed**2)])
    mean = (total[steps:] - total[:-steps]) / steps
    variance = np.maximum((square[steps:] - square[:-steps]) / steps - mean**2, 0.0)
    first, last = at[: at.size - steps + 1], at[steps - 1 :]
    whole = (row_index.step[last] - row_index.step[first] == steps - 1) & (
        row_index.agent[first] == row_index.agent[last]
    )
    steady = whole & (mean > FOLLOWING_MPS) & (np.sqrt(variance) < UNIFORM_VARIATION * mean)
    even = np.zeros(seen.speed.size, dtype=bool)
    even[first[steady]] = True
    found = []
    for run in row_index.runs(even):
        values = seen.speed[run.start : run.stop - 1 + steps]
        found.append(
            Exhibit(
                trait=Trait.UNIFORM_SPEED,
                agent=int(row_index.agent[run.start]),
                begin_s=seen.when(run.start),
                end_s=seen.when(run.stop - 2 + steps),
                value=float(values.std() / values.mean()),
            )
        )
    return found


def _no_reason(seen: Seen) -> BoolArray:
    """(m,) whether nothing ahead explains slowing down or standing."""
    near = (seen.gap < REASON_GAP_M) | (seen.gap < REASON_GAP_S * seen.speed)
    junction = (seen.stop_distance < REASON_STOP_M) & seen.stop_ahead
    junction |= seen.stop_distance < REASON_JUNCTION_M
    crossing = (seen.crossing_distance < REASON_STOP_M) & seen.crossing_used
    wrong_side = np.abs(seen.lane_heading) > np.pi / 2  # somebody comes the other way
    return seen.driving & ~(near | junction | crossing | wrong_side)


def not_moving(seen: Seen) -> list[Exhibit]:
    """Standing without a reason; the value is for how long, s."""
    flags = _no_reason(seen) & (seen.speed < STANDING_MPS)
    return _exhibits(seen, Trait.NOT_MOVING, flags, NOT_MOVING_S, _how_long(seen))


def slowing(seen: Seen) -> list[Exhibit]:
    """Slowing down a lot without a reason; the value is the speed lost, m/s."""
    row_index, steps = seen.row_index, round(SLOWING_S / seen.step_s)
    if seen.speed.size <= steps:
        return []
    before, after = seen.speed[:-steps], seen.speed[steps:]
    lost = np.flatnonzero((before > FOLLOWING_MPS) & (after < SLOWING_SHARE * before)) + steps
    # all that time seen, with no reason: every row since continues the one before
    going_on = _no_reason(seen)
    unbroken = going_on & ~row_index.begins
    so_far = np.cumsum(unbroken)
    lost = lost[(so_far[lost] - so_far[lost - steps] == steps) & going_on[lost - steps]]
    flags = np.zeros(seen.speed.size, dtype=bool)
    flags[lost] = True
    return _exhibits(
        seen, Trait.SLOWING, flags, seen.step_s,
        lambda at: float(
            seen.speed[at.start - steps : at.stop].max() - seen.speed[at].min()
        ),
    )  # fmt: skip


def waits(seen: Seen) -> list[Exhibit]:
    """Every stand before a crossing or junction for others who go first; the value is its s.

    First in line only: who stands behind somebody waits for that car. Nor does wait for others who
    came there by breaking a rule: they are in its way, as it is in theirs.
    """
    first = (seen.gap > seen.crossing_distance) | (seen.gap > seen.stop_distance)
    crossing = (seen.crossing_distance < 8.0) & (seen.crossing_distance >= -1.0)
    flags = (seen.driving & first & crossing & (seen.speed < STANDING_MPS)) & ~(
        (seen.stop_distance < 12.0) & seen.stop_ahead
    )
    for broken in (e for e in seen.encounters if not e.kept):
        mine = seen.row_index.rows(broken.agent)
        when_s = seen.time_s[seen.row_index.step[mine]]
        flags[mine] &= np.abs(when_s - broken.time_s) > CROSSING_S
    return _exhibits(seen, Trait.WAITING, flags, seen.step_s, _how_long(seen))


def waiting(seen: Seen) -> list[Exhibit]:
    """Waiting long for vehicles or pedestrians; the value is for how long, s."""
    return [w for w in waits(seen) if w.value >= WAITING_S]


DETECTORS: Final[dict[Trait, Callable[[Seen], list[Exhibit]]]] = {
    Trait.OVERTAKING: overtaking,
    Trait.OVER_SPEEDING: over_speeding,
    Trait.TAILGATING: tailgating,
    Trait.WEAVING: weaving,
    Trait.CUTTING_IN: cutting_in,
    Trait.DRIVING_CLOSE: driving_close,
    Trait.WRONG_DIRECTION: wrong_direction,
    Trait.JAYWALKING: jaywalking,
    Trait.BREAKING_RULES: breaking_rules,
    Trait.KEEPING_NEIGHBORS: keeping_neighbors,
    Trait.UNIFORM_SPEED: uniform_speed,
    Trait.FOLLOWING_RULES: following_rules,
    Trait.NOT_MOVING: not_moving,
    Trait.SLOWING: slowing,
    Trait.WAITING: waiting,
}
"""A detector for every row of the paper's trait table."""


def detect(seen: Seen) -> tuple[Exhibit, ...]:
    """Everything that anybody showed, in order of time, then agent."""
    found = [exhibit for detector in DETECTORS.values() for exhibit in detector(seen)]
    return tuple(sorted(found, key=lambda e: (e.begin_s, e.agent, e.trait)))
