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

import experiments.data.generate
from behaviors import InputError
from experiments.data.array_job.parts import generate_part, merge
from experiments.data.configuration import GenerateConfig
from experiments.data.exchange import as_dataset, export_dataset, import_recordings
from experiments.data.generate import generate
from experiments.data.shards.plan import Part
from experiments.data.shards.staging import staging_folder
from experiments.data.verify import verify_dataset
from experiments.score.labels import classify_dataset
from experiments.training.classifier import train_on
from sim.store.dataset import open_dataset
from sim.store.places import Place, file_checksum, place_of, url_of
from tests.experiments.shared import in_this_process, object_store

CONFIG = GenerateConfig(scenarios=("straight_road",), episodes=3, seed=5, duration_s=12.0)


@pytest.fixture(scope="module")
def bucket(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with pytest.MonkeyPatch.context() as patched, object_store("datasets"):
        patched.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        patched.setattr(experiments.data.generate, "make_in_processes", in_this_process)
        yield "s3://datasets"


@pytest.fixture(scope="module")
def made(bucket: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "data"
    generate(CONFIG, folder, jobs=1, quiet=True)
    return folder


def content(place: Place) -> dict[str, bytes]:
    return {name: place.read(name) for name in place.files()}


@pytest.fixture(scope="module")
def stored(bucket: str, made: Path) -> Path:
    out = Path(f"{bucket}/data")
    generate(CONFIG, out, jobs=1, quiet=True)
    return out


def test_the_same_bytes_as_in_a_folder(stored: Path, made: Path) -> None:
    assert content(place_of(stored)) == content(place_of(made))
    assert not staging_folder(stored).exists()


def test_what_is_missing_is_made_again(bucket: str, made: Path) -> None:
    out = Path(f"{bucket}/again")
    generate(CONFIG.model_copy(update={"episodes": 1}), out, jobs=1, quiet=True)
    place = place_of(out)
    place.remove("episodes.parquet")
    place.write(next(place.files("steps")), b"altered")
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
    "remove": lambda place, _: place.remove("one"),
    "checksum": lambda place, _: file_checksum(place, "one"),
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
    again = import_recordings(stored.parent / "fcd", out, "sumo-fcd", quiet=True)
    assert again == open_dataset(out).manifest  # it is there already
    with pytest.raises(InputError, match="expected a new or empty folder"):
        import_recordings(stored.parent / "fcd", out, "sumo-fcd", split="test", quiet=True)


def test_verify_finds_and_repairs(bucket: str, stored: Path, made: Path) -> None:
    out = Path(f"{bucket}/verified")
    for name, data in content(place_of(made)).items():
        place_of(out).write(name, data)
    place = place_of(out)
    assert verify_dataset(out) == []
    first, *_ = place.files("steps")
    place.write(first, place.read(first)[:-1])
    other = next(place.files("agents"))
    place.remove(other)
    place.write("notes.txt", b"mine")
    assert {(str(f.path), f.state) for f in verify_dataset(out)} == {
        (first, "altered"), (other, "missing"), ("notes.txt", "foreign"),
    }  # fmt: skip
    left = verify_dataset(out, mend=True, jobs=1, quiet=True)
    assert [str(f.path) for f in left] == ["notes.txt"]
    place.remove("notes.txt")
    assert content(place) == content(place_of(made))


def test_parts_meet_in_a_bucket(bucket: str, made: Path) -> None:
    out = Path(f"{bucket}/parts")
    for number in (3, 1):
        generate_part(CONFIG, out, Part(number, 3), jobs=1, quiet=True)
    assert {name.partition("/")[0] for name in place_of(out).files()} == {
        "episodes", "plan.json", "roads",
    }  # fmt: skip
    with pytest.raises(InputError, match=r"1 of 3 episodes missing.* run part 2/3 again"):
        merge(out, quiet=True)
    for number in (2, 2):
        generate_part(CONFIG, out, Part(number, 3), jobs=1, quiet=True)
    merge(out, quiet=True)
    assert content(place_of(out)) == content(place_of(made))


def test_an_unfinished_run_goes_on_where_it_was(bucket: str, made: Path, monkeypatch) -> None:
    out = Path(f"{bucket}/unfinished")

    def killed(make, folder, tasks, jobs, shown):
        make(folder, tasks[0])
        raise SystemExit

    with monkeypatch.context() as patched:
        patched.setattr(experiments.data.generate, "make_in_processes", killed)
        with pytest.raises(SystemExit):
            generate(CONFIG, out, jobs=1, quiet=True)
    assert len(list((staging_folder(out) / "episodes").iterdir())) == 1
    generate(CONFIG, out, jobs=1, quiet=True)
    assert content(place_of(out)) == content(place_of(made))
    assert not staging_folder(out).exists()


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
    def refuse() -> None:
        raise EOFError("nobody\nlistens")

    with pytest.raises(OSError, match="nobody listens") as found:
        place_of("memory://here/data")._tried(refuse, "a")  # type: ignore[attr-defined]
    assert found.value.filename == "memory://here/data/a"


def test_a_cluster_needs_a_shared_folder(bucket: str) -> None:
    with pytest.raises(InputError, match="expected a folder on a disk that every worker sees"):
        generate(CONFIG, Path(f"{bucket}/no"), quiet=True, cluster="tcp://127.0.0.1:1")


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
