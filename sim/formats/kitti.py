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
from sim.formats.common.packed import lines_of, opened, plain_name, stem
from sim.formats.common.recording import (
    Recording,
    Rows,
    assemble,
    check_size,
    kind_codes,
)
from sim.frames import AgentKind
from sim.written_numbers import real

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

FIELDS: Final = (17, 18)
"""Fields of a label: 17, and a score where a tracker wrote it."""

LEAST_POSE: Final = 6
"""Fields of a pose that are read: latitude, longitude, altitude, roll, pitch, yaw."""

EARTH_M: Final = 6378137.0
"""Radius of the earth that the Mercator projection of KITTI's tools takes, m."""

MAX_FRAMES: Final = 10**6
"""Most frames of a sequence (the longest has 1 059)."""

MAX_LINE: Final = 4096
"""Longest line, bytes (a pose has some 500)."""

LONGEST_ID: Final = 20
"""Most digits of an agent's id (real ones have up to three)."""

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
        agent=np.append(labels.agent, np.full(frames.size, n)),
        names=(*labels.names, "ego"),
        time_s=np.append(labels.frame, frames).astype(np.float64) * PERIOD_S,
        x=np.append(xy[:, 0], ego[:, 0]),
        y=np.append(xy[:, 1], ego[:, 1]),
        heading=heading,
        speed=np.full(heading.size, np.nan),
        length=np.append(labels.sizes[:, 0], EGO_SIZE_M[0]),
        width=np.append(labels.sizes[:, 1], EGO_SIZE_M[1]),
        kind=kind_codes([*labels.kinds, AgentKind.CAR]),
    )
    notes = (
        "the recording car's motion is undone with its poses; it is the agent ego",
        "speeds are taken from the motion",
    )
    yield Recording(stem(path), assemble(path, rows), notes)


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


def _lines(path: Path) -> Iterator[tuple[int, list[bytes]]]:
    """The number and the fields of every line that is not blank.

    Raises:
        InputError: if there are too many.
    """
    check_size(path)
    with opened(path) as file:
        for line_number, line in lines_of(path, file, MAX_LINE):
            if line_number > 100 * MAX_FRAMES:
                raise InputError(f"{path}: found more than {100 * MAX_FRAMES} lines")
            fields = line.split()
            if fields:
                yield line_number, fields


def _numbers(where: str, fields: list[bytes]) -> list[float]:
    try:
        return [real(field) for field in fields]
    except ValueError:
        raise InputError(f"{where}: found {fields[0][:40]!r}..., expected numbers") from None


def _labels(path: Path) -> _Labels:
    frames, agents, numbers = list[int](), list[int](), list[list[float]]()
    index: dict[str, int] = {}
    kinds, sizes = list[AgentKind](), list[list[float]]()
    read = 0
    for line_number, fields in _lines(path):
        where, read = f"{path}: line {line_number}", line_number
        if len(fields) not in FIELDS:
            raise InputError(f"{where}: found {len(fields)} fields, expected {FIELDS[0]}")
        word = fields[2].decode("ascii", "replace")
        if word in LEFT_OUT:
            continue
        if word not in TYPES:
            raise InputError(f"{where}: found {word[:40]!r}, expected one of {', '.join(TYPES)}")
        for field, what, longest in ((fields[0], "frame", 6), (fields[1], "id", LONGEST_ID)):
            if not field.isdigit() or len(field) > longest:
                found = field[:40].decode("ascii", "replace")
                raise InputError(
                    f"{where}: found {found!r}, expected a{'n' * (what == 'id')} {what}, at most "
                    f"{longest} digits"
                )
        name = fields[1].decode("ascii")
        if name not in index:
            index[name] = len(index)
            kinds.append(TYPES[word])
            sizes.append(_numbers(where, [fields[12], fields[11]]))
        values = _numbers(where, fields[13:17])
        if not np.isfinite(values).all() or np.abs(values).max() > 1e4:
            raise InputError(f"{where}: found place {values[:3]}, expected metres and an angle")
        frames.append(int(fields[0]))
        agents.append(index[name])
        numbers.append(values)
    if not read:
        raise InputError(f"{path}: found no label, expected at least one")
    table = np.array(numbers, dtype=np.float64).reshape(-1, 4)
    return _Labels(
        np.array(frames, dtype=np.int64),
        np.array(agents, dtype=np.int64),
        table[:, :3],
        table[:, 3],
        tuple(index),
        tuple(kinds),
        np.array(sizes, dtype=np.float64).reshape(-1, 2),
    )


def _poses(path: Path) -> FloatArray:
    """(frames, 3, 4) rotation and place of the car at each frame, m from the first place."""
    rows = []
    for line_number, fields in _lines(path):
        where = f"{path}: line {line_number}"
        if len(fields) < LEAST_POSE:
            raise InputError(f"{where}: found {len(fields)} fields, expected 30")
        values = _numbers(where, fields[:LEAST_POSE])
        if not np.isfinite(values).all() or abs(values[0]) > 89 or abs(values[1]) > 360:
            raise InputError(f"{where}: found {values[:2]}, expected latitude and longitude")
        rows.append(values)
        if len(rows) > MAX_FRAMES:
            raise InputError(f"{path}: found more than {MAX_FRAMES} poses")
    if not rows:
        raise InputError(f"{path}: found no pose, expected one for each frame")
    latitude, longitude, altitude, roll, pitch, yaw = np.array(rows).T
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
    found: dict[str, FloatArray] = {}
    for line_number, fields in _lines(path):
        name = fields[0].decode("ascii", "replace").rstrip(":")
        size = {"R_rect": 9, "Tr_velo_cam": 12, "Tr_imu_velo": 12}.get(name)
        if size is None:
            continue
        where = f"{path}: line {line_number}"
        values = np.array(_numbers(where, fields[1:]))
        if values.size != size or not (np.abs(values) < 1e4).all():
            raise InputError(f"{where}: found {values.size} numbers, expected {size} in metres")
        matrix = np.eye(4)
        matrix[:3, : size // 3] = values.reshape(3, size // 3)
        found[name] = matrix
    missing = {"R_rect", "Tr_velo_cam", "Tr_imu_velo"} - set(found)
    if missing:
        raise InputError(f"{path}: found no {min(missing)}, expected it")
    to_camera = found["R_rect"] @ found["Tr_velo_cam"] @ found["Tr_imu_velo"]
    turn = to_camera[:3, :3]
    if not np.abs(turn @ turn.T - np.eye(3)).max() < 0.01:
        raise InputError(f"{path}: found a mounting that is no rotation, expected one")
    return np.asarray(np.linalg.inv(to_camera))
