"""All drivers of a straight road at once, in compiled code.

They decide and move exactly as by `ProfileVehicle.act` and `ProfileVehicle.step`, by the same
functions (`sim.highway.driving`), but in one loop over arrays; random numbers are still drawn by
each driver. Vehicles are read at the beginning of a step and written back at its end, so a vehicle
that is changed in between (its place, its speed, its profile) drives on accordingly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from highway_env.road.lane import StraightLane
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.compiled import compiled, inner
from sim.highway.driving import (
    CHANGE_GAP,
    COMFORT_DECEL,
    SPEED_FACTOR,
    TOP_SPEED,
    Follower,
    Leader,
    approach,
    change_incentive,
    follow,
    may_cut_in,
    start_up,
    steer,
)
from sim.highway.network import HighwayNetwork
from sim.highway.state import LEADER_RANGE_M, LaneTable, RoadState
from sim.highway.vehicle import (
    CHANGE_LEAST_SPEED_MPS,
    DEFAULT_PARAMETERS,
    ProfileVehicle,
    parameters_of,
)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Drivers(NamedTuple):
    """Everybody on the road, one row each.

    Attributes:
        active: (n,) whether the vehicle is driven by a profile and has not crashed.
        may_change: (n,) whether its driver considers a lane change now.
        cutting_in: (n,) whether it looks for a vehicle to cut in front of.
        stopping: (n,) whether it stops for no reason.
        speed: (n,) m/s.
        heading: (n,) rad.
        length: (n,) m.
        lane: (n,) present lane.
        target: (n,) lane it is changing to, or the present one.
        parameters: (n, 14) as from `sim.highway.driving.driver_parameters`.
        stop_gap: (n,) m; see `sim.highway.vehicle.DriverCommands`.
        speed_cap: (n,) m/s.
        clock: (n,) the driver's time, s.
    """

    active: BoolArray
    may_change: BoolArray
    cutting_in: BoolArray
    stopping: BoolArray
    speed: FloatArray
    heading: FloatArray
    length: FloatArray
    lane: IntArray
    target: IntArray
    parameters: FloatArray
    stop_gap: FloatArray
    speed_cap: FloatArray
    clock: FloatArray


class Decisions(NamedTuple):
    """What the drivers decide, one row each.

    Attributes:
        lane: (n,) lane to head for.
        steering: (n,) rad.
        accel: (n,) m/s2.
        cut_in: (n,) whether the driver cuts in.
        go_at: (n,) when a standing vehicle may start, s; read and written.
    """

    lane: IntArray
    steering: FloatArray
    accel: FloatArray
    cut_in: BoolArray
    go_at: FloatArray


@inner
def _search(
    i: int, lane: int, table: LaneTable, length: FloatArray
) -> tuple[int, float, float, int, float, float]:
    """The vehicles ahead and behind on a lane: row (-1: none), bumper gap and speed of both."""
    here = table.s[i, lane]
    order, count = table.order[lane], table.number[lane]
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        if table.s[order[middle], lane] < here:
            low = middle + 1
        else:
            high = middle
    front, front_gap, front_speed = -1, np.inf, 0.0
    at = low
    while at < count and order[at] == i:
        at += 1
    if at < count:
        j = order[at]
        gap = -here + table.s[j, lane] - (length[i] + length[j]) / 2
        if gap < LEADER_RANGE_M:
            front, front_gap, front_speed = j, gap, table.along[j, lane]
    rear, rear_gap, rear_speed = -1, np.inf, 0.0
    at = low - 1
    while at >= 0 and order[at] == i:
        at -= 1
    if at >= 0:
        j = order[at]
        rear, rear_gap = j, here - table.s[j, lane] - (length[i] + length[j]) / 2
        rear_speed = table.along[j, lane]
    return front, front_gap, front_speed, rear, rear_gap, rear_speed


@inner
def _follower(
    row: int, speed: float, gap: float, front_gap: float, limit: float, parameters: FloatArray,
    default: FloatArray,
) -> Follower:  # fmt: skip
    driver = parameters[row] if row >= 0 else default
    desired = min(driver[SPEED_FACTOR] * limit, driver[TOP_SPEED]) if row >= 0 else 0.0
    return Follower(driver, speed, desired, gap, front_gap)


@inner
def _finish_change(i: int, drivers: Drivers, table: LaneTable) -> int:
    """The target lane, or the present one if a vehicle just ahead changes to the same lane."""
    mine, target = drivers.lane[i], drivers.target[i]
    least = drivers.parameters[i, CHANGE_GAP] + drivers.speed[i] * 0.5
    for j in range(drivers.lane.size):
        if j == i or not drivers.active[j]:
            continue
        if drivers.target[j] != target or drivers.lane[j] == target:
            continue
        ahead = table.s[j, mine] - table.s[i, mine]
        if ahead > 0.0 and ahead - (drivers.length[i] + drivers.length[j]) / 2 < least:
            return int(mine)
    return int(target)


@inner
def _choose_lane(
    i: int, desired: float, limit: float, drivers: Drivers, table: LaneTable, default: FloatArray
) -> tuple[int, bool]:
    """The best lane beside the present one or that one, and whether the driver cuts in there."""
    driver, mine, speed = drivers.parameters[i], drivers.lane[i], drivers.speed[i]
    length = drivers.length
    _, gap, ahead, rear, rear_gap, rear_speed = _search(i, mine, table, length)
    follower = _follower(
        rear, rear_speed, rear_gap, rear_gap + length[i] + gap, limit, drivers.parameters, default
    )
    choice, most = mine, 0.0
    for side in (mine - 1, mine + 1):
        if side < 0 or side >= table.number.size:
            continue
        _, new_gap, new_speed, rear, rear_gap, rear_speed = _search(i, side, table, length)
        if drivers.cutting_in[i] and may_cut_in(
            driver, speed, new_gap, new_speed, rear_gap, rear_speed
        ):
            return side, True
        new_follower = _follower(
            rear, rear_speed, rear_gap, rear_gap + length[i] + new_gap, limit,
            drivers.parameters, default,
        )  # fmt: skip
        gain = change_incentive(
            driver, speed, desired, Leader(gap, ahead), Leader(new_gap, new_speed), follower,
            new_follower,
        )  # fmt: skip
        if gain > most:
            choice, most = side, gain
    return choice, False


@compiled
def decide(
    drivers: Drivers,
    table: LaneTable,
    limit: FloatArray,
    lane_heading: float,
    default: FloatArray,
    decisions: Decisions,
) -> None:
    """Fill the decisions of the active drivers.

    Args:
        drivers: everybody.
        table: where they are; lanes from left to right.
        limit: (k,) speed limits, m/s.
        lane_heading: rad.
        default: parameters assumed of vehicles without a profile.
        decisions: written.
    """
    for i in range(drivers.lane.size):
        if not drivers.active[i]:
            continue
        driver, mine, speed = drivers.parameters[i], drivers.lane[i], drivers.speed[i]
        desired = min(driver[SPEED_FACTOR] * limit[mine], driver[TOP_SPEED], drivers.speed_cap[i])
        choice = mine
        if drivers.target[i] != mine:
            choice = _finish_change(i, drivers, table)
        elif drivers.may_change[i]:
            choice, decisions.cut_in[i] = _choose_lane(
                i, desired, limit[mine], drivers, table, default
            )
        _, gap, ahead, _, _, _ = _search(i, mine, table, drivers.length)
        accel = follow(driver, speed, desired, gap, ahead)
        if choice != mine:
            _, gap, ahead, _, _, _ = _search(i, choice, table, drivers.length)
            accel = min(accel, follow(driver, speed, desired, gap, ahead))
        if drivers.stop_gap[i] < np.inf:
            accel = min(accel, approach(driver, speed, drivers.stop_gap[i]))
        if drivers.stopping[i]:
            accel = min(accel, -driver[COMFORT_DECEL])
        accel, go_at = start_up(driver, speed, accel, drivers.clock[i], decisions.go_at[i])
        decisions.go_at[i], decisions.lane[i], decisions.accel[i] = go_at, choice, accel
        lateral = table.lateral[i, choice]
        decisions.steering[i] = steer(
            lateral, lane_heading, 0.0, drivers.heading[i], speed, drivers.length[i]
        )


@compiled
def move(
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
    """Move the vehicles of ``mask`` by highway-env's kinematic bicycle for ``dt`` s, in place."""
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

    def __init__(self, road: RoadState) -> None:
        self.road = road
        stretch = single_stretch(road.network_info)
        lanes = road.network.graph[stretch[0]][stretch[1]]
        self.lanes = lanes
        self.keys = [(*stretch, i) for i in range(len(lanes))]
        self._limit = np.array([lane.speed_limit for lane in lanes], dtype=np.float64)
        self._heading = float(lanes[0].heading)
        self._rows: list[FloatArray] = []
        self._parameters = np.empty((0, DEFAULT_PARAMETERS.size))
        self._steering = self._accel = np.empty(0)

    def _all_parameters(self, vehicles: list[Vehicle]) -> FloatArray:
        """Everybody's driver parameters, (n, 14), built again only if somebody's changed."""
        rows = [parameters_of(vehicle) for vehicle in vehicles]
        if len(rows) != len(self._rows) or any(
            a is not b for a, b in zip(rows, self._rows, strict=True)
        ):
            self._rows = rows
            self._parameters = np.array(rows).reshape(-1, DEFAULT_PARAMETERS.size)
        return self._parameters

    def act(self) -> None:
        """Decide for everybody; after the road's `locate` and the rules' commands."""
        vehicles = self.road.vehicles
        for vehicle in vehicles:
            if not isinstance(vehicle, ProfileVehicle):
                vehicle.act()
        if not vehicles:
            return
        drivers = self._read_drivers(vehicles)
        n = len(vehicles)
        go_at = [v.go_at if isinstance(v, ProfileVehicle) else math.inf for v in vehicles]
        decisions = Decisions(
            lane=drivers.lane.copy(),
            steering=np.zeros(n),
            accel=np.zeros(n),
            cut_in=np.zeros(n, dtype=bool),
            go_at=np.array(go_at),
        )
        table = self.road.lane_table(self.keys)
        decide(drivers, table, self._limit, self._heading, DEFAULT_PARAMETERS, decisions)
        self._steering, self._accel = decisions.steering, decisions.accel
        for i, driver in enumerate(vehicles):
            if not isinstance(driver, ProfileVehicle):
                continue
            driver.go_at = float(decisions.go_at[i])
            driver.wanted_lane_index = self.keys[decisions.lane[i]]
            if decisions.cut_in[i]:
                driver.schedule_cut_in()

    def _read_drivers(self, vehicles: list[Vehicle]) -> Drivers:
        n = len(vehicles)
        active, may_change = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        cutting_in, stopping = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        stop_gap, cap, clock = np.full(n, np.inf), np.full(n, np.inf), np.zeros(n)
        lane = np.array([v.lane_index[2] for v in vehicles], dtype=np.int64)
        target = lane.copy()
        for i, driver in enumerate(vehicles):
            if not isinstance(driver, ProfileVehicle):
                continue
            target[i] = driver.target_lane_index[2]
            if driver.crashed:
                continue
            active[i] = True
            if lane[i] == target[i] and driver.timer > driver.LANE_CHANGE_DELAY:
                driver.timer = 0.0
                if driver.commands.changes and driver.speed >= CHANGE_LEAST_SPEED_MPS:
                    may_change[i] = True
                    cutting_in[i] = driver.wants_cut_in()
            stopping[i] = driver.wants_stop()
            stop_gap[i], cap[i] = driver.commands.stop_gap, driver.commands.speed_cap
            clock[i] = driver.clock
        return Drivers(
            active=active,
            may_change=may_change,
            cutting_in=cutting_in,
            stopping=stopping,
            speed=np.array([v.speed for v in vehicles], dtype=np.float64),
            heading=np.array([v.heading for v in vehicles], dtype=np.float64),
            length=self.road.lengths,
            lane=lane,
            target=target,
            parameters=self._all_parameters(vehicles),
            stop_gap=stop_gap,
            speed_cap=cap,
            clock=clock,
        )

    def step(self, dt: float) -> None:
        """Move everybody for ``dt`` seconds."""
        vehicles = self.road.vehicles
        if not vehicles:
            return
        mine = np.array([isinstance(v, ProfileVehicle) for v in vehicles])
        xy = np.array([v.position for v in vehicles], dtype=np.float64)
        heading = np.array([v.heading for v in vehicles], dtype=np.float64)
        speed = np.array([v.speed for v in vehicles], dtype=np.float64)
        crashed = np.array([bool(v.crashed) for v in vehicles])
        length = np.array([v.LENGTH for v in vehicles], dtype=np.float64)
        most = float(ProfileVehicle.MAX_SPEED)
        move(mine, crashed, xy, heading, speed, length, self._steering, self._accel, most, dt)
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
            vehicle.update_standing()


def is_single_stretch(network: HighwayNetwork) -> bool:
    """Whether a road is one straight stretch."""
    straight = all(type(lane) is StraightLane for lane in network.lanes.values())
    return straight and len(set(network.stretch_of.values())) == 1


def single_stretch(network: HighwayNetwork) -> tuple[str, str]:
    """The only stretch of a straight road.

    Raises:
        InputError: if there are several, or it bends.
    """
    if not is_single_stretch(network):
        raise InputError(
            f"compiled: found road {network.road.name!r} with junctions or bends, "
            "expected one straight stretch"
        )
    return next(iter(network.stretch_of.values()))
