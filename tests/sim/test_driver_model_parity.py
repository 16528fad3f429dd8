"""The driver models against the same laws in SUMO and in highway-env."""

import libsumo
import numpy as np
import pytest
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle

from behaviors.driver_models import (
    idm_desired_gap,
    idm_free_acceleration,
    idm_interaction,
    krauss_safe_speed,
    mobil_incentive,
    mobil_safe,
)

# SUMO ----------------------------------------------------------------------------------------

ACCEL, DECEL, HEADWAY, MIN_GAP, LIMIT, STEP_S = 1.2, 3.0, 1.3, 2.0, 30.0, 0.1

NET = """<net version="1.16">
<location netOffset="0,0" convBoundary="0,0,900,0" origBoundary="0,0,900,0" projParameter="!"/>
<edge id="e" from="a" to="b">
<lane id="e_0" index="0" speed="30" length="900" shape="0,0 900,0"/></edge>
<junction id="a" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0 0,3"/>
<junction id="b" type="dead_end" x="900" y="0" incLanes="e_0" intLanes="" shape="900,0 900,3"/>
</net>"""

NUMBERS = 'accel="1.2" decel="3" tau="1.3" minGap="2" sigma="0" speedFactor="1" speedDev="0"'

ROUTES = f"""<routes>
<vType id="krauss" carFollowModel="KraussOrig1" {NUMBERS}/>
<vType id="idm" carFollowModel="IDM" stepping="{STEP_S}" {NUMBERS}/>
<vehicle id="krauss" type="krauss" depart="0" departPos="500"><route edges="e"/></vehicle>
<vehicle id="idm" type="idm" depart="0" departPos="100"><route edges="e"/></vehicle>
</routes>"""


@pytest.fixture(scope="module")
def sumo(tmp_path_factory):
    """A SUMO run with one driver of each law on one lane."""
    folder = tmp_path_factory.mktemp("parity")
    (folder / "one.net.xml").write_text(NET)
    (folder / "one.rou.xml").write_text(ROUTES)
    libsumo.start(["sumo", "-n", str(folder / "one.net.xml"), "-r", str(folder / "one.rou.xml"),
                   "--step-length", str(STEP_S), "--no-step-log", "--no-warnings"])  # fmt: skip
    libsumo.simulationStep()
    yield libsumo
    libsumo.close()


@pytest.mark.parametrize("speed", [4.0, 10.0, 20.0])
@pytest.mark.parametrize("leader_speed", [0.0, 6.0, 18.0])
@pytest.mark.parametrize("gap", [30.0, 60.0])
def test_idm_is_sumo_s(sumo, speed, leader_speed, gap):
    wanted = idm_desired_gap(speed, leader_speed, MIN_GAP, HEADWAY, ACCEL, DECEL)
    accel = idm_free_acceleration(speed, LIMIT, ACCEL)
    accel -= ACCEL * idm_interaction(gap, wanted)
    # SUMO's gaps leave out the one at a standstill
    found = sumo.vehicle.getFollowSpeed("idm", speed, gap - MIN_GAP, leader_speed, DECEL, "")
    assert found == pytest.approx(max(speed + accel * STEP_S, 0.0), rel=1e-12)


@pytest.mark.parametrize("leader_speed", [0.0, 6.0, 18.0])
@pytest.mark.parametrize("gap", [0.5, 16.0, 60.0])
def test_krauss_safe_speed_is_sumo_s(sumo, leader_speed, gap):
    fast = 29.0  # so that the acceleration bounds nothing
    found = sumo.vehicle.getFollowSpeed("krauss", fast, gap, leader_speed, DECEL, "")
    safe = krauss_safe_speed(gap, leader_speed, HEADWAY, DECEL)
    assert found == pytest.approx(safe, rel=1e-12)


# highway-env ---------------------------------------------------------------------------------


def accel_of(follower: IDMVehicle, front: IDMVehicle | None) -> float:
    """IDM with highway-env's numbers, whose gaps are from middle to middle."""
    most, braking = follower.COMFORT_ACC_MAX, -follower.COMFORT_ACC_MIN
    accel = idm_free_acceleration(follower.speed, follower.target_speed, most)
    if front is None:
        return accel
    wanted = idm_desired_gap(
        follower.speed, front.speed, follower.DISTANCE_WANTED, follower.TIME_WANTED, most, braking
    )
    return accel - most * idm_interaction(front.position[0] - follower.position[0], wanted)


def two_lanes(seed: int) -> tuple[Road, IDMVehicle]:
    """A straight road with a vehicle, and with some luck others before and behind it."""
    rng = np.random.default_rng(seed)
    road = Road(RoadNetwork.straight_road_network(2, speed_limit=30.0), np_random=rng)
    ahead, behind = (20.0, 60.0), (-60.0, -20.0)
    for lane, span in ((0, ahead), (0, behind), (1, ahead), (1, behind)):
        if rng.random() < 0.8:
            _add(road, lane, 200.0 + rng.uniform(*span), rng.uniform(15.0, 25.0))
    ego = _add(road, 0, 200.0, rng.uniform(15.0, 25.0))
    ego.POLITENESS = rng.uniform(0.0, 1.0)
    return road, ego


def _add(road: Road, lane: int, x: float, speed: float) -> IDMVehicle:
    position = road.network.get_lane(("0", "1", lane)).position(x, 0.0)
    vehicle = IDMVehicle(road, position, 0.0, speed, target_speed=28.0)
    road.vehicles.append(vehicle)
    return vehicle


def test_idm_and_mobil_are_highway_env_s():
    decided = []
    for seed in range(200):
        road, ego = two_lanes(seed)
        front, rear = road.neighbour_vehicles(ego)
        new_front, new_rear = road.neighbour_vehicles(ego, ("0", "1", 1))
        for one, other in ((ego, front), (ego, new_front), (rear, ego), (new_rear, ego)):
            if one is not None:
                assert ego.acceleration(one, other) == pytest.approx(accel_of(one, other))
        own = accel_of(ego, new_front) - accel_of(ego, front)
        behind = new_gain = old_gain = 0.0
        if new_rear is not None:
            behind = accel_of(new_rear, ego)
            new_gain = behind - accel_of(new_rear, new_front)
        if rear is not None:
            old_gain = accel_of(rear, front) - accel_of(rear, ego)
        incentive = mobil_incentive(own, new_gain, old_gain, ego.POLITENESS)
        changes = (
            mobil_safe(behind, ego.LANE_CHANGE_MAX_BRAKING_IMPOSED)
            and incentive >= ego.LANE_CHANGE_MIN_ACC_GAIN
        )
        assert changes == ego.mobil(("0", "1", 1))
        decided.append(changes)
    assert 20 < sum(decided) < 180
