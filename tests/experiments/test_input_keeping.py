"""Commands refuse to write over what they read."""

from pathlib import Path

import pytest

from behaviors.errors import InputError
from experiments.cli.input_keeping import refuse_to_overwrite
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from tests.experiments.shared import call, content, write_recording


@pytest.fixture
def recordings(tmp_path: Path) -> Path:
    """A folder with one recording: two cars for three seconds."""
    folder = tmp_path / "recordings"
    folder.mkdir()
    write_recording(folder, [(10.0, 3.5), (20.0, 7.0)], frames=30)
    return folder


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keeping") / "data"
    config = GenerateConfig(scenarios=("straight_road",), episodes=1, duration_s=10.0)
    generate(config, folder, jobs=1, quiet=True)
    return folder


@pytest.mark.parametrize("option", ["--out", "--json"])
@pytest.mark.parametrize("read", ["recordings", "recordings/vehicle_tracks_000.csv"])
def test_a_recording_is_not_written_over(recordings, monkeypatch, capsys, option, read):
    monkeypatch.chdir(recordings.parent)
    before = content(recordings)
    assert call("classify", read, option, "recordings/vehicle_tracks_000.csv", "-q") == 2
    assert capsys.readouterr().err == (
        f"graphrqi: error: {option}: found recordings/vehicle_tracks_000.csv, which is read, "
        "expected another file\n"
    )
    assert content(recordings) == before


def test_a_dataset_is_not_written_over_but_may_have_other_files(dataset):
    for name in ("episodes.parquet", next(n for n in content(dataset) if n.startswith("steps/"))):
        with pytest.raises(InputError, match=r"--out: found .*, which is read"):
            refuse_to_overwrite({"source": dataset, "out": dataset / name})
    answers = dataset / "answers.parquet"
    answers.touch()
    refuse_to_overwrite({"source": dataset, "out": answers})
    answers.unlink()


def test_other_files_are_read_too_and_two_outputs_are_two_files(tmp_path, monkeypatch):
    labels = tmp_path / "labels.csv"
    labels.touch()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"--json: found labels\.csv, which is read"):
        refuse_to_overwrite({"labels": labels, "json": Path("labels.csv"), "out": None})
    with pytest.raises(InputError, match=r"--json: found .*one\.csv, as --out, expected another"):
        refuse_to_overwrite({"out": Path("one.csv"), "json": tmp_path / "one.csv"})
    with pytest.raises(InputError, match="which is read"):
        refuse_to_overwrite({"runs": [tmp_path / "other", labels], "out": labels})
    refuse_to_overwrite({"labels": labels, "json": Path("-"), "out": Path("one.csv")})
