"""What pictures are drawn on: pixels, or a figure whose lines stay sharp in a paper.

`Pixels` and `Vectors` offer the same pen. Places on both are pixels from the top left corner.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, FancyBboxPatch, Polygon, Rectangle
from PIL import Image, ImageDraw, ImageFont

from sim.frames import IntArray

Box = tuple[float, float, float, float]
"""Left, top, right and bottom, pixels."""

POINTS_PER_INCH: Final = 72


class Pixels:
    """An image as a sheet.

    Args:
        image: what is drawn on.
    """

    def __init__(self, image: Image.Image) -> None:
        self.image = image

    @contextmanager
    def part(self, box: Box, ground: str | None = None) -> Iterator[tuple[Pen, IntArray]]:
        """A pen that draws inside a box only, and the place where its own pixels begin.

        Args:
            box: the part of the sheet.
            ground: the colour that it is filled with first; None to draw on what is there.
        """
        left, top, right, bottom = (round(side) for side in box)
        if ground is None:
            piece = self.image.crop((left, top, right, bottom))
        else:
            piece = Image.new("RGB", (right - left, bottom - top), ground)
        yield ImageDraw.Draw(piece), np.array([left, top])
        self.image.paste(piece, (left, top))

    def whole(self) -> Pen:
        """A pen that draws anywhere."""
        return ImageDraw.Draw(self.image)


class Vectors:
    """A figure as a sheet.

    Args:
        width: pixels.
        height: pixels.
        pixels_per_point: how many pixels of the sheet a point of the figure has.
    """

    def __init__(self, width: int, height: int, pixels_per_point: int) -> None:
        inch = POINTS_PER_INCH * pixels_per_point
        self.figure = Figure(figsize=(width / inch, height / inch))
        self._axes = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._axes.set_axis_off()
        self._axes.set(xlim=(0, width), ylim=(height, 0))
        self._point = 1.0 / pixels_per_point

    @contextmanager
    def part(self, box: Box, ground: str | None = None) -> Iterator[tuple[Pen, IntArray]]:
        """As of `Pixels`; the pen's own pixels are the sheet's."""
        left, top, right, bottom = box
        pen = VectorPen(self._axes, self._point, box)
        if ground is not None:
            corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
            pen.polygon(corners, ground)
        yield pen, np.zeros(2, dtype=np.int64)

    def whole(self) -> Pen:
        """A pen that draws anywhere."""
        return VectorPen(self._axes, self._point, None)


class VectorPen:
    """What `Painter` needs of `PIL.ImageDraw.ImageDraw`, drawn as shapes of a figure.

    Args:
        axes: where shapes go; what is drawn later lies above.
        point: points per pixel.
        box: outside of it nothing is shown; None for no limit.
    """

    def __init__(self, axes: Any, point: float, box: Box | None) -> None:
        self._axes, self._point, self._clip = axes, point, None
        if box is not None:
            left, top, right, bottom = box
            self._clip = Rectangle(
                (left, top), right - left, bottom - top, transform=axes.transData
            )

    def _add(self, shape: Any) -> None:
        shape.set_zorder(1 + len(self._axes.get_children()))
        self._axes.add_artist(shape)
        if self._clip is not None:
            shape.set_clip_path(self._clip)

    def _paint(self, fill: str | None, outline: str | None, width: float) -> dict[str, Any]:
        """A shape's colours; a shape without an outline has none that a viewer would thicken."""
        return {
            "facecolor": fill or "none",
            "edgecolor": outline or "none",
            "linewidth": width * self._point if outline else 0.0,
        }

    def line(
        self, xy: Sequence[tuple[float, float]], fill: str, width: float = 1,
        joint: str | None = None,
    ) -> None:  # fmt: skip
        """A line through points."""
        x, y = zip(*xy, strict=True)
        self._add(
            Line2D(
                x, y, color=fill, linewidth=width * self._point, solid_capstyle="butt",
                solid_joinstyle="round" if joint == "curve" else "miter",
            )
        )  # fmt: skip

    def polygon(
        self, xy: Sequence[tuple[float, float]], fill: str | None = None,
        outline: str | None = None, width: float = 1,
    ) -> None:  # fmt: skip
        """A closed outline, filled."""
        self._add(Polygon(np.asarray(xy), closed=True, **self._paint(fill, outline, width)))

    def ellipse(
        self, xy: Box, fill: str | None = None, outline: str | None = None, width: float = 1
    ) -> None:
        """The ellipse that a box holds."""
        left, top, right, bottom = xy
        middle = ((left + right) / 2, (top + bottom) / 2)
        size = (right - left, bottom - top)
        self._add(Ellipse(middle, *size, **self._paint(fill, outline, width)))

    def rounded_rectangle(
        self, xy: Box, radius: float, fill: str | None = None, outline: str | None = None,
        width: float = 1,
    ) -> None:  # fmt: skip
        """A rectangle with round corners."""
        left, top, right, bottom = xy
        style = f"round,pad=0,rounding_size={radius}"
        self._add(
            FancyBboxPatch(
                (left, top), right - left, bottom - top, boxstyle=style,
                **self._paint(fill, outline, width),
            )
        )  # fmt: skip

    def text(
        self, xy: tuple[float, float], text: str, fill: str, font: ImageFont.FreeTypeFont,
        anchor: str,
    ) -> None:  # fmt: skip
        """A line of text; of Pillow's anchors, these: l, m and r with m and s."""
        across = {"l": "left", "m": "center", "r": "right"}[anchor[0]]
        up = {"m": "center_baseline", "s": "baseline"}[anchor[1]]
        self._axes.text(
            *xy, text, color=fill, ha=across, va=up, parse_math=False, font=Path(str(font.path)),
            fontsize=font.size * self._point, zorder=1 + len(self._axes.get_children()),
        )  # fmt: skip

    def textlength(self, text: str, font: ImageFont.FreeTypeFont) -> float:
        """How long a line of text is, pixels."""
        return font.getlength(text)


Pen = ImageDraw.ImageDraw | VectorPen

_fonts: dict[tuple[int, bool], ImageFont.FreeTypeFont] = {}


def letters(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The font that matplotlib brings along, so that every machine draws the same letters.

    Args:
        size: pixels.
        bold: whether letters are thick.
    """
    if (size, bold) not in _fonts:
        name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
        path = Path(mpl.get_data_path()) / "fonts" / "ttf" / name
        _fonts[size, bold] = ImageFont.truetype(str(path), size)
    return _fonts[size, bold]
