"""Overlap of rectangles: gaps worked out by hand."""

import numpy as np
import pytest

from sim.geometry import Outlines, separation


def outline(x: float, y: float, heading: float = 0.0) -> Outlines:
    """A rectangle of 4 m by 2 m."""
    return Outlines.of(np.array([[x, y]]), np.array([heading]), np.array([4.0]), np.array([2.0]))


@pytest.mark.parametrize(
    ("other", "gap"),
    [
        (outline(5.0, 0.0), 1.0),  # 5 - 2 - 2
        (outline(0.0, 1.5), -0.5),  # 1.5 - 1 - 1: half a metre aside would free it
        (outline(3.5, 0.0, np.pi / 2), 0.5),  # 3.5 - 2 - 1
        (outline(0.0, 0.0), -2.0),  # the width
        # turned by 45 degrees: along its own axis the first reaches (2 + 1) / sqrt(2)
        (outline(4.0, 4.0, np.pi / 4), 4.0 * np.sqrt(2.0) - 2.0 - 3.0 / np.sqrt(2.0)),
    ],
)
def test_separation(other, gap):
    assert separation(outline(0.0, 0.0), other)[0] == pytest.approx(gap)
    assert separation(other, outline(0.0, 0.0))[0] == pytest.approx(gap)


def test_separation_holds_during_a_move():
    moved = np.array([[-1.5, 0.0]])
    gap = separation(outline(5.0, 0.0), outline(0.0, 0.0), moved)
    assert gap[0] == pytest.approx(1.0 - 1.5)
