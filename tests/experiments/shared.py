"""What several tests of the programs do: call a command, look at a folder, have an object store."""

from __future__ import annotations

import http.client
import importlib
import logging
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from experiments.cli.commands import main
from sim import files


def call(*arguments: object) -> int:
    """The exit code of a command that runs in this process."""
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return int(ended.value.code or 0)


def content(folder: Path) -> dict[str, bytes]:
    """The bytes of every file below a folder, by its name there."""
    files = (p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


def write_recording(folder: Path, places: Sequence[tuple[float, float]], frames: int) -> None:
    """A recording of cars of 4.5 m that drive east at 8 m/s from given places, at 10 Hz."""
    head = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width"
    rows = [
        f"{car},{k},{100 * k},car,{x + 0.8 * k:.1f},{y},8.0,0.0,0.0,4.5,1.8"
        for car, (x, y) in enumerate(places)
        for k in range(1, frames + 1)
    ]
    (folder / "vehicle_tracks_000.csv").write_text("\n".join([head, *rows]) + "\n")


def heed_signals() -> None:
    """Be stopped as usual by Ctrl-C and a hangup, whatever started the suite lets it ignore."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


@contextmanager
def object_store(bucket: str) -> Iterator[None]:
    """An S3 server on the loopback address with one bucket, which the environment names."""
    pytest.importorskip("moto", reason="pip install 'graphrqi[dev]'")
    s3fs = pytest.importorskip("s3fs", reason="pip install 'graphrqi[store]'")
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    asked = http.client.HTTPConnection(host, port)  # a server before it leaves its objects
    asked.request("POST", "/moto-api/reset")
    asked.getresponse().read()
    asked.close()
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        patched.setenv("AWS_ACCESS_KEY_ID", "testing")
        patched.setenv("AWS_SECRET_ACCESS_KEY", "testing")
        patched.setenv("AWS_DEFAULT_REGION", "us-east-1")
        patched.setenv("AWS_MAX_ATTEMPTS", "1")  # a server that is gone is gone at once
        try:
            _forget_clients()
            s3fs.S3FileSystem(skip_instance_cache=True).mkdir(bucket)
            yield
        finally:
            server.stop()
            _forget_clients()


def _forget_clients() -> None:
    """Forget the clients that this process has: they ask the server that was there before."""
    s3fs = importlib.import_module("s3fs")
    files._filesystem.cache_clear()
    s3fs.S3FileSystem.clear_instance_cache()
