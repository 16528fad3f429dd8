"""A recorded instant from which traffic is simulated, and what really came after it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from experiments.benches.realism.likelihood import Motion
from experiments.training.recordings import RecordedPlace
from graphrqi.predict.rollout.lane_positions import along_path
from graphrqi.predict.rollout.rollout import on_lanes
from graphrqi.predict.scene.scene import RETURN_MPS, Scene, make_scene
from sim.frames import PEDESTRIAN, Tracks

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

PAST_S: Final = 1.0
"""Everybody who is simulated has been seen so long, s (as in the challenge)."""

FINEST_S: Final = 0.1
"""Longest step of the simulation, s."""

KEPT_M: Final = 0.5
"""Drivers keep a distance of at most this from the lane's middle, m; those farther off return (cars
keep their own side of a lane, and nobody stays between two lanes)."""

SETTLED_S, SETTLED_M = 1.0, 3.0
"""The difference between a vehicle's heading and its lane's falls to 1/e within this time, s, and
no sooner than within this distance, m (about a car's wheelbase)."""

STEEPEST: Final = 0.2
"""A vehicle moves sideways by no more than this share of the distance that it drives (at an angle
of 11 degrees); a standing one does not move sideways."""

STANDS_M: Final = 0.5
"""A vehicle that has moved by less than this since it was first seen stands, m."""

KERB_M: Final = 0.25
"""A standing vehicle whose side is this near to the border of an outermost lane, or over it, is
parked, m (drivers who wait in a lane keep farther away)."""


@dataclass(frozen=True, eq=False)
class Start:
    """Everybody at one instant of a recording, their past and what they did next.

    Attributes:
        tracks: the recording.
        scene: the instant; rows are those who are simulated, everybody who is seen there.
        stop: index one past the present in the recording.
        ahead: how many of its steps are simulated.
    """

    tracks: Tracks
    scene: Scene
    stop: int
    ahead: int

    @cached_property
    def rows(self) -> IntArray:
        """(n,) rows of the vehicles in the recording."""
        return np.searchsorted(self.tracks.ids, self.scene.ids)

    @property
    def past(self) -> int:
        """How many steps before the future are looked at."""
        return min(self.stop, round(PAST_S / self.tracks.step_s) + 1)

    @property
    def scored(self) -> BoolArray:
        """(n,) vehicles on a lane that have been seen for `PAST_S`."""
        seen = self.tracks.valid[self.rows, self.stop - self.past : self.stop].all(axis=1)
        return np.asarray(seen & (self.scene.history.kind != PEDESTRIAN) & self.scene.on_path)

    @cached_property
    def parked(self) -> BoolArray:
        """(n,) vehicles that have stood at the kerb for as long as they were seen."""
        scene, tracks = self.scene, self.tracks
        seen = tracks.valid[self.rows, : self.stop, None]
        places = np.where(seen, tracks.xy[self.rows, : self.stop], scene.xy[:, None])
        stands = np.hypot(*np.moveaxis(places - scene.xy[:, None], -1, 0)).max(axis=1) < STANDS_M
        lane, side = np.maximum(scene.lane, 0), np.where(scene.offset > 0.0, 0, 1)
        margin = scene.graph.width[lane] / 2.0 - np.abs(scene.offset) - self.recorded.width / 2.0
        outermost = scene.paths.beside[side, lane] < 0
        aside = np.abs(scene.offset) > KEPT_M
        return np.asarray(self.scored & stands & aside & outermost & (margin < KERB_M))

    @property
    def substeps(self) -> int:
        """Steps of the simulation from one frame of the recording to the next."""
        return max(1, int(np.ceil(self.tracks.step_s / FINEST_S - 1e-6)))

    @property
    def speed(self) -> FloatArray:
        """(n,) present speeds, m/s."""
        return np.maximum(self.scene.speed, 0.0)

    @cached_property
    def recorded(self) -> Motion:
        """What everybody did: the past and the future."""
        when = slice(self.stop - self.past, self.stop + self.ahead)
        tracks, rows = self.tracks, self.rows
        valid = tracks.valid[rows, when]
        return Motion(
            np.where(valid[..., None], tracks.xy[rows, when], 0.0),
            np.where(valid, tracks.heading[rows, when], 0.0),
            valid, tracks.length[rows], tracks.width[rows], tracks.step_s, self.past,
        )  # fmt: skip

    @cached_property
    def limit(self) -> FloatArray:
        """(n,) speed limits, m/s; NaN where none is known."""
        graph = self.scene.graph
        return np.where(self.scene.lane >= 0, graph.limit[np.maximum(self.scene.lane, 0)], np.nan)

    def motion(self, x: FloatArray, travelled: FloatArray) -> Motion:
        """The recorded past, and a simulated future.

        Args:
            x: (n, ahead) distances along their paths, m, of those on a path; the others go straight
                on.
            travelled: (n, ahead) distances since the present, m.
        """
        scene, past = self.scene, self.past
        lane, s = along_path(scene.path, x, scene.paths.lane, scene.paths.start)
        time_s = np.arange(1, x.shape[1] + 1) * self.tracks.step_s
        pace = np.maximum(np.abs(scene.lateral_speed), RETURN_MPS)[:, None] * time_s
        pace = np.minimum(pace, STEEPEST * travelled)
        away = np.abs(scene.offset)[:, None]
        side = np.sign(scene.offset)[:, None] * np.maximum(away - pace, np.minimum(away, KEPT_M))
        xy = on_lanes(scene, lane, s, side)
        ahead = on_lanes(scene, lane, s + 0.5, side) - on_lanes(scene, lane, s - 0.5, side)
        heading = np.arctan2(ahead[..., 1], ahead[..., 0])
        now = scene.heading
        off = (now - heading[:, 0] + np.pi) % (2.0 * np.pi) - np.pi
        settled = np.minimum(time_s / SETTLED_S, travelled / SETTLED_M)
        heading = heading + off[:, None] * np.exp(-settled)
        straight = ~scene.on_path
        facing = np.stack([np.cos(now), np.sin(now)], axis=-1)[straight, None]
        xy[straight] = scene.xy[straight, None] + travelled[straight][..., None] * facing
        heading[straight] = now[straight, None]
        recorded = self.recorded
        return Motion(
            np.concatenate([recorded.xy[:, :past], xy], axis=1),
            np.concatenate([recorded.heading[:, :past], heading], axis=1),
            np.concatenate([recorded.valid[:, :past], np.ones(x.shape, dtype=bool)], axis=1),
            recorded.length, recorded.width, recorded.step_s, past,
        )  # fmt: skip


def _on_nearest_lanes(scene: Scene) -> Scene:
    """The scene with everybody on the lane in whose width it is, where that is a lane beside.

    A predictor takes drivers for changing lanes only once they are over; here all that counts is
    where they are.
    """
    paths, lane, offset = scene.paths, scene.lane.copy(), scene.offset.copy()
    path = scene.path.copy()
    for i in np.flatnonzero(scene.on_path):
        side = 0 if offset[i] > 0.0 else 1
        beside, apart = paths.beside[side, lane[i]], paths.lane_spacing[side, lane[i]]
        if beside >= 0 and abs(offset[i]) > apart / 2.0 and paths.options[beside] > 0:
            lane[i], path[i] = beside, paths.likeliest[beside]
            offset[i] -= apart if side == 0 else -apart
    return scene.replaced(lane=lane, path=path, offset=offset)


def starts(place: RecordedPlace, seconds: float, every_s: float) -> Iterator[Start]:
    """The instants of a recording from which traffic can be simulated for so many seconds.

    Args:
        place: with its map.
        seconds: how far ahead.
        every_s: time between instants, s.
    """
    tracks = place.tracks
    if place.road is None or tracks.time_s.size < 4:
        return
    ahead = round(seconds / tracks.step_s)
    begin = round(PAST_S / tracks.step_s) + 1
    apart = max(1, round(every_s / tracks.step_s))
    for stop in range(begin, tracks.time_s.size - ahead + 1, apart):
        history = tracks.window(stop, stop)
        if history.ids.size:
            scene = _on_nearest_lanes(make_scene(history, place.road, seconds))
            start = Start(tracks, scene, stop, ahead)
            if start.scored.any():
                yield start
