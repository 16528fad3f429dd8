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
from numba import njit
from numpy.typing import NDArray

from sim.highway import driving
from sim.highway.vehicle import CHANGE_LEAST_SPEED_MPS, ProfileVehicle, numbers_of

if TYPE_CHECKING:
    from sim.highway.traffic import TrafficRoad

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@njit(cache=True, error_model="numpy")
def _search(
    i: int,
    lane: int,
    order: IntArray,
    count: IntArray,
    s: FloatArray,
    along: FloatArray,
    length: FloatArray,
    sight: float,
) -> tuple[int, float, float, int, float, float]:
    """Who is ahead of and behind a vehicle on a lane: row, bumper gap and speed of both."""
    here = s[i, lane]
    low, high = 0, count[lane]
    while low < high:
        middle = (low + high) // 2
        if s[order[lane, middle], lane] < here:
            low = middle + 1
        else:
            high = middle
    front, front_gap, front_speed = -1, np.inf, 0.0
    at = low
    while at < count[lane] and order[lane, at] == i:
        at += 1
    if at < count[lane]:
        j = order[lane, at]
        gap = -here + s[j, lane] - (length[i] + length[j]) / 2
        if gap < sight:
            front, front_gap, front_speed = j, gap, along[j, lane]
    rear, rear_gap, rear_speed = -1, np.inf, 0.0
    at = low - 1
    while at >= 0 and order[lane, at] == i:
        at -= 1
    if at >= 0:
        j = order[lane, at]
        rear, rear_gap = j, here - s[j, lane] - (length[i] + length[j]) / 2
        rear_speed = along[j, lane]
    return front, front_gap, front_speed, rear, rear_gap, rear_speed


@njit(cache=True, error_model="numpy")
def _wanted_by(row: int, numbers: FloatArray, limit: float) -> float:
    if row < 0:
        return 0.0
    return float(min(numbers[row, driving.SPEED_FACTOR] * limit, numbers[row, driving.TOP_SPEED]))


@njit(cache=True, error_model="numpy")
def _decide(
    active: BoolArray,
    eligible: BoolArray,
    cutting_in: BoolArray,
    stopping: BoolArray,
    order: IntArray,
    count: IntArray,
    s: FloatArray,
    lateral: FloatArray,
    along: FloatArray,
    length: FloatArray,
    speed: FloatArray,
    heading: FloatArray,
    lane: IntArray,
    target: IntArray,
    numbers: FloatArray,
    default: FloatArray,
    stop_gap: FloatArray,
    speed_cap: FloatArray,
    clock: FloatArray,
    go_at: FloatArray,
    limit: FloatArray,
    lane_heading: float,
    sight: float,
    wanted: IntArray,
    steering: FloatArray,
    accel: FloatArray,
    cut_in: BoolArray,
) -> None:
    """Fill ``wanted``, ``steering``, ``accel``, ``go_at`` and ``cut_in`` of the active rows."""
    n, lanes = s.shape
    for i in range(n):
        if not active[i]:
            continue
        driver, mine, v = numbers[i], lane[i], speed[i]
        desired = min(
            driver[driving.SPEED_FACTOR] * limit[mine], driver[driving.TOP_SPEED], speed_cap[i]
        )
        _, gap, ahead, rear, rear_gap, rear_speed = _search(
            i, mine, order, count, s, along, length, sight
        )
        choice = mine
        if target[i] != mine:
            choice = target[i]
            for j in range(n):
                if j == i or not active[j] or target[j] != target[i] or lane[j] == target[i]:
                    continue
                beyond = s[j, mine] - s[i, mine]
                room = beyond - (length[i] + length[j]) / 2
                if beyond > 0.0 and room < driver[driving.CHANGE_GAP] + v * 0.5:
                    choice = mine
                    break
        elif eligible[i]:
            most = 0.0
            for side in (mine - 1, mine + 1):
                if side < 0 or side >= lanes:
                    continue
                _, new_gap, new_speed, new_rear, new_rear_gap, new_rear_speed = _search(
                    i, side, order, count, s, along, length, sight
                )
                if cutting_in[i] and driving.may_cut_in(
                    driver, v, new_gap, new_speed, new_rear_gap, new_rear_speed
                ):
                    choice = side
                    cut_in[i] = True
                    break
                gain = driving.change_incentive(
                    driver,
                    v,
                    desired,
                    gap,
                    ahead,
                    new_gap,
                    new_speed,
                    numbers[new_rear] if new_rear >= 0 else default,
                    new_rear_speed,
                    _wanted_by(new_rear, numbers, limit[mine]),
                    new_rear_gap,
                    new_rear_gap + length[i] + new_gap,
                    numbers[rear] if rear >= 0 else default,
                    rear_speed,
                    _wanted_by(rear, numbers, limit[mine]),
                    rear_gap,
                    rear_gap + length[i] + gap,
                )
                if gain > most:
                    choice, most = side, gain
        a = driving.follow(driver, v, desired, gap, ahead)
        if choice != mine:
            _, new_gap, new_speed, _, _, _ = _search(
                i, choice, order, count, s, along, length, sight
            )
            a = min(a, driving.follow(driver, v, desired, new_gap, new_speed))
        if stop_gap[i] < np.inf:
            a = min(a, driving.approach(driver, v, stop_gap[i]))
        if stopping[i]:
            a = min(a, -driver[driving.COMFORT_DECEL])
        a, go_at[i] = driving.start_up(driver, v, a, clock[i], go_at[i])
        wanted[i], accel[i] = choice, a
        steering[i] = driving.steer(lateral[i, choice], lane_heading, 0.0, heading[i], v, length[i])


@njit(cache=True, error_model="numpy")
def _move(
    mask: BoolArray,
    crashed: BoolArray,
    xy: FloatArray,
    heading: FloatArray,
    speed: FloatArray,
    length: FloatArray,
    steering: FloatArray,
    accel: FloatArray,
    most: float,
    dt: float,
) -> None:
    """highway-env's kinematic bicycle for ``dt`` seconds, in place."""
    for i in range(len(mask)):
        if not mask[i]:
            continue
        angle, a, v = steering[i], accel[i], speed[i]
        if crashed[i]:
            angle, a = 0.0, -v
        if v > most:
            a = min(a, most - v)
        slip = math.atan(0.5 * math.tan(angle))
        xy[i, 0] += v * math.cos(heading[i] + slip) * dt
        xy[i, 1] += v * math.sin(heading[i] + slip) * dt
        heading[i] += v * math.sin(slip) / (length[i] / 2.0) * dt
        speed[i] = max(v + a * dt, 0.0)


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
        self._numbers = np.empty((0, 13))
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
            self._numbers = np.array(rows).reshape(-1, 13)
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
        _decide(
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
        _move(
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
