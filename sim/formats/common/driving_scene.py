"""A scenario of a driving dataset in a common form, which becomes a recording.

Waymo's records, the JSON made from them and ScenarioNet's dictionaries hold the same things: agents
by steps, lanes with their successors, crosswalks, and what each lane's light showed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, Rows, recorded
from sim.frames import AgentKind, FloatArray, Signal
from sim.road.maps.waymo import WaymoLane, waymo_road

STATES: Final = (
    Signal.OFF, Signal.RED, Signal.YELLOW, Signal.GREEN, Signal.RED, Signal.YELLOW, Signal.GREEN,
    Signal.RED, Signal.YELLOW,
)  # fmt: skip
"""What lights show, by the format's number: unknown; stop, caution and go as arrows, then as discs;
flashing stop and caution."""


@dataclass(frozen=True)
class SceneAgent:
    """An agent of a scenario.

    Attributes:
        name: its own name.
        kind: what it is.
        steps: (k,) the steps at which it is seen.
        values: (k, 6) x, y, heading, speed, length and width at these steps.
        behavior: code into ``BEHAVIORS``; -1 where it has none.
    """

    name: str
    kind: AgentKind
    steps: NDArray[np.int64]
    values: FloatArray
    behavior: int = -1


@dataclass
class DrivingScene:
    """A scenario of a driving dataset, whichever file it was read from.

    Attributes:
        path: its file.
        name: its own name.
        time_s: (T,) of the steps, s.
        agents: that are road-agents.
        lanes: of the map.
        crosswalks: (P, 2) outline of each, m, by id.
        lights: what the lights show at each step: index into `STATES` by lane.
        left_out: how many objects are no road-agents.
    """

    path: Path
    name: str
    time_s: FloatArray
    agents: list[SceneAgent] = field(default_factory=list)
    lanes: list[WaymoLane] = field(default_factory=list)
    crosswalks: dict[str, FloatArray] = field(default_factory=dict)
    lights: list[dict[int, int]] = field(default_factory=list)
    left_out: int = 0


def recording_of(scene: DrivingScene) -> Recording:
    """The scenario as a recording with its road.

    Raises:
        InputError: if its times do not increase, or an id is twice.
    """
    path, time_s = scene.path, scene.time_s
    if not time_s.size or not (np.diff(time_s) > 0).all() or not (np.abs(time_s) < 1e9).all():
        raise InputError(f"{path}: timestamps: found {time_s.size}, expected some that increase")
    seen = [agent for agent in scene.agents if len(agent.steps)]
    names = [agent.name for agent in seen]
    if len(set(names)) != len(names):
        raise InputError(f"{path}: tracks: found an id twice, expected each once")
    table = np.concatenate([np.empty((0, 6)), *(agent.values for agent in seen)])
    steps = np.concatenate([np.empty(0, dtype=np.int64), *(agent.steps for agent in seen)])
    behavior = np.array([agent.behavior for agent in seen], dtype=np.int8)
    recording = recorded(
        path,
        scene.name,
        Rows(
            np.repeat(np.arange(len(seen)), [len(agent.steps) for agent in seen]),
            names,
            time_s[steps] - time_s[0],
            table[:, :2],
            table[:, 2],
            table[:, 3],
            [agent.kind for agent in seen],
            np.array([_size(agent.values[:, 4:]) for agent in seen]).reshape(-1, 2),
            behavior=behavior if (behavior >= 0).any() else None,
            empty_s=(time_s - time_s[0]).tolist(),
        ),
    )
    lights = sorted({lane for shown in scene.lights for lane in shown})
    road = waymo_road(path, scene.name, scene.lanes, scene.crosswalks, lights)
    notes = ["vehicles are taken for cars, whatever they are"]
    if scene.left_out:
        notes.append(f"left out, because they are not road-agents: {scene.left_out} objects")
    tracks = recording.tracks
    if road is not None:
        tracks = replace(tracks, signals=_signals(scene, lights))
        notes.append("widths of lanes are told from neighbours, or assumed to be 3.5 m")
        if road.knows.unknown:
            notes.append(f"not in the map: {', '.join(road.knows.unknown)}")
    return replace(recording, tracks=tracks, notes=tuple(notes), road=road, own_road=True)


def _size(sides: FloatArray) -> FloatArray:
    """(2,) the median length and width of the steps that have both; of none, the first ones."""
    known = (sides > 0).all(axis=1)
    return np.asarray(np.median(sides[known], axis=0) if known.any() else sides[0])


def _signals(scene: DrivingScene, lights: Sequence[int]) -> NDArray[np.int8]:
    """(lights, T) codes of what they show; off where a light was not seen."""
    group = {lane: i for i, lane in enumerate(lights)}
    codes = np.full((len(lights), scene.time_s.size), Signal.OFF.code, dtype=np.int8)
    for t, shown in enumerate(scene.lights[: scene.time_s.size]):
        for lane, state in shown.items():
            codes[group[lane], t] = STATES[state].code
    return codes
