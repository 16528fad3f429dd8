"""Pictures and films of replays, and of counterfactual paths, drawn without a browser.

A still picture is PNG for screens, or PDF or SVG for papers, where it stays sharp at any size. The
same figure gives the same bytes: no date is written, and no name that is drawn by chance.
"""

from __future__ import annotations

import io
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib import colormaps
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, COLORS, OWN_COLOR, UNKNOWN_COLOR
from experiments.console.progress import Progress
from experiments.replay.scene import ReplayScene
from experiments.what_if.branches import branch_of, change_of
from experiments.what_if.outcomes import (
    INCIDENTS,
    branches_of,
    factual_of,
    new_incidents,
    paths_since,
)
from sim.files import write_whole
from sim.frames import PEDESTRIAN, SIGNALS, EventKind, FloatArray, IntArray, Signal, Tracks
from sim.road import Road
from sim.road.shapes import road_shapes
from sim.store.dataset import Dataset
from sim.store.schema import EpisodeEntry

STILL: Final[dict[str, dict[str, Any]]] = {
    ".png": {"Software": None}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}
}  # fmt: skip
"""By the ending of a picture: what matplotlib would write about when and with what it was made."""

STYLE: Final[dict[Any, Any]] = {"pdf.fonttype": 42, "svg.hashsalt": "graphrqi"}
"""TrueType letters, which publishers ask for, and names inside an SVG that do not change."""

FILMS: Final = {".mp4": (1280, 720), ".gif": (960, 540)}
"""Size in pixels of a film, by the file's ending."""

FILM_HZ: Final = 10
"""Frames per second of a film, which plays in real time."""

MOST_FRAMES: Final = 10_000

INK, MUTED = "#18202B", "#55606E"
GROUND, PAVING, ASPHALT, PAINT, MIDDLE = "#ECEEEA", "#DCDCD6", "#C6CBD2", "#FFFFFF", "#8A6D1D"
TRACK, EDGE, GRAVE, FACTUAL, ACTION = "#C3C9D0", "#38506E", "#B3261E", "#7A8390", "#7A2E8E"
LAMPS: Final = {
    Signal.RED: ("#D3312B", "s"),
    Signal.YELLOW: ("#F2C230", "^"),
    Signal.GREEN: ("#25A55F", "o"),
    Signal.OFF: ("#9AA3AD", ""),
}
"""Colour and shape of a signal's lamp, as on the replay page."""

RAMP_BEGIN: Final = 0.12
"""Where in viridis the ramp begins (darker colours could not be seen on a dark road)."""

BODY: Final = np.array([(1, 0.6), (0.7, 1), (-1, 1), (-1, -1), (0.7, -1), (1, -0.6)])
"""Outline of a vehicle, in halves of its length and of its width."""

ROUND: Final = np.array([(np.cos(turn), np.sin(turn)) for turn in np.linspace(0.0, 2 * np.pi, 13)])
"""Outline of a pedestrian, in halves of its width."""

LONG: Final = 4.0
"""A scene that is this many times as long as high is folded into rows."""

MOST_ROWS: Final = 10

DPI, HEAD_PX, FOOT_PX, GAP_PX = 100, 44, 46, 8
"""Pixels per inch, height of the title, height of the legend, distance between rows, pixels."""

LEAST_PX: Final = np.array([6.0, 4.0])
"""Least length and width of a drawn agent, pixels."""

EVENT_S, SHOWN_S = 1.5, 2.0
"""How long a collision stays marked, and a prediction without a later one shown, s."""

AFFECTED_M: Final = 1.0
"""Agents that are ever this far from where they factually were are affected, m."""

DRAWN_OTHERS: Final = 8
"""Most others that are drawn: those that differ most."""


def ramp_color(share: float) -> str:
    """The colour of a share, 0 to 1, as in HTML: viridis without its darkest end."""
    place = RAMP_BEGIN + (1.0 - RAMP_BEGIN) * min(max(share, 0.0), 1.0)
    return str(to_hex(colormaps["viridis"](place)))


def check_picture(path: Path, films: bool = False) -> None:
    """Refuse a picture, or a film where it may be one, that cannot be made."""
    endings = (*STILL, *FILMS) if films else tuple(STILL)
    if path.suffix.lower() not in endings:
        raise InputError(
            f"--picture: found {path.name!r}, expected a name that ends in {', '.join(endings)}"
        )
    if not path.parent.is_dir():
        raise InputError(f"{path}: found no folder {path.parent}, expected one")
    if path.suffix.lower() == ".mp4":
        try:
            import imageio_ffmpeg
        except ImportError:
            raise InputError(
                f"{path}: found no imageio-ffmpeg, expected it for MP4: "
                "pip install 'graphrqi[video]', or name a .gif"
            ) from None
        mpl.rcParams["animation.ffmpeg_path"] = imageio_ffmpeg.get_ffmpeg_exe()


def figure_bytes(figure: Figure, ending: str, dpi: int = 110) -> bytes:
    """Content of a figure's file with such an ending; ``dpi`` are pixels per inch of a PNG."""
    out = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure.savefig(out, format=ending[1:], dpi=dpi, metadata=STILL[ending])
    return out.getvalue()


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
    check_picture(path, films=True)
    ending = path.suffix.lower()
    if ending in STILL:
        moment = scene.fullest_s if begin_s is None else begin_s
        write_whole(path, figure_bytes(Drawing(scene, mode).draw(moment), ending, DPI))
        return
    times = scene.tracks.time_s
    begin = float(times[0]) if begin_s is None else max(begin_s, float(times[0]))
    end = float(times[-1]) if end_s is None else min(end_s, float(times[-1]))
    count = int((end - begin) * FILM_HZ + 1e-6) + 1
    if end <= begin or count > MOST_FRAMES:
        raise InputError(
            f"--begin-s and --end-s: found {begin:g} to {end:g} s, expected some time between "
            f"{times[0]:g} and {times[-1]:g} s, and at most {MOST_FRAMES // FILM_HZ} s of it"
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


def draw_road(axes: Axes, road: Road, width: float) -> None:
    """Draw what never moves of a road, with lines of a width in points."""
    shapes = road_shapes(road)
    for color, polygons in ((PAVING, shapes.paving), (ASPHALT, shapes.asphalt),
                            (PAINT, shapes.bars)):  # fmt: skip
        axes.add_collection(PolyCollection(polygons, facecolors=color, linewidths=0, zorder=1))
    for color, lines in ((PAINT, [*shapes.edges, *shapes.dashes]), (MIDDLE, shapes.middles)):
        axes.add_collection(LineCollection(lines, colors=color, linewidths=width, zorder=1))


def shown_extent(scene: ReplayScene) -> FloatArray:
    """(2, 2) x0, y0, x1, y1 of what a picture shows: the road, or where a junction's traffic is."""
    places = scene.tracks.row_xy
    if scene.road is None:
        low, high = places.min(axis=0), places.max(axis=0)
        margin = max(0.03 * float((high - low).max()), 1.0)
        return np.array([low - margin, high + margin])
    low, high = np.reshape(scene.road.bounds, (2, 2))
    sides = np.sort(high - low)
    if sides[1] <= LONG * sides[0]:
        near, far = np.quantile(places, [0.2, 0.8], axis=0)
        half = max(45.0, float((far - near).max()) / 2)
        middle = (near + far) / 2
        low, high = np.maximum(low, middle - half), np.minimum(high, middle + half)
    return np.array([low - 7.0, high + 7.0])


class Drawing:
    """A scene as a figure of some pixels, which can be drawn at any time.

    Agents are coloured by a mode: true, predicted, confidence, speed or w. A long road is folded
    into rows that are as large as possible.
    """

    def __init__(self, scene: ReplayScene, mode: str, size: tuple[int, int] = (1280, 720)) -> None:
        self.scene, self.mode = scene, mode
        self.fastest = max(1.0, float(np.quantile(scene.tracks.row_speed, 0.995)))
        self._stops = () if scene.road is None else road_shapes(scene.road).stops
        self._likeliest = None if scene.futures is None else scene.futures.likeliest
        width, height = size
        tall = height - HEAD_PX - FOOT_PX
        (x0, y0), (x1, y1) = shown_extent(scene)
        rows = np.arange(1, (MOST_ROWS if x1 - x0 > LONG * (y1 - y0) else 1) + 1)
        heights = (tall - GAP_PX * (rows - 1)) / rows
        scales = np.minimum(width * rows / (x1 - x0), heights / (y1 - y0))
        many = int(rows[scales.argmax()])
        each, self.scale = heights[many - 1], float(scales[many - 1])
        self._thin = max(0.5, 0.14 * self.scale * 72 / DPI)
        half = width / self.scale / 2, each / self.scale / 2
        self.figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
        self._axes: list[Axes] = []
        for row in range(many):
            bottom = FOOT_PX + (many - 1 - row) * (each + GAP_PX)
            axes = self.figure.add_axes((0.0, bottom / height, 1.0, each / height))
            x, y = x0 + (row + 0.5) * (x1 - x0) / many, (y0 + y1) / 2
            axes.set(xlim=(x - half[0], x + half[0]), ylim=(y - half[1], y + half[1]))
            axes.set(xticks=[], yticks=[], facecolor=GROUND)
            axes.spines[:].set_visible(False)
            self._axes.append(axes)
            if scene.road is None:  # faint lines where everyone went
                xy, index = scene.tracks.row_xy, scene.tracks.index
                paths = [xy[index.rows(agent)] for agent in range(index.agents)]
                axes.add_collection(LineCollection(paths, colors=TRACK, linewidths=1.0, zorder=1))
            else:
                draw_road(axes, scene.road, self._thin)
        middle = 1 - HEAD_PX / 2 / height
        self._clock = self.figure.text(0.985, middle, "", ha="right", va="center")
        self._draw_words(middle)
        self._still = {id(artist) for axes in self._axes for artist in axes.get_children()}

    def draw(self, time_s: float) -> Figure:
        """The figure of the scene as it is at a time, s; the next call draws on the same one."""
        tracks, step = self.scene.tracks, self._step(time_s)
        self._clock.set_text(f"{time_s:.1f} s")
        at = tracks.index.at(step)
        rows, xy = tracks.index.agent[at], tracks.row_xy[at]
        colors = self._colors(rows, tracks.row_speed[at], time_s)
        ghosts = [] if self.scene.ghosts is None else self._bodies(self.scene.ghosts, step)
        bodies = self._bodies(tracks, step)
        overlay = self._overlay(dict(zip(rows.tolist(), xy, strict=True)),
                                dict(zip(rows.tolist(), colors, strict=True)), time_s)  # fmt: skip
        for axes in self._axes:
            for artist in axes.get_children():
                if id(artist) not in self._still:
                    artist.remove()
            self._draw_stops(axes, step)
            for collection in (
                LineCollection(**overlay, zorder=3),
                PolyCollection(ghosts, facecolors="none", edgecolors=MUTED, linestyles="--",
                               linewidths=0.8, zorder=4),
                PolyCollection(bodies, facecolors=colors, edgecolors=INK, linewidths=0.7, zorder=5),
            ):  # fmt: skip
                axes.add_collection(collection)
            self._draw_collisions(axes, time_s)
        return self.figure

    def _draw_words(self, middle: float) -> None:
        """Write title and legend, and draw a bar of a round length as a scale."""
        scene, unit = self.scene, self.scene.unit
        fast = f"{self.fastest:.0f} {unit}/s"
        said, low, high = {
            "true": ("true behaviour", "", ""),
            "predicted": (f"the behaviour that {scene.believer} believes in", "", ""),
            "confidence": (f"how sure {scene.believer} is", "17 %, a guess", "100 %"),
            "speed": (f"speed, 0 to {fast}", "0", f"{fast} and more"),
            "w": ("prominence in the graph, relative to the largest (square root)",
                  "0", "the largest"),
        }[self.mode]  # fmt: skip
        self.figure.text(
            0.012, middle, f"{scene.entry.name}: coloured by {said}", va="center", color=INK,
            parse_math=False,
        )  # fmt: skip
        known = [(COLORS[b], b.value) for b in BEHAVIORS]
        if low:
            known = [(ramp_color(0.0), low), (ramp_color(0.5), "half"), (ramp_color(1.0), high)]
        known.append((UNKNOWN_COLOR, "not known"))
        handles = [Patch(facecolor=color, edgecolor=INK, label=word) for color, word in known]
        self.figure.legend(
            handles=handles, loc="lower left", ncols=len(handles), frameon=False, fontsize=9
        )
        axes, longest = self._axes[-1], 110.0 / self.scale
        length = max(n * 10.0**power for n in (1, 2, 5) for power in range(-3, 6)
                     if n * 10.0**power <= longest)  # fmt: skip
        x, y = axes.get_xlim()[0] + 16 / self.scale, axes.get_ylim()[0] + 10 / self.scale
        axes.plot([x, x + length], [y, y], color=INK, linewidth=1.5, zorder=9)
        axes.text(x + length / 2, y + 3 / self.scale, f"{length:g} {unit}", ha="center", fontsize=8)

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
        self, place: dict[int, FloatArray], color: dict[int, str], time_s: float
    ) -> dict[str, Any]:
        """Lines over the road: the graph's edges, or the rest of each likeliest future."""
        graph, futures = self.scene.graph, self.scene.futures
        if self.mode == "w":
            sample = int(np.searchsorted(graph.time_s, time_s + 1e-6)) - 1
            live = (graph.edges[:, 2] <= sample) & (graph.edges[:, 3] > sample)
            pairs = [pair for pair in graph.edges[live, :2].tolist() if place.keys() >= {*pair}]
            lines = [np.stack([place[a], place[b]]) for a, b in pairs]
            return {"segments": lines, "colors": EDGE, "linewidths": 0.6}
        if self.mode != "predicted" or futures is None or self._likeliest is None:
            return {"segments": []}
        made = self._likeliest[futures.time_s[self._likeliest] <= time_s + 1e-6]
        now_s = futures.time_s[made].max(initial=-np.inf)
        if time_s - now_s >= SHOWN_S:
            return {"segments": []}
        agents = [(m, int(futures.agent[m])) for m in made[futures.time_s[made] == now_s]]
        agents = [(m, agent) for m, agent in agents if agent in place]
        rest = futures.ahead_s > time_s - now_s
        lines = [np.concatenate([place[agent][None], futures.xy[m, rest]]) for m, agent in agents]
        return {"segments": lines, "colors": [color[a] for _, a in agents], "linewidths": 1.4}

    def _bodies(self, tracks: Tracks, step: int) -> list[FloatArray]:
        """The outlines of agents at a step, at least a few pixels large."""
        at, found = tracks.index.at(step), []
        for row, xy, heading in zip(tracks.index.agent[at], tracks.row_xy[at],
                                    tracks.row_heading[at], strict=True):  # fmt: skip
            size = np.maximum((tracks.length[row], tracks.width[row]), LEAST_PX / self.scale)
            walks = tracks.kind[row] == PEDESTRIAN
            shape = ROUND * size[1] / 2 if walks else BODY * size / 2
            forward, left = (np.cos(heading), np.sin(heading)), (-np.sin(heading), np.cos(heading))
            found.append(xy + shape @ np.array([forward, left]))
        return found

    def _draw_stops(self, axes: Axes, step: int) -> None:
        """Draw stop lines in the colour of their signals, with a lamp of a shape of its own."""
        signals = self.scene.tracks.signals
        for stop in self._stops:
            color, marker = PAINT, ""
            if 0 <= stop.signal < len(signals):
                color, marker = LAMPS[SIGNALS[signals[stop.signal, step]]]
            axes.add_collection(
                LineCollection([stop.line], colors=color, linewidths=max(1.5, 4 * self._thin),
                               zorder=2)
            )  # fmt: skip
            if marker:
                axes.plot(*stop.line.mean(axis=0), marker, markersize=6, color=color,
                          markeredgecolor=INK, zorder=4)  # fmt: skip

    def _draw_collisions(self, axes: Axes, time_s: float) -> None:
        """Draw a ring around the place of each collision of the last moments."""
        tracks = self.scene.tracks
        for event in tracks.events:
            since, row = time_s - event.time_s, np.flatnonzero(tracks.ids == event.agent)
            if event.kind is EventKind.COLLISION and 0.0 <= since <= EVENT_S and row.size:
                place = tracks.positions(row[0], np.array(self._step(event.time_s)))
                axes.plot(*place, "o", markersize=18 + 10 * since, zorder=6, color=GRAVE,
                          fillstyle="none", markeredgewidth=2)  # fmt: skip


def write_paths(dataset: Dataset, path: Path) -> None:
    """Draw every counterfactual episode of a dataset of ``what-if`` over the factual one.

    The file, .png, .pdf or .svg, appears whole or not at all.
    """
    check_picture(path)
    happened, branched = factual_of(dataset), branches_of(dataset)
    factual, road = dataset.read(happened).tracks, dataset.road(happened)
    figure = Figure(figsize=(13.0, 3.4 * len(branched)), layout="constrained")
    axes = figure.subplots(len(branched), 2, squeeze=False, width_ratios=(1.25, 1.0))
    for (plan, course), entry in zip(axes, branched, strict=True):
        if road is not None:
            draw_road(plan, road, 0.7)
        _draw_change(plan, course, entry, factual, dataset.read(entry).tracks)
    write_whole(path, figure_bytes(figure, path.suffix.lower()))


def _draw_change(
    plan: Axes, course: Axes, entry: EpisodeEntry, factual: Tracks, other: Tracks
) -> None:
    """Draw one change: on the left the paths on the road, on the right distances over time."""
    branch = branch_of(entry) or {}
    since_s, agent, change = float(branch["at_s"]), int(branch["agent"]), change_of(entry)
    color = COLORS.get(change, OWN_COLOR) if "behavior" in branch else ACTION
    happened, changed = (paths_since(since_s, factual, tracks) for tracks in (factual, other))
    both = happened.merge(changed, on=["id", "time_s"])
    both["apart"] = np.hypot(both["x_x"] - both["x_y"], both["y_x"] - both["y_y"])
    apart = both.groupby("id")["apart"].max().sort_values(ascending=False, kind="stable")
    others = [i for i in apart.index[apart > AFFECTED_M] if i != agent]
    for paths, paint, dashes, wide, done in (
        (happened, FACTUAL, "--", 3.4, "factual"),
        (changed, color, "-", 1.8, "changed"),
    ):
        for name in (agent, *others[:DRAWN_OTHERS]):
            path, own = paths[paths["id"] == name], name == agent
            label = f"driver {agent}, {done}" if own else None
            plan.plot(path["x"], path["y"], color=paint, linewidth=wide if own else wide / 2,
                      zorder=3 + own)  # fmt: skip
            plan.plot(path["x"][-1:], path["y"][-1:], "o", color=paint,
                      markersize=6 if own else 3, zorder=6)  # fmt: skip
            course.plot(path["time_s"], path["way_m"], color=paint, linestyle=dashes,
                        linewidth=2.4 if own else 0.9, label=label)  # fmt: skip
    known = [event for event in factual.events if event.time_s > since_s]
    for paths, events, paint in (
        (changed, new_incidents(other.events, known), INK),
        (happened, new_incidents(known, other.events), FACTUAL),
    ):
        for event in events:
            place = paths[(paths["id"] == event.agent) & (paths["time_s"] > event.time_s - 1e-6)]
            marker = "X" if event.kind is INCIDENTS[0] else "^"
            plan.plot(place["x"][:1], place["y"][:1], marker, color=paint, markersize=9, zorder=8)
            course.axvline(event.time_s, color=paint, linewidth=0.8, linestyle=":")
    xy = np.concatenate([line.get_xydata() for line in plan.lines])  # the paths, not all the road
    low, high = xy.min(axis=0) - 6.0, xy.max(axis=0) + 6.0
    sides = np.sort(high - low)
    plan.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x, m", ylabel="y, m")
    plan.set_aspect("auto" if sides[1] > LONG * sides[0] else "equal")
    title = f"driver {agent} from {since_s:g} s on: {change}; {len(others)} others affected"
    plan.set_title(title, loc="left", fontsize=11, color=INK)
    course.set(xlabel="time, s", ylabel="way gone since the instant, m")
    course.legend(frameon=False, fontsize=9)
    course.set_title("thin: the others who differ most", loc="right", fontsize=9, color=MUTED)
