"""TFRecord files without TensorFlow: length, checksum, data, checksum; again and again.

References:
    tensorflow/core/lib/io/record_writer.h: the checksums are CRC-32C, rotated and offset.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import google_crc32c

from behaviors.errors import InputError
from sim.input_files import opened

_HEAD: Final = struct.Struct("<QI")
_TAIL: Final = struct.Struct("<I")
_OFFSET: Final = 0xA282EAD8


def masked_checksum(data: bytes) -> int:
    """The checksum of data as such files have it.

    Examples:
        >>> hex(masked_checksum(b"123456789"))
        '0xc78ab0e5'
    """
    crc = int(google_crc32c.value(data))
    return (((crc >> 15) | (crc << 17)) + _OFFSET) & 0xFFFFFFFF


def read_records(path: Path) -> Iterator[bytes]:
    """The records of a file, each checked.

    Args:
        path: the file, gzipped where its name ends in ``.gz``.

    Yields:
        Each record's data.

    Raises:
        InputError: naming the file and the record that is broken.
    """
    with opened(path) as file:
        number = 0
        while head := file.read(_HEAD.size):
            number += 1
            where = f"{path}: record {number}"
            if len(head) < _HEAD.size or masked_checksum(head[:8]) != _HEAD.unpack(head)[1]:
                raise InputError(f"{where}: found no length with its checksum, expected a TFRecord")
            size = _HEAD.unpack(head)[0]
            data, tail = file.read(size), file.read(_TAIL.size)
            if len(data) < size or len(tail) < _TAIL.size:
                raise InputError(f"{where}: found the file's end, expected a whole record")
            if masked_checksum(data) != _TAIL.unpack(tail)[0]:
                raise InputError(
                    f"{where}: found another checksum of its data, expected it unaltered"
                )
            yield data
        if not number:
            raise InputError(f"{path}: found no record, expected at least one")


def write_record(data: bytes) -> bytes:
    """A record as it is in a file."""
    size = _HEAD.pack(len(data), 0)[:8]
    return b"".join(
        [size, _TAIL.pack(masked_checksum(size)), data, _TAIL.pack(masked_checksum(data))]
    )
