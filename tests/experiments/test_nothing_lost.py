"""Commands that write a folder keep, or refuse, what somebody else has put there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from behaviors import InputError
from experiments.data.configuration import GenerateConfig
from experiments.data.generate import generate
from experiments.data.verify import verify_dataset
from experiments.training.classifier import train_on
from sim.store.atomic import whole_folder

CONFIG = GenerateConfig(scenarios=("straight_road",), episodes=3, seed=2, duration_s=20.0)
NOTE = "what took a year to find out"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "data"
    generate(CONFIG, folder, jobs=1, quiet=True)
    return folder


def test_a_folder_that_is_written_again_keeps_other_files(tmp_path: Path) -> None:
    target = tmp_path / "folder"
    with whole_folder(target) as partial:
        (partial / "ours").write_text("one")
    (target / "deep" / "er").mkdir(parents=True)
    (target / "deep" / "er" / "note").write_text(NOTE)
    (target / "link").symlink_to("nowhere")
    with whole_folder(target) as partial:
        (partial / "ours").write_text("two")
    assert (target / "ours").read_text() == "two"
    assert (target / "deep" / "er" / "note").read_text() == NOTE
    assert os.readlink(target / "link") == "nowhere"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["folder"]


def test_a_folder_behind_a_link_is_written_there(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "disk")
    for content in ("one", "two"):
        with whole_folder(tmp_path / "link") as partial:
            (partial / "ours").write_text(content)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "disk" / "ours").read_text() == "two"


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


def test_generating_refuses_a_readme_that_is_not_its_own(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text(NOTE)
    with pytest.raises(InputError, match=r"found README\.md in it, expected an empty folder"):
        generate(CONFIG, tmp_path, jobs=1, quiet=True)
    assert (tmp_path / "README.md").read_text() == NOTE


def test_generating_more_keeps_an_edited_card(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    generate(CONFIG.model_copy(update={"episodes": 1}), tmp_path, jobs=1, quiet=True)
    written = (tmp_path / "README.md").read_text()
    generate(CONFIG, tmp_path, jobs=1, quiet=True)
    assert (tmp_path / "README.md").read_text() != written, "three episodes, not one"
    (tmp_path / "README.md").write_text(NOTE)
    generate(CONFIG, tmp_path, jobs=1, quiet=True)
    assert (tmp_path / "README.md").read_text() == NOTE
    assert "README.md: kept, since it was edited" in caplog.text
    (tmp_path / "episodes.parquet").unlink()  # nothing tells any more what the card was
    with pytest.raises(InputError, match=r"found README\.md in it"):
        generate(CONFIG, tmp_path, jobs=1, quiet=True)
    assert (tmp_path / "README.md").read_text() == NOTE


def test_a_repair_moves_foreign_files_beside_the_dataset(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / "data"
    generate(CONFIG, folder, jobs=1, quiet=True)
    home = next((folder / "steps").rglob("*.parquet")).parent
    (home / "note").write_text(NOTE)
    (folder / "note").write_text(NOTE)
    flaws = verify_dataset(folder, mend=True, jobs=1, quiet=True)
    assert [(flaw.path.as_posix(), flaw.state) for flaw in flaws] == [("note", "foreign")]
    beside = tmp_path / "data-foreign"
    assert (beside / home.relative_to(folder) / "note").read_text() == NOTE
    assert f"moved 1 foreign files to {beside}" in caplog.text
