"""Files appear whole: through links, and into what is no file."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from sim.store.atomic import (
    remove_temporary,
    temporary_folder,
    whole_file,
    whole_folder,
    write_whole,
)


def test_a_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "real").write_bytes(b"old")
    (tmp_path / "link").symlink_to("real")
    (tmp_path / "dangling").symlink_to("new")
    write_whole(tmp_path / "link", b"one")
    write_whole(tmp_path / "dangling", b"two")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_bytes() == b"one"
    assert (tmp_path / "new").read_bytes() == b"two"


def test_a_pipe_is_written_to_and_stays_one(tmp_path: Path) -> None:
    pipe, got = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()))
    reader.start()
    write_whole(pipe, b"through")
    reader.join()
    assert got == [b"through"]
    assert pipe.is_fifo()


def test_an_error_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    with pytest.raises(ZeroDivisionError), whole_file(path) as partial:
        partial.write_bytes(b"half" * (1 // 0))
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    assert path.read_bytes() == b"old"


@pytest.mark.parametrize("whole", [whole_file, whole_folder])
@pytest.mark.parametrize(
    ("said", "named"),
    [
        ("Permission denied", True),
        ("Permission denied", False),
        ("Failed to open '{partial}'. Detail: [errno 13] Permission denied", False),
    ],
    ids=["the hidden path", "no path", "the hidden path in words"],
)
def test_an_error_names_the_path_that_was_given(
    whole: Callable[[Path], AbstractContextManager[Path]],
    said: str,
    named: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)

    def write() -> None:
        with whole(Path("out")) as partial:
            error = PermissionError(13, said.format(partial=partial))
            error.filename = str(partial) if named else None
            raise error

    with pytest.raises(OSError, match="denied") as found:
        write()
    assert (found.value.filename, found.value.strerror) == ("out", "Permission denied")
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_process_left_is_removed_by_the_next_one(tmp_path: Path) -> None:
    script = (
        "import os, signal, sys; from pathlib import Path\n"
        "from sim.store.atomic import whole_file, whole_folder\n"
        "folder = Path(sys.argv[1])\n"
        "with whole_folder(folder / 'part') as part, whole_file(folder / 'file') as file:\n"
        "    file.write_text('half')\n"
        "    os.kill(os.getpid(), int(sys.argv[2]))\n"
    )
    command = [sys.executable, "-c", script, str(tmp_path)]
    assert subprocess.run([*command, "9"], check=False).returncode == -9
    with whole_file(tmp_path / "other") as mine:
        mine.write_text("in progress")
        left = {path for path in tmp_path.iterdir() if path != mine}
        assert left == set(), "the file and the folder of the killed process"
        assert subprocess.run([*command, "0"], check=True).returncode == 0
        assert mine.read_text() == "in progress", "somebody alive is at it"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "other", "part"]


def test_temporary_folders_of_killed_processes_go_with_the_next_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    script = (
        "import os; from sim.store.atomic import temporary_folder\n"
        "with temporary_folder('sumo') as folder:\n"
        "    (folder / 'routes').write_text('half')\n"
        "    os.kill(os.getpid(), 9)\n"
    )
    subprocess.run([sys.executable, "-c", script], check=False)
    (left,) = tmp_path.iterdir()
    (tmp_path / "graphrqi-sumo-of-another-kind").mkdir()
    with temporary_folder("road") as mine:
        assert not left.exists()
        remove_temporary()
        assert mine.exists()
    assert [path.name for path in tmp_path.iterdir()] == ["graphrqi-sumo-of-another-kind"]


def test_a_process_that_ends_leaves_no_temporary_folder_whatever_its_threads_do(
    tmp_path: Path,
) -> None:
    script = """
import threading, time
from sim.store.atomic import end_without_temporary, temporary_folder

def make():
    while True:
        try:
            with temporary_folder("sumo") as folder:
                for number in range(20):
                    (folder / str(number)).write_text("half")
        except OSError:
            pass

for _ in range(4):
    threading.Thread(target=make, daemon=True).start()
time.sleep(0.05)
end_without_temporary(7)
"""
    for _ in range(5):
        command = [sys.executable, "-c", script]
        run = subprocess.run(command, env={**os.environ, "TMPDIR": str(tmp_path)}, check=False)
        assert run.returncode == 7
        assert list(tmp_path.iterdir()) == []


def test_a_fork_can_make_temporary_folders_while_a_thread_makes_some() -> None:
    script = """
import os, threading
from sim.store.atomic import temporary_folder

def make():
    while True:
        with temporary_folder("a"):
            pass

with temporary_folder("first"):  # Python looks once where temporary files go
    threading.Thread(target=make, daemon=True).start()
for _ in range(50):
    child = os.fork()
    if child == 0:
        with temporary_folder("b"):
            os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)
