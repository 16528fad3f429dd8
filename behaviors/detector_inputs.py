"""Input and output of the trait detectors: plain arrays and values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import Trait
from behaviors.row_index import RowIndex

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]

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


@dataclass(frozen=True, slots=True)
class RuleEncounter:
    """A rule that applied to an agent, which kept or broke it.

    Attributes:
        agent: index of the agent.
        time_s: when, s.
        kept: whether it was kept.
    """

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
    """Rows in which vehicles changed lanes.

    Returns:
        (k,) the first rows with the centre on the new lane. Driving from one edge to the next does
        not count.
    """
    rows = np.flatnonzero(inputs.lane[1:] != inputs.lane[:-1]) + 1
    changed = (inputs.edge[rows - 1] == inputs.edge[rows]) & ~inputs.row_index.begins[rows]
    changed &= (inputs.lane[rows - 1] >= 0) & (inputs.lane[rows] >= 0) & inputs.driving[rows]
    return np.asarray(rows[changed], dtype=np.int64)
