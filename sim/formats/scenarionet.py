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
from pathlib import Path
from typing import Any, Final

import numpy as np

from sim.files import write_whole
from sim.formats.common.recording import Recording
from sim.formats.driving_scenes import DrivingScene, recording_of
from sim.frames import KINDS, AgentKind, BoolArray, FloatArray, IntArray, Signal, Tracks
from sim.geometry import borders
from sim.input_files import read_bytes, stem
from sim.road import Road
from sim.road.maps.lanelets import Lanelet, followers
from sim.units import in_si

PERIOD_S: Final = 0.1
"""Time between two steps where the file does not say it, s (ScenarioNet's own rate)."""

TYPES: Final[dict[AgentKind, str]] = {
    AgentKind.CAR: "VEHICLE",
    AgentKind.BUS: "VEHICLE",
    AgentKind.TRUCK: "VEHICLE",
    AgentKind.BICYCLE: "CYCLIST",
    AgentKind.MOTORCYCLE: "CYCLIST",
    AgentKind.PEDESTRIAN: "PEDESTRIAN",
}
"""MetaDrive's type of each kind; of the kinds of a type, the first one is read."""

READ_KINDS: Final = {word: kind for kind, word in reversed(TYPES.items())}
"""Types of objects that are road-agents; cones, barriers and the like are left out."""

STREET, ACROSS, BIKE_LANE = "LANE_SURFACE_STREET", "LANE_SURFACE_UNSTRUCTURE", "LANE_BIKE_LANE"
LANES: Final = frozenset({STREET, ACROSS, BIKE_LANE, "LANE_UNKNOWN", "LANE_FREEWAY"})
"""Types of lanes; an unstructured one is a way across a junction."""

CROSSWALK: Final = "CROSSWALK"

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

LIGHTS: Final = (
    ("RED", Signal.RED), ("STOP", Signal.RED), ("YELLOW", Signal.YELLOW),
    ("CAUTION", Signal.YELLOW), ("GREEN", Signal.GREEN), ("GO", Signal.GREEN),
)  # fmt: skip
"""What a light shows, by the end of its word; it is off where none fits."""


def read(path: Path) -> Iterator[Recording]:
    """The recording of the scenario in one ``sd_*.pkl``, with its road."""
    yield recording_of(_scene(path, PlainUnpickler(io.BytesIO(read_bytes(path))).load()))


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
    times = np.asarray(metadata.get("ts", metadata.get("timestep", np.arange(steps) * PERIOD_S)))
    time_s: FloatArray = times.astype(np.float64)
    if times.dtype == np.float32:
        # Single precision tells a step of .1 s to a ten-millionth only, and late times worse.
        time_s = np.round(time_s, 4)
    name = found.get("id") or metadata.get("scenario_id") or stem(path)
    scene = DrivingScene(path, str(name)[:100], time_s, lights=[{} for _ in range(steps)])
    for label, track in tracks.items():
        kind = READ_KINDS.get(track["type"])
        if kind is None:
            scene.left_out += 1
            continue
        scene.agents.append((str(label), kind, *_states(track["state"], steps)))
        scene.behaviors[str(label)] = track.get("metadata", {}).get("behavior")
    numbers = _add_map(scene, found.get("map_features", {}))
    for name, light in found.get("dynamic_map_states", {}).items():
        lane = numbers.get(str(light.get("lane", name)))
        if lane is None:
            continue
        state = light["state"]
        words = state["object_state"] if isinstance(state, Mapping) else state
        for shown, word in zip(scene.lights, words, strict=False):
            signals = (signal for end, signal in LIGHTS if str(word).upper().endswith(end))
            shown[lane] = next(signals, Signal.OFF)
    return scene


def _states(state: Mapping[str, Any], steps: int) -> tuple[IntArray, FloatArray]:
    """The steps at which an agent is seen, and what is known of it there."""
    size = state.get("size", state.get("dimension"))  # length, width and height, maybe of each step
    length, width = (
        state[side] if side in state else np.asarray(size)[..., k]
        for k, side in enumerate(("length", "width"))
    )
    velocity = np.hypot(*_points(state["velocity"]).T)
    columns = (*_points(state["position"]).T, state["heading"], velocity, length, width)
    table = np.stack([_column(values, steps) for values in columns], axis=1)
    seen = np.flatnonzero(_column(state["valid"], steps))
    return seen, table[seen]


def _column(values: Any, steps: int) -> FloatArray:
    """A number of each step; some converters write one for all, or a column of a table."""
    found = np.asarray(values, dtype=np.float64)
    return np.broadcast_to(found[:, 0] if found.ndim == 2 else found, steps)


def _points(values: Any) -> FloatArray:
    """(P, 2) points, m; heights go."""
    return np.asarray(values, dtype=np.float64)[..., :2].reshape(-1, 2)


def _add_map(scene: DrivingScene, features: Mapping[Any, Any]) -> dict[str, int]:
    """Take in lanes and crosswalks; gives the number of each lane by its name."""
    lanes = {str(name): one for name, one in features.items() if one["type"] in LANES}
    numbers = {name: number for number, name in enumerate(lanes)}
    if all(name.isascii() and name.isdecimal() and len(name) < 16 for name in numbers):
        numbers = {name: int(name) for name in numbers}

    for name, lane in lanes.items():
        beside: dict[str, tuple[int, ...]] = {}
        for key in ("entry_lanes", "exit_lanes", "left_neighbor", "right_neighbor"):
            others = lane.get(key)  # names of lanes, or Waymo's records of them
            words = [
                str(one["feature_id"] if isinstance(one, Mapping) else one)
                for one in ([] if others is None else others)
            ]
            beside[key] = tuple(numbers[word] for word in words if word in numbers)
        # converters write none or 0 for an unknown limit, and mostly a width at every point
        limits = [
            in_si(float(lane[key]), unit)
            for key, unit in (("speed_limit_mph", "mph"), ("speed_limit_kmh", "km/h"))
            if lane.get(key)
        ]
        width = lane.get("width")
        scene.lanes.append(
            Lanelet(
                id=numbers[name],
                centerline=_points(lane["polyline"]),
                limit_mps=next(iter(limits), math.nan),
                cars=lane["type"] != BIKE_LANE,
                internal=lane["type"] == ACROSS or bool(lane.get("interpolating", False)),
                predecessors=beside["entry_lanes"],
                successors=beside["exit_lanes"],
                left=next(iter(beside["left_neighbor"]), None),
                right=next(iter(beside["right_neighbor"]), None),
                width_m=math.nan if width is None or np.ndim(width) else float(width),
            )
        )
    for name, feature in features.items():
        if feature["type"] == CROSSWALK and "polygon" in feature:
            scene.crosswalks[str(name)] = _points(feature["polygon"])
    return numbers


# --- writing ------------------------------------------------------------------------------------

VERSION: Final = "0.1"
SUMMARY, MAPPING = "dataset_summary.pkl", "dataset_mapping.pkl"
"""Names of the files that MetaDrive looks for in a folder."""

MOVED_M: Final = 1.0
"""An agent that goes farther than this is counted as moving, m (MetaDrive's number)."""

HEIGHT_M: Final = 1.6
"""Height that is written for everyone, m: the format wants one and traffic here is flat."""


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
    steps = int(tracks.time_s.size)
    series = {
        "position": _flat(tracks.xy),
        "heading": heading,
        "velocity": np.stack([speed * np.cos(heading), speed * np.sin(heading)], axis=2),
        "valid": valid,
        "length": tracks.length[:, None],
        "width": tracks.width[:, None],
        "height": np.array([[HEIGHT_M]]),
    }
    for field, values in series.items():
        if field != "valid":
            seen = valid[..., None] if values.ndim == 3 else valid
            series[field] = np.where(seen, values, 0.0).astype(np.float32)
    agents: dict[str, Any] = {}
    for i, label in enumerate(tracks.names):
        code = -1 if tracks.behavior is None else int(tracks.behavior[i])
        agents[label] = {
            "type": TYPES[KINDS[tracks.kind[i]]],
            "state": {field: values[i].copy() for field, values in series.items()},
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
    valid: BoolArray = agent["state"]["valid"]
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


def _flat(points: FloatArray) -> FloatArray:
    """(..., 3) points of height 0."""
    return np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)


def _map_features(road: Road) -> dict[str, Any]:
    """Lanes and crosswalks."""
    features: dict[str, Any] = {}
    before, after = followers(road)
    for lane in (lane for lane in road.lanes if not lane.walking):
        features[lane.id] = {
            "type": ACROSS if lane.internal else STREET,
            "polyline": _flat(lane.centerline).astype(np.float32),
            "entry_lanes": sorted(before[lane.id]),
            "exit_lanes": sorted(after[lane.id]),
            "width": lane.width_m,
        }
        if np.isfinite(lane.speed_limit_mps):
            features[lane.id]["speed_limit_kmh"] = 3.6 * lane.speed_limit_mps
    for crossing in road.crossings:
        left, right = borders(crossing.centerline[[0, -1]], crossing.width_m)
        outline = _flat(np.concatenate([left, right[::-1]])).astype(np.float32)
        features[crossing.id] = {"type": CROSSWALK, "polygon": outline}
    return features


def write(folder: Path, name: str, tracks: Tracks, road: Road | None = None) -> list[Path]:
    """Write an episode as ``sd_graphrqi_<name>.pkl``; gives the file."""
    path = folder / f"sd_graphrqi_{name}.pkl"
    write_whole(path, pickle.dumps(description(name, tracks, road), protocol=4))
    return [path]
