"""Line charts: SVG in a page, in the page's colours, light or dark; figures for papers.

Matplotlib draws both.
"""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from markupsafe import Markup

from behaviors.colors import COLORS, UNKNOWN_COLOR
from behaviors.labels import Behavior
from experiments.figure_files import figure_bytes

if TYPE_CHECKING:
    from matplotlib.axis import Axis as DrawnAxis
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN, LEGEND_LINE_IN = 5.0, 3.1, 0.21
"""Size of a chart without its legend, and the height of a line of the legend, inches."""

_CYCLE: Final = ("#4477AA", "#EE6677", "#228833", "#CCBB44", "#66CCEE", "#AA3377", UNKNOWN_COLOR)
"""Colours of lines that are no behaviours; none is a behaviour's colour: the scheme "bright" of
Tol (2021, SRON technical note EPS/TN/09-002), for all common colour blindness too."""

_DASHES: Final = ("-", "--", ":")


@dataclass(frozen=True, slots=True)
class Inks:
    """Colours of a chart's words, of its axes, and of its grid."""

    word: str
    axis: str
    rule: str

    def style(self) -> dict[Any, Any]:
        """Matplotlib's settings for these colours."""
        return {
            "svg.fonttype": "none", "font.family": "DejaVu Sans", "font.size": 9,
            "text.color": self.word, "text.parse_math": False, "axes.labelcolor": self.word,
            "axes.edgecolor": self.axis, "xtick.color": self.axis, "ytick.color": self.axis,
            "xtick.labelcolor": self.word, "ytick.labelcolor": self.word, "grid.color": self.rule,
            "axes.axisbelow": True,
        }  # fmt: skip


PAGE: Final = Inks("#010101", "#020202", "#030303")
"""Colours of charts in a page; `inlined` replaces them by the page's own, light or dark."""

PAPER: Final = Inks("#000000", "#55606E", "#D9DDE2")
"""Colours of charts in a file of their own."""

_PAGE_COLORS: Final = {
    PAGE.word: "currentColor", PAGE.axis: "var(--muted)", PAGE.rule: "var(--line)"
}  # fmt: skip
"""The page's colour for each colour that matplotlib draws in."""


@dataclass(frozen=True, slots=True)
class Point:
    """A point of a line with its interval, if it has one."""

    x: float
    y: float
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, slots=True)
class Line:
    """A line of a chart.

    Attributes:
        name: for the legend.
        points: in order of x.
        color: None to take the next one.
        thin: whether it is a guide for the eye and no data.
    """

    name: str
    points: tuple[Point, ...]
    color: str | None = None
    thin: bool = False


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis of a chart.

    Attributes:
        label: what it shows, with the unit.
        log: whether it counts in powers of ten.
        low: where it begins; None for 0, or for the data's own on a logarithmic axis.
        high: where it ends; None for the data's own.
    """

    label: str
    log: bool = False
    low: float | None = None
    high: float | None = None

    def fits(self, value: float) -> bool:
        """Whether a value can be drawn."""
        return math.isfinite(value) and (not self.log or value > 0)


def color_of(name: str, number: int) -> str:
    """The colour of a behaviour, or for anything else the next colour that no behaviour has.

    Examples:
        >>> color_of("timid", 0), color_of("arpack", 0)
        ('#009E73', '#4477AA')
    """
    try:
        return COLORS[Behavior(name)]
    except ValueError:
        return _CYCLE[number % len(_CYCLE)]


@dataclass(frozen=True, slots=True)
class Chart:
    """Lines with their intervals as bands.

    Attributes:
        title: what the chart shows, for the caption and for those who hear it.
        x: across.
        y: up.
        lines: what to draw; those without a point that can be drawn are left out.
    """

    title: str
    x: Axis
    y: Axis
    lines: tuple[Line, ...]

    def _drawn(self) -> list[tuple[Line, list[Point]]]:
        return [
            (line, points)
            for line in self.lines
            if (points := [p for p in line.points if self.x.fits(p.x) and self.y.fits(p.y)])
        ]

    def __bool__(self) -> bool:
        """Whether there is something to draw."""
        return bool(self._drawn())

    def __html__(self) -> Markup:
        """A figure with an SVG, empty if there is nothing to draw; text in it is escaped."""
        from matplotlib import rc_context

        if not self:
            return Markup("")
        out = io.StringIO()
        with rc_context({"svg.hashsalt": self.title, **PAGE.style()}):
            figure = self._figure(PAGE)
            figure.savefig(out, format="svg", transparent=True, metadata={"Date": None})
        return Markup('<figure class="chart"><figcaption>{}</figcaption>{}</figure>').format(
            self.title, inlined(out.getvalue(), self.title)
        )

    def pdf(self) -> bytes:
        """The chart as a PDF without a title, as a paper's captions say what figures show."""
        from matplotlib import rc_context

        with rc_context(PAPER.style()):
            return figure_bytes(self._figure(PAPER), ".pdf")

    def _figure(self, inks: Inks) -> Figure:
        from matplotlib.figure import Figure

        x, y, drawn = self.x, self.y, self._drawn()
        legend_in = LEGEND_LINE_IN * -(-len(drawn) // 2)
        figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN + legend_in), layout="constrained")
        axes = figure.add_subplot()
        for number, (line, points) in enumerate(drawn):
            dash = "--" if line.thin else _DASHES[number // len(_CYCLE) % len(_DASHES)]
            color = inks.axis if line.thin else line.color or color_of(line.name, number)
            axes.plot(
                [p.x for p in points], [p.y for p in points], dash, color=color, label=line.name,
                linewidth=1.0 if line.thin else 1.8, markersize=4, clip_on=False,
                marker="o" if len(points) <= 24 and not line.thin else "",
            )  # fmt: skip
            banded = [p for p in points if p.low is not None and p.high is not None]
            if len(banded) > 1:
                low, high = [p.low for p in banded], [p.high for p in banded]
                across = [p.x for p in banded]
                axes.fill_between(across, low, high, color=color, alpha=0.16, linewidth=0)  # type: ignore[arg-type]
        axes.set(xlabel=x.label, ylabel=y.label)
        if x.log:
            axes.set_xscale("log")
            _label_logarithms(axes.xaxis)
        else:
            axes.set_xlim(min(0.0, axes.get_xlim()[0]) if x.low is None else x.low, x.high)
        if y.log:
            axes.set_yscale("log")
            _label_logarithms(axes.yaxis)
        else:
            lowest = min([0.0, *(v for _, ps in drawn for p in ps for v in (p.y, p.low or 0.0))])
            axes.set_ylim(lowest if y.low is None else y.low, y.high)
        axes.grid(visible=True, axis="y", linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        figure.legend(loc="outside lower left", ncols=2, frameon=False, handlelength=2.2)
        return figure


def _label_logarithms(axis: DrawnAxis) -> None:
    """Label powers of ten, and twice and five times these where there are few, as plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator

    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0,) if high > 100.0 * low else (1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(FuncFormatter(lambda value, _: ""))


def inlined(svg: str, title: str) -> Markup:
    """A matplotlib picture as part of a page: as wide as its place, in the page's colours."""
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    svg = re.sub(r'^(<svg[^>]*?) width="[^"]*" height="[^"]*"', r"\1", svg)
    svg = re.sub(r"^(<svg[^>]*?) height=\"[^\"]*\"", r"\1", svg)
    svg = re.sub(r"^(<svg[^>]*?) width=\"[^\"]*\"", r"\1", svg)
    for drawn, color in _PAGE_COLORS.items():
        svg = svg.replace(drawn, color)
    label = Markup('<svg role="img" aria-label="{}" ').format(title)
    return label + Markup(svg.removeprefix("<svg "))
