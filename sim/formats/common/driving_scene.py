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
from sim.formats.common.recording import Recording, Rows, assemble, kind_codes
from sim.frames import AgentKind, Signal
from sim.road.maps.waymo import WaymoLane, waymo_road
from sim.track_rows import MAX_CELLS

FloatArray = NDArray[np.float64]

STATES: Final = (
    Signal.OFF, Signal.RED, Signal.YELLOW, Signal.GREEN, Signal.RED, Signal.YELLOW, Signal.GREEN,
    Signal.RED, Signal.YELLOW,
)  # fmt: skip
"""What lights show, by the format's number: unknown; stop, caution and go as arrows, then as discs;
flashing stop and caution."""

MAX_OBJECTS: Final = 10_000
"""Most objects of a scenario (scenarios have some 100)."""

MAX_STEPS: Final = 10_000
"""Most steps of a scenario (scenarios have 91, or 198)."""

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
        InputError: if it is larger than any, its times do not increase, or an id is twice.
    """
    path = scene.path
    if len(scene.names) * scene.time_s.size > MAX_CELLS:
        raise InputError(f"{path}: found more than {MAX_CELLS} objects times steps")
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
        Rows(
            agent=np.repeat(np.arange(len(seen)), counts),
            names=tuple(names),
            time_s=scene.time_s[step] - scene.time_s[0] if step.size else np.empty(0),
            x=table[:, 0],
            y=table[:, 1],
            heading=table[:, 2],
            speed=table[:, 3],
            length=sizes[:, 0],
            width=sizes[:, 1],
            kind=kind_codes([scene.kinds[i] for i in seen]),
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


def check_counts(where: str, objects: int, steps: int) -> None:
    """Refuse scenarios that are too large, or have no times.

    Raises:
        InputError: if it is so.
    """
    if objects > MAX_OBJECTS or steps > MAX_STEPS:
        raise InputError(
            f"{where}: found {objects} objects and {steps} steps, expected at most {MAX_OBJECTS} "
            f"and {MAX_STEPS}"
        )
    if steps == 0:
        raise InputError(f"{where}: found no timestamps, expected some")
