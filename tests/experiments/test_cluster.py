"""Generating on Dask: the same bytes, whatever dies on the way."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import dask
import pytest
from distributed import Client, LocalCluster
from distributed.security import Security

from behaviors import InputError
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from tests.experiments.shared import content

CONFIG = GenerateConfig(scenarios=("straight_road",), episodes=4, seed=5, duration_s=30.0)


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as running:
        yield running


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("loky") / "data"
    generate(CONFIG, folder, jobs=1, quiet=True)
    return content(folder)


def test_same_bytes_as_on_one_machine(
    cluster: LocalCluster, undisturbed: dict[str, bytes], tmp_path: Path
) -> None:
    generate(CONFIG, tmp_path, quiet=True, cluster=cluster.scheduler_address)
    assert content(tmp_path) == undisturbed


def test_a_killed_worker_changes_nothing(
    cluster: LocalCluster, undisturbed: dict[str, bytes], tmp_path: Path
) -> None:
    def kill_one() -> None:
        while not any(tmp_path.glob(".partial-*")):
            time.sleep(0.01)
        with Client(cluster.scheduler_address) as client:
            pids = client.run(os.getpid)
            os.kill(next(iter(pids.values())), signal.SIGKILL)

    killer = threading.Thread(target=kill_one)
    killer.start()
    generate(CONFIG, tmp_path, quiet=True, cluster=cluster.scheduler_address)
    killer.join()
    generate(CONFIG, tmp_path, quiet=True, jobs=1)  # clears what the killed worker left behind
    assert content(tmp_path) == undisturbed


@pytest.mark.parametrize(
    ("address", "found"),
    [
        ("tcp://head:8786", "an unencrypted address of another machine"),
        ("tcp://10.0.0.1:8786", "an unencrypted address of another machine"),
        ("tcp://localhost.evil.org:1", "an unencrypted address of another machine"),
        ("tcp://[::ffff:1]:8786", "an unencrypted address of another machine"),
        ("ws://127.0.0.1:1", "expected tls://HOST:PORT"),
        ("head:8786", "expected tls://HOST:PORT"),
        ("tcp://[::", "expected tls://HOST:PORT"),
        ("tls://127.0.0.1:9", "no certificates"),
    ],
)
def test_addresses_that_others_could_reach_are_refused(
    tmp_path: Path, address: str, found: str
) -> None:
    with pytest.raises(InputError, match=found):
        generate(CONFIG, tmp_path, quiet=True, cluster=address)


def test_an_encrypted_cluster_makes_the_same_bytes(
    undisturbed: dict[str, bytes], tmp_path: Path
) -> None:
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("found no openssl to make a certificate with")
    key, cert = tmp_path / "key.pem", tmp_path / "cert.pem"
    command = ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=dask"]
    subprocess.run(
        [openssl, *command, "-keyout", key, "-out", cert], check=True, capture_output=True
    )
    roles = {f"{role}.{part}": str(file) for role in ("scheduler", "worker", "client")
             for part, file in (("cert", cert), ("key", key))}  # fmt: skip
    settings = {f"distributed.comm.tls.{name}": file for name, file in roles.items()}
    with (
        dask.config.set({**settings, "distributed.comm.tls.ca-file": str(cert)}),
        LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None,
            protocol="tls://", security=Security(require_encryption=True),
        ) as running,
    ):  # fmt: skip
        assert running.scheduler_address.startswith("tls://")
        generate(CONFIG, tmp_path / "data", quiet=True, cluster=running.scheduler_address)
    assert content(tmp_path / "data") == undisturbed
