"""An S3 server for tests that can be killed and started again with what it kept.

moto keeps objects in memory. Here every object is also a file, written before the request is
answered, and a server that starts begins with these files. Uploads in several parts that are not
finished are lost with the server; those of other servers are not.

References:
    moto, Mock AWS services: https://docs.getmoto.org/en/latest/docs/server_mode.html.
"""

from __future__ import annotations

import importlib
import multiprocessing
import random
import socket
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote, unquote

from behaviors.errors import InputError
from sim.store.atomic import PARTIAL_PREFIX, write_whole

BUCKET: Final = "datasets"

HOST: Final = "127.0.0.1"

PORTS: Final = range(20_000, 30_000)

LONGEST_START_S: Final = 600.0
"""Longest time until the server listens (it takes a second, minutes on a busy machine)."""


def environment(port: int) -> dict[str, str]:
    """What programs find the server by."""
    return {
        "AWS_ENDPOINT_URL": f"http://{HOST}:{port}", "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing", "AWS_DEFAULT_REGION": "us-east-1",
    }  # fmt: skip


class ObjectServer:
    """A server in a process of its own, with one bucket.

    Attributes:
        port: where it listens, on the loopback address only; the same when it is started again.
    """

    def __init__(self, kept: Path) -> None:
        """A server that is not running yet.

        Args:
            kept: folder of the objects that outlive it.

        Raises:
            InputError: if moto is not installed.
        """
        try:
            importlib.import_module("moto.moto_server.werkzeug_app")
        except ImportError:
            raise InputError("moto: found no such package: pip install 'graphrqi[dev]'") from None
        self._kept = kept
        kept.mkdir(parents=True, exist_ok=True)
        self.port = _free_port()
        self._process: Any = None

    def start(self) -> None:
        """Start it; it answers when this returns."""
        # Forked from a process that only imports: moto's objects are kept in the one that serves.
        clean = multiprocessing.get_context("forkserver")
        clean.set_forkserver_preload([__name__, "moto.moto_server.werkzeug_app", "moto.s3.models"])
        self._process = clean.Process(target=_serve, args=(self.port, self._kept), daemon=True)
        self._process.start()
        begin = time.monotonic()
        while time.monotonic() - begin < LONGEST_START_S:
            with suppress(OSError), socket.create_connection((HOST, self.port), 1.0):
                return
            if self._process.exitcode is not None:
                raise RuntimeError(f"the server at {HOST}:{self.port} ended when it was started")
            time.sleep(0.01)
        raise TimeoutError(f"no server at {HOST}:{self.port} after {LONGEST_START_S:g} s")

    def kill(self) -> None:
        """End it by SIGKILL, in the middle of whatever it does."""
        if self._process is not None:
            self._process.kill()
            self._process.join()

    def objects(self, below: str = "") -> dict[str, bytes]:
        """What it keeps whose name begins so, by the rest of the name."""
        names = {unquote(file.name): file for file in self._files()}
        return {
            name.removeprefix(below): file.read_bytes()
            for name, file in names.items()
            if name.startswith(below)
        }

    def clear(self) -> None:
        """Remove all objects: the server ends, and begins with none."""
        self.kill()
        for file in self._kept.iterdir():
            file.unlink()
        self.start()

    def _files(self) -> list[Path]:
        return [p for p in self._kept.iterdir() if not p.name.startswith(PARTIAL_PREFIX)]


def _free_port() -> int:
    """A port that nobody has, below those that connections get by themselves.

    A client that tries to reach one of those while nobody listens may be given the same as its own;
    it then talks to itself, and the server cannot have it.
    """
    for port in random.SystemRandom().sample(PORTS, len(PORTS)):
        with socket.socket() as tried, suppress(OSError):
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind((HOST, port))
            return port
    raise OSError(f"no free port at {HOST} from {PORTS.start} to {PORTS.stop}")


def _serve(port: int, kept: Path) -> None:
    """Serve until killed."""
    import logging

    from moto.moto_server.werkzeug_app import (
        DomainDispatcherApplication,
        MotoRequestHandler,
        create_backend_app,
    )
    from werkzeug.serving import make_server
    from werkzeug.test import Client

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    application = DomainDispatcherApplication(create_backend_app)
    client = Client(application)
    host = {"Host": f"{HOST}:{port}"}
    client.put(f"/{BUCKET}", headers=host)
    for file in sorted(kept.iterdir()):
        if file.name.startswith(PARTIAL_PREFIX):
            file.unlink()
        else:
            client.put(f"/{BUCKET}/{quote(unquote(file.name))}", headers=host,
                       data=file.read_bytes())  # fmt: skip
    server = make_server(
        HOST, port, _Keeping(application, kept), True, request_handler=MotoRequestHandler
    )
    server.serve_forever()


class _Keeping:
    """A WSGI application that writes what changed before it answers."""

    def __init__(self, application: Any, kept: Path) -> None:
        self._application = application
        self._kept = kept
        self._one_at_a_time = threading.Lock()

    def __call__(self, asked: dict[str, Any], answer: Callable[..., Any]) -> Iterable[bytes]:
        if asked["REQUEST_METHOD"] in ("GET", "HEAD"):
            return list(self._application(asked, answer))
        with self._one_at_a_time:
            answered = list(self._application(asked, answer))
            self._keep()
        return answered

    def _keep(self) -> None:
        from moto.s3.models import s3_backends

        (account,) = s3_backends
        bucket = s3_backends[account]["aws"].buckets[BUCKET]
        objects = {quote(name, safe=""): key for name, key in bucket.keys.items()}
        for name, key in objects.items():
            file = self._kept / name
            if not file.exists() or file.read_bytes() != key.value:
                write_whole(file, key.value)
        for file in list(self._kept.iterdir()):
            if file.name not in objects and not file.name.startswith(PARTIAL_PREFIX):
                file.unlink(missing_ok=True)
