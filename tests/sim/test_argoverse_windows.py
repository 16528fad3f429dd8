"""Argoverse windows: no gap in time, short episodes, labels come back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.data.exchange import export_dataset, import_recordings
from sim.formats import get_writer
from sim.formats.argoverse import windows
from sim.frames import Tracks
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeMeta
from sim.store.writing import new_dataset

FORMATS = ("argoverse1", "argoverse2")
STEPS = {"argoverse1": 50, "argoverse2": 110}


def drive(time_s: np.ndarray, behavior: tuple[int, ...] | None = (4, -1, 1)) -> Tracks:
    """Three cars side by side at 10, 11 and 12 m/s: where they are tells the time."""
    time_s = np.asarray(time_s, dtype=np.float64)
    speed = np.array([10.0, 11.0, 12.0])[:, None] * np.ones(time_s.size)
    xy = np.stack([speed * time_s, np.arange(3)[:, None] * 4.0 + 0 * speed], axis=2)
    return Tracks.of_dense(
        ids=np.arange(3),
        names=("9", "a", "b"),
        kind=np.zeros(3, dtype=np.int8),
        length=np.full(3, 4.5),
        width=np.full(3, 1.8),
        time_s=time_s,
        xy=xy,
        heading=np.zeros((3, time_s.size)),
        speed=speed,
        valid=np.ones((3, time_s.size), dtype=bool),
        signals=np.empty((0, time_s.size), dtype=np.int8),
        behavior=None if behavior is None else np.array(behavior, dtype=np.int8),
    )


def frames(*spans: tuple[int, int], step_s: float = 0.1) -> np.ndarray:
    """Times of some ranges of frames."""
    return np.concatenate([np.arange(*span) for span in spans]) * step_s


def dataset(folder: Path, *episodes: Tracks) -> Path:
    metas = [EpisodeMeta(scenario="here", engine="made", index=i) for i in range(len(episodes))]
    with new_dataset(folder, {}) as out:
        for meta, tracks in zip(metas, episodes, strict=True):
            out.write_recording(meta, tracks)
    return folder


# --- time ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("time_s", "starts"),
    [
        (frames((0, 120)), [0.0, 5.0]),
        (frames((0, 40), (70, 200)), [7.0, 12.0]),
        (frames((0, 60), (61, 130)), [0.0, 6.1]),
        (frames((0, 60), (63, 130)) + 1.1e9, [1.1e9, 1.1e9 + 6.3]),
        (frames((0, 240), step_s=0.05), [0.0, 5.0]),
        (frames((0, 81), (100, 300), step_s=0.05), [5.0, 10.0]),
        (frames((0, 150), (151, 401), step_s=0.05), [0.0, 7.45, 12.45]),  # 7.5 is missing
        (frames((0, 151), (152, 400), step_s=0.05), [0.0, 5.0, 10.0, 15.0]),  # 7.55 is not needed
        (frames((0, 10_001), step_s=0.0005), [0.0]),
        (frames((0, 49)), []),
        (frames((0, 1)), []),
        (np.empty(0), []),
    ],
)
def test_windows_hold_times_a_tenth_apart(time_s: np.ndarray, starts: list[float]) -> None:
    cut = list(windows(drive(time_s), 50))
    assert [w.time_s[0] for w in cut] == pytest.approx(starts, abs=1e-3)
    for window in cut:
        assert window.time_s.shape == (50,)
        np.testing.assert_allclose(np.diff(window.time_s), 0.1, rtol=0, atol=1e-3)
        np.testing.assert_allclose(window.xy[0, :, 0], 10.0 * window.time_s)


# --- episodes that are too short ----------------------------------------------------------------


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("short", [frames((0, 30)), frames((0, 1)), frames((0, 40), (70, 100))])
def test_short_episodes_are_left_out(
    tmp_path: Path, name: str, short: np.ndarray, caplog: pytest.LogCaptureFixture
) -> None:
    data = dataset(tmp_path / "data", drive(short), drive(frames((0, 120))), drive(short[:1]))
    written = export_dataset(data, tmp_path / "out", name, quiet=True)
    first, long, _ = (e.id for e in open_dataset(data).manifest.episodes)
    assert written
    (line,) = caplog.messages
    assert f"2 of 3 episodes left out, first {first}: found no " in line
    assert long not in line


# --- labels -------------------------------------------------------------------------------------


def written(folder: Path, name: str, behavior: tuple[int, ...] | None = (4, -1, 1)) -> Path:
    """The recording of one window."""
    folder.mkdir(exist_ok=True)
    tracks = drive(frames((0, STEPS[name])), behavior)
    (path, *_) = get_writer(name)(folder, "drive", tracks, None)
    return path / f"scenario_{path.name}.parquet" if path.is_dir() else path


@pytest.mark.parametrize("name", FORMATS)
def test_labels_go_out_and_in_again_as_datasets(tmp_path: Path, name: str) -> None:
    data = dataset(tmp_path / "data", drive(frames((0, 120))))
    export_dataset(data, tmp_path / "out", name, quiet=True)
    import_recordings(tmp_path / "out", tmp_path / "back", name, quiet=True)
    back = open_dataset(tmp_path / "back")
    for entry in back.manifest.episodes:
        tracks = back.read(entry).tracks
        assert tracks.names == ("9", "a", "b")
        assert tracks.behavior is not None
        assert tracks.behavior.tolist() == [4, -1, 1]


# --- small files that claim much ----------------------------------------------------------------
