"""Windows for PyTorch: every one once, in an order that the seed decides, also from two workers."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from behaviors import InputError
from graphrqi.torch_windows import TorchWindows, WindowOptions, windows_of
from sim.frames import Tracks
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeMeta, split_of
from sim.store.writing import new_dataset

STEPS = 101


def tracks(first: int) -> Tracks:
    """Three agents on straight lines far from the origin; the last one leaves early."""
    time_s = 0.1 * np.arange(STEPS)
    speed = np.array([10.0, 5.0, 20.0])
    xy = np.tile([4.5e5, 5.4e6], (3, STEPS, 1))
    xy[..., 0] += speed[:, None] * time_s
    valid = np.ones((3, STEPS), dtype=bool)
    valid[2, 40:] = False
    return Tracks(
        ids=first + np.arange(3),
        names=tuple(str(first + i) for i in range(3)),
        kind=np.zeros(3, dtype=np.int8),
        length=np.full(3, 4.0),
        width=np.full(3, 2.0),
        time_s=time_s,
        xy=np.where(valid[..., None], xy, np.nan),
        heading=np.where(valid, 0.0, np.nan),
        speed=np.where(valid, speed[:, None], np.nan),
        valid=valid,
        signals=np.empty((0, STEPS), dtype=np.int8),
        behavior=np.array([0, 5, -1], dtype=np.int8),
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("windows") / "data"
    with new_dataset(folder, {}) as out:
        for i in range(6):
            meta = EpisodeMeta(scenario="line", engine="ngsim", index=i, split=split_of(i))
            out.write_recording(meta, tracks(10 * i))
    return folder


def keys(windows) -> list[tuple[str, int, float]]:
    return [(w["episode"], w["agent"], round(w["time_s"], 3)) for w in windows]


def test_a_window_is_past_future_and_label() -> None:
    options = WindowOptions(history_s=1.0, future_s=2.0, step_s=0.5)
    windows = list(windows_of(tracks(0), options))
    assert [w["agent"] for w in windows[:3]] == [0, 1, 2]
    first, second, third = windows[:3]
    assert first["time_s"] == pytest.approx(1.0)
    torch.testing.assert_close(first["history"][:, 0], torch.tensor([-10.0, -5.0, 0.0]))
    torch.testing.assert_close(first["history"][:, 3], torch.full((3,), 10.0))
    torch.testing.assert_close(first["future"][:, 0], torch.tensor([5.0, 10.0, 15.0, 20.0]))
    assert first["origin"].dtype == torch.float64
    assert first["origin"].tolist() == [450_010.0, 5.4e6]
    assert [w["behavior"] for w in (first, second, third)] == [0, 5, -1]
    assert {w["agent"] for w in windows if w["time_s"] > 2.5} == {0, 1}


def test_agents_that_leave_have_a_mask() -> None:
    options = WindowOptions(history_s=1.0, future_s=2.0, step_s=0.5, whole=False)
    left = [w for w in windows_of(tracks(0), options) if w["agent"] == 2]
    assert left[-1]["future_valid"].tolist() == [True, False, False, False]
    assert left[-1]["future"][1:].abs().sum() == 0


def test_every_window_comes_once_from_any_number_of_workers(folder: Path) -> None:
    plain = keys(TorchWindows(folder))
    assert len(plain) == len(set(plain)) > 60
    shuffled = TorchWindows(folder, seed=3, buffer=20)
    once = keys(shuffled)
    assert once == keys(TorchWindows(folder, seed=3, buffer=20))
    assert once != plain
    assert sorted(once) == sorted(plain)
    shuffled.set_epoch(1)
    again = keys(shuffled)
    assert again != once
    assert sorted(again) == sorted(plain)
    two = list(DataLoader(shuffled, batch_size=None, num_workers=2))
    assert sorted(keys(two)) == sorted(plain)
    assert keys(two) == keys(DataLoader(shuffled, batch_size=None, num_workers=2))


def test_batches_and_filters(folder: Path) -> None:
    loader = DataLoader(TorchWindows(folder, split="test", seed=0), batch_size=4)
    batch = next(iter(loader))
    assert batch["history"].shape == (4, 21, 4)
    assert batch["future"].shape == (4, 30, 2)
    assert set(batch["split"]) == {"test"}
    assert batch["behavior"].dtype == torch.int64
    wanted = {e.id for e in open_dataset(folder).episodes(split="test")}
    assert set(batch["episode"]) <= wanted


def test_a_worker_is_sent_no_rows(folder: Path) -> None:
    windows = TorchWindows(folder)
    sent = pickle.dumps(windows)
    assert len(sent) < 2000
    assert keys(pickle.loads(sent)) == keys(windows)


def test_what_cannot_be(folder: Path) -> None:
    with pytest.raises(InputError, match="found no episode that fits"):
        TorchWindows(folder, scenario="circle")
    with pytest.raises(InputError, match=r"step_s: found 0\.25, expected a multiple"):
        list(TorchWindows(folder, WindowOptions(step_s=0.25)))
    with pytest.raises(InputError, match="future_s: found -1"):
        WindowOptions(future_s=-1.0)
