"""Arrays as text for a page: quantised, differenced, deflated, base64.

All arrays of a page become one zlib stream, which browsers inflate themselves. ``page/data.js``
reads it back in the page.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sim.frames import FloatArray, IntArray

DTYPES: Final = {"u1": "Uint8", "u2": "Uint16", "i2": "Int16", "i4": "Int32", "f4": "Float32"}
"""Little-endian numbers that a browser reads as typed arrays."""


def pack(arrays: Mapping[str, NDArray[Any]]) -> tuple[dict[str, list[Any]], str]:
    """Put arrays into one text.

    Args:
        arrays: by name, each of a type in ``DTYPES``.

    Returns:
        What is where (by name: type, offset in bytes, count), and the text.

    Examples:
        >>> index, text = pack({"a": np.array([1, 2], dtype="<i2")})
        >>> index, list(zlib.decompress(base64.b64decode(text)))
        ({'a': ['Int16', 0, 2]}, [1, 0, 2, 0])
    """
    index: dict[str, list[Any]] = {}
    parts: list[bytes] = []
    offset = 0
    for name, array in sorted(arrays.items(), key=lambda item: -item[1].itemsize):
        kind = array.dtype.newbyteorder("<").str.lstrip("<|")
        data = np.ascontiguousarray(array, dtype=f"<{kind}").tobytes()
        index[name] = [DTYPES[kind], offset, array.size]
        # A typed array begins at a multiple of its size.
        data += bytes(-len(data) % 4)
        parts.append(data)
        offset += len(data)
    return index, base64.b64encode(zlib.compress(b"".join(parts), 9)).decode()


def quantum(steps: FloatArray, finest: float) -> float:
    """The finest rounding, not finer than ``finest``, with which every step fits 16 bits."""
    largest = float(np.abs(steps).max(initial=0.0))
    return max(finest, largest / 32000.0)


def differences(values: FloatArray, begins: IntArray, unit: float) -> tuple[IntArray, NDArray[Any]]:
    """Runs of values as a first one and steps.

    Args:
        values: (n,) the runs, one after another.
        begins: (r,) where each run begins.
        unit: what one step counts.

    Returns:
        (r,) the first values as int32, and (n,) int16 steps, 0 at the beginning of each run.

    Examples:
        >>> first, steps = differences(np.array([1.0, 1.5, 9.0]), np.array([0, 2]), 0.5)
        >>> first.tolist(), steps.tolist()
        ([2, 18], [0, 1, 0])
    """
    whole = np.rint(values / unit).astype(np.int64)
    steps = np.diff(whole, prepend=whole[:1])
    steps[begins] = 0
    return whole[begins].astype(np.int32), steps.astype(np.int16)
