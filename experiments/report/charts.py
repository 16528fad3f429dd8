"""Line charts as SVG that take the page's colours and type, light or dark."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from markupsafe import Markup, escape

from behaviors.colors import COLORS, UNKNOWN_COLOR
from behaviors.labels import Behavior

WIDTH, HEIGHT = 480, 300
LEFT, RIGHT, TOP, BOTTOM = 58, 14, 12, 46

_CYCLE: Final = ("#4477AA", "#EE6677", "#228833", "#CCBB44", "#66CCEE", "#AA3377", UNKNOWN_COLOR)
"""Of lines that are no behaviours, none of which has a behaviour's colour: the scheme "bright" of
Tol (2021, SRON technical note EPS/TN/09-002), for all common colour blindness too."""
_DASHES: Final = ("", "6 3", "2 3")


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
        thin: whether it only helps the eye.
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
        low: where it begins; None for the data's own.
        high: where it ends; None for the data's own.
    """

    label: str
    log: bool = False
    low: float | None = None
    high: float | None = None


def color_of(name: str, number: int) -> str:
    """A behaviour's own colour, or the next that is none's.

    Examples:
        >>> color_of("timid", 0), color_of("arpack", 0)
        ('#009E73', '#4477AA')
    """
    try:
        return COLORS[Behavior(name)]
    except ValueError:
        return _CYCLE[number % len(_CYCLE)]


def line_chart(title: str, x: Axis, y: Axis, lines: Sequence[Line]) -> Markup:
    """Draw lines with their intervals as bands.

    Args:
        title: what the chart shows, for the caption and for those who hear it.
        x: across.
        y: up.
        lines: what to draw; those without a point that can be drawn are left out.

    Returns:
        A figure with an SVG; text in it is escaped.
    """
    drawn = [
        Line(line.name, points, line.color, line.thin)
        for line in lines
        if (points := tuple(p for p in line.points if _fits(p, x, y)))
    ]
    if not drawn:
        return Markup("")
    across = _Scale(x, [p.x for n in drawn for p in n.points], LEFT, WIDTH - RIGHT)
    values = [v for n in drawn for p in n.points for v in (p.y, p.low, p.high) if v is not None]
    up = _Scale(y, [v for v in values if not y.log or v > 0], HEIGHT - BOTTOM, TOP)
    parts = [_axes(x, y, across, up)]
    legend = []
    for number, line in enumerate(drawn):
        color = line.color or color_of(line.name, number)
        dash = _DASHES[number // len(_CYCLE) % len(_DASHES)]
        parts.append(_drawn_line(line, color, dash, across, up))
        legend.append(_legend_entry(line, color, dash))
    return Markup(
        '<figure class="chart"><figcaption>{title}</figcaption>'
        '<svg viewBox="0 0 {w} {h}" role="img" aria-label="{title}">{parts}</svg>'
        '<ul class="legend">{legend}</ul></figure>'
    ).format(title=title, w=WIDTH, h=HEIGHT, parts=Markup("").join(parts),
             legend=Markup("").join(legend))  # fmt: skip


def _fits(point: Point, x: Axis, y: Axis) -> bool:
    return (
        math.isfinite(point.x)
        and math.isfinite(point.y)
        and (not x.log or point.x > 0)
        and (not y.log or point.y > 0)
    )


class _Scale:
    """From values to pixels."""

    def __init__(self, axis: Axis, values: Sequence[float], begin: float, end: float) -> None:
        low, high = min(values), max(values)
        self.log = axis.log
        if axis.log:
            low, high = 10 ** math.floor(math.log10(low) + 1e-9), 10 ** math.ceil(math.log10(high))
            high = max(high, low * 10)
            self.ticks = [
                10.0**k for k in range(round(math.log10(low)), round(math.log10(high)) + 1)
            ]
        else:
            low = min(low, 0.0) if axis.low is None else axis.low
            high = high if axis.high is None else axis.high
            step = _nice((high - low or 1.0) / 4)
            high = math.ceil(high / step - 1e-9) * step if axis.high is None else high
            first = math.ceil(low / step - 1e-9)
            self.ticks = [
                round(k * step, 10) for k in range(first, math.floor(high / step + 1e-9) + 1)
            ]
        self.low, self.high, self.begin, self.end = low, max(high, low + 1e-12), begin, end

    def at(self, value: float) -> float:
        """The pixel of a value."""
        if self.log:
            value = max(value, self.low)
            share = math.log(value / self.low) / math.log(self.high / self.low)
        else:
            share = (value - self.low) / (self.high - self.low)
        return round(self.begin + min(max(share, 0.0), 1.0) * (self.end - self.begin), 1)


def _nice(step: float) -> float:
    power: float = 10.0 ** math.floor(math.log10(step))
    return next(n * power for n in (1, 2, 2.5, 5, 10) if n * power >= step - 1e-12)


def _tick(value: float) -> str:
    return f"{value:g}"


_GRID: Final = Markup('<path class="grid" d="M{} {}H{}"/><text x="{}" y="{}" class="end">{}</text>')
_TICK: Final = Markup('<text x="{}" y="{}" class="mid">{}</text>')
_DOT: Final = Markup('<circle cx="{}" cy="{}" r="3" fill="{}"/>')
_AXES: Final = Markup(
    '<path class="axis" d="M{l} {t}V{b}H{r}"/>'
    '<text x="{mx}" y="{ly}" class="mid">{xl}</text>'
    '<text transform="translate(13 {my}) rotate(-90)" class="mid">{yl}</text>'
)


def _axes(x: Axis, y: Axis, across: _Scale, up: _Scale) -> Markup:
    right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM
    parts = [
        _GRID.format(LEFT, up.at(v), right, LEFT - 7, up.at(v) + 4, _tick(v)) for v in up.ticks
    ]
    parts += [_TICK.format(across.at(v), bottom + 17, _tick(v)) for v in across.ticks]
    parts.append(
        _AXES.format(
            l=LEFT, t=TOP, b=bottom, r=right, mx=(LEFT + right) / 2, ly=HEIGHT - 8,
            my=(TOP + bottom) / 2, xl=x.label, yl=y.label,
        )
    )  # fmt: skip
    return Markup("").join(parts)


def _drawn_line(line: Line, color: str, dash: str, across: _Scale, up: _Scale) -> Markup:
    places = [(across.at(p.x), up.at(p.y)) for p in line.points]
    path = "M" + "L".join(f"{a} {b}" for a, b in places)
    parts = []
    spread = [p for p in line.points if p.low is not None and p.high is not None]
    if len(spread) > 1:
        top = [f"{across.at(p.x)} {up.at(p.high)}" for p in spread if p.high is not None]
        bottom = [f"{across.at(p.x)} {up.at(p.low)}" for p in spread[::-1] if p.low is not None]
        parts.append(
            Markup('<path class="band" fill="{}" d="M{}Z"/>').format(color, "L".join(top + bottom))
        )
    style = "helper" if line.thin else "line"
    parts.append(
        Markup('<path class="{}" stroke="{}" stroke-dasharray="{}" d="{}"/>').format(
            style, color, "4 4" if line.thin else dash or "none", path
        )
    )
    if len(places) <= 24 and not line.thin:
        parts += [_DOT.format(a, b, color) for a, b in places]
    return Markup("").join(parts)


def _legend_entry(line: Line, color: str, dash: str) -> Markup:
    return Markup(
        '<li><svg viewBox="0 0 26 10" aria-hidden="true"><path class="{}" stroke="{}" '
        'stroke-dasharray="{}" d="M1 5H25"/></svg>{}</li>'
    ).format(
        "helper" if line.thin else "line", color, "4 4" if line.thin else dash or "none",
        escape(line.name),
    )  # fmt: skip
