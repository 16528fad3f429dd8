"""KITTI tracking: hand-computed places in the world, and real sequences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from sim.formats import left_out_files, read_recordings, recognise
from sim.frames import KINDS, AgentKind
from tests.sim.scenes import KITTI_CALIB, KITTI_LABELS, KITTI_OXTS


def sequence(folder: Path, **changed: str) -> Path:
    texts = {"label_02": KITTI_LABELS, "oxts": KITTI_OXTS, "calib": KITTI_CALIB} | changed
    for name, text in texts.items():
        (folder / name).mkdir()
        (folder / name / "0007.txt").write_text(text)
    return folder / "label_02" / "0007.txt"


def test_places_in_the_world(tmp_path: Path) -> None:
    (recording,) = read_recordings(sequence(tmp_path))
    tracks = recording.tracks
    assert tracks.names == ("3", "7", "ego")
    assert [KINDS[k] for k in tracks.kind[:2]] == [AgentKind.CAR, AgentKind.PEDESTRIAN]
    # 10 m ahead of a camera half a metre before the unit, 2 m to the right; then the car has moved
    np.testing.assert_allclose(tracks.xy[0], [[10.5, -2.0], [10.5, -2.0]], atol=1e-3)
    np.testing.assert_allclose(tracks.xy[1, 0], [8.5, 3.0], atol=1e-3)
    np.testing.assert_allclose(tracks.heading[0], 0.0, atol=1e-6)
    np.testing.assert_allclose(tracks.heading[1, 0], -np.pi / 2, atol=1e-6)
    np.testing.assert_allclose(tracks.speed[2], 10.0, atol=0.01)
    assert (tracks.length[0], tracks.width[0]) == (4.25, 1.75)
    assert recognise(tmp_path) == "kitti"
    assert left_out_files(tmp_path, ["kitti"]) == []


def test_without_poses_the_motion_cannot_be_undone(tmp_path: Path) -> None:
    path = sequence(tmp_path)
    (tmp_path / "oxts" / "0007.txt").unlink()
    with pytest.raises(InputError, match=r"found no oxts/0007\.txt"):
        list(read_recordings(path))


def test_parked_cars_stand_in_real_sequences(shared_data: Path) -> None:
    (recording,) = read_recordings(shared_data / "real" / "kitti" / "label" / "0007.txt.gz")
    tracks = recording.tracks
    ego = tracks.xy[tracks.names.index("ego")]
    assert np.hypot(*np.diff(ego, axis=0).T).sum() > 400
    drift, turned = [], []
    for row in range(len(tracks.names) - 1):
        xy, heading = tracks.xy[row][tracks.valid[row]], tracks.heading[row][tracks.valid[row]]
        if len(xy) < 10 or KINDS[tracks.kind[row]] is not AgentKind.CAR:
            continue
        way = xy[5:] - xy[:-5]
        moving = np.hypot(*way.T) > 2
        if np.hypot(*(xy[-1] - xy[0])) < 2:
            drift.append(np.hypot(*(xy - np.median(xy, axis=0)).T).max())
        off = np.arctan2(way[:, 1], way[:, 0]) - heading[2:-3]
        turned += np.abs(np.angle(np.exp(1j * off[moving]))).tolist()
    assert np.median(drift) < 0.5
    assert np.degrees(np.median(turned)) < 4
