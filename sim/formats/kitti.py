"""KITTI tracking: boxes in a moving camera's frame (``label_02/NNNN.txt``), its motion undone.

Poses of the recording car are in ``oxts/NNNN.txt`` (latitude, longitude, angles; a row per frame),
and how its camera is mounted in ``calib/NNNN.txt``, both beside the folder of the labels. Frames
are 0.1 s apart. The recording car itself is the agent ``ego``.

References:
    Geiger, Lenz, Urtasun (2012), Are we ready for autonomous driving? The KITTI vision benchmark
    suite, CVPR; Geiger et al. (2013), Vision meets robotics, IJRR (poses from oxts).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import pandas
from scipy.spatial.transform import Rotation

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, recorded
from sim.formats.common.tables import among, finite, kinds_in, read_text, whole
from sim.frames import AgentKind, FloatArray
from sim.input_files import broken_as_one_line, opened, plain_name, stem

PERIOD_S: Final = 0.1
"""Time between two frames, s."""

TYPES: Final[dict[str, AgentKind]] = {
    **dict.fromkeys(("Car", "Van"), AgentKind.CAR),
    "Truck": AgentKind.TRUCK,
    "Tram": AgentKind.BUS,
    "Cyclist": AgentKind.BICYCLE,
    **dict.fromkeys(("Pedestrian", "Person", "Person_sitting"), AgentKind.PEDESTRIAN),
}
"""Types that are road-agents; ``Misc`` and ``DontCare`` are left out."""

LEFT_OUT: Final = frozenset({"Misc", "DontCare"})

_COLUMNS: Final = (
    "frame", "agent", "type", "truncated", "occluded", "alpha", "left", "top", "right", "bottom",
    "height", "width", "length", "x", "y", "z", "angle",
)  # fmt: skip
_NUMBERS: Final = ("frame", "x", "y", "z", "angle")
_POSE: Final = ("latitude", "longitude", "altitude", "roll", "pitch", "yaw")
"""Columns of labels and of poses, in order."""

EARTH_M: Final = 6378137.0
"""Radius of the earth that the Mercator projection of KITTI's tools takes, m."""

EGO_SIZE_M: Final = (4.77, 1.82)
"""Length and width of the recording car, a Volkswagen Passat B6."""

EGO_CENTRE_M: Final = (0.96, -0.05)
"""The car's centre before and left of its measuring unit, m: that is 0.32 m before the rear axle
and 0.05 m left (KITTI's drawing of the sensors), which is 1.28 m behind the centre."""


def read(path: Path) -> Iterator[Recording]:
    """The recording of one sequence, x east and y north of the first frame's place, m.

    ``oxts/NNNN.txt`` and ``calib/NNNN.txt`` must lie in folders beside that of the labels.
    """
    table = read_text(path, _COLUMNS, _NUMBERS, ("agent", "type", "length", "width"))
    boxes, others = among(table, "type", TYPES)
    unknown = next((word for word in others if word not in LEFT_OUT), None)
    if unknown is not None:
        raise InputError(
            f"{path}: type: found {unknown[:40]!r}, expected one of {', '.join(TYPES)}"
        )
    frame, angle = whole(boxes, "frame"), finite(boxes, "angle")
    poses = _poses(_neighbour(path, "oxts"))
    to_car = _camera_to_car(_neighbour(path, "calib"))
    if ((frame < 0) | (frame >= len(poses))).any():
        raise InputError(
            f"{path}: found frame {frame.max()}, expected one of the {len(poses)} poses"
        )
    pose = poses[frame]
    in_car = boxes[["x", "y", "z"]].to_numpy() @ to_car[:3, :3].T + to_car[:3, 3]
    xy = (np.einsum("nij,nj->ni", pose[:, :3, :3], in_car) + pose[:, :3, 3])[:, :2]
    # a box's angle turns about the camera's y axis, which points down, from its x axis
    ahead = np.stack([np.cos(angle), np.zeros(angle.size), -np.sin(angle)], axis=1)
    ahead = np.einsum("nij,nj->ni", pose[:, :3, :3], ahead @ to_car[:3, :3].T)
    length, width = (
        pandas.to_numeric(boxes[side], errors="coerce") for side in ("length", "width")
    )
    agents = pandas.DataFrame(
        {"id": boxes["agent"], "t": frame * PERIOD_S, "x": xy[:, 0], "y": xy[:, 1],
         "heading": np.arctan2(ahead[:, 1], ahead[:, 0]), "length": length, "width": width,
         "kind": kinds_in(boxes["type"], TYPES)}
    )  # fmt: skip
    centre = poses[:, :2, 3] + poses[:, :2, :2] @ np.array(EGO_CENTRE_M)
    ego = pandas.DataFrame(
        {"id": "ego", "t": np.arange(len(poses)) * PERIOD_S, "x": centre[:, 0], "y": centre[:, 1],
         "heading": np.arctan2(poses[:, 1, 0], poses[:, 0, 0]), "length": EGO_SIZE_M[0],
         "width": EGO_SIZE_M[1], "kind": AgentKind.CAR.code}
    )  # fmt: skip
    notes = (
        "the recording car's motion is undone with its poses; it is the agent ego",
        "speeds are taken from the motion",
    )
    yield recorded(stem(path), pandas.concat([agents, ego]), notes)


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


def _poses(path: Path) -> FloatArray:
    """(frames, 3, 4) rotation and place of the car at each frame, m from the first place."""
    with broken_as_one_line(path, "a table of poses"):
        table = read_text(path, _POSE, _POSE)
        latitude, longitude, altitude, roll, pitch, yaw = (finite(table, name) for name in _POSE)
    scale = np.cos(np.radians(latitude[0]))
    east = scale * EARTH_M * np.radians(longitude)
    north = scale * EARTH_M * np.log(np.tan(np.radians(90.0 + latitude) / 2))
    place = np.stack([east - east[0], north - north[0], altitude - altitude[0]], axis=1)
    turn = Rotation.from_euler("xyz", np.stack([roll, pitch, yaw], axis=1)).as_matrix()
    return np.concatenate([turn, place[:, :, None]], axis=2)


def _camera_to_car(path: Path) -> FloatArray:
    """(4, 4) from the rectified camera's frame to that of the car's measuring unit."""
    to_camera = np.eye(4)
    with opened(path) as file:
        lines = [line.decode("ascii", "replace").split() for line in file]
    found = {fields[0].rstrip(":"): fields[1:] for fields in lines if fields}
    for name, columns in (("R_rect", 3), ("Tr_velo_cam", 4), ("Tr_imu_velo", 4)):
        matrix = np.eye(4)
        try:
            matrix[:3, :columns] = np.reshape([float(x) for x in found[name]], (3, columns))
        except (KeyError, ValueError):
            raise InputError(
                f"{path}: found no {name} of {3 * columns} numbers, expected them"
            ) from None
        to_camera = to_camera @ matrix
    return np.asarray(np.linalg.inv(to_camera))
