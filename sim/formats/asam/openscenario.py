"""Episodes as OpenSCENARIO 1.2 with the road beside them as OpenDRIVE, for other simulators.

Every agent is an entity that appears when it is first seen, follows its recorded positions and
headings at their times, and disappears after it is last seen. An entity's reference point is the
middle of its outline. Signals change by actions; drivers' behaviours are properties of entities.
Time is the episode's own.

References:
    ASAM OpenSCENARIO XML 1.2; ASAM OpenDRIVE 1.7. Needs ``pip install graphrqi[asam]``.
"""

from __future__ import annotations

import datetime
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from scenariogeneration import xosc

from sim.files import write_whole
from sim.formats.asam.opendrive import NO_DATE, RoadFile, as_bytes, opendrive
from sim.frames import KINDS, SIGNALS, AgentKind, FloatArray, IntArray, Tracks
from sim.road import Road

HEIGHTS_M: Final[dict[AgentKind, float]] = {
    AgentKind.CAR: 1.5, AgentKind.BUS: 3.2, AgentKind.TRUCK: 3.5, AgentKind.MOTORCYCLE: 1.5,
    AgentKind.BICYCLE: 1.7, AgentKind.PEDESTRIAN: 1.7,
}  # fmt: skip
"""Heights of outlines, m (SUMO's defaults, rounded); frames have none."""

CATEGORIES: Final[dict[AgentKind, str]] = {
    AgentKind.CAR: "car", AgentKind.BUS: "bus", AgentKind.TRUCK: "truck",
    AgentKind.MOTORCYCLE: "motorbike", AgentKind.BICYCLE: "bicycle",
}  # fmt: skip
"""OpenSCENARIO's categories of vehicles."""

MAX_SPEED_MPS, MAX_ACCEL_MPS2, MAX_DECEL_MPS2 = 70.0, 10.0, 10.0
"""Limits of vehicles, which the format asks for (no recorded motion exceeds them)."""

AXLE_SHARE: Final = 0.3
"""Axles lie this share of the length before and behind the middle (a car's)."""


def write(folder: Path, name: str, tracks: Tracks, road: Road | None = None) -> list[Path]:
    """Write an episode as ``<name>.xosc``, and its road, if known, as ``<name>.xodr``."""
    made = None if road is None else opendrive(road, name)
    paths = []
    if made is not None:
        paths.append(folder / f"{name}.xodr")
        write_whole(paths[-1], made.content)
    paths.append(folder / f"{name}.xosc")
    write_whole(paths[-1], scenario(name, tracks, made, paths[0].name if made else None))
    return paths


def scenario(name: str, tracks: Tracks, road: RoadFile | None, road_file: str | None) -> bytes:
    """An episode as OpenSCENARIO; signals have the ids of its road's file."""
    entities, init = xosc.Entities(), xosc.Init()
    act = xosc.Act("episode", _at(0.0, "begin"))
    for agent in range(len(tracks.ids)):
        what = f"agent {int(tracks.ids[agent])}"  # names in recordings may be anything
        entities.add_scenario_object(what, _entity(tracks, agent))
        mine = tracks.index.rows(agent)
        maneuver = xosc.Maneuver(f"{what} as recorded")
        for event in _events(
            what,
            tracks.time_s,
            tracks.index.step[mine],
            tracks.row_xy[mine],
            tracks.row_heading[mine],
        ):
            maneuver.add_event(event)
        group = xosc.ManeuverGroup(f"{what} alone")
        group.add_actor(what)
        group.add_maneuver(maneuver)
        act.add_maneuver_group(group)
    if road is not None and len(tracks.signals) == len(road.signals):
        _add_signals(tracks, road, init, act)
    end_s = float(tracks.time_s[-1]) if len(tracks.time_s) else 0.0
    board = xosc.StoryBoard(init, _at(end_s, "end", stops=True))
    if act.maneuvergroup:  # an episode may be empty
        story = xosc.Story("recorded")
        story.add_act(act)
        board.add_story(story)
    made = xosc.Scenario(
        name, "GraphRQI", xosc.ParameterDeclarations(), entities, board,
        xosc.RoadNetwork(roadfile=road_file), xosc.Catalog(), osc_minor_version=2,
        creation_date=datetime.datetime.fromisoformat(NO_DATE),
    )  # fmt: skip
    return as_bytes(made.get_element())


def _entity(tracks: Tracks, agent: int) -> Any:
    """What an agent is: a vehicle with axles, or a pedestrian."""
    kind = KINDS[tracks.kind[agent]]
    length, width = float(tracks.length[agent]), float(tracks.width[agent])
    height = HEIGHTS_M[kind]
    box = xosc.BoundingBox(width, length, height, 0.0, 0.0, height / 2)
    what = f"{kind} {int(tracks.ids[agent])}"
    if kind is AgentKind.PEDESTRIAN:
        return xosc.Pedestrian(what, 75.0, xosc.PedestrianCategory.pedestrian, box)
    axle = AXLE_SHARE * length
    made = xosc.Vehicle(
        what, getattr(xosc.VehicleCategory, CATEGORIES[kind]), box,
        xosc.Axle(0.6, 0.6, 0.8 * width, axle, 0.3), xosc.Axle(0.0, 0.6, 0.8 * width, -axle, 0.3),
        MAX_SPEED_MPS, MAX_ACCEL_MPS2, MAX_DECEL_MPS2,
    )  # fmt: skip
    if tracks.behavior is not None and tracks.behavior[agent] >= 0:
        made.add_property("behavior", str(tracks.classes[tracks.behavior[agent]]))
    return made


def _at(time_s: float, name: str, *, stops: bool = False) -> Any:
    """A trigger at a time of the simulation."""
    rule = xosc.Rule.greaterThan if stops else xosc.Rule.greaterOrEqual
    condition = xosc.SimulationTimeCondition(time_s, rule)
    point = "stop" if stops else "start"
    return xosc.ValueTrigger(name, 0, xosc.ConditionEdge.none, condition, triggeringpoint=point)


def _events(
    what: str, time_s: FloatArray, steps: IntArray, xy: FloatArray, heading: FloatArray
) -> Iterator[Any]:
    """The events of an agent for each time that it is seen: it appears, drives, and disappears."""
    gaps = np.flatnonzero(np.diff(steps) > 1) + 1
    for number, part in enumerate(np.split(np.arange(steps.size), gaps)):
        if not part.size:
            continue
        times = time_s[steps[part]].tolist()
        places = [
            xosc.WorldPosition(float(xy[i, 0]), float(xy[i, 1]), 0.0, float(heading[i]))
            for i in part
        ]
        about = f"{what}, part {number}"
        appears = xosc.AddEntityAction(what, places[0])
        yield _event(f"{about}: appear", appears, times[0])
        if len(places) > 1:
            line = xosc.Trajectory(f"{about}: line", closed=False)
            line.add_shape(xosc.Polyline(times, places))
            follow = xosc.FollowTrajectoryAction(
                line, xosc.FollowingMode.position, xosc.ReferenceContext.absolute, 1.0, 0.0
            )
            yield _event(f"{about}: drive", follow, times[0])
        yield _event(f"{about}: disappear", xosc.DeleteEntityAction(what), times[-1])


def _event(name: str, action: Any, time_s: float) -> Any:
    """An event of one action at a time."""
    event = xosc.Event(name, xosc.Priority.parallel)
    event.add_action(f"{name}: action", action)
    event.add_trigger(_at(time_s, f"{name}: time"))
    return event


def _add_signals(tracks: Tracks, road: RoadFile, init: Any, act: Any) -> None:
    """What lights show at first, and every change."""
    maneuver = xosc.Maneuver("programme")
    count = itertools.count()
    for states, ids in zip(tracks.signals, road.signals, strict=True):
        if not len(states):
            continue
        for light in ids:
            init.add_global_action(xosc.TrafficSignalStateAction(light, str(SIGNALS[states[0]])))
        for step in (np.flatnonzero(np.diff(states)) + 1).tolist():
            for light in ids:
                action = xosc.TrafficSignalStateAction(light, str(SIGNALS[states[step]]))
                time_s = float(tracks.time_s[step])
                maneuver.add_event(_event(f"change {next(count)}", action, time_s))
    if maneuver.events:
        group = xosc.ManeuverGroup("signals")
        group.add_maneuver(maneuver)
        act.add_maneuver_group(group)
