"""The part of the world that each part of a picture shows, and its scale."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from experiments.replay.scene import ReplayScene
from sim.frames import FloatArray

LONG: Final = 4.0
"""A scene whose sides have a larger ratio is turned until it lies, and folded into rows."""

HEAD_PX, FOOT_PX, GAP_PX = 44, 46, 8
"""Height of the title, height of the legend, distance between rows, pixels."""


@dataclass(frozen=True, slots=True)
class Panel:
    """A part of the picture that shows a part of the world.

    Attributes:
        box: left, top, right and bottom, pixels.
        scale: pixels per metre.
        matrix: (2, 3) from x, y, 1 to pixels.
    """

    box: tuple[float, float, float, float]
    scale: float
    matrix: FloatArray

    def pixels(self, xy: FloatArray) -> FloatArray:
        """Pixels of places (..., 2)."""
        return np.asarray(xy @ self.matrix[:, :2].T + self.matrix[:, 2])


def lay_out(
    extent: tuple[float, float, float, float],
    width: int,
    height: int,
    head: int = HEAD_PX,
    foot: int = FOOT_PX,
) -> list[Panel]:
    """Divide a picture into panels that show an extent as large as possible.

    A long road is cut into rows, one panel each; anything else has one panel.

    Args:
        extent: x0, y0, x1, y1 of what is shown, in the scene's unit.
        width: width of the picture, pixels.
        height: height of the picture, pixels.
        head: height left free above the panels, pixels.
        foot: height left free below the panels, pixels.

    Returns:
        The panels, from top to bottom.

    Examples:
        >>> [len(lay_out((0, 0, size, 12), 1280, 720)) for size in (12, 800)]
        [1, 6]
    """
    x0, y0, x1, y1 = extent
    turned = y1 - y0 > LONG * (x1 - x0)
    u0, v0, u1, v1 = (y0, -x1, y1, -x0) if turned else (x0, y0, x1, y1)
    axes = np.array([[0.0, 1.0], [1.0, 0.0]]) if turned else np.array([[1.0, 0.0], [0.0, -1.0]])
    tall = height - head - foot
    many = range(1, 11) if u1 - u0 > LONG * (v1 - v0) else range(1, 2)
    sizes = {
        n: min(width / ((u1 - u0) / n), (tall - GAP_PX * (n - 1)) / n / (v1 - v0)) for n in many
    }
    rows = max(sizes, key=lambda n: (round(sizes[n], 6), -n))
    scale, each, length = sizes[rows], (tall - GAP_PX * (rows - 1)) / rows, (u1 - u0) / rows
    panels = []
    for row in range(rows):
        top = head + row * (each + GAP_PX)
        u, v = u0 + (row + 0.5) * length, 0.5 * (v0 + v1)
        shift = np.array([[width / 2 - u * scale], [top + each / 2 + v * scale]])
        matrix = np.concatenate([scale * axes, shift], axis=1)
        panels.append(Panel((0.0, top, float(width), top + each), scale, matrix))
    return panels


def round_below(length: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above a length.

    Examples:
        >>> [round_below(length) for length in (0.3, 7.0, 10.0, 49.0)]
        [0.2, 5.0, 10.0, 20.0]
    """
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(n * power for n in (1, 2, 5) if n * power <= length))


def shown_extent(scene: ReplayScene) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1 of what a picture shows: the road; of a junction, where its traffic is."""
    places = scene.tracks.as_rows().xy
    if scene.road is None:
        low, high = places.min(axis=0), places.max(axis=0)
        margin = max(0.03 * float((high - low).max()), 1.0)
    else:
        x0, y0, x1, y1 = scene.road.bounds
        low, high, margin = np.array([x0, y0]), np.array([x1, y1]), 7.0
        sides = np.sort(high - low)
        if sides[1] <= LONG * sides[0]:
            near, far = np.quantile(places, [0.2, 0.8], axis=0)
            half = max(45.0, float((far - near).max()) / 2)
            middle = (near + far) / 2
            low, high = np.maximum(low, middle - half), np.minimum(high, middle + half)
    return (
        float(low[0] - margin), float(low[1] - margin),
        float(high[0] + margin), float(high[1] + margin),
    )  # fmt: skip
