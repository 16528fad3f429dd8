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
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from scenariogeneration import xosc

from sim.files import write_whole
from sim.formats.asam.opendrive import NO_DATE, as_bytes, opendrive
from sim.frames import KINDS, SIGNALS, AgentKind, Tracks
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
    scenario, lines = folder / f"{name}.xosc", folder / f"{name}.xodr"
    if road is None:
        write_whole(scenario, _scenario(name, tracks, None, ()))
        return [scenario]
    content, signals = opendrive(road, name)
    write_whole(lines, content)
    write_whole(scenario, _scenario(name, tracks, lines.name, signals))
    return [lines, scenario]


def _scenario(
    name: str, tracks: Tracks, road_file: str | None, signals: Sequence[Sequence[str]]
) -> bytes:
    """An episode as OpenSCENARIO; ``signals`` are the ids of each group's lights in the road."""
    entities, init = xosc.Entities(), xosc.Init()
    act = xosc.Act("episode", _at(0.0, "begin"))
    for agent in range(len(tracks.ids)):
        what = f"agent {int(tracks.ids[agent])}"  # names in recordings may be anything
        entities.add_scenario_object(what, _entity(tracks, agent))
        _add_maneuver(
            act, f"{what} alone", f"{what} as recorded", _events(what, tracks, agent), what
        )
    if len(tracks.signals) == len(signals):
        changes = list[Any]()
        for states, ids in zip(tracks.signals, signals, strict=True):
            for light in ids if len(states) else ():
                init.add_global_action(_shows(light, states[0]))
            for step in (np.flatnonzero(np.diff(states)) + 1).tolist():
                for light in ids:
                    about, time_s = f"change {len(changes)}", float(tracks.time_s[step])
                    changes.append(_event(about, _shows(light, states[step]), time_s))
        _add_maneuver(act, "signals", "programme", changes)
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


def _events(what: str, tracks: Tracks, agent: int) -> Iterator[Any]:
    """The events of an agent for each time that it is seen: it appears, drives, and disappears."""
    mine = tracks.index.rows(agent)
    times = tracks.time_s[tracks.index.step[mine]].tolist()
    places = [
        xosc.WorldPosition(float(x), float(y), 0.0, float(heading))
        for (x, y), heading in zip(tracks.row_xy[mine], tracks.row_heading[mine], strict=True)
    ]
    begins = np.flatnonzero(tracks.index.begins[mine]).tolist()
    for number, (first, last) in enumerate(pairwise([*begins, len(times)])):
        about = f"{what}, part {number}"
        yield _event(f"{about}: appear", xosc.AddEntityAction(what, places[first]), times[first])
        if last - first > 1:
            line = xosc.Trajectory(f"{about}: line", closed=False)
            line.add_shape(xosc.Polyline(times[first:last], places[first:last]))
            follow = xosc.FollowTrajectoryAction(
                line, xosc.FollowingMode.position, xosc.ReferenceContext.absolute, 1.0, 0.0
            )
            yield _event(f"{about}: drive", follow, times[first])
        yield _event(f"{about}: disappear", xosc.DeleteEntityAction(what), times[last - 1])


def _shows(light: str, state: int) -> Any:
    """The action by which a light shows a state."""
    return xosc.TrafficSignalStateAction(light, str(SIGNALS[state]))


def _at(time_s: float, name: str, *, stops: bool = False) -> Any:
    """A trigger at a time of the simulation."""
    rule = xosc.Rule.greaterThan if stops else xosc.Rule.greaterOrEqual
    condition = xosc.SimulationTimeCondition(time_s, rule)
    point = "stop" if stops else "start"
    return xosc.ValueTrigger(name, 0, xosc.ConditionEdge.none, condition, triggeringpoint=point)


def _event(name: str, action: Any, time_s: float) -> Any:
    """An event of one action at a time."""
    event = xosc.Event(name, xosc.Priority.parallel)
    event.add_action(f"{name}: action", action)
    event.add_trigger(_at(time_s, f"{name}: time"))
    return event


def _add_maneuver(act: Any, group: str, name: str, events: Iterable[Any], *actors: str) -> None:
    """Add a group of one manoeuvre of events, if there are any."""
    maneuver = xosc.Maneuver(name)
    for event in events:
        maneuver.add_event(event)
    made = xosc.ManeuverGroup(group)
    for actor in actors:
        made.add_actor(actor)
    made.add_maneuver(maneuver)
    if maneuver.events:
        act.add_maneuver_group(made)
