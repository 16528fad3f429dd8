"""Structures in Thrift's compact protocol, as Parquet files hold them, as plain dictionaries.

Arrow reads them too, but ends the whole process at some broken ones. Here every broken structure is
a `ThriftError`, and nothing of it is larger in memory than some times its bytes.

References:
    Apache Thrift (2024), Compact protocol encoding, thrift-compact-protocol.md.
"""

from __future__ import annotations

from typing import Any, Final

MAX_DEPTH: Final = 24
"""Deepest nesting of structures and lists (Parquet's own have 8)."""

MAX_VARINT_BITS: Final = 63
_TRUE, _FALSE, _BYTE, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = 1, 2, 3, 7, 8, 9, 10, 11, 12
_INTEGERS: Final = frozenset({4, 5, 6})


class ThriftError(ValueError):
    """What is there is no structure of the compact protocol."""


def read_struct(data: Any, at: int, end: int) -> tuple[dict[int, Any], int]:
    """Read one structure.

    Args:
        data: bytes, or anything whose slices are bytes.
        at: where it begins.
        end: where the bytes end that it may take.

    Returns:
        Its values by number of the field, and where it ends. Structures are such dictionaries,
        lists are lists, texts are bytes, maps and doubles are None.

    Raises:
        ThriftError: if it is broken or does not end in time.

    Examples:
        >>> read_struct(bytes([0x15, 0x06, 0x18, 0x02, 65, 66, 0x00]), 0, 7)
        ({1: 3, 2: b'AB'}, 7)
    """
    try:
        found, at = _struct(data, at, end, 0)
    except IndexError:
        raise ThriftError("found its end too early") from None
    if at > end:
        raise ThriftError("found its end too early")
    return found, at


def _varint(data: Any, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
        shift += 7
        if shift > MAX_VARINT_BITS:
            raise ThriftError("found a number of more than 64 bits")


def _struct(data: Any, at: int, end: int, depth: int) -> tuple[dict[int, Any], int]:
    if depth > MAX_DEPTH:
        raise ThriftError(f"found structures more than {MAX_DEPTH} deep")
    found: dict[int, Any] = {}
    field = 0
    while True:
        byte = data[at]
        at += 1
        if byte == 0:
            return found, at
        kind, delta = byte & 15, byte >> 4
        if delta:
            field += delta
        else:
            number, at = _varint(data, at)
            field = (number >> 1) ^ -(number & 1)
        if field in found:
            raise ThriftError(f"found field {field} twice")
        if kind in _INTEGERS:
            number = data[at]
            if number < 128:  # most numbers are one byte
                at += 1
            else:
                number, at = _varint(data, at)
            found[field] = (number >> 1) ^ -(number & 1)
        elif kind <= _FALSE and kind:
            found[field] = kind == _TRUE
        else:
            found[field], at = _value(data, at, end, kind, depth)


def _value(data: Any, at: int, end: int, kind: int, depth: int) -> tuple[Any, int]:
    """A value that is no field's flag."""
    if kind in _INTEGERS:
        number, at = _varint(data, at)
        return (number >> 1) ^ -(number & 1), at
    if kind == _BINARY:
        size, at = _varint(data, at)
        if size > end - at:
            raise ThriftError(f"found a text of {size} bytes, which does not fit")
        return bytes(data[at : at + size]), at + size
    if kind == _STRUCT:
        return _struct(data, at, end, depth + 1)
    if kind in (_LIST, _SET):
        return _list(data, at, end, depth)
    if kind == _DOUBLE:
        return None, at + 8
    if kind in (_TRUE, _FALSE, _BYTE):
        return data[at], at + 1
    if kind == _MAP:
        return _map(data, at, end, depth)
    raise ThriftError(f"found a value of the unknown type {kind}")


def _list(data: Any, at: int, end: int, depth: int) -> tuple[list[Any], int]:
    if depth > MAX_DEPTH:
        raise ThriftError(f"found lists more than {MAX_DEPTH} deep")
    byte = data[at]
    at += 1
    kind, count = byte & 15, byte >> 4
    if count == 15:
        count, at = _varint(data, at)
    if count > end - at:
        raise ThriftError(f"found a list of {count} values, which does not fit")
    values: list[Any] = []
    for _ in range(count):
        value, at = _value(data, at, end, kind, depth + 1)
        values.append(value)
    return values, at


def _map(data: Any, at: int, end: int, depth: int) -> tuple[None, int]:
    count, at = _varint(data, at)
    if count > end - at or depth > MAX_DEPTH:
        raise ThriftError(f"found a map of {count} values, which does not fit")
    if count:
        kinds = data[at]
        at += 1
        for _ in range(count):
            _, at = _value(data, at, end, kinds >> 4, depth + 1)
            _, at = _value(data, at, end, kinds & 15, depth + 1)
    return None, at
