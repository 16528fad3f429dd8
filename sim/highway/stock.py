"""Traffic on highway-env's own road with its own drivers, to compare speeds with."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle

LANES: Final = 3
SPACING_M: Final = 40.0
"""Mean distance between cars on a lane, m (a dense road: they interact)."""


def stock_traffic(cars: int, seed: int) -> Any:
    """highway-env's straight road with its own drivers.

    Args:
        cars: how many.
        seed: of places and speeds.

    Returns:
        A road; ``act()`` and ``step(dt)`` move everybody.

    Examples:
        >>> road = stock_traffic(5, seed=0)
        >>> road.act()
        >>> road.step(0.1)
        >>> len(road.vehicles)
        5
    """
    net = RoadNetwork.straight_road_network(LANES, length=20_000.0, speed_limit=25.0)
    road = Road(net, np_random=np.random.RandomState(seed))
    rng = np.random.default_rng(seed)
    for i in range(cars):
        lane = net.get_lane(("0", "1", i % LANES))
        s = 50.0 + (i // LANES) * SPACING_M + float(rng.uniform(0.0, SPACING_M / 3))
        vehicle = IDMVehicle(road, lane.position(s, 0.0), speed=float(rng.uniform(8.0, 14.0)))
        vehicle.target_speed = float(rng.uniform(11.0, 17.0))
        road.vehicles.append(vehicle)
    return road
