"""Writes ScenarioNet's dictionaries, one per episode, for MetaDrive and the tools around it.

The format is defined as pickled dictionaries: one for each episode, ``dataset_summary.pkl`` with
what each of them holds, and ``dataset_mapping.pkl`` with where it is.

References:
    Li et al. (2023), ScenarioNet, NeurIPS Datasets and Benchmarks.
"""

from __future__ import annotations

import pickle
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from sim.files import write_whole
from sim.frames import KINDS, AgentKind, Tracks
from sim.road import Road

VERSION: Final = "0.1"
SUMMARY, MAPPING = "dataset_summary.pkl", "dataset_mapping.pkl"
"""Names of the files that MetaDrive looks for in a folder."""

MOVED_M: Final = 1.0
"""An agent that goes farther than this is counted as moving, m (MetaDrive's number)."""

MAX_STATES: Final = 10**7
"""Most agents times times of an episode (0.4 GB, and as much again while it is packed)."""

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
    n, t = tracks.ids.size, tracks.time_s.size
    if n * t > MAX_STATES:
        raise InputError(
            f"{name}: found {n} agents at {t} times, expected agents times times at most "
            f"{MAX_STATES}, since this format has a state for each"
        )
    rows = tracks.rows
    agents: dict[str, Any] = {}
    for i, label in enumerate(tracks.names):
        at = rows.index.rows(i)
        valid = np.zeros(t, dtype=bool)
        valid[rows.index.step[at]] = True

        def seen(
            values: NDArray[np.float64] | float, valid: NDArray[np.bool_] = valid
        ) -> NDArray[np.float32]:
            filled = np.zeros((t, *np.shape(values)[1:]), dtype=np.float32)
            filled[valid] = values
            return filled

        heading, speed = rows.heading[at], rows.speed[at]
        velocity = np.stack([speed * np.cos(heading), speed * np.sin(heading)], axis=1)
        code = -1 if tracks.behavior is None else int(tracks.behavior[i])
        size = {
            "length": seen(tracks.length[i]),
            "width": seen(tracks.width[i]),
            "height": seen(HEIGHT_M),
        }
        agents[label] = {
            "type": TYPES[KINDS[tracks.kind[i]]],
            "state": {
                "position": seen(_flat(rows.xy[at])),
                "heading": seen(heading),
                "velocity": seen(velocity),
                "valid": valid,
                **size,
            },
            "metadata": {
                "track_length": int(tracks.time_s.size),
                "type": TYPES[KINDS[tracks.kind[i]]],
                "object_id": label,
                "behavior": BEHAVIORS[code].value if code >= 0 else None,
            },
        }
    summary = {key: _object_summary(key, agent) for key, agent in agents.items()}
    features = {} if road is None else _map_features(road)
    longest = int(np.argmax(np.diff(rows.index.first))) if len(tracks.names) else 0
    return {
        "id": name,
        "version": VERSION,
        "length": int(tracks.time_s.size),
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
    state = agent["state"]
    valid: NDArray[np.bool_] = state["valid"]
    seen = np.flatnonzero(valid)
    # how long it is seen from the first time on, until it is lost for the first time
    lost = np.flatnonzero(~valid[seen[0] :]) if seen.size else seen
    whole = 0 if not seen.size else int(lost[0]) if lost.size else int(valid.size - seen[0])
    moved = np.diff(state["position"][seen, :2].astype(np.float64), axis=0)
    return {
        "type": agent["type"],
        "object_id": name,
        "track_length": int(valid.size),
        "moving_distance": float(np.hypot(moved[:, 0], moved[:, 1]).sum()),
        "valid_length": int(seen.size),
        "continuous_valid_length": whole,
    }


def _number_summary(summary: Mapping[str, Mapping[str, Any]], features: int) -> dict[str, Any]:
    """What the format counts in an episode; there are no lights and no heights in ours."""
    types = Counter(agent["type"] for agent in summary.values())
    moving = Counter(
        agent["type"] for agent in summary.values() if agent["moving_distance"] > MOVED_M
    )
    return {
        "num_objects": len(summary),
        "object_types": tuple(sorted(types)),
        "num_objects_each_type": {name: types[name] for name in sorted(types)},
        "num_moving_objects": moving.total(),
        "num_moving_objects_each_type": {name: moving[name] for name in sorted(moving)},
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
        """Take note of an episode's file.

        Args:
            files: what `write` gave.
            name: the episode's id.
            tracks: the episode.
            road: where it happened, if known.
        """
        found = description(name, tracks, road)["metadata"]
        for file in files:
            self._summary[file.name] = {**found, "ts": found["ts"].tolist()}

    def write(self, folder: Path) -> list[Path]:
        """Write both files.

        Args:
            folder: that of the episodes' files.

        Returns:
            The files written.
        """
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
    """Write an episode as ``sd_graphrqi_<name>.pkl``.

    Args:
        folder: where; it must exist.
        name: the episode's id.
        tracks: the episode.
        road: where it happened, if known.

    Returns:
        The file written.
    """
    path = folder / f"sd_graphrqi_{name}.pkl"
    write_whole(path, pickle.dumps(description(name, tracks, road), protocol=4))
    return [path]
