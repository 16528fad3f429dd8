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
from sim.store.entries import write_catalogue
from sim.store.places import place_of
from sim.store.schema import CATALOGUE, EpisodeEntry

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


def shards(folder: Path, table: str = "steps") -> list[Path]:
    return sorted((folder / table).rglob("*.parquet"))


def flaws(folder: Path) -> dict[str, str]:
    return {flaw.path.as_posix(): flaw.state for flaw in verify_dataset(folder)}


def spoil(folder: Path) -> None:
    """A table of one shard altered, and of another lost."""
    first, second = shards(folder)
    first.write_bytes(b"altered")
    second.unlink()


def test_what_cannot_be_made_again_is_not_taken_away(folder: Path) -> None:
    spoil(folder)
    dataset = open_dataset(folder)
    configuration = {**dataset.header.configuration, "flow": "nan"}
    header = dataset.header.model_copy(update={"configuration": configuration})
    write_catalogue(place_of(folder), header, [dataset.catalogue.cast(CATALOGUE)])
    before = content(folder)
    with pytest.raises(InputError, match="flow: found 'nan'"):
        verify_dataset(folder, mend=True, jobs=1, quiet=True)
    assert content(folder) == before


def test_a_full_disk_leaves_everything_as_it_was(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spoil(folder)
    (first,) = shards(folder)
    first.rename(tmp_path / "elsewhere")
    first.symlink_to(tmp_path / "elsewhere")
    before = content(folder)

    def full(*_: object, **__: object) -> None:
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


def test_shards_that_say_something_else_are_made_again(made: Path, folder: Path) -> None:
    spoil(folder)
    whole, other = shards(folder, "agents")
    other.write_bytes(whole.read_bytes())
    first, second = (path.relative_to(made / "steps") for path in shards(made))
    assert flaws(folder) == {
        f"steps/{first}": "altered",
        f"steps/{second}": "missing",
        f"agents/{second}": "altered",
    }
    assert verify_dataset(folder, mend=True, jobs=1, quiet=True) == []
    assert content(folder) == content(made)


def test_folders_and_files_in_the_wrong_places_are_made_good(made: Path, folder: Path) -> None:
    first, second = shards(folder)
    first.unlink()
    first.mkdir()
    (first / "inside").touch()
    shutil.rmtree(second.parent)
    second.parent.touch()
    (folder / "episodes" / "stranger" / "deep").mkdir(parents=True)
    (folder / "episodes" / "stranger" / "deep" / "file").touch()
    assert verify_dataset(folder, mend=True, jobs=1, quiet=True) == []
    assert content(folder) == content(made)
    assert not (folder / "episodes").exists()


def test_a_link_to_a_folder_is_foreign_and_what_it_points_to_is_left_alone(
    made: Path, folder: Path, tmp_path: Path
) -> None:
    target, gone = tmp_path / "target", tmp_path / "gone"
    target.mkdir()
    (target / "thesis.tex").write_text("all of it")
    first, second = (path.parent for path in shards(folder))
    (folder / "steps" / "stranger").symlink_to(target)
    (folder / "agents" / "dangling").symlink_to(gone)
    (second / "inside").symlink_to(target)
    first.rename(tmp_path / "elsewhere")
    (kept,) = (tmp_path / "elsewhere").iterdir()
    kept.write_bytes(b"altered")
    first.symlink_to(tmp_path / "elsewhere")
    before = content(tmp_path / "elsewhere")
    assert flaws(folder) == {
        "steps/stranger": "foreign",
        "agents/dangling": "foreign",
        f"{second.relative_to(folder)}/inside": "foreign",
        f"{first.relative_to(folder)}": "foreign",
        f"{first.relative_to(folder)}/{kept.name}": "altered",
    }
    assert verify_dataset(folder, mend=True, jobs=1, quiet=True) == []
    assert content(folder) == content(made)
    assert content(tmp_path / "elsewhere") == before
    assert content(target) == {"thesis.tex": b"all of it"}


def test_tables_on_another_disk_are_no_flaw(made: Path, folder: Path, tmp_path: Path) -> None:
    (folder / "steps").rename(tmp_path / "disk")
    (folder / "steps").symlink_to(tmp_path / "disk")
    assert flaws(folder) == {}
    assert verify_dataset(folder, mend=True, jobs=1, quiet=True) == []
    assert (folder / "steps").is_symlink()
    assert open_dataset(folder).manifest == open_dataset(made).manifest


def test_a_folder_in_the_place_of_a_road_is_one_line(folder: Path) -> None:
    (road,) = (folder / "roads").iterdir()
    road.unlink()
    road.mkdir()
    shards(folder)[0].write_bytes(b"altered")
    before = content(folder)
    assert flaws(folder)[f"roads/{road.name}"] == "altered"
    with pytest.raises(InputError, match=r"\.net\.xml: found a folder, expected a file"):
        verify_dataset(folder, mend=True, jobs=1, quiet=True)
    assert content(folder) == before
    assert road.is_dir()
