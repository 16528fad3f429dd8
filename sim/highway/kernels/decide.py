"""The drivers' decisions: the lane to head for, the acceleration and the steering angle.

Kernels over all drivers that call the functions of `sim.highway.driving`, as `ProfileVehicle.act`
does for one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.compiled import in_place
from sim.highway.driving import (
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
from sim.highway.kernels.lane_tables import Lanes
from sim.highway.kernels.leaders import Beside, Places, beside, next_stretch, path_to

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Drivers(NamedTuple):
    """Everybody on the road, one row each.

    Attributes:
        active: (n,) whether the vehicle is driven by a profile and has not crashed.
        may_change: (n,) whether its driver considers a lane change now.
        cutting_in: (n,) whether it looks for a vehicle to cut in front of.
        lane: (n,) present lane.
        parameters: (n, 14) as from `sim.highway.driving.driver_parameters`; highway-env's own for
            a vehicle without a profile.
        known: (n,) whether it has a profile.
        speed_cap: (n,) m/s; see `sim.highway.vehicle.DriverCommands`.
        stop_gap: (n,) m.
        clock: (n,) the driver's time, s.
    """

    active: BoolArray
    may_change: BoolArray
    cutting_in: BoolArray
    lane: IntArray
    parameters: FloatArray
    speed_cap: FloatArray
    stop_gap: FloatArray
    clock: FloatArray


@in_place(inner=True)
def desired_speed(driver: FloatArray, limit: float, cap: float) -> float:
    """The speed wanted on a free road, m/s."""
    return float(min(min(driver[SPEED_FACTOR] * limit, driver[TOP_SPEED]), cap))


@in_place(inner=True)
def _follower(
    i: int, found: Beside, limit: float, length: FloatArray, parameters: FloatArray,
    default: FloatArray,
) -> Follower:  # fmt: skip
    driver, desired = default, 0.0
    if found.rear >= 0:
        driver = parameters[found.rear]
        desired = min(driver[SPEED_FACTOR] * limit, driver[TOP_SPEED])
    front_gap = found.rear_gap + length[i] + found.front_gap
    return Follower(driver, found.rear_speed, desired, found.rear_gap, front_gap)


@in_place()
def choose_lanes(
    drivers: Drivers,
    lanes: Lanes,
    places: Places,
    default: FloatArray,
    choice: IntArray,
    cut_in: BoolArray,
) -> None:
    """Weigh the lanes beside for those who consider a lane change.

    Args:
        drivers: everybody.
        lanes: of the road.
        places: where everybody is.
        default: parameters assumed where there is no follower.
        choice: (n,) the lane to head for; changed.
        cut_in: (n,) whether the driver cuts in there; changed.
    """
    for i in range(drivers.lane.size):
        if not drivers.may_change[i]:
            continue
        driver, mine, speed = drivers.parameters[i], drivers.lane[i], places.speed[i]
        limit = lanes.limit[mine]
        desired = desired_speed(driver, limit, drivers.speed_cap[i])
        then = next_stretch(i, mine, lanes, places)
        here = beside(i, mine, lanes, places)
        leader = Leader(here.front_gap, here.front_speed)
        follower = _follower(i, here, limit, places.length, drivers.parameters, default)
        most = 0.0
        for side in (lanes.left[mine], lanes.right[mine]):
            if side < 0 or (then >= 0 and path_to(side, then, lanes) < 0):
                continue
            there = beside(i, side, lanes, places)
            if drivers.cutting_in[i] and may_cut_in(
                driver, speed, there.front_gap, there.front_speed, there.rear_gap, there.rear_speed
            ):
                choice[i], cut_in[i] = side, True
                break
            new_follower = _follower(i, there, limit, places.length, drivers.parameters, default)
            new_leader = Leader(there.front_gap, there.front_speed)
            gain = change_incentive(
                driver, speed, desired, leader, new_leader, follower, new_follower
            )
            if gain > most:
                choice[i], most = side, gain


@in_place()
def accelerate(
    drivers: Drivers,
    lanes: Lanes,
    places: Places,
    choice: IntArray,
    stopping: BoolArray,
    go_at: FloatArray,
    accel: FloatArray,
) -> None:
    """Fill the accelerations of the active drivers.

    Args:
        drivers: everybody.
        lanes: of the road.
        places: where everybody is.
        choice: (n,) the lane that each heads for.
        stopping: (n,) who stops for no reason.
        go_at: (n,) when a standing vehicle may start, s; read and written.
        accel: (n,) m/s2; written.
    """
    for i in range(drivers.lane.size):
        if not drivers.active[i]:
            continue
        driver, mine, speed = drivers.parameters[i], drivers.lane[i], places.speed[i]
        desired = desired_speed(driver, lanes.limit[mine], drivers.speed_cap[i])
        here = beside(i, mine, lanes, places)
        wanted = follow(driver, speed, desired, here.front_gap, here.front_speed)
        if choice[i] != mine:
            there = beside(i, choice[i], lanes, places)
            wanted = min(wanted, follow(driver, speed, desired, there.front_gap, there.front_speed))
        if drivers.stop_gap[i] < np.inf:
            wanted = min(wanted, approach(driver, speed, drivers.stop_gap[i]))
        if stopping[i]:
            wanted = min(wanted, -driver[COMFORT_DECEL])
        accel[i], go_at[i] = start_up(driver, speed, wanted, drivers.clock[i], go_at[i])


@in_place()
def steer_all(
    active: BoolArray,
    found: FloatArray,
    heading: FloatArray,
    speed: FloatArray,
    length: FloatArray,
    steering: FloatArray,
) -> None:
    """Fill the steering angles of the active drivers, rad.

    Args:
        active: (n,) who steers.
        found: (n, 4) as from `sim.highway.kernels.lane_tables.places_on_lanes`, on the lane to head
            for.
        heading: (n,) rad.
        speed: (n,) m/s.
        length: (n,) m.
        steering: (n,) written.
    """
    for i in range(len(active)):
        if active[i]:
            lateral, lane_heading, curvature = found[i, 1], found[i, 2], found[i, 3]
            steering[i] = steer(lateral, lane_heading, curvature, heading[i], speed[i], length[i])
