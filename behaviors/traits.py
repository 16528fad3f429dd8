"""Detectors of the traits in the paper's trait table, on plain arrays.

Every detector reads only what an observer could measure (positions, speeds, lanes, gaps), never a
driver's profile, so it works on simulated and on recorded traffic alike. It returns who showed the
trait when, and the number behind it. The thresholds stand first, each with its source.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from behaviors.labels import Trait
from behaviors.row_index import BoolArray, FloatArray, IntArray, RowIndex

FOLLOWING_MPS: Final = 5.0
"""Above this speed a time headway says how closely a driver follows (our choice: all gaps in a
crawling queue are short)."""


@dataclass(frozen=True, slots=True)
class ShownTrait:
    """A trait that an agent showed.

    Attributes:
        trait: the trait.
        agent: index of the agent (its id where an episode is stored).
        begin_s: from when, s.
        end_s: until when, s.
        value: the detector's number.
        other: index or id of the second agent, -1 if none.
    """

    trait: Trait
    agent: int
    begin_s: float
    end_s: float
    value: float
    other: int = -1


class RuleEncounter(NamedTuple):
    """A rule that applied to an agent (its index) at a time, s, and whether it was kept."""

    agent: int
    time_s: float
    kept: bool


@dataclass(frozen=True, slots=True)
class DetectorInputs:
    """Measurements of N agents, one row per agent and time (`RowIndex`).

    Distances are +inf, and rows and lanes -1, where there is nothing.

    Attributes:
        row_index: the m rows: which agent, when.
        time_s: (T,) s, evenly spaced.
        drives: (N,) whether it is a vehicle.
        length: (N,) m.
        width: (N,) m.
        speed: (m,) m/s.
        limit: (m,) speed limit, m/s; +inf where unknown.
        edge: (m,) index of the edge (the stretch of road in one direction).
        lane: (m,) index of the lane.
        offset: (m,) signed distance to the left of the lane's centre line, m.
        lane_width: (m,) m.
        lane_heading: (m,) heading relative to the lane's, rad.
        leader: (m,) row of the vehicle ahead at the same time.
        follower: (m,) row of the vehicle behind at the same time.
        gap: (m,) bumper to bumper to the leader, m.
        closing: (m,) own speed minus the leader's, m/s.
        stop_distance: (m,) front bumper to the next junction, m; negative inside one.
        stop_ahead: (m,) whether a red signal, a stop sign or a lack of priority holds there.
        crossing_distance: (m,) front bumper to the next crossing, m.
        crossing_used: (m,) whether a pedestrian is on that crossing or about to be.
        off_crossing: (m,) whether a pedestrian is on the carriageway, off any crossing.
        on_red: (m,) whether a pedestrian is on a crossing entered on red.
        encounters: the rules that applied, kept or broken.
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


def lane_changes(inputs: DetectorInputs) -> IntArray:
    """(k,) the first rows of vehicles with their centre on another lane of the same edge."""
    rows = np.flatnonzero(inputs.lane[1:] != inputs.lane[:-1]) + 1
    changed = (inputs.edge[rows - 1] == inputs.edge[rows]) & ~inputs.row_index.begins[rows]
    changed &= (inputs.lane[rows - 1] >= 0) & (inputs.lane[rows] >= 0) & inputs.driving[rows]
    return np.asarray(rows[changed], dtype=np.int64)


OVER_LIMIT: Final = 1.10
"""Over-speeding: above the limit by this factor; the usual tolerance of enforcement (National
Police Chiefs' Council 2013: 10 % and 2 mph)."""

TAILGATING_HEADWAY_S: Final = 1.0
"""Tailgating: closer than drivers call comfortable, 0.98 s (Taieb-Maimon and Shinar 2001)."""

CLOSE_HEADWAY_S: Final = 0.66
"""Driving extremely close: below what drivers call the least safe headway (same source)."""

CUT_IN_HEADWAY_S: Final = 1.0
"""Cutting in: the new follower has less headway than this when the vehicle's outline touches the
lane (Vogel 2003 calls headways under 1 s dangerous)."""

WEAVING_CHANGES, WEAVING_S = 2, 20.0
"""Weaving: this many lane changes, each within this time of the one before, s (our choice)."""

OVERTAKING_S: Final = 20.0
"""Overtaking: the former leader is passed within this after the lane change (our choice)."""

UNIFORM_S, UNIFORM_VARIATION = 15.0, 0.05
"""Uniform speed: this long, the speed varies by less than this share of its mean (our choice)."""

KEEPING_S: Final = 30.0
"""Maintaining neighbours: the same lane and the same leader for this long (our choice)."""

STANDING_MPS: Final = 0.3
"""Below this speed a vehicle counts as standing (our choice: noise of differenced positions)."""

NOT_MOVING_S: Final = 2.0
"""Duration of standing without a reason, for "not moving" (our choice)."""

SLOWING_SHARE, SLOWING_S = 0.6, 4.0
"""Slowing down: to this share of the own speed within this time, without reason (our choice)."""

REASON_GAP_S, REASON_GAP_M = 4.0, 15.0
"""A leader within this headway or gap is a reason to slow down (our choice)."""

REASON_JUNCTION_M, REASON_STOP_M = 40.0, 60.0
"""Any junction within the first distance is a reason to slow down (our choice). A duty to stop or a
used crossing is one within the second."""

WAITING_S: Final = 3.0
"""Waiting: standing for this long for others who go first (our choice)."""

CROSSING_S: Final = 15.0
"""Time to cross a junction, standing in it included (our choice)."""

WRONG_WAY_S: Final = 1.0
"""Wrong direction: facing against the lane for this long (our choice)."""

JAYWALKING_S: Final = 1.0
"""Jaywalking: on the carriageway, off any crossing, for this long (our choice)."""


def _stretches(
    inputs: DetectorInputs,
    trait: Trait,
    flags: BoolArray,
    shortest_s: float,
    value: Callable[[slice], float],
) -> list[ShownTrait]:
    """A shown trait for every long enough stretch of ``flags``; ``value`` gives its number."""
    shortest = max(1, round(shortest_s / inputs.step_s))
    return [
        _shown(inputs, trait, run.start, run.stop - 1, value(run))
        for run in inputs.row_index.runs(flags, shortest)
    ]


def _shown(
    inputs: DetectorInputs, trait: Trait, begin: int, end: int, value: float, other: int = -1
) -> ShownTrait:
    """A trait that the agent of two rows showed from the first until the second."""
    agent = int(inputs.row_index.agent[begin])
    return ShownTrait(trait, agent, inputs.when(begin), inputs.when(end), value, other)


def _how_long(inputs: DetectorInputs) -> Callable[[slice], float]:
    """A value function that gives a stretch's duration, s."""
    step_s = inputs.step_s
    return lambda at: (at.stop - at.start) * step_s


def over_speeding(inputs: DetectorInputs) -> list[ShownTrait]:
    """Faster than the limit allows for 3 s; the value is the largest speed over the limit."""
    flags = inputs.driving & (inputs.speed > OVER_LIMIT * inputs.limit)
    return _stretches(
        inputs, Trait.OVER_SPEEDING, flags, 3.0,
        lambda at: float(np.max(inputs.speed[at] / inputs.limit[at])),
    )  # fmt: skip


def tailgating(inputs: DetectorInputs) -> list[ShownTrait]:
    """Following at a headway that is too short, for 3 s; the value is the median headway, s."""
    headway = inputs.headway
    flags = (headway < TAILGATING_HEADWAY_S) & (headway >= CLOSE_HEADWAY_S)
    return _stretches(
        inputs, Trait.TAILGATING, flags, 3.0, lambda at: float(np.median(headway[at]))
    )


def driving_close(inputs: DetectorInputs) -> list[ShownTrait]:
    """Following extremely close for 2 s; the value is the median headway, s."""
    headway = inputs.headway
    return _stretches(
        inputs, Trait.DRIVING_CLOSE, headway < CLOSE_HEADWAY_S, 2.0,
        lambda at: float(np.median(headway[at])),
    )  # fmt: skip


def weaving(inputs: DetectorInputs) -> list[ShownTrait]:
    """Several lane changes in a short time; the value is how many."""
    rows = lane_changes(inputs)
    who, when_s = inputs.row_index.agent[rows], inputs.time_s[inputs.row_index.step[rows]]
    new = (np.diff(who, prepend=-1) != 0) | (np.diff(when_s, prepend=-np.inf) > WEAVING_S)
    series = np.split(rows, np.flatnonzero(new)[1:])
    return [
        _shown(inputs, Trait.WEAVING, int(one[0]), int(one[-1]), one.size)
        for one in series
        if one.size >= WEAVING_CHANGES
    ]


def overtaking(inputs: DetectorInputs) -> list[ShownTrait]:
    """Leaving a lane and passing the former leader; the value is the speed difference, m/s.

    The difference of the speeds is summed until it has made up the former gap and both lengths,
    so no common coordinate along the road is needed.
    """
    row_index, speed = inputs.row_index, inputs.speed
    ahead = round(OVERTAKING_S / inputs.step_s)
    found = []
    for row in lane_changes(inputs).tolist():
        leader = int(inputs.leader[row - 1])
        if leader < 0:
            continue
        agent, other = int(row_index.agent[row]), int(row_index.agent[leader])
        begin = int(row_index.step[row])
        end = min(begin + ahead, inputs.time_s.size)
        own, theirs = (row_index.over(speed, a, begin, end, np.nan) for a in (agent, other))
        both = np.isfinite(own - theirs)
        faster = np.where(both, own - theirs, 0.0)
        to_pass = inputs.gap[row - 1] + inputs.length[agent] + inputs.length[other]
        passed = np.flatnonzero((np.cumsum(faster) * inputs.step_s > to_pass) & both)[:1]
        for last in passed.tolist():
            mean = float(faster[: last + 1].mean())
            times = float(inputs.time_s[begin]), float(inputs.time_s[begin + last])
            found.append(ShownTrait(Trait.OVERTAKING, agent, *times, mean, other))
    return found


def cutting_in(inputs: DetectorInputs) -> list[ShownTrait]:
    """Entering a lane close in front of somebody; the value is the headway left to them, s.

    The new follower's headway counts when the changing vehicle's outline first touches the new
    lane. UN Regulation 157 uses the same moment.
    """
    begins, agent = inputs.row_index.begins, inputs.row_index.agent
    found = []
    for row in lane_changes(inputs).tolist():
        follower = int(inputs.follower[row])
        if follower < 0 or begins[follower]:
            continue
        back = 1  # how many steps ago the outline touched the new lane
        reach = inputs.lane_width[row - 1] / 2 - inputs.width[agent[row]] / 2
        while (
            not begins[row - back]
            and inputs.lane[row - back - 1] == inputs.lane[row - 1]
            and abs(inputs.offset[row - back - 1]) >= reach
            and not begins[follower - back]
        ):
            back += 1
        mine, theirs = slice(row - back, row), slice(follower - back, follower)
        gained = float(np.sum(inputs.speed[mine] - inputs.speed[theirs])) * inputs.step_s
        gap = float(inputs.gap[follower]) - gained
        speed = float(inputs.speed[follower - back])
        if speed > FOLLOWING_MPS and gap / speed < CUT_IN_HEADWAY_S:
            left_s, other = max(gap, 0.0) / speed, int(agent[follower])
            found.append(_shown(inputs, Trait.CUTTING_IN, row - back, row, left_s, other))
    return found


def wrong_direction(inputs: DetectorInputs) -> list[ShownTrait]:
    """Driving against the lane's direction; the value is the distance driven that way, m."""
    flags = inputs.driving & (inputs.lane >= 0) & (np.abs(inputs.lane_heading) > np.pi / 2)
    flags &= inputs.speed > STANDING_MPS
    return _stretches(
        inputs, Trait.WRONG_DIRECTION, flags, WRONG_WAY_S,
        lambda at: float(inputs.speed[at].sum()) * inputs.step_s,
    )  # fmt: skip


def jaywalking(inputs: DetectorInputs) -> list[ShownTrait]:
    """Walking on the road where or when one may not; the value is for how long, s."""
    flags = ~inputs.driving & (inputs.off_crossing | inputs.on_red)
    return _stretches(inputs, Trait.JAYWALKING, flags, JAYWALKING_S, _how_long(inputs))


def breaking_rules(inputs: DetectorInputs) -> list[ShownTrait]:
    """Disregarding a red light, a stop line or another's priority; the value is 1."""
    return [
        ShownTrait(Trait.BREAKING_RULES, agent, time_s, time_s, 1.0)
        for agent, time_s, kept in inputs.encounters
        if not kept
    ]


def following_rules(inputs: DetectorInputs) -> list[ShownTrait]:
    """Keeping every rule that applied, and the limit; the value is how many rules applied."""
    fast = inputs.speed > OVER_LIMIT * inputs.limit
    found = []
    for agent in sorted({e.agent for e in inputs.encounters}):
        met = [e for e in inputs.encounters if e.agent == agent]
        if all(e.kept for e in met) and not fast[inputs.row_index.rows(agent)].any():
            span = min(e.time_s for e in met), max(e.time_s for e in met)
            found.append(ShownTrait(Trait.FOLLOWING_RULES, agent, *span, float(len(met))))
    return found


def keeping_neighbors(inputs: DetectorInputs) -> list[ShownTrait]:
    """Staying on the lane behind the same leader; the value is for how long, s."""
    lead, row_index = inputs.leader, inputs.row_index
    follows = (lead >= 0) & (inputs.gap < 4.0 * np.maximum(inputs.speed, 5.0))
    whom = np.where(lead >= 0, row_index.agent[lead], -1)
    same = follows & ~row_index.begins
    same[1:] &= whom[1:] == whom[:-1]
    same[lane_changes(inputs)] = False
    return _stretches(inputs, Trait.KEEPING_NEIGHBORS, same, KEEPING_S, _how_long(inputs))


def uniform_speed(inputs: DetectorInputs) -> list[ShownTrait]:
    """Driving at an even speed; the value is the coefficient of variation."""
    row_index, steps = inputs.row_index, round(UNIFORM_S / inputs.step_s)
    at = np.flatnonzero(inputs.driving)
    if at.size < steps:
        return []
    speed = inputs.speed[at]
    total = np.concatenate([[0.0], np.cumsum(speed)])
    square = np.concatenate([[0.0], np.cumsum(speed**2)])
    mean = (total[steps:] - total[:-steps]) / steps
    variance = np.maximum((square[steps:] - square[:-steps]) / steps - mean**2, 0.0)
    first, last = at[: at.size - steps + 1], at[steps - 1 :]
    whole = (row_index.step[last] - row_index.step[first] == steps - 1) & (
        row_index.agent[first] == row_index.agent[last]
    )
    steady = whole & (mean > FOLLOWING_MPS) & (np.sqrt(variance) < UNIFORM_VARIATION * mean)
    even = np.zeros(inputs.speed.size, dtype=bool)
    even[first[steady]] = True
    found = []
    for run in row_index.runs(even):
        end = run.stop - 2 + steps
        values = inputs.speed[run.start : end + 1]
        variation = float(values.std() / values.mean())
        found.append(_shown(inputs, Trait.UNIFORM_SPEED, run.start, end, variation))
    return found


def _no_reason(inputs: DetectorInputs) -> BoolArray:
    """(m,) whether nothing ahead explains slowing down or standing."""
    near = (inputs.gap < REASON_GAP_M) | (inputs.gap < REASON_GAP_S * inputs.speed)
    junction = (inputs.stop_distance < REASON_STOP_M) & inputs.stop_ahead
    junction |= inputs.stop_distance < REASON_JUNCTION_M
    crossing = (inputs.crossing_distance < REASON_STOP_M) & inputs.crossing_used
    wrong_side = np.abs(inputs.lane_heading) > np.pi / 2  # somebody comes the other way
    return inputs.driving & ~(near | junction | crossing | wrong_side)


def not_moving(inputs: DetectorInputs) -> list[ShownTrait]:
    """Standing without a reason; the value is for how long, s."""
    flags = _no_reason(inputs) & (inputs.speed < STANDING_MPS)
    return _stretches(inputs, Trait.NOT_MOVING, flags, NOT_MOVING_S, _how_long(inputs))


def slowing(inputs: DetectorInputs) -> list[ShownTrait]:
    """Slowing down a lot without a reason; the value is the speed lost, m/s."""
    row_index, steps = inputs.row_index, round(SLOWING_S / inputs.step_s)
    if inputs.speed.size <= steps:
        return []
    before, after = inputs.speed[:-steps], inputs.speed[steps:]
    lost = np.flatnonzero((before > FOLLOWING_MPS) & (after < SLOWING_SHARE * before)) + steps
    # without a reason all that time, and every row since continues the one before
    going_on = _no_reason(inputs)
    so_far = np.cumsum(going_on & ~row_index.begins)
    lost = lost[(so_far[lost] - so_far[lost - steps] == steps) & going_on[lost - steps]]
    flags = np.zeros(inputs.speed.size, dtype=bool)
    flags[lost] = True
    return _stretches(
        inputs, Trait.SLOWING, flags, inputs.step_s,
        lambda at: float(
            inputs.speed[at.start - steps : at.stop].max() - inputs.speed[at].min()
        ),
    )  # fmt: skip


def waits(inputs: DetectorInputs) -> list[ShownTrait]:
    """Every stop for others at a crossing without a duty to stop; the value is its duration, s.

    Only the first vehicle in line counts: those behind it wait for that vehicle. Stops near the
    time of the driver's own violation do not count: it blocks others as they block it.
    """
    first = (inputs.gap > inputs.crossing_distance) | (inputs.gap > inputs.stop_distance)
    crossing = (inputs.crossing_distance < 8.0) & (inputs.crossing_distance >= -1.0)
    flags = (inputs.driving & first & crossing & (inputs.speed < STANDING_MPS)) & ~(
        (inputs.stop_distance < 12.0) & inputs.stop_ahead
    )
    for broken in (e for e in inputs.encounters if not e.kept):
        mine = inputs.row_index.rows(broken.agent)
        when_s = inputs.time_s[inputs.row_index.step[mine]]
        flags[mine] &= np.abs(when_s - broken.time_s) > CROSSING_S
    return _stretches(inputs, Trait.WAITING, flags, inputs.step_s, _how_long(inputs))


def waiting(inputs: DetectorInputs) -> list[ShownTrait]:
    """Waiting for vehicles or pedestrians for long; the value is for how long, s."""
    return [w for w in waits(inputs) if w.value >= WAITING_S]


DETECTORS: Final[dict[Trait, Callable[[DetectorInputs], list[ShownTrait]]]] = {
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


def detect(inputs: DetectorInputs) -> tuple[ShownTrait, ...]:
    """Every trait that any agent showed, in order of time, then agent."""
    found = [one for detector in DETECTORS.values() for one in detector(inputs)]
    return tuple(sorted(found, key=lambda one: (one.begin_s, one.agent, one.trait)))
