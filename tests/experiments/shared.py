"""What several tests of the programs do: call a command, look at a folder, make episodes here."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.cli.commands import main


def call(*arguments: object) -> int:
    """The exit code of a command that runs in this process."""
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return int(ended.value.code or 0)


def content(folder: Path) -> dict[str, bytes]:
    """The bytes of every file below a folder, by its name there."""
    files = (p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


def in_this_process(make, folder, tasks, jobs, shown):
    """As `make_in_processes`, without the seconds that starting workers takes."""
    return [make(folder, task) for task in tasks], []
