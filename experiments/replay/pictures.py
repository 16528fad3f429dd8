"""Pictures and films of replays, and of counterfactual paths, drawn without a browser."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, COLORS, OWN_COLOR, UNKNOWN_COLOR
from experiments.console.progress import Progress
from experiments.figure_files import check_figure_file, write_figure
from experiments.replay.page import ramp_color
from experiments.replay.scene import ReplayScene
from experiments.what_if.branches import branch_of, change_of
from experiments.what_if.outcomes import INCIDENTS, branches_of, factual_of, new_incidents, path_of
from sim.files import write_whole
from sim.frames import PEDESTRIAN, SIGNALS, EventKind, FloatArray, IntArray, Signal, Tracks
from sim.road import Road
from sim.road.shapes import road_shapes
from sim.store.dataset import Dataset
from sim.store.schema import EpisodeEntry

INK, MUTED = "#18202B", "#55606E"
GROUND, PAVING, ASPHALT, PAINT, MIDDLE = "#ECEEEA", "#DCDCD6", "#C6CBD2", "#FFFFFF", "#8A6D1D"
TRACK, EDGE, GRAVE = "#C3C9D0", "#38506E", "#B3261E"
LAMPS: Final = {
    Signal.RED: ("#D3312B", "s"),
    Signal.YELLOW: ("#F2C230", "^"),
    Signal.GREEN: ("#25A55F", "o"),
    Signal.OFF: ("#9AA3AD", ""),
}
"""Colour and shape of a signal's lamp, as on the replay page."""

BODY: Final = np.array([(1, 0.6), (0.7, 1), (-1, 1), (-1, -1), (0.7, -1), (1, -0.6)])
"""Outline of a vehicle, in halves of its length and of its width."""

LONG: Final = 4.0
"""A scene that is this many times as long as high is folded into rows."""

MOST_ROWS: Final = 10

HEAD_PX, FOOT_PX, GAP_PX = 44, 46, 8
"""Height of the title, height of the legend, distance between rows, pixels."""

DPI: Final = 100

LEAST_PX: Final = (6.0, 4.0)
"""Least length and width of a drawn agent, pixels."""

EVENT_S: Final = 1.5
"""How long a collision stays marked, s."""

FILMS: Final = {".mp4": (1280, 720), ".gif": (960, 540)}
"""Size in pixels of a film, by the file's ending."""

FILM_HZ: Final = 10
"""Frames per second of a film, which plays in real time."""

MOST_FRAMES: Final = 10_000

AFFECTED_M: Final = 1.0
"""Agents that are ever this far from where they factually were are affected, m."""

DRAWN_OTHERS: Final = 8
"""Most others that are drawn: those that differ most."""

FACTUAL: Final = "#7A8390"
"""Colour of what happened."""

ACTION: Final = "#7A2E8E"
"""Colour of an action."""


def draw_road(axes: Axes, road: Road, width: float) -> None:
    """Draw what never moves of a road, with lines of a width in points."""
    shapes = road_shapes(road)
    for color, polygons in ((PAVING, shapes.paving), (ASPHALT, shapes.asphalt),
                            (PAINT, shapes.bars)):  # fmt: skip
        axes.add_collection(PolyCollection(polygons, facecolors=color, linewidths=0, zorder=1))
    for color, lines in ((PAINT, [*shapes.edges, *shapes.dashes]), (MIDDLE, shapes.middles)):
        axes.add_collection(LineCollection(lines, colors=color, linewidths=width, zorder=1))


def rows_of(extent: tuple[float, float, float, float], width: int, height: int) -> int:
    """How many rows show an extent (x0, y0, x1, y1, m) as large as possible in so many pixels."""
    long, high = extent[2] - extent[0], extent[3] - extent[1]
    if long <= LONG * high:
        return 1
    rows = np.arange(1, MOST_ROWS + 1)
    scales = np.minimum(width * rows / long, (height - GAP_PX * (rows - 1)) / rows / high)
    return int(rows[scales.argmax()])


def shown_extent(scene: ReplayScene) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1 of what a picture shows: the road; of a junction, where its traffic is."""
    places = scene.tracks.row_xy
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
    x0, y0, x1, y1 = (float(v) for v in (*(low - margin), *(high + margin)))
    return x0, y0, x1, y1


class Drawing:
    """A scene as a figure of some pixels, which can be drawn at any time.

    Agents are coloured by a mode: true, predicted, confidence, speed or w.
    """

    def __init__(self, scene: ReplayScene, mode: str, size: tuple[int, int] = (1280, 720)) -> None:
        self.scene, self.mode = scene, mode
        width, height = size
        self.figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
        self.fastest = max(1.0, float(np.quantile(scene.tracks.row_speed, 0.995)))
        self._stops = () if scene.road is None else road_shapes(scene.road).stops
        self._moving: list[Artist] = []
        tall = height - HEAD_PX - FOOT_PX
        x0, y0, x1, y1 = extent = shown_extent(scene)
        many = rows_of(extent, width, tall)
        each = (tall - GAP_PX * (many - 1)) / many
        self.scale = min(width * many / (x1 - x0), each / (y1 - y0))
        self._thin = max(0.5, 0.14 * self.scale * 72 / DPI)
        half = width / self.scale / 2, each / self.scale / 2
        self._axes: list[Axes] = []
        for row in range(many):
            bottom = FOOT_PX + (many - 1 - row) * (each + GAP_PX)
            axes = self.figure.add_axes((0.0, bottom / height, 1.0, each / height))
            x, y = x0 + (row + 0.5) * (x1 - x0) / many, (y0 + y1) / 2
            axes.set(xlim=(x - half[0], x + half[0]), ylim=(y - half[1], y + half[1]))
            axes.set(xticks=[], yticks=[], facecolor=GROUND)
            axes.spines[:].set_visible(False)
            self._axes.append(axes)
        self._draw_ground()
        self._draw_words()
        self._clock = self.figure.text(0.985, 1 - HEAD_PX / 2 / height, "", ha="right", va="center")

    def draw(self, time_s: float) -> Figure:
        """The figure of the scene as it is at a time, s; the next call draws on the same one."""
        for artist in self._moving:
            artist.remove()
        self._clock.set_text(f"{time_s:.1f} s")
        at = self.scene.tracks.index.at(self._step(time_s))
        rows, xy = self.scene.tracks.index.agent[at], self.scene.tracks.row_xy[at]
        colors = self._colors(rows, self.scene.tracks.row_speed[at], time_s)
        lines, inks, width = self._overlay(rows, xy, colors, time_s)
        bodies = [
            self._body(*one)
            for one in zip(rows, xy, self.scene.tracks.row_heading[at], strict=True)
        ]
        body: dict[str, Any] = {"edgecolors": INK, "linewidths": 0.7, "zorder": 5}
        self._moving = [
            *self._draw_stops(time_s),
            *self._lines(lines, inks, width, 3),
            *self._lines(self._ghosts(time_s), MUTED, 0.8, 4, linestyles="--"),
            *self._add(PolyCollection(bodies, facecolors=colors, **body) for _ in self._axes),
            *self._collisions(time_s),
        ]
        return self.figure

    def _add(self, collections: Any) -> list[Artist]:
        """Add a collection to every row."""
        pairs = zip(self._axes, collections, strict=False)
        return [axes.add_collection(one) for axes, one in pairs]

    def _lines(
        self, lines: Any, colors: Any, width: float, zorder: int, **style: Any
    ) -> list[Artist]:
        """Add lines to every row."""
        style = {"colors": colors, "linewidths": width, "zorder": zorder, **style}
        rows = self._axes if len(lines) else ()
        return self._add(LineCollection(lines, **style) for _ in rows)

    def _draw_ground(self) -> None:
        """Draw what does not move."""
        if self.scene.road is None:
            paths = [
                self.scene.tracks.row_xy[self.scene.tracks.index.rows(row)]
                for row in range(self.scene.tracks.ids.size)
            ]
            self._lines([p for p in paths if len(p) > 1], TRACK, 1.0, 1)
            return
        for axes in self._axes:
            draw_road(axes, self.scene.road, self._thin)

    def _draw_words(self) -> None:
        """Write title and legend, and draw a bar of a round length as a scale."""
        scene, height = self.scene, self.figure.get_figheight() * DPI
        said = {
            "true": "coloured by true behaviour",
            "predicted": f"coloured by the behaviour that {scene.believer} believes in",
            "confidence": f"coloured by how sure {scene.believer} is",
            "speed": f"coloured by speed, 0 to {self.fastest:.0f} {scene.unit}/s",
            "w": "coloured by prominence in the graph, relative to the largest (square root)",
        }[self.mode]
        middle = 1 - HEAD_PX / 2 / height
        self.figure.text(
            0.012, middle, f"{scene.entry.name}: {said}", va="center", color=INK, parse_math=False
        )
        if self.mode in ("true", "predicted"):
            known = [(COLORS[b], b.value) for b in BEHAVIORS]
        else:
            low, high = {
                "confidence": ("17 %, a guess", "100 %"),
                "speed": ("0", f"{self.fastest:.0f} {scene.unit}/s and more"),
                "w": ("0", "the largest"),
            }[self.mode]
            known = [(ramp_color(0.0), low), (ramp_color(0.5), "half"), (ramp_color(1.0), high)]
        known.append((UNKNOWN_COLOR, "not known"))
        handles = [Patch(facecolor=color, edgecolor=INK, label=word) for color, word in known]
        self.figure.legend(
            handles=handles, loc="lower left", ncols=len(handles), frameon=False, fontsize=9
        )
        axes, scale = self._axes[-1], self.scale
        power = 10.0 ** np.floor(np.log10(110.0 / scale))
        length = max(n * power for n in (1, 2, 5) if n * power <= 110.0 / scale)
        x, y = axes.get_xlim()[0] + 16 / scale, axes.get_ylim()[0] + 10 / scale
        axes.plot([x, x + length], [y, y], color=INK, linewidth=1.5, zorder=9)
        axes.text(
            x + length / 2, y + 3 / scale, f"{length:g} {scene.unit}", ha="center", fontsize=8
        )

    def _step(self, time_s: float) -> int:
        return max(int(np.searchsorted(self.scene.tracks.time_s, time_s + 1e-6)) - 1, 0)

    def _colors(self, rows: IntArray, speed: FloatArray, time_s: float) -> list[str]:
        scene = self.scene
        if self.mode == "speed":
            return [ramp_color(v / self.fastest) for v in speed]
        if self.mode == "w":
            sample = int(np.searchsorted(scene.graph.time_s, time_s + 1e-6)) - 1
            w = scene.graph.w[:, max(sample, 0)]
            share = np.sqrt(w / float(np.nan_to_num(w).max(initial=1e-12)))
            return [UNKNOWN_COLOR if np.isnan(v) else ramp_color(float(v)) for v in share[rows]]
        if self.mode == "true":
            behavior = scene.tracks.behavior
            codes = np.full(rows.size, -1) if behavior is None else behavior[rows]
            return [UNKNOWN_COLOR if c < 0 else scene.tracks.classes[c].color for c in codes]
        posterior = scene.beliefs.at(time_s)
        if self.mode == "confidence":
            chance = posterior.probability.max(axis=1)
            colors = [ramp_color(1.2 * c - 0.2) for c in chance.tolist()]
        else:
            colors = [UNKNOWN_COLOR if b is None else b.color for b in posterior.behaviors]
        known = dict(zip(posterior.ids.tolist(), colors, strict=True))
        return [known.get(i, UNKNOWN_COLOR) for i in scene.beliefs.ids[rows].tolist()]

    def _overlay(
        self, rows: IntArray, xy: FloatArray, colors: list[str], time_s: float
    ) -> tuple[list[FloatArray], list[str] | str, float]:
        """Lines over the road: the graph's edges, or the rest of each likeliest future."""
        place = dict(zip(rows.tolist(), xy, strict=True))
        if self.mode == "w":
            graph = self.scene.graph
            sample = int(np.searchsorted(graph.time_s, time_s + 1e-6)) - 1
            live = graph.edges[(graph.edges[:, 2] <= sample) & (graph.edges[:, 3] > sample)]
            pairs = [(a, b) for a, b in live[:, :2].tolist() if a in place and b in place]
            return [np.stack([place[a], place[b]]) for a, b in pairs], EDGE, 0.6
        made = [f for f in self.scene.forecasts if time_s - 2.0 < f.time_s <= time_s + 1e-6]
        if self.mode != "predicted" or not made:
            return [], [], 1.0
        forecast, color = made[-1], dict(zip(rows.tolist(), colors, strict=True))
        rest = forecast.ahead_s > time_s - forecast.time_s
        pairs = [(m, int(forecast.agent[m])) for m in forecast.likeliest]
        shown = [(m, agent) for m, agent in pairs if agent in place]
        ways = [np.concatenate([place[agent][None], forecast.xy[m, rest]]) for m, agent in shown]
        return ways, [color[agent] for _, agent in shown], 1.4

    def _body(self, row: int, xy: FloatArray, heading: float) -> FloatArray:
        """The outline of an agent, at least a few pixels large."""
        tracks = self.scene.tracks
        length = max(float(tracks.length[row]), LEAST_PX[0] / self.scale)
        width = max(float(tracks.width[row]), LEAST_PX[1] / self.scale)
        if tracks.kind[row] == PEDESTRIAN:
            turns = np.linspace(0.0, 2.0 * np.pi, 13)
            return xy + 0.5 * width * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        return _outline(xy, heading, length, width)

    def _draw_stops(self, time_s: float) -> list[Artist]:
        """Draw stop lines in the colour of their signals, with a lamp of a shape of its own."""
        signals, step = self.scene.tracks.signals, self._step(time_s)
        drawn: list[Artist] = []
        for stop in self._stops:
            color, marker = PAINT, ""
            if 0 <= stop.signal < len(signals):
                color, marker = LAMPS[SIGNALS[signals[stop.signal, step]]]
            drawn += self._lines([stop.line], color, max(1.5, 4 * self._thin), 2)
            style: dict[str, Any] = {"color": color, "markeredgecolor": INK, "zorder": 4}
            for axes in self._axes if marker else ():
                drawn += axes.plot(*stop.line.mean(axis=0), marker, markersize=6, **style)
        return drawn

    def _ghosts(self, time_s: float) -> list[FloatArray]:
        """Outlines of where agents were in the factual episode."""
        ghosts = self.scene.ghosts
        if ghosts is None:
            return []
        found, at = [], ghosts.index.at(self._step(time_s))
        for row, xy, heading in zip(
            ghosts.index.agent[at], ghosts.row_xy[at], ghosts.row_heading[at], strict=True
        ):
            outline = _outline(xy, heading, float(ghosts.length[row]), float(ghosts.width[row]))
            found.append(np.concatenate([outline, outline[:1]]))
        return found

    def _collisions(self, time_s: float) -> list[Artist]:
        """Draw a ring around the place of each collision of the last moments."""
        tracks = self.scene.tracks
        drawn: list[Artist] = []
        style: dict[str, Any] = {"color": GRAVE, "fillstyle": "none", "markeredgewidth": 2}
        for event in tracks.events:
            since, row = time_s - event.time_s, np.flatnonzero(tracks.ids == event.agent)
            if event.kind is EventKind.COLLISION and 0.0 <= since <= EVENT_S and row.size:
                place = tracks.positions(row[0], np.array(self._step(event.time_s)))
                for axes in self._axes:
                    drawn += axes.plot(*place, "o", markersize=18 + 10 * since, zorder=6, **style)
        return drawn


def _outline(xy: FloatArray, heading: float, length: float, width: float) -> FloatArray:
    forward = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-forward[1], forward[0]])
    return np.asarray(xy + BODY @ np.stack([forward * length / 2, left * width / 2]))


def fullest_s(scene: ReplayScene) -> float:
    """The time with most agents, s."""
    return float(scene.tracks.time_s[scene.tracks.index.counts().argmax()])


def check_picture(path: Path) -> None:
    """Refuse a name of a picture or film that cannot be made, before anything is computed."""
    endings = (".png", ".pdf", ".svg", *FILMS)
    if path.suffix.lower() not in endings:
        raise InputError(
            f"--picture: found {path.name!r}, expected a name that ends in {', '.join(endings)}"
        )
    if path.suffix.lower() == ".mp4":
        try:
            import imageio_ffmpeg
        except ImportError:
            raise InputError(
                f"{path}: found no imageio-ffmpeg, expected it for MP4: "
                "pip install 'graphrqi[video]', or name a .gif"
            ) from None
        mpl.rcParams["animation.ffmpeg_path"] = imageio_ffmpeg.get_ffmpeg_exe()


def write_picture(
    scene: ReplayScene,
    path: Path,
    mode: str,
    begin_s: float | None = None,
    end_s: float | None = None,
    quiet: bool = True,
) -> None:
    """Draw a scene at one time, or film it, coloured as in `Drawing`.

    The file's ending says the format; it appears complete or not at all. A picture is of the time
    at which it begins, s, or by default of that with most agents. A film lasts by default from the
    episode's beginning to its end.
    """
    check_picture(path)
    ending = path.suffix.lower()
    if ending not in FILMS:
        moment = fullest_s(scene) if begin_s is None else begin_s
        write_figure(Drawing(scene, mode).draw(moment), path, DPI)
        return
    times = scene.tracks.time_s
    begin = float(times[0]) if begin_s is None else max(begin_s, float(times[0]))
    end = float(times[-1]) if end_s is None else min(end_s, float(times[-1]))
    count = int((end - begin) * FILM_HZ + 1e-6) + 1
    if end <= begin or count > MOST_FRAMES:
        raise InputError(
            f"{path}: found {begin:g} to {end:g} s, expected some time between {times[0]:g} and "
            f"{times[-1]:g} s, and at most {MOST_FRAMES // FILM_HZ} s of it"
        )
    drawing = Drawing(scene, mode, FILMS[ending])
    writer: Any = (FFMpegWriter if ending == ".mp4" else PillowWriter)(fps=FILM_HZ)
    with TemporaryDirectory() as scratch, Progress("drawing frames", count, quiet) as progress:
        film = Path(scratch) / f"film{ending}"
        with writer.saving(drawing.figure, str(film), DPI):
            for number in range(count):
                drawing.draw(begin + number / FILM_HZ)
                writer.grab_frame()
                progress.advance()
        write_whole(path, film.read_bytes())


def write_paths(dataset: Dataset, path: Path) -> None:
    """Draw every counterfactual episode of a dataset of ``what-if`` over the factual one.

    The file, .png, .pdf or .svg, appears whole or not at all.
    """
    check_figure_file(path, "--picture")
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
        start = path_of(factual, name, since_s - 1e-6)[:1, 1:]
        for tracks, paint, dashes in ((factual, FACTUAL, "--"), (other, color, "-")):
            path = path_of(tracks, name, since_s - 1e-6)
            time_s, xy = path[:, 0], path[:, 1:]
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
            xy = path_of(tracks, event.agent, event.time_s - 1e-6)[:, 1:]
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
