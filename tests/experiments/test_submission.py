"""The challenge's file holds every future, ordered, and refuses what the challenge would."""

from __future__ import annotations

import numpy as np
import pyarrow.parquet as pq
import pytest

from behaviors.errors import InputError
from experiments.data.exchange import import_recordings
from experiments.scoring.submission import STEPS, submit_dataset, write_submission
from graphrqi.predict.prediction import Prediction
from scenarios import SCENARIOS
from sim.engines import get_engine
from sim.formats.argoverse.forecasting2 import write
from sim.frames import Frame, Tracks
from sim.scenario import sample_agents
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeMeta
from sim.store.writing import new_dataset


def futures(agents=2, modes=3, steps=STEPS) -> Prediction:
    rng = np.random.default_rng(0)
    probability = rng.dirichlet(np.ones(modes), agents)
    xy = rng.normal(size=(agents, modes, steps, 2))
    return Prediction(np.arange(agents), np.arange(1, steps + 1) * 0.1, xy, probability)


def test_every_future_is_written_in_order_of_probability(tmp_path):
    told = futures()
    path = tmp_path / "submission.parquet"
    assert write_submission({"s1": (("a", "b"), told)}, path) == 6
    table = pq.read_table(path).to_pydict()
    assert table["scenario_id"] == ["s1"] * 6
    assert table["track_id"] == ["a"] * 3 + ["b"] * 3
    assert table["probability"][:3] == sorted(told.probability[0], reverse=True)
    first = int(told.probability[1].argmax())
    assert table["predicted_trajectory_x"][3] == told.xy[1, first, :, 0].tolist()
    assert table["predicted_trajectory_y"][3] == told.xy[1, first, :, 1].tolist()


@pytest.mark.parametrize(
    ("names", "prediction", "message"),
    [
        (("a",), futures(), "found 1 names, expected 2"),
        (("a", "b"), futures(steps=50), "found 50 places per future, expected 60"),
        (("a", "b"), futures(modes=7), "found 7 futures, expected at most 6"),
    ],
)
def test_what_the_challenge_refuses_is_refused(names, prediction, message, tmp_path):
    with pytest.raises(InputError, match=message):
        write_submission({"s": (names, prediction)}, tmp_path / "no.parquet")
    assert not (tmp_path / "no.parquet").exists()


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Windows of 11 s at 10 Hz as a dataset of imported recordings."""
    folder = tmp_path_factory.mktemp("recordings")
    scenario = SCENARIOS["straight_road"](duration_s=36.0, flow=1500)
    frames = get_engine("sumo")(scenario, sample_agents(scenario, 0), 0)
    write(folder, "drive", Tracks.from_frames(frames), scenario.road)
    out = folder / "data"
    import_recordings(folder, out, "argoverse2", quiet=True)
    return out


def test_recordings_become_a_submission_that_the_challenge_takes(recordings, tmp_path):
    path = tmp_path / "submission.parquet"
    rows = submit_dataset(recordings, "constant-velocity", "graphrqi-plus", path)
    table = pq.read_table(path).to_pylist()
    assert len(table) == rows > 0
    dataset = open_dataset(recordings)
    present = {
        (str(entry.options["recording"]), name)
        for entry in dataset.manifest.episodes
        for name in dataset.read(entry).tracks.window(50, 50).names
    }
    assert {(row["scenario_id"], row["track_id"]) for row in table} == present
    submission = pytest.importorskip(
        "av2.datasets.motion_forecasting.eval.submission",
        reason="av2 is not installed; it needs Python < 3.13",
    )
    taken = submission.ChallengeSubmission.from_parquet(path)
    assert len(taken.predictions) == len(dataset.manifest.episodes)


def test_only_ten_hertz_can_be_submitted(tmp_path):
    frames = [
        Frame(
            time_s=t, ids=[0], xy=[[t, 0.0]], heading=[0.0], speed=[1.0], length=[4.0],
            width=[2.0], kind=[0],
        )
        for t in np.arange(0.0, 11.0, 0.2)
    ]  # fmt: skip
    meta = EpisodeMeta(scenario="here", engine="argoverse2")
    with new_dataset(tmp_path / "data", {}) as out:
        out.write_recording(meta, Tracks.from_frames(frames))
    with pytest.raises(InputError, match=r"step of 0\.2 s, expected 0\.1 s"):
        submit_dataset(tmp_path / "data", "constant-velocity", "graphrqi-plus", tmp_path / "no")


def test_a_recording_of_one_frame_is_refused_by_name(tmp_path):
    (tmp_path / "one.csv").write_text("frame,id,x,y\n0,1,0,0\n0,2,5,0\n")
    manifest = import_recordings(tmp_path / "one.csv", tmp_path / "data", "argo", quiet=True)
    (entry,) = manifest.episodes
    with pytest.raises(InputError, match=f"episode {entry.id}: found one frame"):
        submit_dataset(
            tmp_path / "data", "constant-velocity", "graphrqi-plus", tmp_path / "no.parquet"
        )
    assert not (tmp_path / "no.parquet").exists()
