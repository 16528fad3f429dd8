"""Argoverse 2 sensor logs: boxes in the recording car's frame, its motion undone with its poses.

A log is a folder. ``annotations.feather`` holds the boxes of each lidar sweep (10 Hz, ns) in the
frame of the car, ``city_SE3_egovehicle.feather`` the car's poses in the city, and
``map/log_map_archive_*.json`` the map (`sim.road.maps.argoverse2`). The recording car itself is
the agent ``AV``, as in the motion forecasting scenarios.

References:
    Wilson et al. (2021), Argoverse 2, NeurIPS Datasets and Benchmarks; the sensor dataset's
    overview in ``av2-api`` (columns, frames, taxonomy).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import pandas
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, left_out, recorded
from sim.formats.common.tables import among, kinds_in, names_in, read_table, whole
from sim.frames import AgentKind, FloatArray
from sim.input_files import beside, broken_as_one_line
from sim.road.maps.argoverse2 import read_map

POSES: Final = "city_SE3_egovehicle.feather"
"""The name of the file of the recording car's poses, beside that of the boxes."""

CATEGORIES: Final[dict[str, AgentKind]] = {
    "REGULAR_VEHICLE": AgentKind.CAR,
    "LARGE_VEHICLE": AgentKind.TRUCK,
    "TRUCK": AgentKind.TRUCK,
    "BOX_TRUCK": AgentKind.TRUCK,
    "TRUCK_CAB": AgentKind.TRUCK,
    "BUS": AgentKind.BUS,
    "SCHOOL_BUS": AgentKind.BUS,
    "ARTICULATED_BUS": AgentKind.BUS,
    "RAILED_VEHICLE": AgentKind.BUS,
    "MOTORCYCLIST": AgentKind.MOTORCYCLE,
    "BICYCLIST": AgentKind.BICYCLE,
    "WHEELED_RIDER": AgentKind.BICYCLE,
    "PEDESTRIAN": AgentKind.PEDESTRIAN,
    "OFFICIAL_SIGNALER": AgentKind.PEDESTRIAN,
}
"""Categories that are road-agents. The others are left out: things, animals, trailers, and
two-wheelers and devices, whose riders have boxes of their own."""

EGO_NAME: Final = "AV"
EGO_CATEGORY: Final = "EGO_VEHICLE"
"""Category under which some copies of a log list the recording car, whose poses are read anyway."""

EGO_SIZE_M: Final = (4.87, 1.85)
"""Length and width of the recording car, a Ford Fusion Hybrid (191.8 by 72.9 inches by its maker);
the format does not tell them."""

EGO_CENTRE_M: Final = 1.34
"""How far the car's centre is ahead of its frame's origin, which is the rear axle's centre (an
estimate, since the format does not tell: py123d takes 1.339 m for this car)."""

UNIT_TOLERANCE: Final = 0.01
"""How far the length of a quaternion may be from one (rounding to six digits stays far below)."""

_TURN: Final = ["qw", "qx", "qy", "qz"]
_PLACE: Final = ["tx_m", "ty_m", "tz_m"]


def read(path: Path) -> Iterator[Recording]:
    """The recording of one log in the city's frame, called like the log's folder.

    Its times are those of the sweeps that have boxes, s from the first.
    """
    numbers = ("timestamp_ns", *_TURN, *_PLACE, "length_m", "width_m")
    boxes = read_table(path, numbers, ("track_uuid", "category"))
    poses = beside(path, POSES)
    if poses is None:
        raise InputError(
            f"{path}: found no {POSES} beside it, expected it: without it the recording car's "
            "motion cannot be undone"
        )
    sweeps, boxes["sweep"] = np.unique(whole(boxes, "timestamp_ns"), return_inverse=True)
    turn, place = _poses_at(poses, sweeps)
    time_s = (sweeps - sweeps[0]) / 1e9

    boxes, others = among(boxes, "category", CATEGORIES)
    at = boxes["sweep"].to_numpy()
    xy = np.einsum("nij,nj->ni", turn[at, :2], boxes[_PLACE].to_numpy()) + place[at, :2]
    ahead = np.einsum("nij,nj->ni", turn[at, :2], _rotations(path, boxes)[:, :, 0])
    centre = place[:, :2] + EGO_CENTRE_M * turn[:, :2, 0]
    agents = pandas.DataFrame(
        {"id": names_in(boxes["track_uuid"]), "t": time_s[at], "x": xy[:, 0], "y": xy[:, 1],
         "heading": np.arctan2(ahead[:, 1], ahead[:, 0]), "length": boxes["length_m"],
         "width": boxes["width_m"], "kind": kinds_in(boxes["category"], CATEGORIES)}
    )  # fmt: skip
    ego = pandas.DataFrame(
        {"id": EGO_NAME, "t": time_s, "x": centre[:, 0], "y": centre[:, 1],
         "heading": np.arctan2(turn[:, 1, 0], turn[:, 0, 0]), "length": EGO_SIZE_M[0],
         "width": EGO_SIZE_M[1], "kind": AgentKind.CAR.code}
    )  # fmt: skip
    notes = [
        f"the recording car's motion is undone with its poses; it is the agent {EGO_NAME}, a Ford "
        f"Fusion of {EGO_SIZE_M[0]:g} by {EGO_SIZE_M[1]:g} m",
        "speeds are taken from the motion",
    ]
    notes += left_out(set(others) - {EGO_CATEGORY})
    home = path.absolute().parent
    maps = [*home.glob("map/log_map_archive_*.json"), *home.glob("log_map_archive_*.json")]
    if len(maps) > 1:
        notes.append(f"found {len(maps)} maps: none is used")
    road = maps[0] if len(maps) == 1 and read_map(maps[0]) is not None else None
    if road is not None:
        notes.append("limits, signals and who has priority are not in this format: unknown")
    yield recorded(home.name, pandas.concat([agents, ego]), notes, road, own_road=True)


def _rotations(path: Path, table: pandas.DataFrame) -> FloatArray:
    """(rows, 3, 3) rotations of a table's unit quaternions."""
    quaternion = table[_TURN].to_numpy()
    length = np.sqrt((quaternion**2).sum(axis=1))
    bad = ~(np.abs(length - 1) <= UNIT_TOLERANCE)
    if bad.any():
        raise InputError(
            f"{path}: columns {', '.join(_TURN)}: found length {length[bad][0]:g} in row "
            f"{table.index[bad][0]}, expected 1"
        )
    return np.asarray(Rotation.from_quat(quaternion, scalar_first=True).as_matrix())


def _poses_at(path: Path, sweeps: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """(sweeps, 3, 3) rotation and (sweeps, 3) place of the recording car at each sweep, m."""
    poses = read_table(path, ("timestamp_ns", *_TURN, *_PLACE))
    with broken_as_one_line(path, "poses"):
        stamp = whole(poses, "timestamp_ns")
    unique, first, count = np.unique(stamp, return_index=True, return_counts=True)
    at = np.minimum(np.searchsorted(unique, sweeps), unique.size - 1)
    for wrong, found in ((unique[at] != sweeps, "no pose"), (count[at] > 1, "several poses")):
        if wrong.any():
            raise InputError(
                f"{path}: column timestamp_ns: found {found} at {sweeps[wrong.argmax()]}, expected "
                "one at each annotated sweep"
            )
    return _rotations(path, poses)[first[at]], poses[_PLACE].to_numpy()[first[at]]
