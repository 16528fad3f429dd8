"""Arrays as text for a page: rounded, differenced, deflated, base64.

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

from sim.frames import FloatArray

DTYPES: Final = {"u1": "Uint8", "u2": "Uint16", "i4": "Int32", "f4": "Float32"}
"""Little-endian numbers that a browser reads as typed arrays."""


def pack(arrays: Mapping[str, NDArray[Any]]) -> tuple[dict[str, list[Any]], str]:
    """Put arrays into one text.

    Args:
        arrays: by name, each of a type in ``DTYPES``.

    Returns:
        What is where (by name: type, offset in bytes, count), and the text.

    Examples:
        >>> index, text = pack({"a": np.array([1, 2], dtype="<u2")})
        >>> index, list(zlib.decompress(base64.b64decode(text)))
        ({'a': ['Uint16', 0, 2]}, [1, 0, 2, 0])
    """
    index: dict[str, list[Any]] = {}
    parts: list[bytes] = []
    offset = 0
    for name, array in arrays.items():
        kind = array.dtype.newbyteorder("<").str.lstrip("<|")
        data = np.ascontiguousarray(array, dtype=f"<{kind}").tobytes()
        index[name] = [DTYPES[kind], offset, array.size]
        data += bytes(-len(data) % 4)  # a typed array begins at a multiple of its size
        parts.append(data)
        offset += len(data)
    return index, base64.b64encode(zlib.compress(b"".join(parts), 9)).decode()


def differences(values: FloatArray, unit: float) -> NDArray[np.int32]:
    """Rounded values (n, ...) as differences along the first axis, as flat numbers.

    Args:
        values: the values.
        unit: what they are rounded to.

    Examples:
        >>> differences(np.array([1.0, 1.5, 9.0]), 0.5).tolist()
        [2, 1, 15]
    """
    return np.diff(np.rint(values / unit), axis=0, prepend=0).astype(np.int32).ravel()
