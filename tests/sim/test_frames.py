"""A frame takes what can be taken without loss, and refuses the rest by name."""

from __future__ import annotations

import numpy as np
import pytest

from behaviors.errors import InputError
from sim.frames import Frame

ONE = {
    "ids": [1], "xy": [[0, 0]], "heading": [0], "speed": [0], "length": [4], "width": [2],
    "kind": [0],
}  # fmt: skip


def test_numbers_of_other_types_are_taken() -> None:
    frame = Frame(0.0, **{**ONE, "ids": np.array([3.0]), "kind": np.zeros(1)})
    assert frame.ids.tolist() == [3]
    assert frame.kind.dtype == np.int8
    assert not frame.xy.flags.writeable


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("ids", [1.7], "float64 values, expected int64"),
        ("ids", [np.nan], "float64 values, expected int64"),
        ("kind", ["car"], "expected int8"),
        ("xy", [["a", "b"]], "expected float64"),
        ("xy", [[1j, 0]], "complex128 values, expected float64"),
        ("xy", [[0, 0], [1]], "expected an array"),
        ("speed", [1, 2], r"shape \(2,\), expected \(1,\)"),
        ("ids", [[1]], "shape"),
    ],
)
def test_what_loses_something_is_refused(name: str, value: object, message: str) -> None:
    with pytest.raises(InputError, match=rf"Frame\.{name}: .*{message}"):
        Frame(0.0, **{**ONE, name: value})  # type: ignore[arg-type]
