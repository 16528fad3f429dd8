"""highway-env's `Road`, quicker, with the same results to the bit.

The stock road spends most of its time in Python loops over all pairs: to find neighbours and to
check for collisions. `FastRoad` computes the lane coordinates of all vehicles with numpy, once per
lane and step, and searches them by bisection; it hands only pairs that come near each other to
highway-env's own collision check. Where rounding could matter (two values within a nanometre) the
stock search decides.

Use it in place of `highway_env.road.road.Road`. Vehicles must not be moved while ``act()`` runs.
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from highway_env.road.lane import StraightLane
from highway_env.road.road import Road
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Landmark, RoadObject
from numpy.typing import NDArray

from sim.geometry import Outlines, separation
from sim.highway.lanes import LaneIndex

FloatArray = NDArray[np.float64]

ROUNDING_M: Final = 1e-9
"""Values that are nearer to each other than this are compared by the stock code, m: far above
rounding errors, far below distances in traffic."""

CLEARANCE_M: Final = 1e-6
"""Outlines that stay farther apart than this cannot collide in the stock check either, m."""

MARGIN_M: Final = 1.0
"""A vehicle this far beyond a lane's edge is still on it, in highway-env's neighbour search."""


@dataclass(frozen=True, slots=True)
class _OnLane:
    """The vehicles on a lane, by distance along it.

    Attributes:
        s: distances, ascending, m.
        vehicles: in that order.
        doubtful: whether rounding could decide who is on the lane, or the order.
    """

    s: list[float]
    vehicles: list[RoadObject]
    doubtful: bool


class FastRoad(Road):  # type: ignore[misc]
    """A road that finds neighbours and collisions quickly; arguments as of highway-env's."""

    _vehicles: list[RoadObject] | None = None
    _positions: FloatArray
    _on_lane: dict[LaneIndex, _OnLane]

    def act(self) -> None:
        """Let everybody decide; nobody moves meanwhile, so that one sorting serves all searches."""
        self._vehicles = [
            other for other in self.vehicles + self.objects if not isinstance(other, Landmark)
        ]
        self._positions = np.array([other.position for other in self._vehicles]).reshape(-1, 2)
        self._on_lane = {}
        try:
            super().act()
        finally:
            self._vehicles = None

    def neighbour_vehicles(
        self, vehicle: Vehicle, lane_index: LaneIndex | None = None
    ) -> tuple[Vehicle | None, Vehicle | None]:
        """The vehicles ahead and behind on a lane, as highway-env defines them."""
        lane_index = lane_index or vehicle.lane_index
        if self._vehicles is None or not lane_index or self.neighbour_vehicles_connected_lanes:
            return super().neighbour_vehicles(vehicle, lane_index)  # type: ignore[no-any-return]
        lane = self.network.get_lane(lane_index)
        if not isinstance(lane, StraightLane) or type(lane) is not StraightLane:
            return super().neighbour_vehicles(vehicle, lane_index)  # type: ignore[no-any-return]
        found = self._on_lane.get(lane_index)
        if found is None:
            found = self._on_lane[lane_index] = self._sort(lane)
        s = lane.local_coordinates(vehicle.position)[0]
        low = bisect.bisect_left(found.s, s - ROUNDING_M)
        high = bisect.bisect_right(found.s, s + ROUNDING_M)
        within = [other for other in found.vehicles[low:high] if other is not vehicle]
        if found.doubtful or within:
            return super().neighbour_vehicles(vehicle, lane_index)  # type: ignore[no-any-return]
        front = found.vehicles[high] if high < len(found.vehicles) else None
        rear = found.vehicles[low - 1] if low > 0 else None
        return front, rear

    def _sort(self, lane: StraightLane) -> _OnLane:
        """Everybody on a straight lane, by distance along it."""
        assert self._vehicles is not None
        if not self._vehicles:
            return _OnLane([], [], False)
        delta = self._positions - lane.start
        s = delta[:, 0] * lane.direction[0] + delta[:, 1] * lane.direction[1]
        across = delta[:, 0] * lane.direction_lateral[0] + delta[:, 1] * lane.direction_lateral[1]
        beyond = np.abs(across) - (lane.width / 2 + MARGIN_M)
        before, after = s + lane.VEHICLE_LENGTH, s - (lane.length + lane.VEHICLE_LENGTH)
        edge = (
            (np.abs(beyond) < ROUNDING_M)
            | (np.abs(before) < ROUNDING_M)
            | (np.abs(after) < ROUNDING_M)
        )
        on = np.flatnonzero((beyond <= 0) & (before >= 0) & (after < 0))
        on = on[np.argsort(s[on], kind="stable")]
        close = np.diff(s[on]) < ROUNDING_M
        return _OnLane(
            s[on].tolist(), [self._vehicles[i] for i in on], bool(edge.any() or close.any())
        )

    def step(self, dt: float) -> None:
        """Move everybody, then check the pairs that come near each other for collisions.

        Args:
            dt: s.
        """
        for vehicle in self.vehicles:
            vehicle.step(dt)
        everyone = self.vehicles + self.objects
        if not self.vehicles:
            return
        position = np.array([other.position for other in everyone])
        diagonal = np.array([other.diagonal for other in everyone])
        n = len(self.vehicles)
        reach = np.array([vehicle.speed for vehicle in self.vehicles]) * dt
        across = position[:n, None] - position[None]
        distance = np.sqrt(across[..., 0] ** 2 + across[..., 1] ** 2)
        near = distance <= (diagonal[:n, None] + diagonal[None]) / 2 + reach[:, None] + ROUNDING_M
        near &= np.arange(n)[:, None] < np.arange(len(everyone))[None]
        one, other = np.nonzero(near)
        if not one.size:
            return
        outlines = outlines_of(everyone)
        moved = outlines.forward * (np.array([o.speed for o in everyone]) * dt)[:, None]
        apart = separation(outlines.rows(one), outlines.rows(other), moved[one] - moved[other])
        close = apart <= CLEARANCE_M
        for i, j in zip(one[close].tolist(), other[close].tolist(), strict=True):
            everyone[i].handle_collisions(everyone[j], dt)


def outlines_of(everyone: Sequence[RoadObject]) -> Outlines:
    """The outlines of highway-env's vehicles and objects, in its axes."""
    heading = np.array([one.heading for one in everyone])
    return Outlines(
        centre=np.array([one.position for one in everyone]),
        forward=np.stack([np.cos(heading), np.sin(heading)], axis=1),
        half=np.array([(one.LENGTH / 2, one.WIDTH / 2) for one in everyone]),
    )
