"""Pictures and films of a replay, drawn by matplotlib without a browser."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from behaviors.colors import COLORS, UNKNOWN_COLOR
from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.console.progress import Progress
from experiments.figure_files import write_figure
from experiments.replay.ramp import ramp_color
from experiments.replay.scene import ReplayScene
from sim.files import write_whole
from sim.frames import PEDESTRIAN, SIGNALS, EventKind, FloatArray, IntArray, Signal
from sim.road.shapes import road_shapes

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
"""A scene whose sides have a larger ratio is turned until it lies, and folded into rows."""

MOST_ROWS: Final = 10

HEAD_PX, FOOT_PX, GAP_PX = 44, 46, 8
"""Height of the title, height of the legend, distance between rows, pixels."""

DPI: Final = 100

LEAST_PX: Final = (6.0, 4.0)
"""Least length and width of a drawn agent, pixels."""

EVENT_S: Final = 1.5
"""How long a collision stays marked, s."""

FILMS: Final = {".mp4": (20, (1280, 720)), ".gif": (10, (960, 540))}
"""Frames per second and size in pixels of a film, by the file's ending; it plays in real time."""

MOST_FRAMES: Final = 20_000


@dataclass(frozen=True, slots=True)
class Layout:
    """How a scene is folded into the rows of a picture.

    Attributes:
        turned: whether the scene is turned by a quarter.
        scale: pixels per metre.
        rows: the middle (u, v) of each row's part of the scene, m.
    """

    turned: bool
    scale: float
    rows: tuple[tuple[float, float], ...]

    @classmethod
    def of(cls, extent: tuple[float, float, float, float], width: int, height: int) -> Layout:
        """The layout that shows an extent as large as possible.

        Args:
            extent: x0, y0, x1, y1 of what is shown, m.
            width: pixels.
            height: of all rows together, pixels.

        Examples:
            >>> [len(Layout.of((0, 0, size, 12), 1280, 630).rows) for size in (12, 800)]
            [1, 6]
        """
        x0, y0, x1, y1 = extent
        turned = y1 - y0 > LONG * (x1 - x0)
        u0, v0, u1, v1 = (y0, -x1, y1, -x0) if turned else extent
        many = range(1, MOST_ROWS + 1) if u1 - u0 > LONG * (v1 - v0) else range(1, 2)
        scales = {
            n: min(width * n / (u1 - u0), (height - GAP_PX * (n - 1)) / n / (v1 - v0)) for n in many
        }
        best = max(scales, key=lambda n: (round(scales[n], 6), -n))
        step, v = (u1 - u0) / best, 0.5 * (v0 + v1)
        return cls(
            turned, scales[best], tuple((u0 + (n + 0.5) * step, v) for n in range(best))
        )  # fmt: skip

    def places(self, xy: FloatArray) -> FloatArray:
        """Places (..., 2) in the turned scene, m."""
        if not self.turned:
            return xy
        return np.stack([xy[..., 1], -xy[..., 0]], axis=-1)


def shown_extent(scene: ReplayScene) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1 of what a picture shows: the road; of a junction, where its traffic is."""
    places = scene.tracks.rows.xy
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
    """A scene as a figure, which can be drawn at any time.

    Args:
        scene: what to draw.
        mode: what agents are coloured by: true, predicted, confidence, speed or w.
        size: width and height, pixels.
    """

    def __init__(self, scene: ReplayScene, mode: str, size: tuple[int, int] = (1280, 720)) -> None:
        from matplotlib.figure import Figure

        self.scene, self.mode = scene, mode
        width, height = size
        self.figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
        tall = height - HEAD_PX - FOOT_PX
        self.layout = Layout.of(shown_extent(scene), width, tall)
        self.fastest = max(1.0, float(np.quantile(scene.tracks.rows.speed, 0.995)))
        self._shapes = None if scene.road is None else road_shapes(scene.road)
        self._axes: list[Axes] = []
        self._moving: list[Artist] = []
        many = len(self.layout.rows)
        each = (tall - GAP_PX * (many - 1)) / many
        for row, (u, v) in enumerate(self.layout.rows):
            bottom = FOOT_PX + (many - 1 - row) * (each + GAP_PX)
            axes = self.figure.add_axes((0.0, bottom / height, 1.0, each / height))
            half = width / self.layout.scale / 2, each / self.layout.scale / 2
            axes.set(xlim=(u - half[0], u + half[0]), ylim=(v - half[1], v + half[1]))
            axes.set(xticks=[], yticks=[], facecolor=GROUND)
            axes.spines[:].set_visible(False)
            self._axes.append(axes)
        self._draw_ground()
        self._draw_words()
        self._clock = self.figure.text(0.985, 1 - HEAD_PX / 2 / height, "", ha="right", va="center")

    def draw(self, time_s: float) -> Figure:
        """Draw the scene as it is at a time.

        Args:
            time_s: the time, s.

        Returns:
            The figure; the next call draws on the same one.
        """
        for artist in self._moving:
            artist.remove()
        self._clock.set_text(f"{time_s:.1f} s")
        rows, xy, heading, speed = self._present(time_s)
        colors = self._colors(rows, speed, time_s)
        lines, inks, width = self._overlay(rows, xy, colors, time_s)
        bodies = [self._body(*one) for one in zip(rows, xy, heading, strict=True)]
        self._moving = [
            *self._stops(time_s),
            *self._lines(lines, inks, width, 3),
            *self._lines(self._ghosts(time_s), MUTED, 0.8, 4, linestyles="--"),
            *self._polygons(bodies, colors, 5, edgecolors=INK, linewidths=0.7),
            *self._collisions(time_s),
        ]
        return self.figure

    def _lines(
        self, lines: Any, colors: Any, width: float, zorder: int, **style: Any
    ) -> list[Artist]:
        """Add lines to every row."""
        from matplotlib.collections import LineCollection

        places, style = [self.layout.places(line) for line in lines], {"colors": colors, **style}
        return [
            axes.add_collection(LineCollection(places, linewidths=width, zorder=zorder, **style))
            for axes in (self._axes if places else ())
        ]

    def _polygons(self, polygons: Any, colors: Any, zorder: int, **style: Any) -> list[Artist]:
        """Add filled outlines to every row."""
        from matplotlib.collections import PolyCollection

        places = [self.layout.places(polygon) for polygon in polygons]
        return [
            axes.add_collection(PolyCollection(places, facecolors=colors, zorder=zorder, **style))
            for axes in (self._axes if places else ())
        ]

    def _draw_ground(self) -> None:
        """Draw what does not move."""
        shapes = self._shapes
        if shapes is None:
            seen = self.scene.tracks.rows
            paths = [seen.xy[seen.index.rows(row)] for row in range(self.scene.tracks.ids.size)]
            self._lines([p for p in paths if len(p) > 1], TRACK, 1.0, 1)
            return
        for color, polygons in (
            (PAVING, shapes.paving), (ASPHALT, shapes.asphalt), (PAINT, shapes.bars)
        ):  # fmt: skip
            self._polygons(polygons, color, 1, linewidths=0)
        thin = max(0.5, 0.14 * self.layout.scale * 72 / DPI)
        self._lines([*shapes.edges, *shapes.dashes], PAINT, thin, 1)
        self._lines(shapes.middles, MIDDLE, thin, 1)

    def _draw_words(self) -> None:
        """Write title and legend, and draw a bar of a round length as a scale."""
        from matplotlib.patches import Patch

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
            0.012, middle, f"{scene.name}: {said}", va="center", color=INK, parse_math=False
        )
        handles = [
            Patch(facecolor=color, edgecolor=INK, label=word) for color, word in self._legend()
        ]
        self.figure.legend(
            handles=handles, loc="lower left", ncols=len(handles), frameon=False, fontsize=9
        )
        axes, scale = self._axes[-1], self.layout.scale
        power = 10.0 ** np.floor(np.log10(110.0 / scale))
        length = max(n * power for n in (1, 2, 5) if n * power <= 110.0 / scale)
        x, y = axes.get_xlim()[0] + 16 / scale, axes.get_ylim()[0] + 10 / scale
        axes.plot([x, x + length], [y, y], color=INK, linewidth=1.5, zorder=9)
        axes.text(
            x + length / 2, y + 3 / scale, f"{length:g} {scene.unit}", ha="center", fontsize=8
        )

    def _legend(self) -> list[tuple[str, str]]:
        if self.mode in ("true", "predicted"):
            known = [(COLORS[b], b.value) for b in BEHAVIORS]
        else:
            low, high = {
                "confidence": ("17 %, a guess", "100 %"),
                "speed": ("0", f"{self.fastest:.0f} {self.scene.unit}/s and more"),
                "w": ("0", "the largest"),
            }[self.mode]
            known = [(ramp_color(0.0), low), (ramp_color(0.5), "half"), (ramp_color(1.0), high)]
        return [*known, (UNKNOWN_COLOR, "not known")]

    def _present(self, time_s: float) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """Rows, places, headings and speeds at a time, between frames on the straight line."""
        tracks = self.scene.tracks
        step = self._step(time_s)
        after = min(step + 1, tracks.time_s.size - 1)
        span = float(tracks.time_s[after] - tracks.time_s[step])
        share = min(max((time_s - float(tracks.time_s[step])) / span, 0.0), 1.0) if span else 0.0
        seen = tracks.rows
        at = seen.index.at(step)
        rows = seen.index.agent[at]
        ahead = tracks.positions(rows, np.full(rows.size, after))
        to = np.where(np.isnan(ahead), seen.xy[at], ahead)
        return rows, seen.xy[at] + share * (to - seen.xy[at]), seen.heading[at], seen.speed[at]

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
            return [UNKNOWN_COLOR if c < 0 else COLORS[BEHAVIORS[c]] for c in codes]
        posterior = scene.beliefs.at(time_s)
        if self.mode == "confidence":
            chance = posterior.probability.max(axis=1)
            known = {i: ramp_color(float(1.2 * c - 0.2)) for i, c in zip(posterior.ids, chance,
                                                                         strict=True)}  # fmt: skip
        else:
            named = zip(posterior.ids, posterior.behaviors, strict=True)
            known = {i: COLORS[b] for i, b in named if b is not None}
        return [known.get(i, UNKNOWN_COLOR) for i in scene.beliefs.ids[rows]]

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
        likeliest = np.flatnonzero(np.diff(forecast.agent, prepend=-1) != 0)
        shown = [(m, int(forecast.agent[m])) for m in likeliest if int(forecast.agent[m]) in place]
        ways = [np.concatenate([place[agent][None], forecast.xy[m, rest]]) for m, agent in shown]
        return ways, [color[agent] for _, agent in shown], 1.4

    def _body(self, row: int, xy: FloatArray, heading: float) -> FloatArray:
        """The outline of an agent, at least a few pixels large."""
        tracks, scale = self.scene.tracks, self.layout.scale
        length = max(float(tracks.length[row]), LEAST_PX[0] / scale)
        width = max(float(tracks.width[row]), LEAST_PX[1] / scale)
        if tracks.kind[row] == PEDESTRIAN:
            turns = np.linspace(0.0, 2.0 * np.pi, 13)
            return xy + 0.5 * width * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        return _outline(xy, heading, length, width)

    def _stops(self, time_s: float) -> list[Artist]:
        """Draw stop lines in the colour of their signals, with a lamp of a shape of its own."""
        signals, step = self.scene.tracks.signals, self._step(time_s)
        drawn: list[Artist] = []
        wide = max(1.5, 0.6 * self.layout.scale * 72 / DPI)
        for stop in () if self._shapes is None else self._shapes.stops:
            color, marker = PAINT, ""
            if 0 <= stop.signal < len(signals):
                color, marker = LAMPS[SIGNALS[signals[stop.signal, step]]]
            drawn += self._lines([stop.line], color, wide, 2)
            middle = self.layout.places(stop.line).mean(axis=0)
            style: dict[str, Any] = {"color": color, "markeredgecolor": INK, "zorder": 4}
            for axes in self._axes if marker else ():
                drawn += axes.plot(*middle, marker, markersize=6, **style)
        return drawn

    def _ghosts(self, time_s: float) -> list[FloatArray]:
        """Outlines of where agents were in the factual episode."""
        ghosts = self.scene.ghosts
        if ghosts is None:
            return []
        outlines = [
            _outline(
                ghosts.xy[i], float(ghosts.heading[i]),
                float(ghosts.length[ghosts.ghost[i]]), float(ghosts.width[ghosts.ghost[i]]),
            )
            for i in ghosts.at(self._step(time_s))
        ]  # fmt: skip
        return [np.concatenate([outline, outline[:1]]) for outline in outlines]

    def _collisions(self, time_s: float) -> list[Artist]:
        """Draw a ring around the place of each collision of the last moments."""
        tracks = self.scene.tracks
        drawn: list[Artist] = []
        for event in tracks.events:
            since = time_s - event.time_s
            row = int(np.searchsorted(tracks.ids, event.agent))
            if event.kind is not EventKind.COLLISION or not 0.0 <= since <= EVENT_S:
                continue
            if row < tracks.ids.size and tracks.ids[row] == event.agent:
                at = np.array(self._step(event.time_s))
                place = self.layout.places(tracks.positions(np.array(row), at))
                style: dict[str, Any] = {"color": GRAVE, "fillstyle": "none", "zorder": 6}
                size = 18 + 10 * since
                for axes in self._axes:
                    drawn += axes.plot(*place, "o", markersize=size, markeredgewidth=2, **style)
        return drawn


def _outline(xy: FloatArray, heading: float, length: float, width: float) -> FloatArray:
    forward = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-forward[1], forward[0]])
    return np.asarray(xy + BODY @ np.stack([forward * length / 2, left * width / 2]))


def fullest_s(scene: ReplayScene) -> float:
    """The time with most agents, s."""
    return float(scene.tracks.time_s[scene.tracks.rows.index.counts().argmax()])


def check_picture(path: Path) -> None:
    """Refuse a name of a picture or film that cannot be made, before anything is computed.

    Args:
        path: the file to be.

    Raises:
        InputError: if its ending is not known, or MP4 cannot be made here.
    """
    endings = (".png", ".pdf", ".svg", *FILMS)
    if path.suffix.lower() not in endings:
        raise InputError(
            f"--picture: found {path.name!r}, expected a name that ends in {', '.join(endings)}"
        )
    if path.suffix.lower() == ".mp4":
        try:
            import imageio_ffmpeg  # noqa: F401
        except ImportError:
            raise InputError(
                f"{path}: found no imageio-ffmpeg, expected it for MP4: "
                "pip install 'graphrqi[video]', or name a .gif"
            ) from None


def write_picture(
    scene: ReplayScene,
    path: Path,
    mode: str,
    begin_s: float | None = None,
    end_s: float | None = None,
    quiet: bool = True,
) -> None:
    """Draw a scene at one time, or film it.

    Args:
        scene: what to draw.
        path: the file; it appears complete or not at all. Its ending says the format.
        mode: what agents are coloured by, as for `Drawing`.
        begin_s: the time of a picture (None for the one with most agents), or when a film begins
            (None for the beginning), s.
        end_s: when a film ends, s; None for the end.
        quiet: whether to show no progress.

    Raises:
        InputError: if the name or the times are wrong.
        OSError: if it cannot be written.
    """
    check_picture(path)
    ending = path.suffix.lower()
    if ending not in FILMS:
        moment = fullest_s(scene) if begin_s is None else begin_s
        write_figure(Drawing(scene, mode).draw(moment), path, DPI)
        return
    import matplotlib as mpl
    from matplotlib.animation import FFMpegWriter, PillowWriter

    per_s, size = FILMS[ending]
    times = scene.tracks.time_s
    begin = float(times[0]) if begin_s is None else max(begin_s, float(times[0]))
    end = float(times[-1]) if end_s is None else min(end_s, float(times[-1]))
    count = int((end - begin) * per_s + 1e-6) + 1
    if end <= begin or count > MOST_FRAMES:
        raise InputError(
            f"{path}: found {begin:g} to {end:g} s, expected some time between {times[0]:g} and "
            f"{times[-1]:g} s, and at most {MOST_FRAMES // per_s} s of it"
        )
    drawing = Drawing(scene, mode, size)
    if ending == ".mp4":
        import imageio_ffmpeg

        mpl.rcParams["animation.ffmpeg_path"] = imageio_ffmpeg.get_ffmpeg_exe()
    writer = FFMpegWriter(fps=per_s) if ending == ".mp4" else PillowWriter(fps=per_s)
    with (
        TemporaryDirectory() as scratch,
        Progress("drawing frames", count, quiet) as progress,
    ):
        film = Path(scratch) / f"film{ending}"
        with writer.saving(drawing.figure, str(film), DPI):
            for number in range(count):
                drawing.draw(begin + number / per_s)
                writer.grab_frame()
                progress.advance()
        write_whole(path, film.read_bytes())
