"""Draws the factual paths under the counterfactual ones: one row of panels for each change."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from behaviors.labels import COLORS, OWN_COLOR
from experiments.figure_files import check_figure_file, write_figure
from experiments.replay.pictures import INK, LONG, MUTED, draw_road
from experiments.what_if.branches import branch_of, change_of
from experiments.what_if.outcomes import INCIDENTS, branches_of, factual_of, new_incidents
from sim.frames import FloatArray, Tracks
from sim.road import Road
from sim.store.dataset import Dataset
from sim.store.schema import EpisodeEntry

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AFFECTED_M: Final = 1.0
"""Agents that are ever this far from where they factually were are affected, m."""

DRAWN_OTHERS: Final = 8
"""Most others that are drawn: those that differ most."""

FACTUAL: Final = "#7A8390"
"""Colour of what happened."""

ACTION: Final = "#7A2E8E"
"""Colour of an action."""


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
    plan: Axes, course: Axes, entry: EpisodeEntry, factual: Tracks, other: Tracks,
    road: Road | None,
) -> None:  # fmt: skip
    """Draw one change: on the left the paths on the road, on the right distances over time."""
    branch = branch_of(entry) or {}
    since_s, agent, change = float(branch["at_s"]), int(branch["agent"]), change_of(entry)
    color = COLORS.get(change, OWN_COLOR) if "behavior" in branch else ACTION
    apart = _separations(factual, other)
    affected = sorted((i for i, d in apart.items() if d > AFFECTED_M), key=lambda i: -apart[i])
    others = [i for i in affected if i != agent]
    if road is not None:
        draw_road(plan, road, 0.7)
    for name in (agent, *others[:DRAWN_OTHERS]):
        own = name == agent
        start = _path(factual, name, since_s)[1][:1]
        for tracks, paint, dashes in ((factual, FACTUAL, "--"), (other, color, "-")):
            time_s, xy = _path(tracks, name, since_s)
            if not len(xy):
                continue
            wide = 3.4 if tracks is factual else 1.8
            plan.plot(*xy.T, color=paint, linewidth=wide if own else wide / 2, zorder=3 + own)
            plan.plot(*xy[-1], "o", color=paint, markersize=6 if own else 3, zorder=6)
            style: dict[str, Any] = {"color": paint, "linestyle": dashes}
            if own:
                done = "factual" if tracks is factual else "changed"
                style["label"] = f"driver {agent}, {done}"
            moved = np.hypot(*np.diff(xy, axis=0, prepend=start if len(start) else xy[:1]).T)
            course.plot(time_s, np.cumsum(moved), linewidth=2.4 if own else 0.9, **style)
    known = [event for event in factual.events if event.time_s > since_s]
    for tracks, events, paint in (
        (other, new_incidents(other.events, known), INK),
        (factual, new_incidents(known, other.events), FACTUAL),
    ):
        for event in events:
            _, xy = _path(tracks, event.agent, event.time_s)
            marker = "X" if event.kind is INCIDENTS[0] else "^"
            plan.plot(*xy[:1].T, marker, color=paint, markersize=9, zorder=8)
            course.axvline(event.time_s, color=paint, linewidth=0.8, linestyle=":")
    plan.set(xlabel="x, m", ylabel="y, m")
    title = f"driver {agent} from {since_s:g} s on: {change}; {len(others)} others affected"
    plan.set_title(title, loc="left", fontsize=11, color=INK)
    _zoom(plan)
    course.set(xlabel="time, s", ylabel="way gone since the instant, m")
    course.legend(frameon=False, fontsize=9)
    course.set_title("thin: the others who differ most", loc="right", fontsize=9, color=MUTED)


def _zoom(plan: Axes) -> None:
    """Show the paths, not the whole road."""
    xy = np.concatenate([line.get_xydata() for line in plan.lines])
    low, high = xy.min(axis=0) - 6.0, xy.max(axis=0) + 6.0
    plan.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    sides = np.sort(high - low)
    plan.set_aspect("auto" if sides[1] > LONG * sides[0] else "equal")


def _separations(factual: Tracks, other: Tracks) -> dict[int, float]:
    """By agent id, the farthest that each agent is from where it factually was, m."""
    columns = np.searchsorted(factual.time_s, other.time_s - 1e-6)
    both, mine, theirs = np.intersect1d(other.ids, factual.ids, return_indices=True)
    apart = other.xy[mine] - factual.xy[theirs][:, columns]
    farthest = np.nan_to_num(np.hypot(apart[..., 0], apart[..., 1])).max(axis=1, initial=0.0)
    return dict(zip(both.tolist(), farthest.tolist(), strict=True))


def _path(tracks: Tracks, agent: int, since_s: float) -> tuple[FloatArray, FloatArray]:
    """(k,) times and (k, 2) places of an agent from an instant on."""
    row = np.flatnonzero(tracks.ids == agent)
    if not row.size:
        return np.empty(0), np.empty((0, 2))
    columns = np.flatnonzero(tracks.valid[row[0]] & (tracks.time_s > since_s - 1e-6))
    return tracks.time_s[columns], tracks.xy[row[0], columns]
