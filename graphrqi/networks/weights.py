"""Files of trained weights: arrays in a safetensors file, and a JSON header.

Nothing in such a file is executed when it is read.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError

SCHEMA_VERSION: Final = 3
"""Version of the files; other versions are refused."""

HEADER: Final = "about"
"""Name of the JSON text in a file's metadata."""

MAX_BYTES: Final = 2**30
"""Largest file that is read (1 GiB; shipped ones have some megabytes)."""

Arrays = Mapping[str, NDArray[Any]]
T = TypeVar("T")


def save_weights(path: Path, kind: str, about: Mapping[str, Any], arrays: Arrays) -> None:
    """Write a file of weights; the same content gives the same bytes.

    Args:
        path: the file.
        kind: what it holds, such as "classifier".
        about: JSON values.
        arrays: by name.

    Raises:
        InputError: if JSON cannot hold ``about``.
    """
    from safetensors.numpy import save

    header = {"schema_version": SCHEMA_VERSION, "kind": kind, **about}
    try:
        text = json.dumps(header, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{path}: found what JSON cannot hold ({error}), expected finite numbers, texts, "
            "lists and tables"
        ) from None
    contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    path.write_bytes(save(contiguous, {HEADER: text}))


def load_weights(path: Path, kind: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read a file of weights.

    Args:
        path: the file.
        kind: what it must hold.

    Returns:
        The JSON values, and the arrays by name, as given to `save_weights`.

    Raises:
        InputError: if the file is missing, broken, of another kind or of another version.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file() or path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path}: found no file of up to {MAX_BYTES} bytes, expected weights")
    try:
        with safe_open(path, "np") as file:
            about = json.loads((file.metadata() or {})[HEADER])
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        version, found = about["schema_version"], about["kind"]
    except (SafetensorError, OSError, LookupError, TypeError, ValueError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(f"{path}: found {reason}, expected weights of the kind {kind!r}") from None
    if found != kind:
        raise InputError(f"{path}: kind: found {found!r}, expected {kind!r}")
    if version != SCHEMA_VERSION:
        raise InputError(
            f"{path}: schema_version: found {version}, expected {SCHEMA_VERSION}; train it again"
        )
    for name, array in arrays.items():
        if array.dtype.kind == "f" and np.isnan(array).any():
            raise InputError(f"{path}: {name}: found gaps, expected numbers")
    return about, arrays


def restored(path: Path, kind: str, read: Callable[[dict[str, Any], Arrays], T]) -> T:
    """What ``read`` makes of a file's JSON values and arrays; its errors are those of the file."""
    about, arrays = load_weights(path, kind)
    try:
        return read(about, arrays)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (LookupError, RuntimeError, TypeError, ValueError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(f"{path}: found {reason}, expected weights of the kind {kind!r}") from None
