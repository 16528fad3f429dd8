"""Draws the road of the highway engine, within highway-env's own viewer.

Vehicles are coloured by their drivers' behaviour, the ego vehicle is white. highway-env's windows,
videos and image arrays work as ever.
"""

from __future__ import annotations

import os
import tempfile
from typing import Any, Final

import numpy as np
import pygame
from highway_env.envs.common.graphics import EnvViewer
from highway_env.road.graphics import WorldSurface
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from sim.frames import FloatArray, Signal
from sim.highway.network import HighwayNetwork
from sim.highway.traffic import TrafficRoad
from sim.road.shapes import RoadShapes, road_shapes

SIGNAL_COLORS: Final = ((235, 50, 50), (250, 205, 45), (60, 205, 90), (245, 245, 245))
"""By the codes of signals."""

BODY: Final = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
GLASS: Final = np.array([[0.15, -0.8], [0.5, -0.8], [0.5, 0.8], [0.15, 0.8]])
"""Outlines of a vehicle and of its windscreen, in half lengths and half widths."""

FLIP: Final = np.array([1.0, -1.0])
"""From a road's axes to highway-env's."""

GROUND, PAVING, ASPHALT = (196, 208, 186), (178, 176, 172), (84, 86, 92)
PAINT, MIDDLE = (240, 240, 240), (240, 200, 80)
EGO, CRASHED, OUTLINE, PERSON = (255, 255, 255), (20, 20, 20), (30, 30, 34), (40, 40, 120)


class TrafficViewer(EnvViewer):  # type: ignore[misc]
    """highway-env's viewer; draws the ``network`` and the traffic of an environment."""

    def __init__(self, env: Any, network: HighwayNetwork) -> None:
        os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())  # or SDL complains
        super().__init__(env)
        self.network = network
        self._shapes = road_shapes(network.road)

    def window_position(self) -> FloatArray:
        """Where the view is centred, m."""
        position = np.array(super().window_position(), dtype=np.float64)
        if not self.network.exit_of:  # a road without junctions stays where it is on the screen
            lane = next(iter(self.network.lanes.values()))
            position[1] = lane.position(0.0, 0.0)[1] + lane.width
        return position

    def display(self) -> None:
        """Draw the scene as it is now; images need no display, unlike highway-env's."""
        if not (self.enabled or self.offscreen):
            return
        surface = self.sim_surface
        surface.move_display_window_to(self.window_position())
        _draw_road(surface, self._shapes, self.env.road.signals)
        _draw_traffic(surface, self.env.road, self.env.vehicle)
        if self.env.scenario.road.left_hand:
            surface.blit(pygame.transform.flip(surface, False, True), (0, 0))
        self._legend(surface)
        if not self.offscreen:
            self.screen.blit(surface, (0, 0))
            if self.env.config["real_time_rendering"]:
                self.clock.tick(self.env.config["simulation_frequency"])
            pygame.display.flip()

    def close(self) -> None:
        """Close the window; other viewers of the process keep theirs and their fonts."""
        if not self.offscreen:
            super().close()

    def _legend(self, surface: WorldSurface) -> None:
        pygame.font.init()  # another viewer of the process may have shut the fonts down
        font = pygame.font.Font(None, 18)
        x, y = 8, surface.get_height() - 20
        pygame.draw.rect(surface, GROUND, (0, y - 6, surface.get_width(), 26))
        for behavior in BEHAVIORS:
            pygame.draw.rect(surface, pygame.Color(behavior.color), (x, y, 12, 12))
            text = font.render(str(behavior), True, OUTLINE)
            surface.blit(text, (x + 16, y))
            x += 26 + text.get_width()
        clock = font.render(f"{self.env.road.time_s:6.1f} s", True, OUTLINE)
        surface.blit(clock, (surface.get_width() - 70, y))


def _pixels(surface: WorldSurface, points: FloatArray) -> list[tuple[float, float]]:
    """The pixels of points in highway-env's axes."""
    moved = (points - surface.origin) * surface.scaling
    return [(float(x), float(y)) for x, y in moved]


def _draw_road(surface: WorldSurface, shapes: RoadShapes, signals: NDArray[np.int8]) -> None:
    """Draw what does not move; stop lines have the colour of their signal."""
    surface.fill(GROUND)
    for color, polygons in ((PAVING, shapes.paving), (ASPHALT, shapes.asphalt)):
        for polygon in polygons:
            if len(polygon) > 2:  # a junction of edges that touch has no surface
                pygame.draw.polygon(surface, color, _pixels(surface, polygon * FLIP))
    thin = max(1, round(0.15 * surface.scaling))
    for color, lines in ((PAINT, (*shapes.edges, *shapes.dashes)), (MIDDLE, shapes.middles)):
        for line in lines:
            pygame.draw.lines(surface, color, False, _pixels(surface, line * FLIP), thin)
    for bar in shapes.bars:
        pygame.draw.polygon(surface, PAINT, _pixels(surface, bar * FLIP))
    for stop in shapes.stops:
        shown = int(signals[stop.signal]) if stop.signal >= 0 else Signal.OFF.code
        begin, end = _pixels(surface, stop.line * FLIP)
        thick = max(2, round(0.6 * surface.scaling))
        pygame.draw.line(surface, SIGNAL_COLORS[shown], begin, end, thick)


def _draw_traffic(surface: WorldSurface, road: TrafficRoad, ego: Any | None) -> None:
    """Draw pedestrians and vehicles."""
    for walker in road.walkers:
        (place,) = _pixels(surface, walker.position[None])
        pygame.draw.circle(surface, PERSON, place, max(3, round(0.35 * surface.scaling)))
    for one in road.vehicles:
        color: Any = EGO if one is ego else PAVING
        if one.crashed or one.behavior is not None:
            color = CRASHED if one.crashed else pygame.Color(one.behavior.color)
        cos, sin = np.cos(one.heading), np.sin(one.heading)
        turn = np.array([[cos, sin], [-sin, cos]])
        half = np.array([one.LENGTH / 2, one.WIDTH / 2])
        body, glass = (
            _pixels(surface, part * half @ turn + one.position) for part in (BODY, GLASS)
        )
        pygame.draw.polygon(surface, color, body)
        pygame.draw.polygon(surface, OUTLINE, glass)
        pygame.draw.polygon(surface, EGO if one is ego else OUTLINE, body, 1)
