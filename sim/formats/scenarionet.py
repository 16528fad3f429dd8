"""ScenarioNet: one pickled dictionary per scenario, for MetaDrive and the tools around it.

Of a pickle only plain data are taken; nothing in it is run. Positions and sizes are in metres,
headings in radians; where ``ts`` is missing, a step is 0.1 s. Beside the episodes,
``dataset_summary.pkl`` says what each holds, and ``dataset_mapping.pkl`` where it is.

References:
    Li et al. (2023), ScenarioNet, NeurIPS Datasets and Benchmarks; MetaDrive's
    ``ScenarioDescription`` and ``MetaDriveType``.
"""

from __future__ import annotations

import io
import math
import pickle
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from sim.files import write_whole
from sim.formats.common.driving_scene import STATES, DrivingScene, recording_of
from sim.formats.common.recording import Recording
from sim.frames import KINDS, AgentKind, FloatArray, Signal, Tracks
from sim.input_files import read_bytes, stem
from sim.road import Road
from sim.road.maps.lanelets import Lanelet
from sim.units import in_si

# --- reading ------------------------------------------------------------------------------------

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

READ_KINDS: Final = {
    "VEHICLE": AgentKind.CAR,
    "PEDESTRIAN": AgentKind.PEDESTRIAN,
    "CYCLIST": AgentKind.BICYCLE,
}
"""Types of objects that are road-agents; cones, barriers and the like are left out."""

BIKE_LANE: Final = "LANE_BIKE_LANE"
LANES: Final = frozenset({
    "LANE_UNKNOWN", "LANE_FREEWAY", "LANE_SURFACE_STREET", BIKE_LANE, "LANE_SURFACE_UNSTRUCTURE",
})  # fmt: skip
"""Types of lanes; an unstructured one is a way across a junction."""

LIGHTS: Final = (
    ("RED", Signal.RED), ("STOP", Signal.RED), ("YELLOW", Signal.YELLOW),
    ("CAUTION", Signal.YELLOW), ("GREEN", Signal.GREEN), ("GO", Signal.GREEN),
)  # fmt: skip
"""What a light shows, by the end of its word; it is off where none fits."""

BEHAVIOR_CODES: Final = {str(behavior): code for code, behavior in enumerate(BEHAVIORS)}


def read(path: Path) -> Iterator[Recording]:
    """The recording of the scenario in one ``sd_*.pkl``, with its road."""
    found = PlainUnpickler(io.BytesIO(read_bytes(path))).load()
    if not isinstance(found, Mapping) or not isinstance(found.get("tracks"), Mapping):
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
    tracks, metadata = found["tracks"], found.get("metadata", {})
    steps = max((len(track["state"]["position"]) for track in tracks.values()), default=0)
    if found.get("length", steps) != steps:
        raise InputError(f"{path}: length: found {found['length']!r:.40}, expected {steps} states")
    times = metadata.get("ts", metadata.get("timestep"))
    stated = np.arange(steps) * PERIOD_S if times is None else _column("ts", times, steps)
    time_s: FloatArray = stated.astype(np.float64)
    if stated.dtype == np.float32:
        # Single precision tells a step of .1 s to a ten-millionth only, and late times worse.
        time_s = np.round(time_s, 4)
    name = _word(found.get("id")) or _word(metadata.get("scenario_id")) or stem(path)
    scene = DrivingScene(path, name, time_s, lights=[{} for _ in range(steps)])
    for label, track in tracks.items():
        kind = READ_KINDS.get(_word(track["type"]))
        if kind is None:
            scene.left_out += 1
            continue
        scene.agents.append((_word(label), kind, *_states(track["state"], steps)))
        behavior = _word(track.get("metadata", {}).get("behavior"))
        scene.behaviors[_word(label)] = BEHAVIOR_CODES.get(behavior, -1)
    numbers = _add_map(scene, found.get("map_features", {}))
    for name, light in found.get("dynamic_map_states", {}).items():
        lane = numbers.get(_word(light.get("lane", name)))
        if lane is None:
            continue
        state = light["state"]
        words = state["object_state"] if isinstance(state, Mapping) else state
        for shown, word in zip(scene.lights, words, strict=False):
            shown[lane] = _light(_word(word))
    return scene


def _states(state: Mapping[str, Any], steps: int) -> tuple[NDArray[np.int64], FloatArray]:
    """The steps at which an agent is seen, and what is known of it there."""
    size = state.get("size", state.get("dimension"))
    if size is not None:
        size = np.broadcast_to(_numbers("size", size), (steps, np.shape(size)[-1]))
    length, width = (
        state[side] if side in state or size is None else size[:, k]
        for k, side in enumerate(("length", "width"))
    )
    x, y = _points(state["position"]).T
    columns = {"x": x, "y": y, "heading": state["heading"],
               "velocity": np.hypot(*_points(state["velocity"]).T), "length": length,
               "width": width}  # fmt: skip
    table = np.stack([_column(field, values, steps) for field, values in columns.items()], axis=1)
    seen = np.flatnonzero(_column("valid", state["valid"], steps).astype(bool))
    return seen, table[seen].astype(np.float64)


def _column(field: str, values: Any, steps: int) -> NDArray[Any]:
    """A number of each step; some converters write one for all, or a column of a table."""
    found = _numbers(field, values)
    if found.ndim == 2 and found.shape[1] == 1:
        found = found[:, 0]
    if found.ndim and found.shape != (steps,):
        raise InputError(f"{field}: found {found.shape} numbers, expected one of each of {steps}")
    return np.broadcast_to(found, (steps,))


def _numbers(field: str, values: Any) -> NDArray[Any]:
    """An array of numbers."""
    found = np.asarray(values)
    if found.dtype.kind not in "biuf":
        raise InputError(f"{field}: found no numbers, expected some")
    return found


def _points(values: Any) -> FloatArray:
    """(P, 2) points, m; heights go."""
    found = _numbers("points", values).reshape(len(values), -1) if len(values) else np.empty((0, 2))
    return np.asarray(found[:, :2], dtype=np.float64)


def _word(value: Any) -> str:
    """A name, which may be a number; "" for anything else, whose text might be endless."""
    return str(value)[:100] if isinstance(value, str | int) else ""


def _light(word: str) -> int:
    """What a light shows, as an index into `STATES`."""
    signals = (signal for end, signal in LIGHTS if word.upper().endswith(end))
    return STATES.index(next(signals, Signal.OFF))


def _add_map(scene: DrivingScene, features: Mapping[Any, Any]) -> dict[str, int]:
    """Take in lanes and crosswalks; gives the number of each lane by its name."""
    lanes = {_word(name): one for name, one in features.items() if _word(one["type"]) in LANES}
    numbers = {name: number for number, name in enumerate(lanes)}
    if all(name.isascii() and name.isdecimal() and len(name) < 16 for name in numbers):
        numbers = {name: int(name) for name in numbers}

    def known(names: Any) -> tuple[int, ...]:
        """Numbers of lanes by their names, or by Waymo's records of them."""
        words = [_word(one.get("feature_id") if isinstance(one, Mapping) else one) for one in names]
        return tuple(numbers[word] for word in words if word in numbers)

    for name, lane in lanes.items():
        before, after, left, right = (
            known(tuple(lane.get(key) or ())[:16])
            for key in ("entry_lanes", "exit_lanes", "left_neighbor", "right_neighbor")
        )
        # converters write none or 0 for an unknown limit, and mostly a width at every point
        limit_mph, limit_kmh = (
            float(lane.get(f"speed_limit_{unit}") or math.nan) for unit in ("mph", "kmh")
        )
        limits = in_si(limit_mph, "mph"), in_si(limit_kmh, "km/h")
        width = lane.get("width")
        width_m = math.nan if width is None or np.ndim(width) else float(width)
        if not (math.isnan(width_m) or 0.0 < width_m <= 100.0):
            raise InputError(f"map_features: found a width of {width_m:g} m, expected up to 100")
        unstructured = lane["type"] == "LANE_SURFACE_UNSTRUCTURE"
        scene.lanes.append(
            Lanelet(
                id=numbers[name],
                centerline=_points(lane["polyline"]),
                limit_mps=limits[1] if math.isnan(limit_mph) else limits[0],
                cars=lane["type"] != BIKE_LANE,
                internal=unstructured or bool(lane.get("interpolating", False)),
                predecessors=before,
                successors=after,
                left=left[0] if left else None,
                right=right[0] if right else None,
                width_m=width_m,
            )
        )
    for name, feature in features.items():
        if _word(feature["type"]) == "CROSSWALK" and "polygon" in feature:
            scene.crosswalks[_word(name)] = _points(feature["polygon"])
    return numbers


# --- writing ------------------------------------------------------------------------------------

VERSION: Final = "0.1"
SUMMARY, MAPPING = "dataset_summary.pkl", "dataset_mapping.pkl"
"""Names of the files that MetaDrive looks for in a folder."""

MOVED_M: Final = 1.0
"""An agent that goes farther than this is counted as moving, m (MetaDrive's number)."""

HEIGHT_M: Final = 1.6
"""Height that is written for everyone, m: the format wants one and traffic here is flat."""

TYPES: Final[dict[AgentKind, str]] = {
    AgentKind.CAR: "VEHICLE",
    AgentKind.BUS: "VEHICLE",
    AgentKind.TRUCK: "VEHICLE",
    AgentKind.MOTORCYCLE: "CYCLIST",
    AgentKind.BICYCLE: "CYCLIST",
    AgentKind.PEDESTRIAN: "PEDESTRIAN",
}
"""MetaDrive's type of each kind."""


def _flat(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P, 3) points of height 0."""
    return np.concatenate([points, np.zeros((len(points), 1))], axis=1)


def description(name: str, tracks: Tracks, road: Road | None = None) -> dict[str, Any]:
    """An episode as the format's dictionary, of plain numbers, words and numpy arrays.

    Args:
        name: the episode's id.
        tracks: the episode.
        road: where it happened; without it there are no map features.

    Returns:
        The dictionary; numbers are 0 where an agent is not valid.
    """
    heading, speed, valid = tracks.heading, tracks.speed, tracks.valid
    velocity = np.stack([speed * np.cos(heading), speed * np.sin(heading)], axis=2)
    steps = int(tracks.time_s.size)
    agents: dict[str, Any] = {}
    for i, label in enumerate(tracks.names):
        code = -1 if tracks.behavior is None else int(tracks.behavior[i])
        series = {
            "position": _flat(tracks.xy[i]),
            "heading": heading[i],
            "velocity": velocity[i],
            "length": tracks.length[i],
            "width": tracks.width[i],
            "height": HEIGHT_M,
        }
        state: dict[str, Any] = {}
        for field, own in series.items():
            seen = valid[i][:, None] if np.ndim(own) == 2 else valid[i]
            state[field] = np.where(seen, own, 0.0).astype(np.float32)
            if field == "velocity":
                state["valid"] = valid[i].copy()
        agents[label] = {
            "type": TYPES[KINDS[tracks.kind[i]]],
            "state": state,
            "metadata": {
                "track_length": steps,
                "type": TYPES[KINDS[tracks.kind[i]]],
                "object_id": label,
                "behavior": str(tracks.classes[code]) if code >= 0 else None,
            },
        }
    summary = {key: _object_summary(key, agent) for key, agent in agents.items()}
    features = {} if road is None else _map_features(road)
    longest = int(np.argmax(valid.sum(axis=1))) if len(tracks.names) else 0
    return {
        "id": name,
        "version": VERSION,
        "length": steps,
        "metadata": {
            "id": name,
            "ts": np.asarray(tracks.time_s, dtype=np.float32),
            "metadrive_processed": False,
            "coordinate": "right-handed",
            "sdc_id": tracks.names[longest] if tracks.names else "",
            "dataset": "graphrqi",
            "scenario_id": name,
            "object_summary": summary,
            "number_summary": _number_summary(summary, len(features)),
        },
        "tracks": agents,
        "dynamic_map_states": {},
        "map_features": features,
    }


def _object_summary(name: str, agent: Mapping[str, Any]) -> dict[str, Any]:
    """What the format says in short of one agent."""
    valid: NDArray[np.bool_] = agent["state"]["valid"]
    seen = np.flatnonzero(valid)
    # how long it is seen from the first time on, until it is lost for the first time
    first = valid[seen[0] :] if seen.size else valid[:0]
    moved = np.diff(agent["state"]["position"][seen, :2].astype(np.float64), axis=0)
    return {
        "type": agent["type"],
        "object_id": name,
        "track_length": int(valid.size),
        "moving_distance": float(np.hypot(moved[:, 0], moved[:, 1]).sum()),
        "valid_length": int(seen.size),
        "continuous_valid_length": int(np.cumprod(first).sum()),
    }


def _number_summary(summary: Mapping[str, Mapping[str, Any]], features: int) -> dict[str, Any]:
    """What the format counts in an episode; there are no lights and no heights in ours."""
    types = Counter(agent["type"] for agent in summary.values())
    moving = Counter(one["type"] for one in summary.values() if one["moving_distance"] > MOVED_M)
    return {
        "num_objects": len(summary),
        "object_types": tuple(sorted(types)),
        "num_objects_each_type": dict(sorted(types.items())),
        "num_moving_objects": moving.total(),
        "num_moving_objects_each_type": dict(sorted(moving.items())),
        "num_traffic_lights": 0,
        "num_traffic_light_types": (),
        "num_traffic_light_each_step": {},
        "num_map_features": features,
        "map_height_diff": 0.0,
    }


class Index:
    """Summary and mapping of a folder's files, for MetaDrive's ``read_dataset_summary``."""

    def __init__(self) -> None:
        self._summary: dict[str, dict[str, Any]] = {}

    def add(self, files: Sequence[Path], name: str, tracks: Tracks, road: Road | None) -> None:
        """Take note of an episode's files, given what `write` was given."""
        found = description(name, tracks, road)["metadata"]
        self._summary |= {file.name: {**found, "ts": found["ts"].tolist()} for file in files}

    def write(self, folder: Path) -> list[Path]:
        """Write both files into the folder of the episodes' files."""
        paths = [folder / SUMMARY, folder / MAPPING]
        mapping = dict.fromkeys(self._summary, "")  # "": in the same folder
        for path, content in zip(paths, (self._summary, mapping), strict=True):
            write_whole(path, pickle.dumps(content, protocol=4))
        return paths


def _map_features(road: Road) -> dict[str, Any]:
    features: dict[str, Any] = {}
    after: dict[str, list[str]] = {}
    before: dict[str, list[str]] = {}
    for connection in road.connections:
        chain = [connection.from_lane, *connection.via, connection.to_lane]
        for one, two in pairwise(chain):
            after.setdefault(one, []).append(two)
            before.setdefault(two, []).append(one)
    for lane in road.lanes:
        if lane.walking:
            continue
        features[lane.id] = {
            "type": "LANE_SURFACE_UNSTRUCTURE" if lane.internal else "LANE_SURFACE_STREET",
            "polyline": _flat(lane.centerline).astype(np.float32),
            "entry_lanes": sorted(set(before.get(lane.id, []))),
            "exit_lanes": sorted(set(after.get(lane.id, []))),
            "width": lane.width_m,
        }
        if np.isfinite(lane.speed_limit_mps):
            features[lane.id]["speed_limit_kmh"] = 3.6 * lane.speed_limit_mps
    for crossing in road.crossings:
        along = crossing.centerline[[0, -1]]
        way = along[1] - along[0]
        across = np.array([-way[1], way[0]]) / max(float(np.hypot(*way)), 1e-9)
        side = 0.5 * crossing.width_m * across
        corners = np.stack([along[0] + side, along[1] + side, along[1] - side, along[0] - side])
        features[crossing.id] = {"type": "CROSSWALK", "polygon": _flat(corners).astype(np.float32)}
    return features


def write(folder: Path, name: str, tracks: Tracks, road: Road | None = None) -> list[Path]:
    """Write an episode as ``sd_graphrqi_<name>.pkl``; gives the file."""
    path = folder / f"sd_graphrqi_{name}.pkl"
    write_whole(path, pickle.dumps(description(name, tracks, road), protocol=4))
    return [path]
