"""The road of a recording, checked against where its vehicles move before anything uses it.

A position fits a map if it is within half the lane's width of a centre line and moves in the lane's
direction. Maps of another place, or in other coordinates, show at once.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from behaviors.errors import InputError
from experiments.console.notices import LOGGER
from experiments.guard import guarded_call
from sim.formats.common.recording import Recording
from sim.frames import Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph
from sim.road.net import net_offset
from sim.road.road_files import read_road_file

MOVING_MPS: Final = 1.0
"""Slower agents do not count: parked cars stand beside lanes, m/s."""

LEAST_POINTS, MOST_POINTS = 20, 3_000
"""Moving positions that are needed to judge a map, and how many are looked at, evenly spread over
all (1 % of standard error)."""

LEAST, UNSURE_LEAST, SURE_VEHICLES = 0.6, 0.3, 8
"""Below this share inside a map is refused (of recordings on maps of other places, most have less
than .3; on their own all have .7 and more); the same where fewer vehicles than the last number
move, because a few fit some lane anywhere, or stray."""

LIMIT_LOW, LIMIT_HIGH, LEAST_VEHICLES = 0.75, 1.35, 3
"""Limits rule where the fastest speeds of vehicles, over the limits there, have their median in
this range (speeds in free traffic have .9 to 1.15 of the limit), and how many vehicles are needed
to compare."""


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
    def fits(self) -> bool:
        """Whether the map may be used; true if too little moves to judge it."""
        return not self.share < (LEAST if self.vehicles >= SURE_VEHICLES else UNSURE_LEAST)

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
        return (
            inside,
            f"the map's limits do not rule: vehicles reach {self.limit_ratio:.0%} of them",
        )


def map_fit(road: Road, tracks: Tracks) -> MapFit:
    """How a map fits a recording: the share inside, and how speeds compare with limits."""
    moving = np.flatnonzero(~tracks.walking & (tracks.row_speed >= MOVING_MPS))
    if moving.size > MOST_POINTS:
        moving = moving[np.linspace(0, moving.size - 1, MOST_POINTS).astype(np.int64)]
    if moving.size < LEAST_POINTS or all(lane.walking for lane in road.lanes):
        return MapFit()
    xy, heading = tracks.row_xy[moving], tracks.row_heading[moving]
    graph = LaneGraph.of(road)
    place = graph.project(xy, heading)
    nearest, direction = graph.position(place.lane, place.s)
    inside = np.hypot(*(nearest - xy).T) <= graph.width[place.lane] / 2
    inside &= np.cos(direction - heading) > 0
    limit = np.array([lane.speed_limit_mps for lane in road.lanes])[place.lane]
    agent = tracks.index.agent[moving]
    ratio = pd.Series(tracks.row_speed[moving] / limit, index=agent)
    fastest = ratio[np.isfinite(ratio)].groupby(level=0).max()
    typical = float(fastest.median()) if len(fastest) >= LEAST_VEHICLES else math.nan
    return MapFit(float(np.mean(inside)), typical, np.unique(agent).size)


class RecordedRoads:
    """The roads of recordings that are read one after another.

    A map that came with a recording and does not fit it is left out, and named once in the log. One
    that a person gave as ``net`` is refused by name, unless too few vehicles move to blame it. All
    maps are moved by ``shift_m``, m.
    """

    def __init__(self, net: Path | None = None, shift_m: tuple[float, float] | None = None) -> None:
        self._net = net
        self._shift_m = shift_m
        self._fitted = False
        self._refused: dict[str, str] = {}
        self._said: set[str] = set()
        if net is not None:
            guarded_call(net, read_road_file, net)

    def of(self, recording: Recording) -> tuple[Path | Road | None, tuple[str, ...]]:
        """The road that a recording is stored with, and one sentence for each finding about it.

        The road is the map's file where it is used unchanged and datasets keep such files; None
        without a map, or where it does not fit.

        Raises:
            InputError: if the map that a person gave is of another place.
        """
        given = recording.road if self._net is None else self._net
        if given is None:
            return None, ()
        # readers of recordings, or this class, have read the file before
        road = given if isinstance(given, Road) else read_road_file(given, origin=recording.origin)
        notes: tuple[str, ...] = ()
        if self._shift_m is not None:
            road = road.with_lines(lambda line: line + np.array(self._shift_m))
            notes = ("the map is shifted by ({:g}, {:g}) m".format(*self._shift_m),)
        for text in set(road.doubts) - self._said:
            LOGGER.warning("%s: %s", road.source, text)
        self._said |= set(road.doubts)
        notes += road.doubts
        fit = map_fit(road, recording.tracks)
        if not fit.fits and self._shift_m is None and isinstance(given, Path):
            x_m, y_m = (-one for one in net_offset(given))
            moved = road.with_lines(lambda line: line + np.array([x_m, y_m]))
            there = map_fit(moved, recording.tracks)
            if (x_m or y_m) and there.fits and not math.isnan(there.share):
                road, fit = moved, there
                notes = (f"the map is shifted by ({x_m:g}, {y_m:g}) m, as its own offset says",)
                LOGGER.warning("%s: %s", road.source, notes[0])
        if recording.own_road and self._net is None:
            fit = dataclasses.replace(fit, vehicles=0)  # it belongs to it by its id
        if not fit.fits:
            found = (
                f"{road.source}: the map does not fit the positions: found {fit.share:.0%} of the "
                f"moving ones of {recording.name} inside its lanes, expected at least {LEAST:.0%}, "
                "or import --shift X,Y"
            )
            if self._net is not None and fit.vehicles >= SURE_VEHICLES:
                raise InputError(found)
            if self._refused.setdefault(str(road.source), found) is found:
                LOGGER.warning("%s: left out", found)
            return None, (f"{found}: left out",)
        self._fitted = True
        keeps = isinstance(given, Path) and given.name.endswith((".json", ".net.xml"))
        if fit.limits_rule and keeps and not notes:
            return given, fit.notes()
        rules = fit.limits_rule and road.knows.limits_rule
        knows = dataclasses.replace(road.knows, limits_rule=rules)
        return dataclasses.replace(road, knows=knows), (*notes, *fit.notes())

    def check(self) -> None:
        """Refuse a map that a person gave and that fitted no recording at all."""
        if self._net is not None and self._refused and not self._fitted:
            raise InputError(next(iter(self._refused.values())))
