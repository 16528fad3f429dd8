"""Repairs: what was there stays until what replaces it is whole, and links are only links."""

from __future__ import annotations

import errno
import shutil
import sys
from pathlib import Path

import cloudpickle
import pytest

import experiments.data.generate
import experiments.data.verify
from behaviors import InputError
from experiments.data.configuration import GenerateConfig
from experiments.data.episode import Task
from experiments.data.generate import generate
from experiments.data.verify import verify_dataset
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry

CONFIG = GenerateConfig(scenarios=("straight_road",), episodes=2, seed=5, duration_s=3.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("verify") / "data"
    generate(CONFIG, folder, jobs=1, quiet=True)
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    copied = tmp_path / "data"
    shutil.copytree(made, copied)
    return copied


def content(folder: Path) -> dict[str, bytes | str]:
    return {
        str(path.relative_to(folder)): str(path.readlink())
        if path.is_symlink()
        else path.read_bytes()
        for path in folder.rglob("*")
        if path.is_symlink() or path.is_file()
    }


def homes(folder: Path) -> list[Path]:
    return sorted((folder / "episodes").iterdir())


def flaws(folder: Path) -> dict[str, str]:
    return {flaw.path.as_posix(): flaw.state for flaw in verify_dataset(folder)}


def spoil(folder: Path) -> None:
    """A table altered, and an episode that says something else of itself."""
    first, second = homes(folder)
    (first / "steps.parquet").write_bytes(b"altered")
    own = second / "episode.json"
    own.write_text(own.read_text().replace('"seed": ', '"seed": 1'))


def test_what_cannot_be_made_again_is_not_taken_away(folder: Path) -> None:
    spoil(folder)
    manifest = folder / "manifest.json"
    manifest.write_text(
        manifest.read_text().replace('"duration_s": 3.0', '"duration_s": 3.0,\n  "flow": "nan"', 1)
    )
    before = content(folder)
    with pytest.raises(InputError, match="flow: found 'nan'"):
        verify_dataset(folder, mend=True, jobs=1, quiet=True)
    assert content(folder) == before


def test_a_full_disk_leaves_everything_as_it_was(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spoil(folder)
    first, _ = homes(folder)
    first.rename(tmp_path / "elsewhere")
    first.symlink_to(tmp_path / "elsewhere")
    before = content(folder)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(folder))

    monkeypatch.setattr(experiments.data.verify, "generate", full)
    with pytest.raises(OSError, match="No space left"):
        verify_dataset(folder, mend=True, jobs=1, quiet=True)
    assert content(folder) == before
    assert not list(folder.glob(".aside-*"))


def _failing(folder: Path, task: Task) -> EpisodeEntry:
    raise InputError("engine: fell over")


def test_an_engine_that_fails_leaves_everything_as_it_was(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spoil(folder)
    before = content(folder)
    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    monkeypatch.setattr(experiments.data.generate, "make_episode", _failing)
    with pytest.raises(InputError, match="engine: fell over"):
        verify_dataset(folder, mend=True, jobs=1, quiet=True)
    cloudpickle.unregister_pickle_by_value(sys.modules[__name__])
    assert content(folder) == before


def test_an_episode_that_says_something_else_of_itself_is_made_again(
    made: Path, folder: Path
) -> None:
    spoil(folder)
    first, second = (home.name for home in homes(folder))
    assert flaws(folder) == {
        f"episodes/{first}/steps.parquet": "altered",
        f"episodes/{second}/episode.json": "altered",
    }
    assert verify_dataset(folder, mend=True, jobs=1, quiet=True) == []
    assert content(folder) == content(made)


def test_folders_and_files_in_the_wrong_places_are_made_good(made: Path, folder: Path) -> None:
    first, second = homes(folder)
    (first / "steps.parquet").unlink()
    (first / "steps.parquet").mkdir()
    (first / "steps.parquet" / "inside").touch()
    (first / "episode.json").unlink()
    (first / "episode.json").mkdir()
    shutil.rmtree(second)
    second.touch()
    (folder / "episodes" / "stranger" / "deep").mkdir(parents=True)
    (folder / "episodes" / "stranger" / "deep" / "file").touch()
    assert verify_dataset(folder, mend=True, jobs=1, quiet=True) == []
    assert content(folder) == content(made)
    assert [home.name for home in homes(folder)] == [first.name, second.name]


def test_a_link_to_a_folder_is_foreign_and_what_it_points_to_is_left_alone(
    made: Path, folder: Path, tmp_path: Path
) -> None:
    target, gone = tmp_path / "target", tmp_path / "gone"
    target.mkdir()
    (target / "thesis.tex").write_text("all of it")
    first, second = homes(folder)
    (folder / "episodes" / "stranger").symlink_to(target)
    (folder / "episodes" / "dangling").symlink_to(gone)
    (second / "inside").symlink_to(target)
    first.rename(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "steps.parquet").write_bytes(b"altered")
    first.symlink_to(tmp_path / "elsewhere")
    before = content(tmp_path / "elsewhere")
    assert flaws(folder) == {
        "episodes/stranger": "foreign",
        "episodes/dangling": "foreign",
        f"episodes/{second.name}/inside": "foreign",
        f"episodes/{first.name}": "foreign",
        f"episodes/{first.name}/steps.parquet": "altered",
    }
    assert verify_dataset(folder, mend=True, jobs=1, quiet=True) == []
    assert content(folder) == content(made)
    assert content(tmp_path / "elsewhere") == before
    assert content(target) == {"thesis.tex": b"all of it"}


def test_episodes_on_another_disk_are_no_flaw(made: Path, folder: Path, tmp_path: Path) -> None:
    (folder / "episodes").rename(tmp_path / "disk")
    (folder / "episodes").symlink_to(tmp_path / "disk")
    assert flaws(folder) == {}
    assert verify_dataset(folder, mend=True, jobs=1, quiet=True) == []
    assert (folder / "episodes").is_symlink()
    assert open_dataset(folder).manifest == open_dataset(made).manifest


def test_a_folder_in_the_place_of_a_road_is_one_line(folder: Path) -> None:
    (road,) = (folder / "roads").iterdir()
    road.unlink()
    road.mkdir()
    (homes(folder)[0] / "steps.parquet").write_bytes(b"altered")
    before = content(folder)
    assert flaws(folder)[f"roads/{road.name}"] == "altered"
    with pytest.raises(InputError, match=r"\.net\.xml: found a folder, expected a file"):
        verify_dataset(folder, mend=True, jobs=1, quiet=True)
    assert content(folder) == before
    assert road.is_dir()
