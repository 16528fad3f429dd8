"""Does the map fit the recording? Before anything uses a map, moving vehicles must be in its lanes.

A position fits if it is within half the lane's width of a centre line and moves in the lane's
direction. Maps of another place, or in other coordinates, show at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from sim.frames import PEDESTRIAN, Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph

MOVING_MPS: Final = 1.0
"""Slower agents do not count: parked cars stand beside lanes, m/s."""

MOST_POINTS: Final = 3_000
"""Positions that are looked at, evenly spread over all (1 % of standard error)."""

LEAST_POINTS: Final = 20
"""Moving positions that are needed to judge a map."""

LEAST: Final = 0.6
"""Below this share inside a map is refused (of recordings on maps of other places, most have less
than .3; on their own all have .7 and more)."""

UNSURE_LEAST: Final = 0.3
"""The same where fewer than `SURE_VEHICLES` move: one may stray by itself."""

SURE_VEHICLES: Final = 8
"""Vehicles that must have moved to blame the map: a few fit some lane anywhere, or stray."""

LIMIT_LOW, LIMIT_HIGH = 0.75, 1.35
"""Limits rule where the fastest speeds of vehicles, over the limits there, have their median in
this range (speeds in free traffic have .9 to 1.15 of the limit)."""

LEAST_VEHICLES: Final = 3
"""Vehicles that must have moved to compare speeds with limits."""


@dataclass(frozen=True)
class MapFit:
    """How a map fits a recording.

    Attributes:
        share: of moving positions inside lanes; NaN where too few move.
        limit_ratio: median over vehicles of their highest speed over the limit there; NaN where
            no limits are known or too few vehicles move.
        vehicles: how many move.
    """

    share: float = math.nan
    limit_ratio: float = math.nan
    vehicles: int = 0

    @property
    def sure(self) -> bool:
        """Whether enough vehicles move to blame the map where they are not inside."""
        return self.vehicles >= SURE_VEHICLES

    @property
    def fits(self) -> bool:
        """Whether the map may be used; true if too little moves to judge it."""
        return not self.share < (LEAST if self.sure else UNSURE_LEAST)

    @property
    def limits_rule(self) -> bool:
        """Whether traffic drives as the limits say; true if too little is known."""
        return math.isnan(self.limit_ratio) or LIMIT_LOW <= self.limit_ratio <= LIMIT_HIGH

    def notes(self) -> tuple[str, ...]:
        """Findings, one sentence each."""
        if math.isnan(self.share):
            return ("too little moves to judge whether the map fits",)
        inside = f"{self.share:.0%} of moving positions are inside the map's lanes"
        if self.limits_rule:
            return (inside,)
        over = f"{self.limit_ratio:.0%} of them"
        return (inside, f"the map's limits do not rule: vehicles reach {over}")


def map_fit(road: Road, tracks: Tracks) -> MapFit:
    """How a map fits a recording: the share inside, and how speeds compare with limits."""
    rows = tracks.rows
    drives = (tracks.kind != PEDESTRIAN)[rows.index.agent]
    moving = np.flatnonzero(drives & (rows.speed >= MOVING_MPS))
    if moving.size > MOST_POINTS:
        moving = moving[np.linspace(0, moving.size - 1, MOST_POINTS).astype(np.int64)]
    if moving.size < LEAST_POINTS or all(lane.walking for lane in road.lanes):
        return MapFit()
    xy, heading = rows.xy[moving], rows.heading[moving]
    graph = LaneGraph.of(road)
    place = graph.project(xy, heading)
    nearest, direction = graph.position(place.lane, place.s)
    inside = np.hypot(*(nearest - xy).T) <= graph.width[place.lane] / 2
    inside &= np.cos(direction - heading) > 0
    limit = np.array([lane.speed_limit_mps for lane in road.lanes])[place.lane]
    agent = rows.index.agent[moving]
    ratio = pd.Series(rows.speed[moving] / limit, index=agent)
    fastest = ratio[np.isfinite(ratio)].groupby(level=0).max()
    typical = float(fastest.median()) if len(fastest) >= LEAST_VEHICLES else math.nan
    return MapFit(float(np.mean(inside)), typical, np.unique(agent).size)


def shifted(road: Road, shift_m: tuple[float, float]) -> Road:
    """A road moved by a translation, m."""
    return road.with_lines(lambda line: line + np.array(shift_m))
