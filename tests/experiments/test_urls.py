"""Datasets in object stores, by a real S3 server that listens on the loopback address only."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from behaviors import InputError
from experiments.data.exchange import as_dataset, export_dataset, import_recordings
from experiments.data.verify import verify_dataset
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.score.labels import classify_dataset
from experiments.training.classifier import train_on
from sim.files import Place, errors_named, place_of, url_of
from sim.store.dataset import open_dataset
from tests.experiments.shared import object_store

CONFIG = GenerateConfig(scenarios=("straight_road",), episodes=3, seed=5, duration_s=12.0)


@pytest.fixture(scope="module")
def bucket(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with pytest.MonkeyPatch.context() as patched, object_store("datasets"):
        patched.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield "s3://datasets"


@pytest.fixture(scope="module")
def made(bucket: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "data"
    generate(CONFIG, folder, jobs=1, quiet=True)
    return folder


def remove(place: Place, name: str) -> None:
    place.filesystem.rm_file(place.full(name))


def content(place: Place) -> dict[str, bytes]:
    return {name: place.read(name) for name in place.files()}


@pytest.fixture(scope="module")
def stored(bucket: str, made: Path) -> Path:
    out = Path(f"{bucket}/data")
    generate(CONFIG, out, jobs=1, quiet=True)
    return out


def test_the_same_bytes_as_in_a_folder(stored: Path, made: Path) -> None:
    assert content(place_of(stored)) == content(place_of(made))


def test_what_is_missing_is_made_again(bucket: str, made: Path) -> None:
    out = Path(f"{bucket}/again")
    generate(CONFIG.model_copy(update={"episodes": 1}), out, jobs=1, quiet=True)
    place = place_of(out)
    remove(place, "episodes.parquet")
    place.write(next(iter(place.files("steps"))), b"altered")
    generate(CONFIG, out, jobs=1, quiet=True)
    assert content(place) == content(place_of(made))
    with pytest.raises(InputError, match=r"s3://datasets/again: was made with seed 5, now 6"):
        generate(CONFIG.model_copy(update={"seed": 6}), out, jobs=1, quiet=True)


def test_episodes_roads_and_tables_are_read(stored: Path, made: Path) -> None:
    dataset, here = open_dataset(str(stored)), open_dataset(made)
    assert repr(dataset).startswith("Dataset(s3://datasets/data: 3 episodes (1 test, 1 train, 1 v")
    for entry in dataset.episodes():
        ours, theirs = dataset.read(entry).tracks, here.read(entry).tracks
        np.testing.assert_array_equal(ours.xy, theirs.xy)
        road = dataset.road(entry)
        assert road is not None
        assert road.name == "straight_road"
    steps = dataset.scan("steps", split="test")
    assert steps.to_table().equals(here.scan("steps", split="test").to_table())
    assert {entry.split for entry in dataset.episodes(split="test")} == {"test"}


CALLS: dict[str, Callable[[Place, Path], object]] = {
    "size": lambda place, _: place.size("one"),
    "read": lambda place, _: place.read("one"),
    "files": lambda place, _: list(place.files()),
    "write": lambda place, _: place.write("two", b"2"),
    "put": lambda place, file: place.put(file, "three"),
    "checksum": lambda place, _: place.checksum("one"),
}


@pytest.mark.parametrize(("call", "answered"), [*((call, 0) for call in CALLS), ("checksum", 1)])
def test_a_store_that_is_gone_is_an_error_with_a_name(
    call: str, answered: int, bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from aiobotocore.httpsession import AIOHTTPSession
    from botocore.exceptions import EndpointConnectionError

    place = place_of(f"{bucket}/gone")
    place.write("one", b"1")
    (tmp_path / "file").write_bytes(b"3")
    send, asked = AIOHTTPSession.send, count()

    async def gone(session, request):
        if next(asked) >= answered:
            raise EndpointConnectionError(endpoint_url=request.url, error=OSError("gone"))
        return await send(session, request)

    monkeypatch.setattr(AIOHTTPSession, "send", gone)
    with pytest.raises(OSError, match="Could not connect") as found:
        CALLS[call](place, tmp_path / "file")
    assert str(found.value.filename).startswith(f"{bucket}/gone")


HUB = """
import sys, warnings
warnings.simplefilter("error")
import datasets
shards = f"{sys.argv[1]}/steps/*/split=test/*.parquet"
steps = datasets.load_dataset("parquet", data_files={"test": shards}, cache_dir=sys.argv[2])
streamed = datasets.load_dataset("parquet", data_files={"test": shards}, streaming=True)
first = next(iter(streamed["test"]))
print(steps["test"].num_rows, first == steps["test"][0], sorted(first))
"""


def test_the_hub_library_reads_a_bucket(stored: Path, tmp_path: Path) -> None:
    """In a process of its own, where every warning is an error."""
    pytest.importorskip("datasets")
    steps = open_dataset(str(stored)).scan("steps", split="test")
    rows = steps.count_rows()
    run = subprocess.run(
        [sys.executable, "-c", HUB, url_of(stored), str(tmp_path / "cache")],
        env={**os.environ, "HF_HOME": str(tmp_path / "home")},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr[-3000:]
    columns = sorted(set(steps.schema.names) - {"scenario", "split"})
    assert run.stdout.split("\n")[-2] == f"{rows} True {columns}"


def test_datasets_are_trained_on_classified_and_exported(stored: Path, tmp_path: Path) -> None:
    model = tmp_path / "model"
    train_on([stored], "majority", model, quiet=True, jobs=1)
    with as_dataset(stored) as dataset:
        classify_dataset(dataset, str(model), stored.parent / "labels.parquet", quiet=True)
    assert place_of(stored.parent).size("labels.parquet")
    written = export_dataset(stored, stored.parent / "fcd", "sumo-fcd", quiet=True)
    assert {url_of(path.parent) for path in written} == {"s3://datasets/fcd"}
    out = stored.parent / "imported"
    import_recordings(stored.parent / "fcd", out, "sumo-fcd", quiet=True)
    assert len(open_dataset(out).episodes()) == 3
    with pytest.raises(InputError, match="expected nothing"):
        import_recordings(stored.parent / "fcd", out, "sumo-fcd", quiet=True)


def test_verify_finds_what_is_wrong_and_generate_mends_it(
    bucket: str, stored: Path, made: Path
) -> None:
    out = Path(f"{bucket}/verified")
    for name, data in content(place_of(made)).items():
        place_of(out).write(name, data)
    place = place_of(out)
    assert verify_dataset(out) == []
    first, *_ = place.files("steps")
    place.write(first, place.read(first)[:-1])
    other = next(iter(place.files("agents")))
    remove(place, other)
    place.write("notes.txt", b"mine")
    assert {(str(f.path), f.state) for f in verify_dataset(out)} == {
        (first, "altered"), (other, "missing"), ("notes.txt", "foreign"),
    }  # fmt: skip
    remove(place, "notes.txt")
    generate(CONFIG, out, jobs=1, quiet=True)
    assert content(place) == content(place_of(made))


KILLED = """
import os, sys
from pathlib import Path
from experiments.generate import dataset
from experiments.generate.configuration import GenerateConfig
from sim.files import Place

put, number = Place.put, iter(range(1000))
def killed(place, file, name):
    if next(number) == int(sys.argv[2]):
        os._exit(9)
    put(place, file, name)
Place.put = killed
config = GenerateConfig(scenarios=("straight_road",), episodes=3, seed=5, duration_s=12.0)
dataset.generate(config, Path(sys.argv[1]), jobs=1, quiet=True)
"""


@pytest.mark.parametrize("number", [3, 5, 14, 19])
def test_a_run_that_was_killed_goes_on_to_the_same_bytes(
    bucket: str, made: Path, number: int
) -> None:
    out = f"{bucket}/killed-{number}"
    run = subprocess.run([sys.executable, "-c", KILLED, out, str(number)], check=False)
    assert run.returncode == 9
    assert "episodes.parquet" not in place_of(out).files()
    generate(CONFIG, Path(out), jobs=1, quiet=True)
    assert content(place_of(out)) == content(place_of(made))


def test_workers_write_to_the_store_themselves(bucket: str, made: Path) -> None:
    out = Path(f"{bucket}/two-jobs")
    generate(CONFIG, out, jobs=2, quiet=True)
    assert content(place_of(out)) == content(place_of(made))


def test_file_urls_are_paths_and_memory_is_a_store(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made, tmp_path / "copy")
    assert open_dataset(f"file://{tmp_path}/copy").path == tmp_path / "copy"
    assert open_dataset(Path(f"file://{tmp_path}/copy")).manifest == open_dataset(made).manifest
    for name, data in content(place_of(made)).items():
        place_of("memory://here/data").write(name, data)
    dataset = open_dataset("memory://here/data")
    assert dataset.read(dataset.episodes()[0]).agents
    assert dataset.scan("agents").count_rows() == open_dataset(made).scan("agents").count_rows()


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("s3://datasets/nowhere", "s3://datasets/nowhere: found nothing there"),
        ("nonsense://a/b", "nonsense://: found an unknown protocol"),
    ],
)
def test_urls_of_nothing(bucket: str, url: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        open_dataset(Path(url))


def test_an_error_of_a_stores_client_is_one_of_the_system() -> None:
    with pytest.raises(OSError, match="nobody listens") as found, errors_named("memory://a/b"):
        raise EOFError("nobody\nlistens")
    assert found.value.filename == "memory://a/b"


def test_commands_say_urls_as_they_were_given(stored: Path, capsys) -> None:
    from experiments.cli.commands import main

    def ended(*words: str) -> int | str | None:
        with pytest.raises(SystemExit) as end:
            main(words)
        return end.value.code

    assert ended("verify", str(stored)) == 0
    assert "s3://datasets/data: every file is as its catalogue says" in capsys.readouterr().out
    url = "s3://datasets/model"
    assert ended("train", str(stored), "--method", "majority", "--out", url, "--quiet") == 2
    assert f"{url}: found a URL, expected a path of this machine" in capsys.readouterr().err
    assert not Path("s3:").exists()


def test_a_forked_process_reads_what_its_parent_wrote(bucket: str) -> None:
    place = place_of(f"{bucket}/forked")
    place.write("a", b"one")
    assert place.size("a") == 3

    def read() -> None:
        os._exit(0 if place.size("a") == 3 else 1)

    child = multiprocessing.get_context("fork").Process(target=read)
    child.start()
    child.join(60)
    assert child.exitcode == 0
