"""Reads ScenarioNet's dictionaries, which MetaDrive and the converters around it write.

They are pickles, of which only plain data are taken; nothing in them is run. Positions and sizes
are in metres, headings in radians; where ``ts`` is missing, a step is 0.1 s.

References:
    Li et al. (2023), ScenarioNet, NeurIPS Datasets and Benchmarks; MetaDrive's
    ``ScenarioDescription`` and ``MetaDriveType``.
"""

from __future__ import annotations

import io
import math
import pickle
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from sim.formats.common.driving_scene import STATES, DrivingScene, SceneAgent, recording_of
from sim.formats.common.recording import Recording
from sim.frames import AgentKind, Signal
from sim.input_files import read_bytes, stem
from sim.road.maps.waymo import MPS_PER_MPH, WaymoLane

FloatArray = NDArray[np.float64]

PLAIN: Final = frozenset(
    {
        *(f"numpy.{core}.{name}" for core in ("core", "_core") for name in
          ("multiarray._reconstruct", "multiarray.scalar", "numeric._frombuffer")),
        "numpy.ndarray", "numpy.dtype", "_codecs.encode", "collections.OrderedDict",
        "collections.defaultdict", "builtins.set", "builtins.frozenset", "builtins.list",
        "builtins.dict", "builtins.bytearray",
    }
)  # fmt: skip
"""Names that pickled plain data need; every other name stands for `Unknown`."""

DICTIONARIES: Final = frozenset({"ScenarioDescription", "Dict", "EasyDict", "Config"})
"""Classes that are dictionaries with a name."""

PERIOD_S: Final = 0.1
"""Time between two steps where the file does not say it, s (ScenarioNet's own rate)."""

KINDS: Final = {
    "VEHICLE": AgentKind.CAR,
    "PEDESTRIAN": AgentKind.PEDESTRIAN,
    "CYCLIST": AgentKind.BICYCLE,
}
"""Types of objects that are road-agents; cones, barriers and the like are left out."""

LANES: Final = {
    "LANE_UNKNOWN": 0, "LANE_FREEWAY": 1, "LANE_SURFACE_STREET": 2, "LANE_BIKE_LANE": 3,
    "LANE_SURFACE_UNSTRUCTURE": 2,
}  # fmt: skip
"""Types of lanes, by Waymo's numbers; an unstructured one is a way across a junction."""

LIGHTS: Final = (
    ("RED", Signal.RED), ("STOP", Signal.RED), ("YELLOW", Signal.YELLOW),
    ("CAUTION", Signal.YELLOW), ("GREEN", Signal.GREEN), ("GO", Signal.GREEN),
)  # fmt: skip
"""What a light shows, by the end of its word; it is off where none fits."""

BEHAVIOR_CODES: Final = {str(behavior): code for code, behavior in enumerate(BEHAVIORS)}


def read(path: Path) -> Iterator[Recording]:
    """Read the scenario of a file.

    Args:
        path: ``sd_*.pkl``.

    Yields:
        The recording, with its road.

    Raises:
        InputError: if the file is broken, or holds something else; the message names the field.
    """
    found = PlainUnpickler(io.BytesIO(read_bytes(path))).load()
    if not isinstance(found, Mapping) or "tracks" not in found:
        raise InputError(f"{path}: found no tracks, expected a dictionary of ScenarioNet")
    yield recording_of(_scene(path, found))


class Unknown:
    """Stands for an object of a class that is not plain data; it does nothing."""

    def __init__(self, *given: object, **named: object) -> None:
        """Take any arguments."""

    def __setstate__(self, state: object) -> None:
        """Take any state."""


class Named(dict[Any, Any]):
    """Stands for ScenarioNet's own class of dictionaries."""


class PlainUnpickler(pickle.Unpickler):
    """Unpickles plain data and numpy's arrays; nothing else in a pickle is imported or called.

    Examples:
        >>> type(PlainUnpickler(io.BytesIO(pickle.dumps(print))).load())
        <class 'type'>
        >>> PlainUnpickler(io.BytesIO(pickle.dumps({"x": np.arange(3.0)}))).load()
        {'x': array([0., 1., 2.])}
    """

    def find_class(self, module: str, name: str) -> Any:
        """The function of a name that plain data need, else `Unknown`."""
        module = "builtins" if module == "__builtin__" else module
        if name in DICTIONARIES:
            return Named
        return super().find_class(module, name) if f"{module}.{name}" in PLAIN else Unknown


def _scene(path: Path, found: Mapping[str, Any]) -> DrivingScene:
    tracks = _dictionary(found["tracks"])
    metadata = _dictionary(found.get("metadata", {}))
    steps = max((len(_dictionary(t["state"])["position"]) for t in tracks.values()), default=0)
    if found.get("length", steps) != steps:
        raise InputError(f"{path}: length: found {found['length']!r:.40}, expected {steps} states")
    times = metadata.get("ts", metadata.get("timestep"))
    stated = np.arange(steps) * PERIOD_S if times is None else _column(times, steps)
    if stated.shape != (steps,):
        raise InputError(f"{path}: ts: found {stated.size} times, expected {steps}")
    time_s: FloatArray = stated.astype(np.float64)
    if stated.dtype == np.float32:
        # Single precision tells a step of .1 s to a ten-millionth only, and late times worse.
        time_s = np.round(time_s, 4)
    name = _word(found.get("id")) or _word(metadata.get("scenario_id")) or stem(path)
    scene = DrivingScene(path, name, time_s, lights=[{} for _ in range(steps)])
    for label, track in tracks.items():
        kind = KINDS.get(_word(_dictionary(track)["type"]))
        if kind is None:
            scene.left_out += 1
            continue
        _add_agent(scene, _word(label), kind, track)
    numbers = _add_map(scene, _dictionary(found.get("map_features", {})))
    _add_lights(scene, _dictionary(found.get("dynamic_map_states", {})), numbers)
    return scene


def _add_agent(scene: DrivingScene, name: str, kind: AgentKind, track: Mapping[str, Any]) -> None:
    """Take in where an agent was."""
    state, steps = _dictionary(track["state"]), scene.time_s.size
    size = state.get("size", state.get("dimension"))
    sides = None if size is None else _numbers(size, None)
    if sides is not None:
        sides = np.broadcast_to(sides, (steps, sides.shape[-1]))
    place, velocity = _numbers(state["position"], 2), _numbers(state["velocity"], 2)
    columns = [
        _column(state["valid"], steps).astype(bool),
        place[:, 0],
        place[:, 1],
        _column(state["heading"], steps),
        np.hypot(velocity[:, 0], velocity[:, 1]),
    ]
    for k, side in enumerate(("length", "width")):
        given = state[side] if side in state or sides is None else sides[:, k]
        columns.append(_column(given, steps))
    if any(column.shape != (steps,) for column in columns):
        raise InputError(f"{scene.path}: tracks: {name}: found states that are not {steps}")
    seen = np.flatnonzero(columns[0])
    table = np.stack(columns[1:], axis=1)[seen].astype(np.float64)
    behavior = _dictionary(track.get("metadata", {})).get("behavior")
    code = BEHAVIOR_CODES.get(_word(behavior), -1)
    scene.agents.append(SceneAgent(name, kind, seen, table, code))


def _column(values: Any, steps: int) -> NDArray[Any]:
    """A number of each step; some converters write one for all, or a column of a table."""
    found = _numbers(values, None)
    if found.ndim == 2 and found.shape[1] == 1:
        found = found[:, 0]
    return np.full(steps, found) if found.ndim == 0 else found


def _add_map(scene: DrivingScene, features: Mapping[Any, Any]) -> dict[str, int]:
    """Take in lanes and crosswalks; gives the number of each lane by its name."""
    lanes = {
        _word(name): feature for name, feature in features.items()
        if _word(_dictionary(feature)["type"]) in LANES
    }  # fmt: skip
    numbers = {name: number for number, name in enumerate(lanes)}
    if all(name.isascii() and name.isdecimal() and len(name) < 16 for name in numbers):
        numbers = {name: int(name) for name in numbers}
    for name, feature in lanes.items():
        kind = _word(feature["type"])
        beside = [_first(feature, f"{side}_neighbor", numbers) for side in ("left", "right")]
        scene.lanes.append(
            WaymoLane(
                id=numbers[name],
                line=_points(feature["polyline"]),
                limit_mph=_limit_mph(feature),
                type=LANES[kind],
                interpolating=kind == "LANE_SURFACE_UNSTRUCTURE"
                or bool(feature.get("interpolating", False)),
                before=_known(feature.get("entry_lanes"), numbers),
                after=_known(feature.get("exit_lanes"), numbers),
                left=beside[0],
                right=beside[1],
                width_m=_width(scene.path, feature),
            )
        )
    for name, feature in features.items():
        if _word(feature["type"]) == "CROSSWALK" and "polygon" in feature:
            scene.crosswalks[_word(name)] = _points(feature["polygon"])
    return numbers


def _width(path: Path, feature: Mapping[str, Any]) -> float:
    """The lane's width, which ours says and converters mostly give at every point, m."""
    width = feature.get("width")
    if width is None or np.ndim(width) != 0:
        return math.nan
    if not 0.0 < float(width) <= 100.0:
        raise InputError(f"{path}: map_features: found a width of {float(width):g} m")
    return float(width)


def _limit_mph(feature: Mapping[str, Any]) -> float:
    """The limit, miles per hour; NaN where it is unknown (converters write none or 0)."""
    if feature.get("speed_limit_mph"):
        return float(feature["speed_limit_mph"])
    limit = feature.get("speed_limit_kmh")
    return float(limit) / 3.6 / MPS_PER_MPH if limit else math.nan


def _known(names: Any, numbers: Mapping[str, int]) -> tuple[int, ...]:
    """Numbers of the lanes that are named and there, at most 16."""
    plain = () if names is None or isinstance(names, str) else tuple(names)[:16]
    return tuple(numbers[_word(name)] for name in plain if _word(name) in numbers)


def _first(feature: Mapping[str, Any], key: str, numbers: Mapping[str, int]) -> int | None:
    """The first neighbour: a name, or Waymo's record of one."""
    beside = feature.get(key) or ()
    one = beside[0] if isinstance(beside, Sequence) and len(beside) else None
    if isinstance(one, Mapping):
        one = one.get("feature_id")
    return numbers.get(_word(one))


def _add_lights(scene: DrivingScene, states: Mapping[Any, Any], numbers: Mapping[str, int]) -> None:
    """Take in what the lights of known lanes show."""
    by_signal = {signal: STATES.index(signal) for _, signal in LIGHTS}
    for name, light in states.items():
        lane = numbers.get(_word(_dictionary(light).get("lane", name)))
        if lane is None:
            continue
        state = light["state"]
        words = _dictionary(state)["object_state"] if isinstance(state, Mapping) else state
        for step, word in enumerate(list(words)[: scene.time_s.size]):
            shown = (signal for end, signal in LIGHTS if _word(word).upper().endswith(end))
            scene.lights[step][lane] = by_signal.get(next(shown, Signal.OFF), 0)


def _word(value: Any) -> str:
    """A name, which may be a number; "" for anything else, whose text might be endless."""
    return str(value)[:100] if isinstance(value, str | int) else ""


def _dictionary(value: Any) -> Mapping[Any, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"found {str(value)[:40]!r}, expected a dictionary of named values")
    return value


def _numbers(values: Any, sides: int | None) -> NDArray[Any]:
    """An array of numbers with so many sides; None for any."""
    found = np.asarray(values)
    if found.dtype.kind not in "biuf" or (sides is not None and found.ndim != sides):
        kind = f"{found.ndim} sides" if found.dtype.kind in "biuf" else "words"
        raise InputError(f"found values with {kind}, expected numbers with {sides or 1}")
    return found


def _points(values: Any) -> FloatArray:
    """(P, 2) points, m; heights go."""
    found = _numbers(values, 2) if len(values) else np.empty((0, 2))
    return np.asarray(found[:, :2], dtype=np.float64)
