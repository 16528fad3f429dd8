"""A sample of ``graphrqi bench kills``: generations killed in a folder and on an S3 server."""

from __future__ import annotations

import dataclasses
import os
import random
from collections import Counter
from pathlib import Path

import pytest

from behaviors import InputError
from experiments.benches.kills import forked, generations
from experiments.benches.kills.bench import Settings, measure
from experiments.benches.kills.object_server import BUCKET, ObjectServer, environment

boto3 = pytest.importorskip("boto3", reason="pip install 'graphrqi[dev]'")
pytest.importorskip("moto", reason="pip install 'graphrqi[dev]'")
pytest.importorskip("s3fs", reason="pip install 'graphrqi[store]'")

CLIENT = {
    "aws_access_key_id": "testing", "aws_secret_access_key": "testing",
    "region_name": "us-east-1",
}  # fmt: skip


@pytest.mark.parametrize("place", generations.PLACES)
def test_killed_generations_end_with_the_same_bytes_and_leave_nothing(
    place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("AWS_ENDPOINT_URL", raising=False)
    *_, rows = measure(Settings(commands=(), places=(place,), place_kills=3))
    found = {row["metric"]: row["value"] for row in rows}
    assert sum(found[f"killed_{who}"] for who in ("runs", "workers", "servers")) >= 3
    assert found["datasets"] >= 1
    assert {m: found[m] for m in ("other_bytes", "left_behind", "wrong_code")} == {
        "other_bytes": 0, "left_behind": 0, "wrong_code": 0,
    }  # fmt: skip
    assert "AWS_ENDPOINT_URL" not in os.environ


def test_other_bytes_and_files_left_are_counted(tmp_path: Path, monkeypatch) -> None:
    trial = generations._Trial("disk", tmp_path, "0", Counter())
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "a").write_text("wanted")
    trial._wanted = trial._content()
    (tmp_path / "data" / "a").write_text("altered")
    trial._temporary.mkdir()
    (trial._temporary / "left").write_text("")
    monkeypatch.setattr(trial, "_run", lambda: True)
    trial.dataset()
    assert trial.counts == {"datasets": 1, "other_bytes": 1, "left_behind": 1}


def test_a_bench_of_kills_goes_on_where_it_stopped(tmp_path: Path) -> None:
    kept = tmp_path / "kept.json"
    settings = Settings(commands=(), places=("disk",), place_kills=1, progress=str(kept))
    *_, first = measure(settings)
    before = kept.read_bytes()
    *_, again = measure(settings)
    assert (again, kept.read_bytes()) == (first, before)
    more = dataclasses.replace(settings, place_kills=int(first[0]["n"]) + 1)
    *_, later = measure(more)
    datasets = [next(r["value"] for r in x if r["metric"] == "datasets") for x in (first, later)]
    assert later[0]["n"] > first[0]["n"]
    assert datasets[1] > datasets[0]


@pytest.mark.parametrize("place", ["disk", "s3"])
def test_workers_are_killed_while_there_are_some(tmp_path: Path, place: str) -> None:
    class Worker(random.Random):
        """First a worker as soon as there is one; then nobody."""

        def choice(self, among):
            return "worker" if "run" in among else among[0]

        def uniform(self, low, high):
            if trial.counts["killed_workers"]:
                return forked.LONGEST_S
            return 0.0 if high == generations.SOON_S else forked.LONGEST_S

    trial = generations._Trial(place, tmp_path, "0", Counter())
    generations._warm(tmp_path / "warm")
    trial.begin()
    try:
        trial._choose = Worker()
        assert trial._run()
    finally:
        trial.stop()
    assert trial.counts["killed_workers"] == 1


def test_an_object_beside_the_dataset_is_counted(tmp_path: Path, monkeypatch) -> None:
    trial = generations._Trial("s3", tmp_path, "0", Counter())
    (tmp_path / "kept" / "data%2Fa").write_text("wanted")
    trial._wanted = trial._content()
    (tmp_path / "kept" / "data.partial").write_text("left")
    monkeypatch.setattr(trial, "_run", lambda: True)
    monkeypatch.setattr(trial, "_clear", lambda: None)
    trial.dataset()
    assert trial.counts == {"datasets": 1, "other_bytes": 1}


def test_a_server_that_ends_when_it_is_started_is_not_waited_for(tmp_path, monkeypatch) -> None:
    (tmp_path / "unreadable").mkdir()  # where it expects an object
    with pytest.raises(RuntimeError, match="ended when it was started"):
        ObjectServer(tmp_path).start()


def test_a_killed_server_remembers_what_it_had_answered(tmp_path: Path) -> None:
    server = ObjectServer(tmp_path)

    store = boto3.client("s3", **CLIENT, endpoint_url=environment(server.port)["AWS_ENDPOINT_URL"])

    try:
        server.start()
        store.put_object(Bucket=BUCKET, Key="data/split=test/a", Body=b"one")
        store.put_object(Bucket=BUCKET, Key="data/b", Body=b"two")
        store.delete_object(Bucket=BUCKET, Key="data/b")
        server.kill()
        server.start()
        found = store.get_object(Bucket=BUCKET, Key="data/split=test/a")
        assert found["Body"].read() == b"one"
        assert server.objects("data/") == {"split=test/a": b"one"}
        server.clear()
        assert not server.objects()
        assert "Contents" not in store.list_objects_v2(Bucket=BUCKET)
    finally:
        server.kill()


def test_places_are_disk_or_s3() -> None:
    with pytest.raises(InputError, match="places: found 'tape', expected disk or s3"):
        next(iter(measure(Settings(places=("tape",)))))
