"""The challenge's file holds every future, ordered, and refuses what the challenge would."""

from __future__ import annotations

import numpy as np
import pyarrow.parquet as pq
import pytest

from behaviors.errors import InputError
from experiments.submission import STEPS, write_submission
from graphrqi.predict.prediction import Prediction


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
