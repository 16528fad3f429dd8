"""Draws the factual paths under the counterfactual ones: one row of panels for each change."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.colors import COLORS
from behaviors.labels import OWN_COLOR
from experiments.figure_files import check_figure_file, write_figure
from experiments.replay.pictures import ASPHALT, INK, MUTED, PAINT, PAVING
from experiments.what_if.branches import branch_of, change_of
from experiments.what_if.outcomes import INCIDENTS, branches_of, factual_of, new_incidents
from sim.frames import Event, FloatArray, Tracks
from sim.road import Road
from sim.road.shapes import road_shapes
from sim.store.dataset import Dataset
from sim.store.schema import EpisodeEntry

AFFECTED_M: Final = 1.0
"""Agents that are ever this far from where they factually were are drawn, m."""

DRAWN_OTHERS: Final = 8
"""Most others that are drawn: those that differ most."""

FACTUAL: Final = "#7A8390"
"""Colour of what happened."""

ACTION: Final = "#7A2E8E"
"""Colour of an action."""

LONG: Final = 4.0
"""From this ratio of its sides on, a road is drawn wider than it is."""


def separations(factual: Tracks, other: Tracks) -> dict[int, FloatArray]:
    """How far each agent is from where it factually was.

    Args:
        factual: what happened.
        other: a continuation whose times are among the factual ones.

    Returns:
        By agent id, (T,) m at each time of ``other``; NaN where the agent is not in both.
    """
    columns = np.searchsorted(factual.time_s, other.time_s - 1e-6)
    found = {}
    for row, agent in enumerate(other.ids.tolist()):
        there = int(np.searchsorted(factual.ids, agent))
        if there < factual.ids.size and factual.ids[there] == agent:
            apart = other.xy[row] - factual.xy[there][columns]
            found[int(agent)] = np.hypot(apart[:, 0], apart[:, 1])
    return found


def write_paths(dataset: Dataset, path: Path) -> None:
    """Draw every counterfactual episode of a dataset over the factual one, as PNG, PDF or SVG.

    Args:
        dataset: as ``what-if`` writes it.
        path: the file; it appears whole or not at all.

    Raises:
        InputError: if the name says no format of figures, or the dataset is not one that
            ``what-if`` wrote.
        OSError: if the file cannot be written.
    """
    check_figure_file(path, "--picture")
    from matplotlib.figure import Figure

    happened = factual_of(dataset)
    branched = branches_of(dataset)
    factual, road = dataset.read(happened).tracks, dataset.road(happened)
    figure = Figure(figsize=(13.0, 3.4 * len(branched)), layout="constrained")
    axes = figure.subplots(len(branched), 2, squeeze=False, width_ratios=(1.25, 1.0))
    for (plan, course), entry in zip(axes, branched, strict=True):
        _draw(plan, course, entry, factual, dataset.read(entry).tracks, road)
    write_figure(figure, path)


def _draw(
    plan: Any, course: Any, entry: EpisodeEntry, factual: Tracks, other: Tracks, road: Road | None
) -> None:
    """Draw one change: on the left the paths on the road, on the right distances over time."""
    branch = branch_of(entry) or {}
    since_s, agent, change = float(branch["at_s"]), int(branch["agent"]), change_of(entry)
    color = COLORS.get(change, OWN_COLOR) if "behavior" in branch else ACTION
    apart = {i: float(np.nanmax(d)) for i, d in separations(factual, other).items() if _known(d)}
    affected = sorted((i for i, d in apart.items() if d > AFFECTED_M), key=lambda i: -apart[i])
    others = [i for i in affected if i != agent]
    drawn = [agent, *others[:DRAWN_OTHERS]]
    _draw_plan(plan, road, factual, other, drawn, color, since_s)
    _draw_course(course, factual, other, drawn, color, since_s)
    known = [e for e in factual.events if e.time_s > since_s]
    for event in new_incidents(other.events, known):
        _mark(plan, course, event, other, INK, drawn)
    for event in new_incidents(known, other.events):
        _mark(plan, course, event, factual, FACTUAL, drawn)
    plan.set_title(
        f"driver {agent} from {since_s:g} s on: {change}; {len(others)} others affected",
        loc="left", fontsize=11, color=INK,
    )  # fmt: skip


def _known(distances: FloatArray) -> bool:
    return bool(np.isfinite(distances).any())


def _path(tracks: Tracks, agent: int, since_s: float) -> tuple[FloatArray, FloatArray]:
    """(k,) times and (k, 2) places of an agent from an instant on."""
    row = int(np.searchsorted(tracks.ids, agent))
    if row >= tracks.ids.size or tracks.ids[row] != agent:
        return np.empty(0), np.empty((0, 2))
    columns = np.flatnonzero(tracks.valid[row] & (tracks.time_s > since_s - 1e-6))
    return tracks.time_s[columns], tracks.xy[row, columns]


def _draw_plan(
    plan: Any, road: Road | None, factual: Tracks, other: Tracks, drawn: list[int], color: str,
    since_s: float,
) -> None:  # fmt: skip
    if road is not None:
        shapes = road_shapes(road)
        for fill, polygons in ((PAVING, shapes.paving), (ASPHALT, shapes.asphalt)):
            for polygon in polygons:
                plan.fill(polygon[:, 0], polygon[:, 1], color=fill, linewidth=0)
        for line in (*shapes.edges, *shapes.dashes):
            plan.plot(line[:, 0], line[:, 1], color=PAINT, linewidth=0.7)
    places = []
    for order, agent in enumerate(drawn):
        own = order == 0
        _, before = _path(factual, agent, since_s)
        _, after = _path(other, agent, since_s)
        places += [before, after]
        style = {"linewidth": 3.4 if own else 2.0, "solid_capstyle": "round"}
        plan.plot(before[:, 0], before[:, 1], color=FACTUAL, alpha=0.55, zorder=3, **style)
        style = {"linewidth": 1.8 if own else 0.9}
        plan.plot(after[:, 0], after[:, 1], color=color, zorder=4 + own, **style)
        for way, paint in ((before, FACTUAL), (after, color)):
            if len(way):
                plan.plot(*way[-1], "o", color=paint, markersize=6 if own else 3, zorder=6)
    xy = np.concatenate(places)
    (x0, y0), (x1, y1) = xy.min(axis=0) - 6.0, xy.max(axis=0) + 6.0
    plan.set_xlim(x0, x1)
    plan.set_ylim(y0, y1)
    long = max(x1 - x0, y1 - y0) > LONG * min(x1 - x0, y1 - y0)
    plan.set_aspect("auto" if long else "equal")
    plan.set_xlabel("x, m")
    plan.set_ylabel("y, m")


def _draw_course(
    course: Any, factual: Tracks, other: Tracks, drawn: list[int], color: str, since_s: float
) -> None:
    for order, agent in enumerate(drawn):
        own = order == 0
        start = _path(factual, agent, since_s)[1][:1]
        for tracks, paint, named in ((factual, FACTUAL, "factual"), (other, color, "changed")):
            time_s, xy = _path(tracks, agent, since_s)
            course.plot(
                time_s, _way(xy, start), color=paint, linewidth=2.4 if own else 0.9,
                linestyle="--" if named == "factual" else "-", alpha=1.0 if own else 0.7,
                label=f"driver {drawn[0]}, {named}" if own else None,
            )  # fmt: skip
    course.set_xlabel("time, s")
    course.set_ylabel("way gone since the instant, m")
    course.legend(frameon=False, fontsize=9)
    course.grid(color="#E3E6EA", linewidth=0.6)
    course.set_title(f"thin: the {len(drawn) - 1} others who differ most", loc="right",
                     fontsize=9, color=MUTED)  # fmt: skip


def _way(xy: FloatArray, start: FloatArray) -> FloatArray:
    """(k,) distance along the path from its start, m."""
    moved = np.diff(xy, axis=0, prepend=start if len(start) else xy[:1])
    return np.cumsum(np.hypot(moved[:, 0], moved[:, 1]))


def _mark(
    plan: Any, course: Any, event: Event, tracks: Tracks, color: str, drawn: list[int]
) -> None:
    """A cross for a collision, a triangle for a near miss, where the first party was."""
    marker = "X" if event.kind is INCIDENTS[0] else "^"
    time_s, xy = _path(tracks, event.agent, event.time_s)
    if not len(xy):
        return
    plan.plot(*xy[0], marker, color=color, markersize=9, markeredgecolor="white", zorder=8)
    if event.agent in drawn:
        course.axvline(float(time_s[0]), color=color, linewidth=0.8, linestyle=":")
