"""Files and folders appear as a whole: through links, and beside what is there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from sim.files import whole_file, whole_folder, write_whole


def test_a_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "real").write_bytes(b"old")
    (tmp_path / "link").symlink_to("real")
    (tmp_path / "dangling").symlink_to("new")
    write_whole(tmp_path / "link", b"one")
    write_whole(tmp_path / "dangling", b"two")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_bytes() == b"one"
    assert (tmp_path / "new").read_bytes() == b"two"


def test_an_error_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    with pytest.raises(ZeroDivisionError), whole_file(path) as partial:
        partial.write_bytes(b"half" * (1 // 0))
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    assert path.read_bytes() == b"old"


def test_a_folder_that_is_written_again_keeps_other_files(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    target = tmp_path / "link"
    target.symlink_to(tmp_path / "disk")
    with whole_folder(target) as partial:
        (partial / "ours").write_text("one")
    (target / "deep" / "er").mkdir(parents=True)
    (target / "deep" / "er" / "note").write_text("a year's work")
    (target / "away").symlink_to("nowhere")
    with whole_folder(target) as partial:
        (partial / "ours").write_text("two")
    assert (target / "ours").read_text() == "two"
    assert (target / "deep" / "er" / "note").read_text() == "a year's work"
    assert os.readlink(target / "away") == "nowhere"
    assert target.is_symlink()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["disk", "link"]
