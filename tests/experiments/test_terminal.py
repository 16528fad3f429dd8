"""Names in files reach the terminal spelt out: no escape sequences, no lines of their own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from behaviors.errors import printable

EVIL = "\x1b[2J\x1b]0;t\x07\r\n/tmp/out: 5 episodes\u202e\x9b31m"


def harmless(text: str) -> bool:
    return all(one.isprintable() or one == "\n" for one in text)


@pytest.mark.parametrize("text", [EVIL, "\udcff", "\u2028x", "a\tb", "plain"])
def test_text_is_spelt_out(text: str) -> None:
    spelt = printable(text)
    assert spelt.isprintable()
    assert spelt.encode()
    assert (spelt == text) == text.isprintable()


def test_errors_print_ids_and_file_names_spelt_out(tmp_path: Path) -> None:
    folder = tmp_path / "\x1b[31mred\n7 done"
    folder.mkdir()
    path = folder / "a.csv"
    path.write_text(
        "TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME\n"
        "0,\x1b[2Jx,AGENT,0,0,PIT\n0,\x1b[2Jx,AGENT,1,1,PIT\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "experiments.cli", "import", path, "--out", tmp_path / "out"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert harmless(done.stderr)
    assert len(done.stderr.splitlines()) == 1
    assert r"agent \x1b[2Jx twice" in done.stderr
