"""A sample of ``graphrqi bench kills``: generations killed in a folder and on an S3 server."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from behaviors import InputError
from experiments.benches.kills import generations
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
    trial = generations._Trial("disk", tmp_path, generations.random.Random(0))
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "a").write_text("wanted")
    trial._wanted = trial._content()
    (tmp_path / "data" / "a").write_text("altered")
    trial._temporary.mkdir()
    (trial._temporary / "left").write_text("")
    monkeypatch.setattr(trial, "_run", lambda: True)
    trial.dataset()
    assert trial.counts == {"datasets": 1, "other_bytes": 1, "left_behind": 1}


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
        assert server.objects("data") == {"split=test/a": b"one"}
    finally:
        server.kill()


def test_places_are_disk_or_s3() -> None:
    with pytest.raises(InputError, match="places: found 'tape', expected disk or s3"):
        next(iter(measure(Settings(places=("tape",)))))
