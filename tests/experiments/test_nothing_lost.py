"""Commands that write a folder keep, or refuse, what somebody else has put there."""

from __future__ import annotations

from pathlib import Path

import pytest

from behaviors import InputError
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.training.classifier import train_on

CONFIG = GenerateConfig(scenarios=("straight_road",), episodes=3, seed=2, duration_s=20.0)
NOTE = "what took a year to find out"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "data"
    generate(CONFIG, folder, jobs=1, quiet=True)
    return folder


def test_training_again_keeps_what_lies_beside_the_model(made: Path, tmp_path: Path) -> None:
    model = tmp_path / "model"
    model.mkdir()
    train_on([made], "majority", model, quiet=True, jobs=1)
    (model / "report.html").write_text(NOTE)
    train_on([made], "majority", model, quiet=True, jobs=1)
    assert (model / "report.html").read_text() == NOTE


def test_training_refuses_a_folder_with_something_else(made: Path, tmp_path: Path) -> None:
    (tmp_path / "note").write_text(NOTE)
    with pytest.raises(InputError, match="something that is not a model"):
        train_on([made], "majority", tmp_path, quiet=True, jobs=1)
    assert (tmp_path / "note").read_text() == NOTE
