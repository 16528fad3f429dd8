"""Recordings without labels, and videos whose labels were never seen."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from behaviors import InputError
from experiments.benches.classification.recorded import (
    cut_in_half,
    places_in,
    recorded_rows,
    spearman,
)
from experiments.benches.classification.second_half import MEASURES, halves, measured
from experiments.benches.classification.zero_shot import mean_rank, mean_row, zero_shot_rows
from graphrqi.features.unit_free import NAMES
from sim.frames import Tracks

STEP_S = 0.1


def drive(along: np.ndarray, across: np.ndarray | None = None) -> Tracks:
    """Cars at these places (n, T) along and across a road."""
    across = np.zeros_like(along) if across is None else across
    n, t = along.shape
    speed = np.gradient(along, STEP_S, axis=1)
    return Tracks(
        ids=np.arange(n),
        names=tuple(map(str, range(n))),
        kind=np.zeros(n, dtype=np.int8),
        length=np.full(n, 4.0),
        width=np.full(n, 1.8),
        time_s=STEP_S * np.arange(t),
        xy=np.stack([along, across], axis=2),
        heading=np.zeros((n, t)),
        speed=speed,
        valid=np.ones((n, t), dtype=bool),
        signals=np.empty((0, t), dtype=np.int8),
    )


TIME_S = STEP_S * np.arange(301)


def test_headway_pace_and_braking_of_each_half():
    """A follower 24 m behind at 10 m/s is 2 s behind; then the leader brakes and all are slower."""
    leader = 10.0 * TIME_S
    leader[230:] = leader[230] + 5.0 * (TIME_S[230:] - TIME_S[230])
    follower = leader - 24.0
    does = measured(drive(np.stack([leader, follower])))
    assert does.shape == (2, 2, len(MEASURES))
    assert np.isnan(does[0, :, 0]).all()
    np.testing.assert_allclose(does[1, :, 0], [2.0, 3.0], rtol=0.05)
    np.testing.assert_allclose(does[:, :, 1], 1.0, rtol=0.01)
    assert does[1, 0, 3] < 0.5
    assert does[1, 1, 3] > 3.0


def test_a_change_of_lane_is_counted_and_weaving_and_turning_are_not():
    along = np.broadcast_to(15.0 * TIME_S, (3, TIME_S.size)) + 60.0 * np.arange(3)[:, None]
    across = np.zeros((3, TIME_S.size))
    across[0] = 3.5 / (1.0 + np.exp(-3.0 * (TIME_S - 24.0)))
    across[1] = 0.5 * np.sin(TIME_S)
    across[2] = 0.01 * np.maximum(TIME_S - 15.0, 0.0) ** 3
    changes = measured(drive(along, across))[:, :, 2] * 14.0 / 60.0  # per minute, of 14 s
    np.testing.assert_allclose(changes[0], [0.0, 1.0], atol=0.02)
    assert changes[1].max() == 0.0
    assert changes[2, 0] == 0.0


def test_halves_are_new_drivers_in_the_same_scene():
    tracks = drive(np.stack([10.0 * TIME_S, 10.0 * TIME_S - 30.0]))
    rows, begins, last = halves(tracks)
    assert rows.tolist() == [0, 1]
    assert begins.tolist() == [[0, 150], [0, 150]]
    assert last.tolist() == [300, 300]
    cut = cut_in_half(tracks, rows, begins[:, 1])
    assert cut.ids.tolist() == [0, 1, 2, 3]
    assert (cut.valid.sum(axis=0) == 2).all()
    assert np.nanmax(cut.xy[0, :, 0]) < np.nanmin(cut.xy[1, :, 0])
    assert not halves(drive(10.0 * TIME_S[None, :90]))[0].size


def test_rank_correlations_have_intervals():
    rng = np.random.default_rng(0)
    one = rng.normal(size=300)
    value, low, high = spearman(one, -one + rng.normal(size=300))
    assert low < value < high < -0.5
    assert np.isnan(spearman(one, np.ones(300))).all()


def write_interaction(path: Path, beside_m: float, cars: int = 12, seconds: float = 14.0) -> None:
    lines = ["track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width"]
    for car in range(cars):
        for step in range(round(10 * seconds)):
            x = 14.0 * (car // 2) + 1.1 * step + 0.02 * car * step
            y = beside_m * (car % 2)
            lines.append(f"{car},{step},{100 * step},car,{x},{y},11,0,0,4.5,1.8")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def test_places_are_measured_and_what_is_no_scene_is_unknown(tmp_path):
    write_interaction(tmp_path / "road" / "vehicle_tracks_000.csv", 3.5)
    write_interaction(tmp_path / "heap" / "vehicle_tracks_000.csv", 0.2)
    (tmp_path / "road" / "vehicle_tracks_001.csv").write_text("track_id,timestamp_ms,agent_type\n")
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "read.me").write_text("nothing")
    assert list(places_in(tmp_path)) == ["heap", "notes", "road"]
    said: list[str] = []
    rows = [
        row
        for part in recorded_rows(tmp_path, "graphrqi-plus", jobs=1, say=said.append)
        for row in part
    ]
    assert len(said) == 2
    assert "notes skipped" in said[0]
    assert "left out" in said[1]
    assert "vehicle_tracks_001.csv" in said[1]
    found = {(row["scenario"], row["metric"]): row for row in rows}
    assert found["heap", "share_unknown"]["value"] == 1.0
    assert found["heap", "share_no_scene"]["value"] == 1.0
    assert ("heap", "share_aggressive") not in found
    assert found["road", "share_no_scene"]["value"] == 0.0
    assert found["road", "spearman_time_headway"]["n"] == 10
    classes = ("impatient", "reckless", "threatening", "careful", "cautious", "timid")
    assert sum(found["road", f"share_{name}"]["value"] for name in classes) == pytest.approx(1.0)


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match="found nothing, expected a folder of recordings"):
        list(recorded_rows(tmp_path / "none", "graphrqi-plus"))


def test_ranks_need_no_training():
    features = np.zeros((3, len(NAMES)))
    features[:, NAMES.index("passed")] = [2.0, 0.0, 1.0]
    features[:, NAMES.index("was passed")] = [0.0, 2.0, 1.0]
    assert mean_rank(features).argsort().tolist() == [1, 2, 0]


def test_the_mean_over_videos_leaves_out_those_without_both_styles():
    row = mean_row([(0.7, 0.6, 0.8), (0.5, 0.4, 0.6), (float("nan"),) * 3], "any", 40)
    assert row["value"] == pytest.approx(0.6)
    assert row["low"] == pytest.approx(0.6 - 0.1 / np.sqrt(2))


def test_videos_that_are_not_there_are_skipped(tmp_path):
    said: list[str] = []
    assert zero_shot_rows(tmp_path, "graphrqi-plus", say=said.append) == []
    assert "found no annotated video" in said[0]


@pytest.mark.skipif("GRAPHRQI_DATA" not in os.environ, reason="GRAPHRQI_DATA names no recordings")
def test_a_video_is_scored_without_its_labels():
    folder = Path(os.environ["GRAPHRQI_DATA"]) / "traf"
    rows = zero_shot_rows(folder, "graphrqi-plus", jobs=1, most=1)
    found = {(row["scenario"], row["method"]): row["value"] for row in rows}
    assert 0.0 <= found["all", "graphrqi-plus"] <= 1.0
    assert found["all", "mean of ranks"] == found[rows[0]["scenario"], "mean of ranks"]
