"""Training scores test episodes that are short."""

from __future__ import annotations

from pathlib import Path

from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.training.classifier import train_on
from graphrqi.model_files import load_model
from graphrqi.stream import load_stream


def dataset(folder: Path, duration_s: float) -> Path:
    config = GenerateConfig(
        scenarios=("straight_road",), episodes=5, seed=1, duration_s=duration_s, flow="dense"
    )
    generate(config, folder, jobs=1, quiet=True)
    return folder


def test_short_test_episodes_are_scored(tmp_path: Path) -> None:
    data = dataset(tmp_path / "data", 8.0)
    train_on([data], "majority", tmp_path / "model", quiet=True, jobs=1)
    assert load_model(tmp_path / "model").card["scores"]
    load_stream(tmp_path / "model")
