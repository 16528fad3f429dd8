"""All drivers of a straight road at once, in compiled code.

Decides and moves exactly as `ProfileVehicle.act` and `ProfileVehicle.step` do, by the same
equations (`sim.highway.driving`), but in one loop over arrays; what is drawn by chance is still
drawn by each driver. Vehicles are read at the beginning of a step and written back at its end, so
whoever changes one in between (its place, its speed, its profile) is heeded at the next step. The
matrix of the drivers' numbers is kept between steps and made anew when a vehicle comes, goes or
gets another profile.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sim.highway import driving
from sim.highway.vehicle import (
    CHANGE_LEAST_SPEED_MPS,
    DEFAULT_DRIVER,
    ProfileVehicle,
    numbers_of,
)

if TYPE_CHECKING:
    from sim.highway.traffic import TrafficRoad

FloatArray = NDArray[np.float64]


class StraightTraffic:
    """Stands in for the vehicles' own ``act`` and ``step`` on a road of one straight stretch.

    Args:
        road: whose vehicles to drive.

    Raises:
        InputError: if the road has junctions or bends.
    """

    def __init__(self, road: TrafficRoad) -> None:
        from sim.highway.traffic import check_single_stretch

        self.road = road
        self.stretch = check_single_stretch(road.network_info)
        lanes = road.network.graph[self.stretch[0]][self.stretch[1]]
        self.lanes = lanes
        self.keys = [(*self.stretch, i) for i in range(len(lanes))]
        self._limit = np.array([lane.speed_limit for lane in lanes], dtype=np.float64)
        self._heading = float(lanes[0].heading)
        self._cached: list[FloatArray] = []
        self._numbers = np.empty((0, DEFAULT_DRIVER.size))
        self._wanted = np.empty(0, dtype=np.int64)
        self._steering = self._accel = np.empty(0)

    def _rows(self, vehicles: list[object]) -> FloatArray:
        """Everybody's numbers, made anew only if somebody's are other ones."""
        rows = [numbers_of(vehicle) for vehicle in vehicles]
        same = len(rows) == len(self._cached) and all(
            a is b for a, b in zip(rows, self._cached, strict=True)
        )
        if not same:
            self._cached = rows
            self._numbers = np.array(rows).reshape(-1, DEFAULT_DRIVER.size)
        return self._numbers

    def act(self) -> None:
        """Decide for everybody; after the road's `look` and orders."""
        from sim.highway.traffic import SIGHT_M
        from sim.highway.vehicle import DEFAULT_DRIVER

        road, vehicles = self.road, self.road.vehicles
        n = len(vehicles)
        drivers = [v if isinstance(v, ProfileVehicle) else None for v in vehicles]
        for vehicle, driver in zip(vehicles, drivers, strict=True):
            if driver is None:
                vehicle.act()
        if n == 0:
            self._wanted = np.empty(0, dtype=np.int64)
            return
        active = np.array([d is not None and not d.crashed for d in drivers])
        speed = np.array([v.speed for v in vehicles], dtype=np.float64)
        lane = np.array([v.lane_index[2] for v in vehicles], dtype=np.int64)
        target = np.array(
            [lane[i] if d is None else d.target_lane_index[2] for i, d in enumerate(drivers)],
            dtype=np.int64,
        )
        late = np.array([d is not None and d.timer > d.LANE_CHANGE_DELAY for d in drivers])
        late &= active & (lane == target)
        changes = np.array([d is not None and d.orders.changes for d in drivers])
        eligible = late & changes & (speed >= CHANGE_LEAST_SPEED_MPS)
        cutting_in, stopping = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        stop_gap, cap = np.full(n, np.inf), np.full(n, np.inf)
        clock, go_at = np.zeros(n), np.full(n, np.inf)
        for i, driver in enumerate(drivers):
            if driver is None or not active[i]:
                continue
            if late[i]:
                driver.timer = 0.0
            if eligible[i]:
                cutting_in[i] = driver.wants_cut_in()
            stopping[i] = driver.wants_stop()
            stop_gap[i], cap[i] = driver.orders.stop_gap, driver.orders.speed_cap
            clock[i], go_at[i] = driver.clock, driver.go_at
        order, count = road.sorted_rows(self.keys)
        s, lateral, along, length = road.lane_table(self.keys)
        self._wanted, self._steering, self._accel = lane.copy(), np.zeros(n), np.zeros(n)
        cut_in = np.zeros(n, dtype=bool)
        driving.decide(
            active, eligible, cutting_in, stopping, order, count, s, lateral, along, length,
            speed, np.array([v.heading for v in vehicles], dtype=np.float64), lane, target,
            self._rows(vehicles), DEFAULT_DRIVER, stop_gap, cap, clock, go_at, self._limit,
            self._heading, SIGHT_M, self._wanted, self._steering, self._accel, cut_in,
        )  # fmt: skip
        for i, driver in enumerate(drivers):
            if driver is None:
                continue
            driver.go_at = float(go_at[i]) if active[i] else driver.go_at
            driver.wanted_lane_index = self.keys[self._wanted[i]]
            if cut_in[i]:
                driver.cut_in_done()

    def step(self, dt: float) -> None:
        """Move everybody for ``dt`` seconds."""
        vehicles = self.road.vehicles
        n = len(vehicles)
        if n == 0:
            return
        mine = np.array([isinstance(v, ProfileVehicle) for v in vehicles])
        xy = np.array([v.position for v in vehicles], dtype=np.float64)
        heading = np.array([v.heading for v in vehicles], dtype=np.float64)
        speed = np.array([v.speed for v in vehicles], dtype=np.float64)
        driving.move(
            mine,
            np.array([bool(v.crashed) for v in vehicles]),
            xy,
            heading,
            speed,
            np.array([v.LENGTH for v in vehicles], dtype=np.float64),
            self._steering,
            self._accel,
            float(ProfileVehicle.MAX_SPEED),
            dt,
        )
        across = np.abs(
            np.stack([(xy - lane.start) @ lane.direction_lateral for lane in self.lanes], axis=1)
        )
        for i, vehicle in enumerate(vehicles):
            if not mine[i]:
                vehicle.step(dt)
                continue
            vehicle.position = xy[i]
            vehicle.heading = float(heading[i])
            vehicle.speed = float(speed[i])
            vehicle.timer += dt
            vehicle.clock += dt
            vehicle.action = {
                "steering": float(self._steering[i]),
                "acceleration": float(self._accel[i]),
            }
            goal = vehicle.target_lane_index = vehicle.wanted_lane_index
            if goal != vehicle.lane_index and (
                across[i, goal[2]] < across[i, vehicle.lane_index[2]]
            ):
                vehicle.lane_index, vehicle.lane = goal, self.lanes[goal[2]]
                vehicle.changed_at = vehicle.clock
            if vehicle.speed > driving.STANDING_MPS:
                vehicle.standing_since = math.inf
            elif vehicle.standing_since == math.inf:
                vehicle.standing_since = vehicle.clock
