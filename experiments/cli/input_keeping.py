"""Commands that never write over what they read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from typer.core import TyperCommand

WRITTEN: Final = ("out", "json", "video", "picture", "submission")
"""Parameters that name files to write; every other path is read."""


class InputKeepingCommand(TyperCommand):
    """A command that refuses to write over a file that it reads, before any work is done."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command.

        Raises:
            InputError: naming the file and the option.
        """
        refuse_to_overwrite(ctx.params)
        return super().invoke(ctx)


def refuse_to_overwrite(parameters: Mapping[str, Any]) -> None:
    """Refuse files to write that are read, too, or that are named twice.

    Args:
        parameters: values of a command's parameters, by their names.

    Raises:
        InputError: naming the file and the option.
    """
    from behaviors.errors import InputError
    from sim.files import is_remote

    read = [path for name, path in _paths(parameters) if name not in WRITTEN]
    written: dict[Path, str] = {}
    for name, path in _paths(parameters):
        if name not in WRITTEN or str(path) == "-" or is_remote(path):
            continue
        if any(_reads(one, path) for one in read):
            raise InputError(f"--{name}: found {path}, which is read, expected another file")
        first = written.setdefault(path.resolve(), name)
        if first != name:
            raise InputError(f"--{name}: found {path}, as --{first}, expected another file")


def _paths(parameters: Mapping[str, Any]) -> Iterator[tuple[str, Path]]:
    """Every path among the parameters, with the parameter's name."""
    for name, value in parameters.items():
        for one in value if isinstance(value, list | tuple) else (value,):
            if isinstance(one, Path):
                yield name, one


def _reads(source: Path, file: Path) -> bool:
    """Whether a file is a source, or one of the files that are read in a folder."""
    if not file.is_file() or not source.exists():
        return False
    if source.is_file():
        return source.samefile(file)
    place, folder = file.resolve(), source.resolve()
    if folder not in place.parents:
        return False
    return _is_of_dataset(source, place) or _is_recording(source, place)


def _is_of_dataset(folder: Path, file: Path) -> bool:
    """Whether a file in a folder is a dataset's: its catalogue, or in one of its folders."""
    from sim.store.catalogue import EPISODES, is_dataset

    if not is_dataset(folder):
        return False
    inside = file.relative_to(folder.resolve())
    return inside.name == EPISODES or len(inside.parts) > 1


def _is_recording(folder: Path, file: Path) -> bool:
    """Whether a file in a folder is of a format that is read."""
    from behaviors.errors import InputError
    from sim.formats import formats_in, recording_files

    try:
        files = [one for name in formats_in(folder) for one in recording_files(folder, name)[0]]
    except InputError:  # the command says what is wrong with the folder
        return False
    return any(one.samefile(file) for one in files)
