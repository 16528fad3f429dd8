"""A scenario of a driving dataset in a common form, which becomes a recording.

Waymo's records, the JSON made from them and ScenarioNet's dictionaries hold the same things: agents
by steps, lanes with their successors, crosswalks, and what each lane's light showed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, Rows, assemble
from sim.frames import AgentKind, Signal
from sim.road.maps.waymo import WaymoLane, waymo_road

FloatArray = NDArray[np.float64]

STATES: Final = (
    Signal.OFF, Signal.RED, Signal.YELLOW, Signal.GREEN, Signal.RED, Signal.YELLOW, Signal.GREEN,
    Signal.RED, Signal.YELLOW,
)  # fmt: skip
"""What lights show, by the format's number: unknown; stop, caution and go as arrows, then as discs;
flashing stop and caution."""

ROWS: Final = ("x", "y", "heading", "speed", "length", "width")


@dataclass
class DrivingScene:
    """A scenario of a driving dataset, whichever file it was read from.

    Attributes:
        path: its file.
        name: its own name.
        time_s: (T,) of the steps, s.
        names: of the agents.
        kinds: of the agents.
        steps: of each agent, the steps at which it is seen.
        values: of each agent and of these steps: x, y, heading, speed, length and width.
        lanes: of the map.
        crosswalks: (P, 2) outline of each, m, by id.
        lights: what the lights show at each step: index into `STATES` by lane.
        left_out: how many objects are no road-agents.
        behavior: codes into ``BEHAVIORS`` of the agents (-1: none); [] where nobody has one.
    """

    path: Path
    name: str
    time_s: FloatArray
    names: list[str]
    kinds: list[AgentKind]
    steps: list[list[int]]
    values: list[list[tuple[float, ...]]]
    lanes: list[WaymoLane]
    crosswalks: dict[str, FloatArray]
    lights: list[dict[int, int]]
    left_out: int = 0
    behavior: list[int] = field(default_factory=list)


def recording_of(scene: DrivingScene) -> Recording:
    """The scenario as a recording with its road.

    Raises:
        InputError: if its times do not increase, or an id is twice.
    """
    path = scene.path
    if not scene.time_s.size:
        raise InputError(f"{path}: found no timestamps, expected some")
    if not (np.diff(scene.time_s) > 0).all() or not (np.abs(scene.time_s) < 1e9).all():
        raise InputError(f"{path}: timestamps_seconds: found times that do not increase")
    seen = [i for i, steps in enumerate(scene.steps) if steps]
    counts = [len(scene.steps[i]) for i in seen]
    step = np.array([s for i in seen for s in scene.steps[i]], dtype=np.int64)
    table = np.array([row for i in seen for row in scene.values[i]], dtype=np.float64)
    table = table.reshape(-1, len(ROWS))
    sizes = np.array(
        [np.median([row[4:] for row in scene.values[i]], axis=0) for i in seen]
    ).reshape(-1, 2)
    names = [scene.names[i] for i in seen]
    if len(set(names)) != len(names):
        raise InputError(f"{path}: tracks: found an id twice, expected each once")
    behavior = np.array(scene.behavior, dtype=np.int8)[seen] if scene.behavior else None
    lights = sorted({lane for shown in scene.lights for lane in shown})
    tracks = assemble(
        path,
        Rows.of(
            np.repeat(np.arange(len(seen)), counts),
            names,
            scene.time_s[step] - scene.time_s[0],
            table[:, :2],
            table[:, 2],
            table[:, 3],
            [scene.kinds[i] for i in seen],
            sizes,
            behavior=behavior,
            empty_s=tuple((scene.time_s - scene.time_s[0]).tolist()),
        ),
    )
    road = waymo_road(path, scene.name, scene.lanes, scene.crosswalks, lights)
    notes = ["vehicles are taken for cars, whatever they are"]
    if scene.left_out:
        notes.append(f"left out, because they are not road-agents: {scene.left_out} objects")
    if road is not None:
        tracks = tracks.changed(signals=_signals(scene, lights))
        notes.append("widths of lanes are told from neighbours, or assumed to be 3.5 m")
        if road.knows.unknown:
            notes.append(f"not in the map: {', '.join(road.knows.unknown)}")
    return Recording(scene.name, tracks, tuple(notes), road)


def _signals(scene: DrivingScene, lights: Sequence[int]) -> NDArray[np.int8]:
    """(lights, T) codes of what they show; off where a light was not seen."""
    group = {lane: i for i, lane in enumerate(lights)}
    codes = np.full((len(lights), scene.time_s.size), Signal.OFF.code, dtype=np.int8)
    for t, shown in enumerate(scene.lights[: scene.time_s.size]):
        for lane, state in shown.items():
            codes[group[lane], t] = STATES[state].code
    return codes
