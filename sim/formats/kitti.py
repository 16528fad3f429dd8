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
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.formats.common.recording import Recording, Rows, recorded
from sim.frames import AgentKind
from sim.input_files import opened, plain_name, stem

FloatArray = NDArray[np.float64]

PERIOD_S: Final = 0.1
"""Time between two frames, s."""

TYPES: Final[dict[str, AgentKind]] = {
    "Car": AgentKind.CAR,
    "Van": AgentKind.CAR,
    "Truck": AgentKind.TRUCK,
    "Tram": AgentKind.BUS,
    "Cyclist": AgentKind.BICYCLE,
    "Pedestrian": AgentKind.PEDESTRIAN,
    "Person": AgentKind.PEDESTRIAN,
    "Person_sitting": AgentKind.PEDESTRIAN,
}
"""Types that are road-agents; ``Misc`` and ``DontCare`` are left out."""

LEFT_OUT: Final = frozenset({"Misc", "DontCare"})

LEAST_POSE: Final = 6
"""Fields of a pose that are read: latitude, longitude, altitude, roll, pitch, yaw."""

EARTH_M: Final = 6378137.0
"""Radius of the earth that the Mercator projection of KITTI's tools takes, m."""

EGO_SIZE_M: Final = (4.77, 1.82)
"""Length and width of the recording car, a Volkswagen Passat B6."""

EGO_CENTRE_M: Final = (0.96, -0.05)
"""The car's centre before and left of its measuring unit, m: that is 0.32 m before the rear axle
and 0.05 m left (KITTI's drawing of the sensors), which is 1.28 m behind the centre."""


@dataclass(frozen=True)
class _Labels:
    """Boxes of road-agents: frame, agent, place in the camera's frame, m, and angle, rad."""

    frame: NDArray[np.int64]
    agent: NDArray[np.int64]
    place: FloatArray
    angle: FloatArray
    names: tuple[str, ...]
    kinds: tuple[AgentKind, ...]
    sizes: FloatArray


def read(path: Path) -> Iterator[Recording]:
    """Read one sequence.

    Args:
        path: ``label_02/NNNN.txt`` (or ``.txt.gz``, in any folder); ``oxts/NNNN.txt`` and
            ``calib/NNNN.txt`` must lie in folders beside that one.

    Yields:
        One recording, x east and y north of the first frame's place, m.

    Raises:
        InputError: if a file is missing or broken; the message names file and line.
    """
    labels = _labels(path)
    poses = _poses(_neighbour(path, "oxts"))
    to_car = _camera_to_car(_neighbour(path, "calib"))
    if labels.frame.size and int(labels.frame.max()) >= len(poses):
        raise InputError(
            f"{path}: found frame {int(labels.frame.max())}, expected one of the {len(poses)} poses"
        )
    pose = poses[labels.frame]
    in_car = labels.place @ to_car[:3, :3].T + to_car[:3, 3]
    xy = (np.einsum("nij,nj->ni", pose[:, :3, :3], in_car) + pose[:, :3, 3])[:, :2]
    # a box's angle turns about the camera's y axis, which points down, from its x axis
    ahead = np.stack(
        [np.cos(labels.angle), np.zeros(labels.angle.size), -np.sin(labels.angle)], axis=1
    )
    ahead = np.einsum("nij,nj->ni", pose[:, :3, :3], ahead @ to_car[:3, :3].T)
    ego = poses[:, :2, 3] + poses[:, :2, :2] @ np.array(EGO_CENTRE_M)
    ego_heading = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    n, frames = len(labels.names), np.arange(len(poses))
    heading = np.append(np.arctan2(ahead[:, 1], ahead[:, 0]), ego_heading)
    rows = Rows(
        np.append(labels.agent, np.full(frames.size, n)),
        (*labels.names, "ego"),
        np.append(labels.frame, frames).astype(np.float64) * PERIOD_S,
        np.concatenate([xy, ego]),
        heading,
        kinds=[*labels.kinds, AgentKind.CAR],
        sizes=np.concatenate([labels.sizes, [EGO_SIZE_M]]),
    )
    notes = (
        "the recording car's motion is undone with its poses; it is the agent ego",
        "speeds are taken from the motion",
    )
    yield recorded(path, stem(path), rows, notes)


def _neighbour(path: Path, folder: str) -> Path:
    """The file of a sequence in another folder beside that of its labels.

    Raises:
        InputError: if there is none.
    """
    home = path.absolute().parent.parent
    names = (plain_name(path), plain_name(path) + ".gz")
    found = next((f for name in names if (f := home / folder / name).is_file()), None)
    if found is None:
        raise InputError(
            f"{path}: found no {folder}/{plain_name(path)} beside its folder, expected it: without "
            "it the camera's motion cannot be undone"
        )
    return found


def _lines(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Where every line that is not blank stands, and its fields."""
    with opened(path) as file:
        for number, line in enumerate(file, 1):
            fields = line.decode("ascii", "replace").split()
            if fields:
                yield f"{path}: line {number}", fields


def _numbers(where: str, fields: list[str], count: int) -> list[float]:
    """So many finite numbers."""
    try:
        found = [float(field) for field in fields]
    except ValueError:
        raise InputError(f"{where}: found {fields[0][:40]!r}..., expected numbers") from None
    if len(found) != count or not np.isfinite(found).all():
        raise InputError(f"{where}: found {len(found)} numbers, expected {count} finite ones")
    return found


def _labels(path: Path) -> _Labels:
    """The boxes in a file of labels."""
    frames, agents, numbers = list[int](), list[int](), list[list[float]]()
    index: dict[str, int] = {}
    kinds, sizes = list[AgentKind](), list[list[float]]()
    where = None
    for where, fields in _lines(path):
        if len(fields) < 17 or not fields[0].isdecimal():
            raise InputError(f"{where}: found {fields[:2]}, expected a frame and 16 more fields")
        word, name = fields[2], fields[1]
        if word in LEFT_OUT:
            continue
        if word not in TYPES:
            raise InputError(f"{where}: found {word[:40]!r}, expected one of {', '.join(TYPES)}")
        if name not in index:
            index[name] = len(index)
            kinds.append(TYPES[word])
            sizes.append(_numbers(where, [fields[12], fields[11]], 2))
        frames.append(int(fields[0]))
        agents.append(index[name])
        numbers.append(_numbers(where, fields[13:17], 4))
    if where is None:
        raise InputError(f"{path}: found no label, expected at least one")
    table = np.reshape(numbers, (-1, 4))
    return _Labels(
        np.array(frames, dtype=np.int64), np.array(agents, dtype=np.int64), table[:, :3],
        table[:, 3], tuple(index), tuple(kinds), np.reshape(sizes, (-1, 2)),
    )  # fmt: skip


def _poses(path: Path) -> FloatArray:
    """(frames, 3, 4) rotation and place of the car at each frame, m from the first place."""
    rows = [_numbers(where, fields[:LEAST_POSE], LEAST_POSE) for where, fields in _lines(path)]
    if not rows:
        raise InputError(f"{path}: found no pose, expected one for each frame")
    latitude, longitude, altitude, roll, pitch, yaw = np.array(rows).T
    if (np.abs(latitude) > 89).any():
        raise InputError(f"{path}: found a latitude beyond 89 degrees")
    scale = np.cos(np.radians(latitude[0]))
    east = scale * EARTH_M * np.radians(longitude)
    north = scale * EARTH_M * np.log(np.tan(np.radians(90.0 + latitude) / 2))
    place = np.stack([east - east[0], north - north[0], altitude - altitude[0]], axis=1)
    turn = _turned(yaw, 2) @ _turned(pitch, 1) @ _turned(roll, 0)
    return np.concatenate([turn, place[:, :, None]], axis=2)


def _turned(angle: FloatArray, axis: int) -> FloatArray:
    """(n, 3, 3) matrices of rotations about an axis by angles in rad."""
    one, other = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = np.zeros((angle.size, 3, 3))
    matrix[:, axis, axis] = 1.0
    matrix[:, one, one] = matrix[:, other, other] = np.cos(angle)
    matrix[:, other, one] = np.sin(angle)
    matrix[:, one, other] = -np.sin(angle)
    return matrix


def _camera_to_car(path: Path) -> FloatArray:
    """(4, 4) from the rectified camera's frame to that of the car's measuring unit."""
    to_camera = np.eye(4)
    found = {fields[0].rstrip(":"): (where, fields[1:]) for where, fields in _lines(path)}
    for name, size in (("R_rect", 9), ("Tr_velo_cam", 12), ("Tr_imu_velo", 12)):
        if name not in found:
            raise InputError(f"{path}: found no {name}, expected it")
        matrix = np.eye(4)
        matrix[:3, : size // 3] = np.reshape(_numbers(*found[name], size), (3, size // 3))
        to_camera = to_camera @ matrix
    turn = to_camera[:3, :3]
    if not np.abs(turn @ turn.T - np.eye(3)).max() < 0.01:
        raise InputError(f"{path}: found a mounting that is no rotation, expected one")
    return np.asarray(np.linalg.inv(to_camera))
