"""A scenario of a driving dataset in a common form, which becomes a recording.

Waymo's records, the JSON made from them and ScenarioNet's dictionaries hold the same things: agents
by steps, lanes with their successors, crosswalks, and what each lane's light showed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, recorded
from sim.frames import AgentKind, FloatArray, Signal
from sim.road.maps.lanelets import Lanelet
from sim.road.maps.waymo import waymo_road

STATES: Final = (
    Signal.OFF, Signal.RED, Signal.YELLOW, Signal.GREEN, Signal.RED, Signal.YELLOW, Signal.GREEN,
    Signal.RED, Signal.YELLOW,
)  # fmt: skip
"""What lights show, by the format's number: unknown; stop, caution and go as arrows, then as discs;
flashing stop and caution."""

VALUES: Final = ("x", "y", "heading", "speed", "length", "width")
"""What is known of an agent at each step, in this order."""


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
        lights: what the lights show at each step: index into `STATES` by lane.
        behaviors: codes into ``BEHAVIORS``, by agent's name.
        left_out: how many objects are no road-agents.
    """

    path: Path
    name: str
    time_s: FloatArray
    agents: list[tuple[str, AgentKind, NDArray[np.int64], FloatArray]] = field(default_factory=list)
    lanes: list[Lanelet] = field(default_factory=list)
    crosswalks: dict[str, FloatArray] = field(default_factory=dict)
    lights: list[dict[int, int]] = field(default_factory=list)
    behaviors: dict[str, int] = field(default_factory=dict)
    left_out: int = 0


def recording_of(scene: DrivingScene) -> Recording:
    """The scenario as a recording with its road.

    Raises:
        InputError: if its times do not increase.
    """
    time_s = scene.time_s
    if not time_s.size or not (np.diff(time_s) > 0).all() or not (np.abs(time_s) < 1e9).all():
        raise InputError(f"timestamps: found {time_s.size}, expected some that increase")
    seen_s = time_s - time_s[0]
    for *_, states in scene.agents:  # sizes are measured anew at each step
        known = states[(states[:, 4:] > 0).all(axis=1), 4:]
        if len(known):
            states[:, 4:] = np.median(known, axis=0)
    values = [np.empty((0, len(VALUES))), *(agent[3] for agent in scene.agents)]
    rows = pandas.DataFrame(np.concatenate(values), columns=VALUES)
    counts = [len(agent[2]) for agent in scene.agents]
    rows["id"] = np.repeat(np.array([agent[0] for agent in scene.agents], dtype=object), counts)
    rows["kind"] = np.repeat(np.array([a[1].code for a in scene.agents], dtype=int), counts)
    steps = [np.empty(0, dtype=np.int64), *(agent[2] for agent in scene.agents)]
    rows["t"] = seen_s[np.concatenate(steps)]
    recording = recorded(scene.name, rows, empty_s=seen_s.tolist()).with_codes(scene.behaviors)
    lights = sorted({lane for shown in scene.lights for lane in shown})
    road = waymo_road(scene.path, scene.name, scene.lanes, scene.crosswalks, lights)
    notes = ["vehicles are taken for cars, whatever they are"]
    if scene.left_out:
        notes.append(f"left out, because they are not road-agents: {scene.left_out} objects")
    tracks = recording.tracks
    if road is not None:
        codes = np.full((len(lights), time_s.size), Signal.OFF.code, dtype=np.int8)
        for step, shown in enumerate(scene.lights[: time_s.size]):
            for lane, state in shown.items():
                codes[lights.index(lane), step] = STATES[state].code
        tracks = replace(tracks, signals=codes)
        notes.append("widths of lanes are told from neighbours, or assumed to be 3.5 m")
        if road.knows.unknown:
            notes.append(f"not in the map: {', '.join(road.knows.unknown)}")
    return replace(recording, tracks=tracks, notes=tuple(notes), road=road, own_road=True)
