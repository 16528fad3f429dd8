"""The arrays that all of this package takes and gives."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
SingleArray = NDArray[np.float32]
CodeArray = NDArray[np.int8]


def softmax(scores: FloatArray) -> FloatArray:
    """(..., C) probabilities in proportion to the exponentials of scores (..., C)."""
    raised = np.exp(scores - scores.max(axis=-1, keepdims=True))
    return np.asarray(raised / raised.sum(axis=-1, keepdims=True))


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """A view that nobody can write through."""
    view = array.view()
    view.flags.writeable = False
    return view
