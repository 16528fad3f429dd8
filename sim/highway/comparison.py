"""The same traffic on highway-env's own roads and on the roads of this package."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle

from behaviors.labels import BEHAVIORS
from behaviors.profiles import sample_profile
from sim.highway.ego import highway_route
from sim.highway.fast_road import FastRoad
from sim.highway.network import HighwayNetwork, LaneInfo
from sim.highway.traffic import TrafficRoad
from sim.highway.vehicle import Driver, ProfileVehicle
from sim.road import Road as SumoRoad

LANES: Final = 4
SPACING_M: Final = 24.0
"""Mean distance between cars on a lane, m (they interact)."""


def straight_traffic(road: str, cars: int, seed: int) -> Any:
    """A straight road with cars, which have the same places and speeds on every kind of road.

    Args:
        road: ``stock`` (highway-env's road and drivers), ``fast`` (`FastRoad` with highway-env's
            drivers), ``stock-profiles`` (highway-env's road with our drivers), ``objects`` or
            ``compiled`` (`TrafficRoad` with our drivers, stepped one by one or by the kernels).
        cars: how many.
        seed: of places, speeds and profiles.
    """
    net = RoadNetwork.straight_road_network(LANES, length=20_000.0, speed_limit=25.0)
    lanes = net.lanes_dict()
    if road in ("objects", "compiled"):
        info = {index: LaneInfo() for index in lanes}
        named = SumoRoad("bench", (), (), (), (), Path("bench"))
        network = HighwayNetwork(named, net, info, lanes, {"0-1": ("0", "1")}, {}, {}, {})
        made: Any = TrafficRoad(network, compiled=road == "compiled")
    else:
        kind = FastRoad if road == "fast" else Road
        made = kind(net, np_random=np.random.RandomState(seed))
    rng = np.random.default_rng(seed)
    for i in range(cars):
        lane = net.get_lane(("0", "1", i % LANES))
        s = 50.0 + (i // LANES) * SPACING_M + float(rng.uniform(0.0, SPACING_M / 3))
        speed, wanted = float(rng.uniform(15.0, 25.0)), float(rng.uniform(18.0, 30.0))
        profile = sample_profile(BEHAVIORS[int(rng.integers(len(BEHAVIORS)))], rng)
        if road in ("stock", "fast"):
            vehicle = IDMVehicle(made, lane.position(s, 0.0), speed=speed)
            vehicle.target_speed = wanted
        else:
            vehicle = ProfileVehicle(
                made,
                lane.position(s, 0.0),
                speed=speed,
                driver=Driver(profile, seed=(seed, i)),
                agent=i,
                lane_index=("0", "1", i % LANES),
                stretches=(("0", "1"),),
            )
        made.vehicles.append(vehicle)
    return made


def stock_copy(road: TrafficRoad) -> RegulatedRoad:
    """highway-env's road for junctions, with its own drivers in the places of a road's vehicles.

    Its drivers know neither signals nor pedestrians: they slow down for those who are about to
    cross their way.
    """
    made = RegulatedRoad(road.network_info.net, np_random=np.random.RandomState(0))
    for vehicle in road.vehicles:
        lane = vehicle.lane_index
        copy = IDMVehicle(made, vehicle.position.copy(), vehicle.heading, vehicle.speed)
        copy.lane_index = copy.target_lane_index = lane
        copy.lane = made.network.get_lane(lane)
        if lane[:2] in vehicle.stretches:
            at = vehicle.stretches.index(lane[:2])
            copy.route = highway_route(lane, vehicle.stretches[at:])
        made.vehicles.append(copy)
    return made
