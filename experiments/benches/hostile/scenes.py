"""Small recordings with maps, by hand: what the tests of formats read, alter and break."""

from __future__ import annotations


def _xy(x: float, y: float) -> str:
    return f"<point><x>{x}</x><y>{y}</y></point>"


def _state(x: float, y: float, heading: float, time: float, speed: float) -> str:
    return (
        f"<position>{_xy(x, y)}</position><orientation><exact>{heading}</exact></orientation>"
        f"<time><exact>{time}</exact></time><velocity><exact>{speed}</exact></velocity>"
    )


COMMONROAD = f"""<?xml version="1.0" encoding="utf-8"?>
<commonRoad benchmarkID="A_B-1_1_T-1" commonRoadVersion="2020a" timeStepSize="0.1">
<lanelet id="1"><leftBound>{_xy(0, 2)}{_xy(50, 2)}</leftBound>
<rightBound>{_xy(0, -2)}{_xy(50, -2)}</rightBound>
<successor ref="2"/><trafficSignRef ref="5"/><trafficLightRef ref="6"/></lanelet>
<lanelet id="2"><leftBound>{_xy(50, 2)}{_xy(90, 2)}</leftBound>
<rightBound>{_xy(50, -2)}{_xy(70, -2)}{_xy(90, -2)}</rightBound></lanelet>
<trafficSign id="5"><trafficSignElement><trafficSignID>274</trafficSignID>
<additionalValue>13.5</additionalValue></trafficSignElement></trafficSign>
<trafficLight id="6"><cycle><cycleElement><duration>300</duration><color>green</color>
</cycleElement><cycleElement><duration>30</duration><color>yellow</color></cycleElement>
<cycleElement><duration>270</duration><color>red</color></cycleElement></cycle></trafficLight>
<intersection id="7"><incoming id="8"><incomingLanelet ref="1"/><successorsStraight ref="2"/>
</incoming></intersection>
<dynamicObstacle id="30"><type>truck</type>
<shape><rectangle><length>8.5</length><width>2.5</width></rectangle></shape>
<initialState>{_state(1, 0, 0, 0, 10)}</initialState>
<trajectory><state>{_state(2, 0.5, 0.25, 1, 10.5)}</state></trajectory></dynamicObstacle>
<staticObstacle id="31"><type>parkedVehicle</type>
<initialState>{_state(9, -3, 0, 0, 0)}</initialState></staticObstacle>
<staticObstacle id="32"><type>pillar</type>
<initialState>{_state(9, -9, 0, 0, 0)}</initialState></staticObstacle>
</commonRoad>
"""
"""A truck and a parked car on two lanelets, the second of which is a junction."""


KITTI_LABELS = """\
0 -1 DontCare -1 -1 -10 1 2 3 4 -1000 -1000 -1000 -10 -1 -1 -1
0 3 Car 0 0 -1.5 1 2 3 4 1.5 1.75 4.25 2 1.5 10 -1.5707963
0 7 Pedestrian 0 0 0 1 2 3 4 1.75 0.5 0.75 -3 1.5 8 0
1 3 Car 0 0 -1.5 1 2 3 4 1.5 1.75 4.25 2 1.5 9 -1.5707963
"""
"""A car ahead on the right, and a pedestrian on the left, seen from a car that drives a metre."""

KITTI_CALIB = """\
P0: 1 0 0 0 0 1 0 0 0 0 1 0
R_rect 1 0 0 0 1 0 0 0 1
Tr_velo_cam 0 -1 0 0 0 0 -1 0 1 0 0 0
Tr_imu_velo 1 0 0 -0.5 0 1 0 0 0 0 1 0
"""
"""A camera half a metre before the measuring unit: its x is the car's right, its z ahead."""

KITTI_OXTS = "".join(
    f"49.0 {8.0 + metres / 73034.0:.12f} 100 0 0 0" + " 0" * 24 + "\n" for metres in (0.0, 1.0)
)
"""Two poses a metre apart, eastward: a degree of longitude at 49 degrees north is 73.03 km."""


def waymo_message() -> bytes:
    """A scenario of two steps as protobuf: a car, a cyclist seen once, a light and three lanes."""
    from sim.formats.waymo.messages import scenario_class

    scenario = scenario_class()(scenario_id=b"abc123", sdc_track_index=0)
    scenario.timestamps_seconds.extend([0.0, 0.1])
    car = scenario.tracks.add(id=5, object_type=1)
    car.states.add(
        center_x=1, center_y=2, length=4.5, width=2, heading=0.5, velocity_x=3, velocity_y=4,
        valid=True,
    )  # fmt: skip
    car.states.add(
        center_x=1.3, center_y=2.4, length=4.5, width=2, heading=0.5, velocity_x=3, velocity_y=4,
        valid=True,
    )  # fmt: skip
    cyclist = scenario.tracks.add(id=9, object_type=3)
    cyclist.states.add(valid=False)
    cyclist.states.add(
        center_x=8, center_y=9, length=2, width=0.5, heading=-1, velocity_x=1, valid=True
    )
    scenario.tracks.add(id=11, object_type=4).states.add(valid=True, length=1, width=1)
    for identity, y, begin in ((21, 0.0, 0.0), (22, 0.0, 30.0), (23, 3.5, 0.0)):
        lane = scenario.map_features.add(id=identity).lane
        lane.speed_limit_mph, lane.type, lane.interpolating = 30, 2, identity == 22
        for x in (begin, begin + 15, begin + 30):
            lane.polyline.add(x=x, y=y)
    scenario.map_features[0].lane.exit_lanes.append(22)
    scenario.map_features[0].lane.left_neighbors.add(feature_id=23)
    walk = scenario.map_features.add(id=31).crosswalk
    for x, y in ((10, -2), (13, -2), (13, 6), (10, 6)):
        walk.polygon.add(x=x, y=y)
    scenario.map_features.add(id=32).stop_sign.lane.append(23)
    for state in (4, 6):
        scenario.dynamic_map_states.add().lane_states.add(lane=22, state=state)
    data: bytes = scenario.SerializeToString()
    return data


def waymo_record() -> bytes:
    """The same as a TFRecord file."""
    from sim.formats.waymo.tfrecord import write_record

    return write_record(waymo_message())
