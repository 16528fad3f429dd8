"""Draws a scene at one time as an image, without a browser: for films, pictures and reports.

The image is drawn at twice its size and then reduced, which smooths edges.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from behaviors.colors import COLORS, UNKNOWN_COLOR
from behaviors.labels import BEHAVIORS
from experiments.figure_files import write_figure
from experiments.replay.pictures.panels import (
    FOOT_PX,
    HEAD_PX,
    Panel,
    lay_out,
    round_below,
    shown_extent,
)
from experiments.replay.pictures.sheets import Pen, Pixels, Vectors, letters
from experiments.replay.ramp import ramp_color
from experiments.replay.scene import ReplayScene
from sim.files import write_whole
from sim.frames import KINDS, PEDESTRIAN, SIGNALS, EventKind, FloatArray, IntArray, Signal
from sim.road.shapes import RoadShapes, road_shapes

FINE: Final = 2
"""By what factor the image is drawn larger before it is reduced."""

INK, MUTED, PAPER = "#18202B", "#55606E", "#FFFFFF"
GROUND, PAVING, ASPHALT, PAINT, MIDDLE = "#ECEEEA", "#DCDCD6", "#C6CBD2", "#FFFFFF", "#8A6D1D"
TRACK, EDGE, GRAVE = "#C3C9D0", "#38506E", "#B3261E"
SIGNAL_COLORS: Final = {
    Signal.RED: "#D3312B",
    Signal.YELLOW: "#F2C230",
    Signal.GREEN: "#25A55F",
    Signal.OFF: "#9AA3AD",
}
"""The colours of the replay page's light theme."""

BODY: Final = np.array(
    [(1, 0.7), (0.8, 1), (-0.9, 1), (-1, 0.8), (-1, -0.8), (-0.9, -1), (0.8, -1), (1, -0.7)]
)
GLASS: Final = np.array([(0.2, 0.7), (0.5, 0.8), (0.5, -0.8), (0.2, -0.7)])
"""Outlines of a vehicle and of its windscreen, in halves of its length and of its width."""

LAMPS: Final = {Signal.RED: 4, Signal.YELLOW: 3, Signal.GREEN: 24}
"""How many corners a lamp has: red is a square, yellow a triangle, green nearly a disc."""

EVENT_S: Final = 1.5
"""How long a collision stays marked, s."""


SCALE_PX: Final = 110
"""Longest bar of a scale, pixels."""


class Painter:
    """Draws one scene at any time.

    Args:
        scene: what to draw.
        mode: what agents are coloured by: true, predicted, confidence, speed or w.
        width: width of the image, pixels.
        height: height of the image, pixels.
        words: whether title, time and legend are drawn; in shrunk pictures nobody can read them.
    """

    def __init__(
        self, scene: ReplayScene, mode: str, width: int = 1280, height: int = 720,
        words: bool = True,
    ) -> None:  # fmt: skip
        self.scene, self.mode, self.words = scene, mode, words
        margins = (HEAD_PX, FOOT_PX) if words else (0, 0)
        self.width, self.height = width * FINE, height * FINE
        self.panels = [
            Panel(
                tuple(FINE * side for side in panel.box),  # type: ignore[arg-type]
                FINE * panel.scale,
                FINE * panel.matrix,
            )
            for panel in lay_out(shown_extent(scene), width, height, *margins)
        ]
        speeds = scene.tracks.as_rows().speed
        self.fastest = max(1.0, float(np.quantile(speeds, 0.995)))
        self._shapes = None if scene.road is None else road_shapes(scene.road)
        self._background = Image.new("RGB", (self.width, self.height), PAPER)
        self._draw_background(Pixels(self._background))

    def draw(self, time_s: float) -> Image.Image:
        """Draw the scene as it is at a time, s."""
        image = self._background.copy()
        self._draw_moment(Pixels(image), time_s)
        return image.reduce(FINE)

    def draw_vectors(self, time_s: float) -> Figure:
        """The same as a figure whose lines and letters stay sharp at any size."""
        sheet = Vectors(self.width, self.height, FINE)
        self._draw_background(sheet)
        self._draw_moment(sheet, time_s)
        return sheet.figure

    def _draw_moment(self, sheet: Pixels | Vectors, time_s: float) -> None:
        rows, xy, heading, speed = self._present(time_s)
        colors = self._colors(rows, speed, time_s)
        for panel in self.panels:
            with sheet.part(panel.box) as (pen, offset):
                if self._shapes is not None:
                    self._draw_stops(pen, panel, offset, self._shapes, time_s)
                if self.mode == "w":
                    self._draw_edges(pen, panel, offset, rows, xy, time_s)
                elif self.mode == "predicted":
                    self._draw_paths(pen, panel, offset, rows, xy, colors, time_s)
                self._draw_ghosts(pen, panel, offset, time_s)
                self._draw_agents(pen, panel, offset, rows, xy, heading, colors)
                self._draw_events(pen, panel, offset, time_s)
        if self.words:
            clock, font = f"{time_s:.1f} s", letters(15 * FINE)
            pen = sheet.whole()
            pen.text((self.width - 16 * FINE, HEAD_PX * FINE / 2), clock, INK, font, anchor="rm")
            self._draw_scale(pen)

    def _draw_scale(self, pen: Pen) -> None:
        """Draw a scale bar of a round length in the lowest panel."""
        panel, unit = self.panels[-1], self.scene.unit
        length = round_below(SCALE_PX * FINE / panel.scale)
        x, y, tick = 16 * FINE, round(panel.box[3]) - 12 * FINE, 5 * FINE
        end = x + length * panel.scale
        pen.line([(x, y - tick), (x, y), (end, y), (end, y - tick)], INK, FINE)
        middle = ((x + end) / 2, y - 4 * FINE)
        pen.text(middle, f"{length:g} {unit}", INK, letters(12 * FINE), anchor="ms")

    def _draw_background(self, sheet: Pixels | Vectors) -> None:
        for panel in self.panels:
            with sheet.part(panel.box, GROUND) as (pen, offset):
                if self._shapes is None:
                    self._draw_tracks(pen, panel, offset)
                else:
                    _draw_road(pen, panel, offset, self._shapes)
        if self.words:
            self._draw_words(sheet.whole())

    def _draw_tracks(self, pen: Pen, panel: Panel, offset: IntArray) -> None:
        rows = self.scene.tracks.as_rows()
        for row in range(self.scene.tracks.ids.size):
            seen = rows.xy[rows.index.rows(row)]
            if len(seen) > 1:
                points = panel.pixels(seen) - offset
                pen.line([tuple(p) for p in points.tolist()], TRACK, FINE)

    def _draw_words(self, pen: Pen) -> None:
        name, middle = self.scene.name, HEAD_PX * FINE / 2
        said = {
            "true": "coloured by true behaviour",
            "predicted": f"coloured by the behaviour that {self.scene.believer} believes in",
            "confidence": f"coloured by how sure {self.scene.believer} is",
            "speed": f"coloured by speed, 0 to {self.fastest:.0f} {self.scene.unit}/s",
            "w": "coloured by prominence in the graph, relative to the largest (square root)",
        }[self.mode]
        x = 16.0 * FINE
        pen.text((x, middle), name, INK, letters(17 * FINE, bold=True), anchor="lm")
        x += pen.textlength(name, letters(17 * FINE, bold=True)) + 14 * FINE
        pen.text((x, middle), said, MUTED, letters(13 * FINE), anchor="lm")
        y, x, font = self.height - FOOT_PX * FINE / 2, 16.0 * FINE, letters(13 * FINE)
        for color, word in self._legend():
            size = 7 * FINE
            box = (x, y - size, x + 24 * FINE, y + size)
            pen.rounded_rectangle(box, 4 * FINE, color, INK, FINE)
            pen.text((x + 31 * FINE, y), word, INK, font, anchor="lm")
            x += 31 * FINE + pen.textlength(word, font) + 22 * FINE

    def _legend(self) -> list[tuple[str, str]]:
        if self.mode in ("true", "predicted"):
            return [*((COLORS[b], b.value) for b in BEHAVIORS), (UNKNOWN_COLOR, "not known")]
        ends = {
            "confidence": ("17 %, a guess", "100 %"),
            "speed": ("0", f"{self.fastest:.0f} {self.scene.unit}/s and more"),
            "w": ("0", "the largest"),
        }[self.mode]
        words = (ends[0], "", "", "", ends[1])
        steps = zip(np.linspace(0.0, 1.0, len(words)), words, strict=True)
        return [*((ramp_color(x), word) for x, word in steps), (UNKNOWN_COLOR, "not known")]

    def _present(self, time_s: float) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """Rows, positions, headings and speeds at a time, interpolated between frames."""
        tracks = self.scene.tracks
        step = max(int(np.searchsorted(tracks.time_s, time_s + 1e-6)) - 1, 0)
        after = min(step + 1, tracks.time_s.size - 1)
        span = float(tracks.time_s[after] - tracks.time_s[step])
        share = min(max((time_s - float(tracks.time_s[step])) / span, 0.0), 1.0) if span else 0.0
        seen = tracks.as_rows()
        at = seen.at(step)
        rows = seen.index.agent[at]
        row, there = seen.find(rows, np.full(rows.size, after))
        share_of = np.where(there, share, 0.0)[:, None]
        to = np.where(there[:, None], seen.xy[row], 0.0)
        xy = seen.xy[at] * (1 - share_of) + to * share_of
        return rows, xy, seen.heading[at], seen.speed[at]

    def _colors(self, rows: IntArray, speed: FloatArray, time_s: float) -> list[str]:
        scene = self.scene
        if self.mode == "speed":
            return [ramp_color(v / self.fastest) for v in speed]
        if self.mode == "w":
            sample = int(np.searchsorted(scene.graph.time_s, time_s + 1e-6)) - 1
            w = scene.graph.w[:, max(sample, 0)]
            largest = float(np.nan_to_num(w).max(initial=1e-12))
            return [
                UNKNOWN_COLOR if np.isnan(v) else ramp_color(float(np.sqrt(v / largest)))
                for v in w[rows]
            ]
        if self.mode == "true":
            behavior = scene.tracks.behavior
            codes = np.full(rows.size, -1) if behavior is None else behavior[rows]
            return [UNKNOWN_COLOR if c < 0 else COLORS[BEHAVIORS[c]] for c in codes]
        ids = scene.beliefs.ids[rows]
        posterior = scene.beliefs.at(time_s)
        if self.mode == "confidence":
            sure = dict(zip(posterior.ids, posterior.probability.max(axis=1), strict=True))
            return [
                ramp_color(float((sure[i] - 1 / 6) * 6 / 5)) if i in sure else UNKNOWN_COLOR
                for i in ids
            ]
        told = dict(zip(posterior.ids, posterior.behaviors, strict=True))
        return [UNKNOWN_COLOR if (b := told.get(i)) is None else COLORS[b] for i in ids]

    def _draw_stops(
        self, pen: Pen, panel: Panel, offset: IntArray, shapes: RoadShapes,
        time_s: float,
    ) -> None:  # fmt: skip
        tracks = self.scene.tracks
        step = max(int(np.searchsorted(tracks.time_s, time_s + 1e-6)) - 1, 0)
        for stop in shapes.stops:
            ends = panel.pixels(stop.line) - offset
            thick = max(2 * FINE, round(0.6 * panel.scale))
            if not 0 <= stop.signal < len(tracks.signals):
                pen.line(_points(ends), PAINT, thick)
                continue
            state = SIGNALS[tracks.signals[stop.signal, step]]
            pen.line(_points(ends), SIGNAL_COLORS[state], thick)
            if state in LAMPS:
                _draw_lamp(pen, ends, max(3.0 * FINE, 0.7 * panel.scale), state)

    def _draw_edges(
        self, pen: Pen, panel: Panel, offset: IntArray, rows: IntArray,
        xy: FloatArray, time_s: float,
    ) -> None:  # fmt: skip
        graph = self.scene.graph
        sample = int(np.searchsorted(graph.time_s, time_s + 1e-6)) - 1
        place = dict(zip(rows.tolist(), panel.pixels(xy) - offset, strict=True))
        live = graph.edges[(graph.edges[:, 2] <= sample) & (graph.edges[:, 3] > sample)]
        for a, b in live[:, :2].tolist():
            if a in place and b in place:
                pen.line([tuple(place[a].tolist()), tuple(place[b].tolist())], EDGE, 1)

    def _draw_paths(
        self, pen: Pen, panel: Panel, offset: IntArray, rows: IntArray,
        xy: FloatArray, colors: list[str], time_s: float,
    ) -> None:  # fmt: skip
        """The rest of each agent's most probable future, as it was last predicted."""
        made = [f for f in self.scene.forecasts if time_s - 2.0 < f.time_s <= time_s + 1e-6]
        if not made:
            return
        forecast = made[-1]
        likeliest = np.flatnonzero(np.diff(forecast.agent, prepend=-1) != 0)
        color = dict(zip(rows.tolist(), colors, strict=True))
        place = dict(zip(rows.tolist(), xy, strict=True))
        rest = forecast.ahead_s > time_s - forecast.time_s
        for m in likeliest:
            agent = int(forecast.agent[m])
            if agent in color:
                way = np.concatenate([place[agent][None], forecast.xy[m, rest]])
                pen.line(_points(panel.pixels(way) - offset), color[agent], 2 * FINE, "curve")

    def _draw_agents(
        self, pen: Pen, panel: Panel, offset: IntArray, rows: IntArray,
        xy: FloatArray, heading: FloatArray, colors: list[str],
    ) -> None:  # fmt: skip
        tracks = self.scene.tracks
        forward = np.stack([np.cos(heading), np.sin(heading)], axis=1) @ panel.matrix[:, :2].T
        forward /= panel.scale
        left = np.stack([forward[:, 1], -forward[:, 0]], axis=1)
        center = panel.pixels(xy) - offset
        for i, row in enumerate(rows):
            small = 5 if KINDS[tracks.kind[row]] == KINDS[PEDESTRIAN] else 6
            a = forward[i] * max(tracks.length[row] * panel.scale, small * FINE) / 2
            b = left[i] * max(tracks.width[row] * panel.scale, 4 * FINE) / 2
            c = center[i]
            if tracks.kind[row] == PEDESTRIAN:
                r = max(float(np.hypot(*b)), 2.5 * FINE)
                pen.ellipse((c[0] - r, c[1] - r, c[0] + r, c[1] + r), colors[i], INK, FINE)
                continue
            pen.polygon(_points(c + BODY @ np.stack([a, b])), colors[i], INK, FINE)
            if np.hypot(*a) > 6 * FINE:
                pen.polygon(_points(c + GLASS @ np.stack([a, b])), INK)

    def _draw_ghosts(self, pen: Pen, panel: Panel, offset: IntArray, time_s: float) -> None:
        """Outlines of where agents were in the factual episode."""
        ghosts, tracks = self.scene.ghosts, self.scene.tracks
        if ghosts is None:
            return
        step = max(int(np.searchsorted(tracks.time_s, time_s + 1e-6)) - 1, 0)
        for i in ghosts.at(step):
            facing = np.array([np.cos(ghosts.heading[i]), np.sin(ghosts.heading[i])])
            left = np.array([-facing[1], facing[0]])
            half = np.stack(
                [
                    facing * ghosts.length[ghosts.ghost[i]] / 2,
                    left * ghosts.width[ghosts.ghost[i]] / 2,
                ]
            )
            outline = panel.pixels(ghosts.xy[i] + BODY @ half) - offset
            pen.polygon(_points(outline), None, MUTED, FINE)

    def _draw_events(self, pen: Pen, panel: Panel, offset: IntArray, time_s: float) -> None:
        tracks = self.scene.tracks
        for event in tracks.events:
            since = time_s - event.time_s
            if event.kind is not EventKind.COLLISION or not 0.0 <= since <= EVENT_S:
                continue
            row = int(np.searchsorted(tracks.ids, event.agent))
            step = int(np.searchsorted(tracks.time_s, event.time_s - 1e-6))
            if row >= tracks.ids.size or tracks.ids[row] != event.agent:
                continue
            step = min(step, tracks.time_s.size - 1)
            place = tracks.as_rows().places(np.array(row), np.array(step))
            if np.isnan(place[0]):
                continue
            x, y = panel.pixels(place) - offset
            r = (12 + 8 * since) * FINE
            pen.ellipse((x - r, y - r, x + r, y + r), None, GRAVE, 3 * FINE)


def write_picture(scene: ReplayScene, path: Path, mode: str, time_s: float | None = None) -> None:
    """Write a scene at one time as a PNG, or as a PDF or SVG, in which lines stay sharp.

    Args:
        scene: what to draw.
        path: the file; it appears whole or not at all. Its ending says the format.
        mode: what agents are coloured by, as for `Painter`.
        time_s: the time that is drawn, s; None for the one with most agents.

    Raises:
        OSError: if it cannot be written.
    """
    if time_s is None:
        time_s = float(scene.tracks.time_s[scene.tracks.as_rows().counts().argmax()])
    painter = Painter(scene, mode)
    if path.suffix.lower() == ".png":
        write_whole(path, png_bytes(painter.draw(time_s)))
    else:
        write_figure(painter.draw_vectors(time_s), path)


def png_bytes(image: Image.Image) -> bytes:
    """A PNG of an image, small because it has at most 256 colours."""
    out = io.BytesIO()
    image.quantize(256, dither=Image.Dither.NONE).save(out, "PNG", optimize=True)
    return out.getvalue()


def _draw_road(pen: Pen, panel: Panel, offset: IntArray, shapes: RoadShapes) -> None:
    for color, polygons in (
        (PAVING, shapes.paving), (ASPHALT, shapes.asphalt), (PAINT, shapes.bars)
    ):  # fmt: skip
        for polygon in polygons:
            pen.polygon(_points(panel.pixels(polygon) - offset), color)
    thin = max(FINE, round(0.14 * panel.scale))
    lines = [(PAINT, line) for line in (*shapes.edges, *shapes.dashes)]
    for color, line in (*lines, *((MIDDLE, line) for line in shapes.middles)):
        pen.line(_points(panel.pixels(line) - offset), color, thin)


def _draw_lamp(pen: Pen, ends: FloatArray, size: float, state: Signal) -> None:
    """Draw a signal's lamp behind its stop line; each colour has a shape of its own."""
    across = (ends[1] - ends[0]) / max(float(np.hypot(*(ends[1] - ends[0]))), 1e-9)
    middle = ends.mean(axis=0) + 1.7 * size * np.array([-across[1], across[0]])
    around = 1.35 * size
    pen.ellipse((*(middle - around), *(middle + around)), INK)
    turns = 2 * np.pi * (np.arange(LAMPS[state]) + 0.5) / LAMPS[state]
    corners = middle + 0.95 * size * np.stack([np.sin(turns), np.cos(turns)], axis=1)
    pen.polygon(_points(corners), SIGNAL_COLORS[state])


def _points(pixels: FloatArray) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in pixels]
