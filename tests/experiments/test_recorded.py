"""Training and scoring on recordings: nothing tells left from right, and what is saved predicts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.benchmarks import recorded_beliefs
from experiments.benchmarks.recorded_prediction import measure
from experiments.training.recorded import (
    MIRROR,
    mirrored,
    recorded_examples,
    train_on_recordings,
)
from experiments.training.recordings import CLASSES, history_of
from graphrqi.posterior import Posterior
from graphrqi.predict import predict
from graphrqi.predict.networks import TIME_S
from graphrqi.predict.recorded.network import SHIPPED
from scenarios import SCENARIOS
from sim.frames import Frame, Tracks
from sim.road.lane_graph import DIRECTIONS, LaneGraph

NOBODY = Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))


def traffic(seed=0, step_s=0.1, seconds=9.0, n=6) -> Tracks:
    """Vehicles that accelerate by waves; the last one is parked."""
    rng = np.random.default_rng(seed)
    phase, speed = rng.uniform(0, 6, n), rng.uniform(6, 14, n)
    x = np.cumsum(rng.uniform(30, 50, n))[::-1].copy()
    frames = []
    for step in range(round(seconds / step_s) + 1):
        now = step * step_s
        fast = np.maximum(speed + 2.0 * np.sin(0.8 * now + phase), 0.0)
        fast[-1] = 0.0
        frames.append(
            Frame(time_s=now, ids=np.arange(n), xy=np.column_stack([x, np.zeros(n)]),
                  heading=np.zeros(n), speed=fast, length=np.full(n, 4.5),
                  width=np.full(n, 1.8), kind=np.zeros(n))
        )  # fmt: skip
        x = x + fast * step_s
    return Tracks.from_frames(frames)


def write_interaction(folder: Path, tracks: Tracks, number: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    rows = ["track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width"]
    for i in range(tracks.ids.size):
        for t, time_s in enumerate(tracks.time_s):
            x, y = tracks.xy[i, t]
            rows.append(
                f"{i + 1},{t + 1},{round(time_s * 1000)},car,{x:.3f},{y:.3f},"
                f"{tracks.speed[i, t]:.3f},0.0,0.0,4.5,1.8"
            )
    (folder / f"vehicle_tracks_{number:03d}.csv").write_text("\n".join(rows) + "\n")


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    for name, seeds in (("ngsim_us101", range(3)), ("some_junction", range(10, 13))):
        for number, seed in enumerate(seeds):
            write_interaction(folder / name, traffic(seed), number)
    (folder / "pairs").mkdir()
    (folder / "pairs" / "numbers.csv").write_text("a,b\n1,2\n")
    return folder


def test_a_mirrored_scene_is_seen_as_the_same_with_left_and_right_swapped():
    """Numbers that tell left from right change sign or place; all others stay as they are."""
    road = SCENARIOS["four_way_intersection"]().road
    graph = LaneGraph.of(road)
    ways = graph.drivable & ~graph.internal & ((graph.successors >= 0).sum(axis=1) > 1)
    lanes = np.repeat(np.flatnonzero(ways), 2)
    back = np.tile([30.0, 55.0], lanes.size // 2)
    frames = []
    for ago in np.arange(3.0, -1e-9, -0.1):
        s = graph.length[lanes] - back - 8.0 * ago
        aside = np.linspace(-1.2, 1.3, lanes.size)
        xy, heading = graph.position(lanes, s, aside * (1.0 + 0.1 * np.cos(ago)))
        n = lanes.size
        frames.append(
            Frame(time_s=10.0 - ago, ids=np.arange(n), xy=xy, heading=heading,
                  speed=np.full(n, 8.0), length=np.full(n, 4.5), width=np.full(n, 1.8),
                  kind=np.zeros(n))
        )  # fmt: skip
    history = Tracks.from_frames(frames)
    truth = history.xy[:, -1, None] + 5.0 * TIME_S[None, :, None]
    everyone = np.ones(lanes.size, bool)
    one = recorded_examples(history, truth, everyone, 0, True, road)
    other = recorded_examples(mirrored(history), truth * MIRROR, everyone, 0, True, road.mirrored)
    for name in ("base", "truth"):
        np.testing.assert_allclose(getattr(one, name) * MIRROR, getattr(other, name), atol=1e-3)
    assert one.ahead.exists.sum() > 2 * lanes.size
    np.testing.assert_array_equal(one.ahead.exists, other.ahead.exists)
    np.testing.assert_allclose(one.ahead.points * MIRROR, other.ahead.points, atol=1e-3)
    np.testing.assert_allclose(one.ahead.offset_m, -other.ahead.offset_m, atol=1e-3)
    share = 10 + 4 + len(DIRECTIONS)  # how many turn right, and left, is the same after mirroring
    paths = (np.delete(each.ahead.features, share, axis=-1) for each in (one, other))
    for before, after in ((one.features, other.features), tuple(paths)):
        sizes = np.sort(np.abs(before), axis=-1), np.sort(np.abs(after), axis=-1)
        np.testing.assert_allclose(*sizes, atol=1e-3)
        assert (before != after).any()


def test_training_writes_weights_that_predict_uses(data, tmp_path):
    scores = train_on_recordings([data], tmp_path, epochs=1, quiet=True)
    assert scores.keys() == {"ngsim_us101", "some_junction"}
    history = history_of(traffic(), 41)
    ours = predict(history, NOBODY, None, weights=tmp_path)
    shipped = predict(history, NOBODY, None)
    assert not np.array_equal(ours.xy, shipped.xy)
    first = (tmp_path / SHIPPED).read_bytes()
    train_on_recordings([data], tmp_path, epochs=1, quiet=True)
    assert (tmp_path / SHIPPED).read_bytes() == first
    with pytest.raises(InputError, match="found no file"):
        predict(history, NOBODY, None, weights=tmp_path / "no")


def test_the_bench_leaves_each_dataset_out(data):
    rows = [row for part in measure(data, 1, 0, 200) for row in part]
    keys = {"dataset", "predictor", "map", "noise_m", "class", "horizon_s"}
    assert all(row.keys() == keys | {"metric", "value", "low", "high", "n"} for row in rows)
    assert {row["predictor"] for row in rows} >= {"left-out", "graphrqi-predict", "base", "kalman"}
    assert {row["noise_m"] for row in rows} == {0.0, 0.1}
    ratios = [row for row in rows if row["metric"] == "ratio_to_cv"]
    assert {row["horizon_s"] for row in ratios} == {0.5, 1.0, 3.0, 5.0}
    assert {row["class"] for row in ratios} <= {"moving", *CLASSES}


def test_beliefs_about_recorded_drivers_are_compared_between_their_halves(data):
    rows = next(recorded_beliefs.measure(data / "ngsim_us101", jobs=1))
    metrics = {row["metric"]: row["value"] for row in rows}
    assert 0.0 <= metrics["share_unknown"] <= 1.0
    assert {row["protocol"] for row in rows} == {"recorded"}
