"""Evaluation of predictors: sums, intervals, futures, and a tiny dataset end to end."""

from __future__ import annotations

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.cli.commands import main
from experiments.score.predictions import (
    GROUPS,
    MEASURES,
    Errors,
    errors_table,
    future,
    instants,
    predict_dataset,
    score_episode,
    score_predictions,
)
from experiments.score.tables import PREDICTIONS
from experiments.training.predictor import calibrate_drivers
from graphrqi.networks.weights import load_weights
from graphrqi.posterior import Posterior
from graphrqi.predict import PREDICTORS
from graphrqi.predict.networks import MODES
from graphrqi.predict.rollout.driver_table import load_table
from scenarios import SCENARIOS
from sim.engines import get_engine
from sim.frames import Frame, Tracks
from sim.scenario import sample_agents
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeMeta
from sim.store.writing import new_dataset

NOBODY = Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))


def steady(speeds, seconds=12.0, step_s=0.1, y=0.0, start=50.0) -> Tracks:
    """Vehicles one behind the other far apart, each at its own constant speed along x."""
    n = len(speeds)
    frames = [
        Frame(
            time_s=t,
            ids=np.arange(n),
            xy=np.column_stack([start + 100 * np.arange(n) + np.array(speeds) * t, np.full(n, y)]),
            heading=np.zeros(n),
            speed=np.array(speeds),
            length=np.full(n, 4.0),
            width=np.full(n, 1.8),
            kind=np.zeros(n),
        )
        for t in np.arange(0.0, seconds + 1e-9, step_s)
    ]
    return Tracks.from_frames(frames, dict.fromkeys(range(n), BEHAVIORS[3]))


@pytest.fixture(scope="module")
def road():
    return SCENARIOS["straight_road"]().road


def test_instants_leave_room_for_past_and_future():
    tracks = steady([5.0], seconds=20.0)
    stops = list(instants(tracks, 5.0, every_s=2.0))
    times = tracks.time_s[np.array(stops) - 1]
    assert times[0] == pytest.approx(5.0)
    assert np.diff(times) == pytest.approx(2.0)
    assert times[-1] == pytest.approx(15.0)
    assert list(instants(steady([5.0], seconds=3.0), 5.0)) == []


@pytest.mark.parametrize("step_s", [0.1, 0.04, 0.25])
def test_future_is_what_happened_whatever_the_step(step_s):
    tracks = steady([5.0, 8.0], step_s=step_s)
    stop = int(np.searchsorted(tracks.time_s, 4.0 - 1e-9)) + 1
    ahead = np.array([0.5, 1.0, 3.0])
    told = future(tracks, np.array([0, 1]), stop, ahead)
    expected = 50 + 100 * np.arange(2)[:, None] + np.outer([5.0, 8.0], 4.0 + ahead)
    assert told[..., 0] == pytest.approx(expected)


def test_future_beyond_the_recording_is_unknown():
    tracks = steady([5.0])
    assert np.isnan(future(tracks, np.array([0]), 100, np.array([5.0]))).all()


def test_constant_velocity_is_perfect_on_steady_vehicles(road):
    tracks = steady([5.0, 8.0], y=-8.0)
    stops = list(instants(tracks, 5.0))
    found = score_episode(tracks, dict.fromkeys(stops, NOBODY), road, ["constant-velocity"])
    errors = found["constant-velocity"]
    assert errors.count[GROUPS.index("all")] == 2 * len(stops)
    assert errors.count[GROUPS.index("careful")] == 2 * len(stops)
    assert errors.count[GROUPS.index("timid")] == 0
    assert np.nanmax(np.abs(errors.total)) < 1e-6
    assert np.isnan(errors.total[0, 0, MEASURES.index("coverage_90")])


OWN = """
import numpy as np

def ahead(scene, posterior):
    unit = np.stack([np.cos(scene.heading), np.sin(scene.heading)], axis=1)
    way = unit[:, None] * (scene.speed[:, None] * scene.time_s)[..., None]
    return scene.predicted(scene.xy[:, None] + way)

def short(scene, posterior):
    return ahead(scene, posterior).until(1.0)

def number(scene, posterior):
    return 3

broken = 4
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    (tmp_path / "my_predictor_of_this_test.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return "my_predictor_of_this_test"


def test_a_predictor_of_ones_own_is_scored_beside_ours(own, dataset, tmp_path, capsys):
    names = ("constant-velocity", f"{own}:ahead")
    with pytest.raises(SystemExit) as ended:
        main(["predict", str(dataset), "--predictors", ",".join(names), "--json", "e.json", "-q"])
    assert ended.value.code == 0
    rows = json.loads((tmp_path / "e.json").read_text())
    ours, mine = (
        {
            (row["behavior"], row["horizon_s"]): row["value"]
            for row in rows
            if row["predictor"] == name and row["metric"] == "fde_m"
        }
        for name in names
    )
    assert mine == ours
    assert mine
    with pytest.raises(SystemExit) as ended:
        main(["predict", str(dataset), "--predictors", f"{own}:short", "-q"])
    assert ended.value.code == 2
    assert "every 0.5 s up to 5 s" in " ".join(capsys.readouterr().err.split())


def test_a_name_from_a_file_runs_no_code(own):
    with pytest.raises(InputError, match="unknown predictor"):
        PREDICTORS[f"{own}:ahead"]


def test_errors_of_a_braking_vehicle_are_the_textbook_ones(road):
    """From speed v with deceleration b, constant velocity is off by b t^2 / 2."""
    frames = []
    for t in np.arange(0.0, 12.0 + 1e-9, 0.1):
        frames.append(
            Frame(
                time_s=t, ids=[0], xy=[[50.0 + 13.0 * t - 0.25 * t**2, -8.0]], heading=[0.0],
                speed=[13.0 - 0.5 * t], length=[4.0], width=[1.8], kind=[0],
            )
        )  # fmt: skip
    tracks = Tracks.from_frames(frames)
    found = score_episode(tracks, {51: NOBODY}, road, ["constant-velocity"])["constant-velocity"]
    fde, ade = MEASURES.index("fde_m"), MEASURES.index("ade_m")
    assert found.total[0, :, fde] == pytest.approx([0.25, 2.25, 6.25], abs=1e-6)
    at = np.arange(0.5, 5.1, 0.5)
    assert found.total[0, 2, ade] == pytest.approx(0.25 * (at**2).mean(), abs=1e-6)


def made_up(value: float, count: float = 10.0) -> Errors:
    total = np.zeros((len(GROUPS), 3, len(MEASURES)))
    total[0] = value * count
    counts = np.zeros(len(GROUPS))
    counts[0] = count
    return Errors(total, counts)


def test_summary_has_intervals_and_paired_differences():
    rng = np.random.default_rng(0)
    difficulty = rng.uniform(1, 3, 12)
    rows = score_predictions(
        [{"a": made_up(d), "b": made_up(d - 0.2)} for d in difficulty],
        {"scenario": "somewhere", "split": "test"},
    )
    assert len(errors_table(rows)) == 2
    picked = {
        (r["predictor"], r["metric"]): r
        for r in rows
        if r["horizon_s"] == 5 and "ade" in r["metric"]
    }
    a = picked["a", "ade_m"]
    assert a["low"] < a["value"] < a["high"]
    assert a["value"] == pytest.approx(difficulty.mean())
    difference = picked["b", "ade_m_minus_a"]
    assert [difference[k] for k in ("value", "low", "high")] == pytest.approx([-0.2] * 3)
    assert {r["behavior"] for r in rows} == {"all"}
    rmse = next(r for r in rows if r["metric"] == "rmse_m" and r["predictor"] == "a")
    assert rmse["value"] == pytest.approx(np.sqrt(difficulty.mean()))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("prediction") / "data"
    with new_dataset(folder, {}) as out:
        for index, split in enumerate(("train", "validation", "test")):
            scenario = SCENARIOS["straight_road"](duration_s=30.0, flow=1500)
            agents = sample_agents(scenario, index)
            meta = EpisodeMeta(
                scenario=scenario.name, options={}, engine="sumo", seed=index, index=index,
                split=split,
            )  # fmt: skip
            frames = get_engine("sumo")(scenario, agents, index)
            out.write_episode(meta, frames, agents, scenario.road.source)
    return folder


def test_calibration_improves_on_training_scenes_and_writes_its_card(dataset, tmp_path):
    out = tmp_path / "drivers.safetensors"
    table = calibrate_drivers(dataset, out, iterations=6, quiet=True)
    assert np.allclose(load_table(out).behavior, table.behavior, atol=1e-4)
    card = load_weights(out, "drivers")[0]["card"]
    assert card["split"] == "train"
    assert set(card["scores"]) == {"train", "validation"}
    again = calibrate_drivers(dataset, tmp_path / "again.safetensors", iterations=6, quiet=True)
    assert np.array_equal(again.behavior, table.behavior)


def test_predictions_file_holds_every_future_of_every_agent(dataset, tmp_path):
    out = tmp_path / "predictions.parquet"
    names = ["constant-velocity", "lstm"]
    predict_dataset(dataset, names, 2.0, out=out, jobs=1, quiet=True)
    rows = pq.read_table(out).to_pandas()
    assert list(rows) == PREDICTIONS.names
    one = rows.groupby(["episode", "predictor", "agent", "time_s"], observed=True)
    assert set(one.ngroup()) >= {0, 1}
    for (_, predictor, _, _), futures in one:
        modes = 1 if predictor == "constant-velocity" else MODES
        assert futures["mode"].tolist() == np.repeat(np.arange(modes), 4).tolist()
        assert futures["ahead_s"].tolist() == [0.5, 1.0, 1.5, 2.0] * modes
        each = futures.drop_duplicates("mode")["probability"]
        assert each.sum() == pytest.approx(1.0, abs=1e-5)
    opened = open_dataset(dataset)
    tracks = opened.read(opened.episodes("test")[0]).tracks
    row = rows[(rows["predictor"] == "constant-velocity") & (rows["ahead_s"] == 2.0)].iloc[0]
    agent, column = tracks.names.index(row["name"]), np.searchsorted(tracks.time_s, row["time_s"])
    assert tracks.ids[agent] == row["agent"]
    heading, speed = tracks.heading[agent, column], tracks.speed[agent, column]
    assert row["x_m"] == pytest.approx(tracks.xy[agent, column, 0] + 2 * speed * np.cos(heading))
    assert row["y_m"] == pytest.approx(tracks.xy[agent, column, 1] + 2 * speed * np.sin(heading))


def recordings(folder, *seconds):
    """A dataset of recordings without a map, of these lengths."""
    with new_dataset(folder, {}) as out:
        for index, length in enumerate(seconds):
            meta = EpisodeMeta(
                scenario="here", engine="here", index=index, split="test",
                options={"recording": f"drive{index}"},
            )  # fmt: skip
            out.write_recording(meta, steady([5.0, 8.0], seconds=length))
    return folder


def test_recordings_too_short_are_skipped_and_named(tmp_path, caplog):
    """Of 4.9 s (Argoverse 1), 4 s (TRAF), one frame and 12 s, with 3 s ahead."""
    folder = recordings(tmp_path / "data", 4.9, 4.0, 3.5, 0.0, 12.0)
    rows = predict_dataset(folder, ["constant-velocity"], 3.0, jobs=1, quiet=True)
    ade = next(row for row in rows if row["metric"] == "ade_m" and row["behavior"] == "all")
    assert ade["n"] == 2 * (1 + 1 + 4)
    said = caplog.messages
    for line, name, length in zip(said, ("drive2", "drive3"), ("3.5", "0"), strict=True):
        assert line.startswith("skipped episode ")
        assert f"({name}): found {length} s, expected at least 4 s to predict 3 s ahead" in line
