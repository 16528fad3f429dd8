"""Boxes in the frame of a moving recording car, its motion undone: Argoverse 2 and KITTI.

A sensor log of Argoverse 2 is a folder. ``annotations.feather`` holds the boxes of each lidar sweep
(10 Hz, ns), ``city_SE3_egovehicle.feather`` the car's poses in the city, and
``map/log_map_archive_*.json`` the map. The car itself is the agent ``AV``.

KITTI tracking has boxes in a camera's frame (``label_02/NNNN.txt``), 0.1 s apart. Poses of the car
are in ``oxts/NNNN.txt`` (latitude, longitude, angles; a row per frame), and how its camera is
mounted in ``calib/NNNN.txt``, both beside the folder of the labels. The car is the agent ``ego``.

References:
    Wilson et al. (2021), Argoverse 2, NeurIPS Datasets and Benchmarks; the sensor dataset's
    overview in ``av2-api`` (columns, frames, taxonomy). Geiger, Lenz, Urtasun (2012), Are we ready
    for autonomous driving? The KITTI vision benchmark suite, CVPR; Geiger et al. (2013), Vision
    meets robotics, IJRR (poses from oxts).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas
from scipy.spatial.transform import Rotation

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, left_out, recorded
from sim.formats.common.tables import among, kinds_in, read_table, read_text, whole
from sim.frames import AgentKind, FloatArray, IntArray
from sim.input_files import beside, broken_as_one_line, opened, plain_name, stem
from sim.road.maps.argoverse2 import MAP_NOTE, read_map


class _Car(NamedTuple):
    """A recording car.

    Attributes:
        name: of its agent.
        length_m, width_m: its size, m.
        centre_m: its centre before and left of its frame's origin, m.
    """

    name: str
    length_m: float
    width_m: float
    centre_m: tuple[float, float]


def _rows(
    car: _Car, turn: FloatArray, place: FloatArray, time_s: FloatArray, boxes: pandas.DataFrame,
    at: IntArray, xyz: FloatArray, ahead: FloatArray,
) -> pandas.DataFrame:  # fmt: skip
    """Rows of n boxes and of the car that saw them.

    The car's (T, 3, 3) ``turn`` and (T, 3) ``place``, m, are its poses at (T,) times. ``boxes``
    have names, kinds and sizes; ``at`` is (n,) the index of their time, and (n, 3) ``xyz``, m, and
    ``ahead`` are their centres and directions in the car's frame.
    """
    xy = np.einsum("nij,nj->ni", turn[at, :2], xyz) + place[at, :2]
    way = np.einsum("nij,nj->ni", turn[at, :2], ahead)
    agents = boxes.assign(
        t=time_s[at], x=xy[:, 0], y=xy[:, 1], heading=np.arctan2(way[:, 1], way[:, 0])
    )
    centre = place[:, :2] + turn[:, :2, :2] @ np.array(car.centre_m)
    own = pandas.DataFrame(
        {"id": car.name, "t": time_s, "x": centre[:, 0], "y": centre[:, 1],
         "heading": np.arctan2(turn[:, 1, 0], turn[:, 0, 0]), "length": car.length_m,
         "width": car.width_m, "kind": AgentKind.CAR.code}
    )  # fmt: skip
    return pandas.concat([agents, own])


# --- Argoverse 2 --------------------------------------------------------------------------------

POSES: Final = "city_SE3_egovehicle.feather"
"""The name of the file of the recording car's poses, beside that of the boxes."""

CATEGORIES: Final[dict[str, AgentKind]] = {
    "REGULAR_VEHICLE": AgentKind.CAR,
    **dict.fromkeys(("LARGE_VEHICLE", "TRUCK", "BOX_TRUCK", "TRUCK_CAB"), AgentKind.TRUCK),
    **dict.fromkeys(("BUS", "SCHOOL_BUS", "ARTICULATED_BUS", "RAILED_VEHICLE"), AgentKind.BUS),
    "MOTORCYCLIST": AgentKind.MOTORCYCLE,
    **dict.fromkeys(("BICYCLIST", "WHEELED_RIDER"), AgentKind.BICYCLE),
    **dict.fromkeys(("PEDESTRIAN", "OFFICIAL_SIGNALER"), AgentKind.PEDESTRIAN),
}
"""Categories that are road-agents. The others are left out: things, animals, trailers, and
two-wheelers and devices, whose riders have boxes of their own."""

EGO_CATEGORY: Final = "EGO_VEHICLE"
"""Category under which some copies of a log list the recording car, whose poses are read anyway."""

AV: Final = _Car("AV", 4.87, 1.85, (1.34, 0.0))
"""A Ford Fusion Hybrid (191.8 by 72.9 inches by its maker); the format does not tell its size. Its
frame begins at the rear axle's centre (an estimate: py123d takes 1.339 m for this car)."""

_TURN: Final = ["qw", "qx", "qy", "qz"]
_PLACE: Final = ["tx_m", "ty_m", "tz_m"]


def read_argoverse2(path: Path) -> Iterator[Recording]:
    """The recording of one log in the city's frame, called like the log's folder.

    Its times are those of the sweeps that have boxes, s from the first.
    """
    numbers = ("timestamp_ns", *_TURN, *_PLACE, "length_m", "width_m")
    boxes = read_table(path, numbers, ("track_uuid", "category"))
    sweeps, boxes["sweep"] = np.unique(whole(boxes, "timestamp_ns"), return_inverse=True)
    boxes, others = among(boxes, "category", CATEGORIES)
    facts = pandas.DataFrame(
        {"id": boxes["track_uuid"], "length": boxes["length_m"],
         "width": boxes["width_m"], "kind": kinds_in(boxes["category"], CATEGORIES)}
    )  # fmt: skip
    turn, place = _argoverse2_poses(path, sweeps)
    ahead = _rotations(boxes)[:, :, 0]
    time_s, at, xyz = (
        (sweeps - sweeps[0]) / 1e9,
        boxes["sweep"].to_numpy(),
        boxes[_PLACE].to_numpy(),
    )
    rows = _rows(AV, turn, place, time_s, facts, at, xyz, ahead)
    notes = [
        f"the recording car's motion is undone with its poses; it is the agent {AV.name}, a Ford "
        f"Fusion of {AV.length_m:g} by {AV.width_m:g} m",
        "speeds are taken from the motion",
        *left_out(set(others) - {EGO_CATEGORY}),
    ]
    home = path.absolute().parent
    maps = [*home.glob("map/log_map_archive_*.json"), *home.glob("log_map_archive_*.json")]
    if len(maps) > 1:
        notes.append(f"found {len(maps)} maps: none is used")
    road = maps[0] if len(maps) == 1 and read_map(maps[0]) is not None else None
    if road is not None:
        notes.append(MAP_NOTE)
    yield recorded(home.name, rows, notes, road, own_road=True)


def _rotations(table: pandas.DataFrame) -> FloatArray:
    """(rows, 3, 3) rotations of a table's quaternions."""
    quaternions = table[_TURN].to_numpy()
    return np.asarray(Rotation.from_quat(quaternions, scalar_first=True).as_matrix())


def _argoverse2_poses(path: Path, sweeps: IntArray) -> tuple[FloatArray, FloatArray]:
    """(sweeps, 3, 3) rotation and (sweeps, 3) place of the recording car at each sweep, m."""
    file = beside(path, POSES)
    if file is None:
        raise InputError(
            f"{path}: found no {POSES} beside it, expected it: without it the recording car's "
            "motion cannot be undone"
        )
    with broken_as_one_line(file, "poses"):
        poses = read_table(file, ("timestamp_ns", *_TURN, *_PLACE))
        stamps, first = np.unique(whole(poses, "timestamp_ns"), return_index=True)
        at = np.minimum(np.searchsorted(stamps, sweeps), stamps.size - 1)
        missing = sweeps[stamps[at] != sweeps]
        if missing.size:
            raise InputError(
                f"column timestamp_ns: found no pose at {missing[0]}, expected one at each "
                "annotated sweep"
            )
        poses = poses.iloc[first[at]]
        return _rotations(poses), poses[_PLACE].to_numpy()


# --- KITTI --------------------------------------------------------------------------------------

PERIOD_S: Final = 0.1
"""Time between two frames, s."""

TYPES: Final[dict[str, AgentKind]] = {
    **dict.fromkeys(("Car", "Van"), AgentKind.CAR),
    "Truck": AgentKind.TRUCK,
    "Tram": AgentKind.BUS,
    "Cyclist": AgentKind.BICYCLE,
    **dict.fromkeys(("Pedestrian", "Person", "Person_sitting"), AgentKind.PEDESTRIAN),
}
"""Types that are road-agents."""

NO_AGENTS: Final = frozenset({"Misc", "DontCare"})
"""Types that are left out without a note."""

_COLUMNS: Final = (
    "frame", "id", "type", "truncated", "occluded", "alpha", "left", "top", "right", "bottom",
    "height", "width", "length", "x", "y", "z", "angle",
)  # fmt: skip
_POSE: Final = ("latitude", "longitude", "altitude", "roll", "pitch", "yaw")
"""Columns of labels and of poses, in order."""

_MOUNTED: Final = (("R_rect", 3), ("Tr_velo_cam", 4), ("Tr_imu_velo", 4))
"""Matrices of three rows that lead from the car's measuring unit to its camera, and their columns;
the last one is applied first."""

EARTH_M: Final = 6378137.0
"""Radius of the earth that the Mercator projection of KITTI's tools takes, m."""

EGO: Final = _Car("ego", 4.77, 1.82, (0.96, -0.05))
"""A Volkswagen Passat B6. Its measuring unit is 0.32 m before the rear axle and 0.05 m left
(KITTI's drawing of the sensors); the axle is 1.28 m behind the centre."""


def read_kitti(path: Path) -> Iterator[Recording]:
    """The recording of one sequence, x east and y north of the first frame's place, m.

    ``oxts/NNNN.txt`` and ``calib/NNNN.txt`` must lie in folders beside that of the labels.
    """
    table = read_text(path, _COLUMNS, ("frame", "x", "y", "z", "angle"),
                      ("id", "type", "length", "width"))  # fmt: skip
    boxes, others = among(table, "type", TYPES)
    sides = {side: pandas.to_numeric(boxes[side], errors="coerce") for side in ("length", "width")}
    facts = pandas.DataFrame({"id": boxes["id"], "kind": kinds_in(boxes["type"], TYPES), **sides})
    turn, place = _kitti_poses(_neighbour(path, "oxts"))
    to_car, angle = _camera_to_car(_neighbour(path, "calib")), boxes["angle"].to_numpy()
    # a box's angle turns about the camera's y axis, which points down, from its x axis
    ahead = np.stack([np.cos(angle), np.zeros(angle.size), -np.sin(angle)], axis=1)
    xyz = boxes[["x", "y", "z"]].to_numpy() @ to_car[:3, :3].T + to_car[:3, 3]
    time_s, at = PERIOD_S * np.arange(len(turn), dtype=np.float64), whole(boxes, "frame")
    if (off := at[(at < 0) | (at >= time_s.size)]).size:
        raise InputError(f"found frame {off[0]}, expected one of the {time_s.size} poses")
    rows = _rows(EGO, turn, place, time_s, facts, at, xyz, ahead @ to_car[:3, :3].T)
    notes = (
        "the recording car's motion is undone with its poses; it is the agent ego",
        "speeds are taken from the motion",
        *left_out({*others} - NO_AGENTS),
    )
    yield recorded(stem(path), rows, notes)


def _neighbour(path: Path, folder: str) -> Path:
    """The file of a sequence in another folder beside that of its labels."""
    home = path.absolute().parent.parent
    names = (plain_name(path), plain_name(path) + ".gz")
    found = next((f for name in names if (f := home / folder / name).is_file()), None)
    if found is None:
        raise InputError(
            f"{path}: found no {folder}/{plain_name(path)} beside its folder, expected it: without "
            "it the camera's motion cannot be undone"
        )
    return found


def _kitti_poses(path: Path) -> tuple[FloatArray, FloatArray]:
    """(frames, 3, 3) rotation and (frames, 3) place of the car, m from the first place."""
    with broken_as_one_line(path, "a table of poses"):
        table = read_text(path, _POSE, _POSE)
    latitude, longitude, altitude, *angles = (table[name].to_numpy() for name in _POSE)
    scale = np.cos(np.radians(latitude[0]))
    east = scale * EARTH_M * np.radians(longitude)
    north = scale * EARTH_M * np.log(np.tan(np.radians(90.0 + latitude) / 2))
    place = np.stack([east - east[0], north - north[0], altitude - altitude[0]], axis=1)
    turn = Rotation.from_euler("xyz", np.stack(angles, axis=1)).as_matrix()
    return np.asarray(turn, dtype=np.float64), place


def _camera_to_car(path: Path) -> FloatArray:
    """(4, 4) from the rectified camera's frame to that of the car's measuring unit."""
    to_camera = np.eye(4)
    with broken_as_one_line(path, "a calibration"), opened(path) as file:
        lines = [line.decode("ascii", "replace").split() for line in file]
        found = {fields[0].rstrip(":"): fields[1:] for fields in lines if fields}
        for name, columns in _MOUNTED:
            matrix = np.eye(4)
            matrix[:3, :columns] = np.reshape([float(x) for x in found[name]], (3, columns))
            to_camera = to_camera @ matrix
    return np.asarray(np.linalg.inv(to_camera))
