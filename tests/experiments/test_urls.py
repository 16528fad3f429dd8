"""Datasets in object stores, by a real S3 server that listens on the loopback address only."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

import pytest

from behaviors import InputError
from experiments.data.exchange import as_dataset, export_dataset, import_recordings
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.score.labels import classify_dataset
from experiments.training.classifier import train_on
from sim.files import Place, place_of, url_of
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
    place.write(next(n for n in place.files() if n.startswith("steps")), b"altered")
    generate(CONFIG, out, jobs=1, quiet=True)
    assert content(place) == content(place_of(made))
    with pytest.raises(InputError, match=r"s3://datasets/again: was made with seed 5, now 6"):
        generate(CONFIG.model_copy(update={"seed": 6}), out, jobs=1, quiet=True)


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


@pytest.mark.parametrize("number", [5, 19])
def test_a_run_that_was_killed_goes_on_to_the_same_bytes(
    bucket: str, made: Path, number: int
) -> None:
    out = f"{bucket}/killed-{number}"
    run = subprocess.run([sys.executable, "-c", KILLED, out, str(number)], check=False)
    assert run.returncode == 9
    assert "episodes.parquet" not in place_of(out).files()
    generate(CONFIG, Path(out), jobs=1, quiet=True)
    assert content(place_of(out)) == content(place_of(made))
