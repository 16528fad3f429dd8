"""Scenarios of driving datasets in a common form, which become recordings with their roads.

Waymo's records, the JSON made from them and ScenarioNet's dictionaries hold the same things: agents
by steps, lanes with their successors, crosswalks, and what each lane's light showed. Lanes have
centre lines, limits and neighbours, but no widths: where a neighbour is known, its distance is the
width. Lights are those that the recording car saw.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, recorded
from sim.frames import AgentKind, FloatArray, Signal
from sim.road import Crossing, Road
from sim.road.maps.lanelets import Lanelet, Lanelets, road_of_lanelets

VALUES: Final = ("x", "y", "heading", "speed", "length", "width")
"""What is known of an agent at each step, in this order."""

WIDTH_M: Final = 3.5
"""Width of a lane without a neighbour, m (urban lanes have 3.3, freeways 3.7)."""

NARROWEST_M, WIDEST_M = 2.5, 5.0
"""Widths that the distance to a neighbour may give, m."""

JOIN_M: Final = 0.5
"""Lanes whose ends are this close follow each other where the map does not say it, m (the distance
of its points)."""


@dataclass
class DrivingScene:
    """A scenario of a driving dataset, whichever file it was read from.

    Attributes:
        path: its file.
        name: its own name.
        time_s: (T,) of the steps, s.
        agents: name and kind of each road-agent, the (k,) steps at which it is seen, and its
            (k, 6) `VALUES` there.
        lanes: of the map; an unknown width is NaN.
        crosswalks: (P, 2) outline of each, m, by id.
        lights: what the lights show at each step: a signal by lane.
        behaviors: what each agent is labelled, by its name.
        left_out: how many objects are no road-agents.
    """

    path: Path
    name: str
    time_s: FloatArray
    agents: list[tuple[str, AgentKind, NDArray[np.int64], FloatArray]] = field(default_factory=list)
    lanes: list[Lanelet] = field(default_factory=list)
    crosswalks: dict[str, FloatArray] = field(default_factory=dict)
    lights: list[dict[int, Signal]] = field(default_factory=list)
    behaviors: dict[str, str | None] = field(default_factory=dict)
    left_out: int = 0


def recording_of(scene: DrivingScene) -> Recording:
    """The scenario as a recording with its road."""
    time_s = scene.time_s
    if not time_s.size or not (np.diff(time_s) > 0).all():
        raise InputError(f"timestamps: found {time_s.size}, expected some that increase")
    seen_s = time_s - time_s[0]
    tables = []
    for name, kind, steps, states in scene.agents:
        rows = pandas.DataFrame(states, columns=VALUES)
        known = states[(states[:, 4:] > 0).all(axis=1), 4:]
        if len(known):  # sizes are measured anew at each step
            rows[["length", "width"]] = np.median(known, axis=0)
        tables.append(rows.assign(t=seen_s[steps], id=name, kind=kind.code))
    if not tables:
        raise InputError("found no road-agents, expected at least one")
    recording = recorded(scene.name, pandas.concat(tables), empty_s=seen_s.tolist())
    notes = ["vehicles are taken for cars, whatever they are"]
    if scene.left_out:
        notes.append(f"left out, because they are not road-agents: {scene.left_out} objects")
    lights = sorted({lane for shown in scene.lights for lane in shown})
    road, tracks = _road(scene, lights), recording.tracks
    if road is not None:
        codes = np.full((len(lights), time_s.size), Signal.OFF.code, dtype=np.int8)
        for step, shown in enumerate(scene.lights[: time_s.size]):
            for lane, signal in shown.items():
                codes[lights.index(lane), step] = signal.code
        tracks = replace(tracks, signals=codes)
        notes.append("widths of lanes are told from neighbours, or assumed to be 3.5 m")
        if road.knows.unknown:
            notes.append(f"not in the map: {', '.join(road.knows.unknown)}")
    found = replace(recording, tracks=tracks, notes=tuple(notes), road=road, own_road=True)
    return found.with_behaviors(scene.behaviors)


def _road(scene: DrivingScene, lights: list[int]) -> Road | None:
    """The road of a scenario, None without a lane for cars; each light is a signal group.

    Lanes that are not for cars are for bicycles.
    """
    named = {lane.id: lane for lane in scene.lanes if len(lane.centerline) >= 2}
    if not any(lane.cars for lane in named.values()):
        return None
    found = dict(sorted(named.items()))
    for lane in named.values():  # neighbours that only one of the two names
        for mine, its in (("left", "right"), ("right", "left")):
            other = named.get(getattr(lane, mine))
            if other is not None and getattr(other, its) is None:
                change: dict[str, Any] = {its: lane.id}
                found[other.id] = replace(found[other.id], **change)
    bare = not any(lane.successors or lane.predecessors for lane in named.values())
    found = {
        i: replace(
            lane,
            width_m=_width(lane, found),
            successors=_onward(lane, named) if bare else lane.successors,
            use="" if lane.cars else "bicycles",
            signal=lights.index(i) if i in lights else -1,
        )
        for i, lane in found.items()
    }
    return road_of_lanelets(
        scene.path,
        scene.name,
        found,
        [_crossing(label, outline) for label, outline in scene.crosswalks.items()],
        find_junctions=bare,
        signal_groups=tuple(map(str, lights)),
    )


def _onward(lane: Lanelet, lanes: Lanelets) -> tuple[int, ...]:
    """The lanes that begin where one ends."""
    begins = np.array([other.centerline[0] for other in lanes.values()])
    near = np.hypot(*(begins - lane.centerline[-1]).T) <= JOIN_M
    return tuple(j for j in np.array(list(lanes))[near].tolist() if j != lane.id)


def _width(lane: Lanelet, lanes: Lanelets) -> float:
    """Width by the map, by the distance to a neighbour's line, or the usual width, m."""
    if math.isfinite(lane.width_m):
        return lane.width_m
    few = lane.centerline[:: max(len(lane.centerline) // 8, 1)]
    for beside in (lane.left, lane.right):
        if beside is not None and beside in lanes:
            apart = few[:, None] - lanes[beside].centerline[None, ::2]
            width = float(np.median(np.hypot(*np.moveaxis(apart, -1, 0)).min(axis=1)))
            if NARROWEST_M <= width <= WIDEST_M:
                return width
    return WIDTH_M


def _crossing(label: str, outline: FloatArray) -> Crossing:
    """A crosswalk's middle line along its longer side, and its width."""
    middle = outline.mean(axis=0)
    _, _, axes = np.linalg.svd(outline - middle, full_matrices=False)
    along, across = ((outline - middle) @ axis for axis in axes)
    ends = np.array([along.min(), along.max()])
    return Crossing(
        label, middle + ends[:, None] * axes[0], float(np.ptp(across)), (), priority=False
    )
