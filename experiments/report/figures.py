"""The report's pictures, as SVG text: confusion matrices, the road with everyone on it, w = L u."""

from __future__ import annotations

import io
from collections.abc import Sequence
from itertools import pairwise

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from numpy.typing import NDArray

from behaviors.colors import COLORS, UNKNOWN_COLOR
from behaviors.labels import BEHAVIORS
from graphrqi.graph import TrafficGraph
from graphrqi.posterior import Posterior
from graphrqi.predict.prediction import Prediction
from sim.frames import Frame
from sim.road import Road

FloatArray = NDArray[np.float64]
CodeArray = NDArray[np.int8]

_ROAD, _CROSSING, _MARK = "#D9D9D9", "#FFFFFF", "#9A9A9A"


def _svg(figure: Figure) -> str:
    """The figure as an <svg> element; the same figure gives the same text."""
    out = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "graphrqi", "svg.fonttype": "none"}):
        figure.savefig(out, format="svg", bbox_inches="tight", metadata={"Date": None})
    text = out.getvalue()
    return text[text.index("<svg") :]


def confusion_figure(matrix: Sequence[Sequence[int]], title: str) -> str:
    """Rows are true behaviours, columns answers; each row adds to 100 %."""
    counts = np.asarray(matrix, dtype=np.float64)
    total = counts.sum(axis=1, keepdims=True)
    share = counts / np.where(total > 0, total, 1.0)
    figure = Figure(figsize=(4.6, 4.2))
    axes = figure.add_subplot()
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0)
    names = [b.value for b in BEHAVIORS]
    axes.set_xticks(range(len(names)), names, rotation=40, ha="right")
    axes.set_yticks(range(len(names)), names)
    axes.set_xlabel("answered")
    axes.set_ylabel("true")
    axes.set_title(title, fontsize=10)
    for i, row in enumerate(share):
        for j, value in enumerate(row):
            color = "white" if value > 0.55 else "black"
            axes.text(j, i, f"{100 * value:.0f}", ha="center", va="center", color=color, fontsize=9)
    return _svg(figure)


def boxes(frame: Frame, grow: float = 1.0) -> FloatArray:
    """(n, 4, 2) corners of every agent's box, m."""
    forward = np.stack([np.cos(frame.heading), np.sin(frame.heading)], axis=1)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    half_l = 0.5 * grow * frame.length[:, None]
    half_w = 0.5 * grow * frame.width[:, None]
    corners = [(1, 1), (1, -1), (-1, -1), (-1, 1)]
    return np.stack(
        [frame.xy + a * half_l * forward + b * half_w * left for a, b in corners], axis=1
    )


def _strip(centerline: FloatArray, width_m: float) -> FloatArray:
    """Outline of a lane: its centre line moved to both sides."""
    step = np.gradient(centerline, axis=0)
    unit = step / np.maximum(np.hypot(step[:, 0], step[:, 1]), 1e-9)[:, None]
    normal = np.stack([-unit[:, 1], unit[:, 0]], axis=1) * width_m / 2
    return np.concatenate([centerline + normal, (centerline - normal)[::-1]])


def draw_road(axes: Axes, road: Road) -> None:
    """Lanes, lane edges and crossings."""
    lanes = [lane for lane in road.lanes if not lane.walking]
    axes.add_collection(
        PatchCollection(
            [Polygon(_strip(lane.centerline, lane.width_m)) for lane in lanes],
            facecolor=_ROAD, edgecolor="none", zorder=0,
        )
    )  # fmt: skip
    edges = [
        _strip(lane.centerline, lane.width_m)[: len(lane.centerline)]
        for lane in lanes
        if not lane.internal
    ]
    axes.add_collection(
        LineCollection(edges, colors=_MARK, linewidths=0.5, linestyles=(0, (6, 5)), zorder=1)
    )
    for crossing in road.crossings:
        outline = _strip(crossing.centerline, crossing.width_m)
        axes.add_patch(
            Polygon(outline, facecolor=_CROSSING, edgecolor=_MARK, hatch="|||", lw=0.3, zorder=1)
        )


def map_figure(
    road: Road,
    frame: Frame,
    truth: CodeArray,
    posterior: Posterior,
    prediction: Prediction,
    happened: FloatArray,
) -> str:
    """Everyone at one instant: true and predicted behaviour, predicted and real path.

    Args:
        road: where.
        frame: the instant.
        truth: (n,) true behaviour codes, -1 for none.
        posterior: beliefs at that instant.
        prediction: the next seconds, as predicted.
        happened: (n, H, 2) the next seconds as they were; NaN where gone.

    Returns:
        SVG: filling is the predicted, outline the true behaviour; a solid line the predicted path
        of the likeliest future, a dotted one what happened.
    """
    believed = np.full(len(frame), -1)
    known = np.isin(frame.ids, posterior.ids)
    believed[known] = posterior.of(frame.ids[known]).argmax(axis=1)
    colors = [*(COLORS[b] for b in BEHAVIORS), UNKNOWN_COLOR]
    figure = Figure(figsize=(11.0, 6.2 if _is_wide(road) else 9.0))
    rows = _windows(road, frame)
    for number, (low, high) in enumerate(rows):
        axes = figure.add_subplot(len(rows), 1, number + 1)
        draw_road(axes, road)
        paths = prediction.xy[np.arange(len(frame)), prediction.probability.argmax(axis=1)]
        ahead = np.concatenate([frame.xy[:, None], paths], axis=1)
        axes.add_collection(
            LineCollection(list(ahead), colors=[colors[c] for c in believed], lw=1.4, zorder=3)
        )
        axes.add_collection(
            LineCollection(
                list(np.concatenate([frame.xy[:, None], happened], axis=1)),
                colors="black", lw=0.9, linestyles=":", zorder=4,
            )
        )  # fmt: skip
        axes.add_collection(
            PatchCollection(
                [Polygon(corners) for corners in boxes(frame)],
                facecolor=[colors[c] for c in believed],
                edgecolor=[colors[c] for c in truth],
                linewidths=1.6, zorder=5,
            )
        )  # fmt: skip
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_aspect("equal")
        axes.set_ylabel("y, m")
    axes.set_xlabel("x, m")
    legend: list[Patch | Line2D] = [Patch(color=COLORS[b], label=b.value) for b in BEHAVIORS]
    legend += [
        Patch(facecolor=UNKNOWN_COLOR, label="pedestrian or not yet known"),
        Line2D([], [], color="black", lw=1.4, label="predicted path"),
        Line2D([], [], color="black", lw=0.9, ls=":", label="what happened"),
    ]
    figure.legend(handles=legend, loc="upper center", ncols=5, fontsize=8, frameon=False,
                  bbox_to_anchor=(0.5, 1.02 if len(rows) > 1 else 0.97))  # fmt: skip
    return _svg(figure)


def _is_wide(road: Road) -> bool:
    x0, y0, x1, y1 = road.bounds
    return (x1 - x0) > 4 * (y1 - y0)


def _windows(road: Road, frame: Frame) -> list[tuple[FloatArray, FloatArray]]:
    """Parts of the road to show: a long straight one is cut into rows, a junction is zoomed."""
    x0, y0, x1, y1 = road.bounds
    if _is_wide(road):
        edges = np.linspace(x0, x1, 5)
        middle = 0.5 * (y0 + y1)
        half = max(0.5 * (y1 - y0) + 4.0, 10.0)
        return [
            (np.array([a, middle - half]), np.array([b, middle + half])) for a, b in pairwise(edges)
        ]
    center = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1)])
    half_size = np.array([95.0, 75.0])
    return [(center - half_size, center + half_size)]


def gradient_figure(frame: Frame, truth: CodeArray, graph: TrafficGraph, w: FloatArray) -> str:
    """The paper's interpretability figure: |w|, w = L u, on the traffic graph.

    Args:
        frame: the instant.
        truth: (n,) true behaviour codes, -1 for none.
        graph: the traffic graph at that instant; may hold vehicles that have left.
        w: (d,) the graph's Laplacian times its leading eigenvector.

    Returns:
        SVG: the darker a vehicle, the larger its share; edges are the graph's.
    """
    value = np.abs(w)[graph.rows_of(frame.ids)]
    place = dict(zip(frame.ids.tolist(), frame.xy, strict=True))
    edges = [[place[a], place[b]] for a, b in graph.edges.tolist() if a in place and b in place]
    figure = Figure(figsize=(11.0, 3.6))
    axes = figure.add_subplot()
    axes.add_collection(LineCollection(edges, colors="#777777", lw=0.5, alpha=0.5, zorder=1))
    colors = [*(COLORS[b] for b in BEHAVIORS), UNKNOWN_COLOR]
    dots = axes.scatter(
        frame.xy[:, 0], frame.xy[:, 1], c=value, cmap="viridis_r",
        norm=Normalize(0.0, max(float(value.max()), 1e-9)),
        s=70, edgecolors=[colors[c] for c in truth], linewidths=1.8, zorder=2,
    )  # fmt: skip
    figure.colorbar(dots, ax=axes, label="|w|")
    axes.margins(0.04)
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    return _svg(figure)
