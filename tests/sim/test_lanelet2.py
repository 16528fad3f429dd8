"""Lanelet2 maps: one made by hand with known answers, its places, and those of recordings."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from sim.formats import read_recordings
from sim.road import Road
from sim.road.maps.lanelet2 import read_map

NODES = {1: (0, 3), 2: (20, 3), 3: (40, 3), 4: (0, 0), 5: (20, 0), 6: (40, 0), 7: (40, -3)}
NODES |= {8: (0, -3), 9: (20, -3)}
WAYS = {11: (1, 2), 12: (2, 3), 13: (5, 4), 14: (5, 6), 15: (8, 9), 16: (9, 7)}
LANELETS = {
    21: (11, 13, {"speed_limit": "50 km/h"}),
    22: (12, 14, {"subtype": "road", "maxspeed": "30 mph"}),
    23: (13, 15, {"subtype": "road"}),
    24: (14, 16, {"subtype": "walkway"}),
}


def osm(place: str = "local", rules: str = "") -> str:
    """The map as text: two lanes side by side, one of them with a sidewalk after it."""
    nodes = ""
    for i, (x, y) in NODES.items():
        if place == "xy":
            nodes += f'<node id="{i}" x="{x}" y="{y}"/>'
        elif place == "local":
            tags = f'<tag k="local_x" v="{x}"/><tag k="local_y" v="{y}"/>'
            nodes += f'<node id="{i}" lat="0" lon="0">{tags}</node>'
        else:
            nodes += f'<node id="{i}" lat="{y / 110_574:.9f}" lon="{x / 111_320:.9f}"/>'
    ways = "".join(
        f'<way id="{i}">' + "".join(f'<nd ref="{n}"/>' for n in nodes) + "</way>"
        for i, nodes in WAYS.items()
    )
    lanelets = "".join(
        f'<relation id="{i}"><member type="way" ref="{left}" role="left"/>'
        f'<member type="way" ref="{right}" role="right"/><tag k="type" v="lanelet"/>'
        + "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())
        + "</relation>"
        for i, (left, right, tags) in LANELETS.items()
    )
    return f"<?xml version='1.0'?><osm>{nodes}{ways}{lanelets}{rules}</osm>"


def read(folder: Path, text: str) -> Road:
    path = folder / "place.osm"
    path.write_text(text)
    return read_map(path)


@pytest.mark.parametrize("place", ["local", "xy"])
def test_lanes(tmp_path: Path, place: str) -> None:
    road = read(tmp_path, osm(place))
    first, second, beside, walk = road.lanes
    assert first.centerline.tolist() == [[0.0, 1.5], [20.0, 1.5]]
    assert [lane.width_m for lane in road.lanes] == [3.0] * 4
    assert first.speed_limit_mps == pytest.approx(50 / 3.6)
    assert second.speed_limit_mps == pytest.approx(30 * 0.44704)
    assert math.isnan(beside.speed_limit_mps)
    assert (first.edge, first.index) == (beside.edge, 1)
    assert (walk.walking, walk.cars) == (True, False)
    assert [(way.from_lane, way.to_lane) for way in road.connections] == [("21", "22")]
    assert road.knows.unknown == ("signals", "priority")


def test_latitudes_and_longitudes_around_zero_are_projected(tmp_path: Path) -> None:
    road = read(tmp_path, osm("degrees"))
    np.testing.assert_allclose(road.lanes[0].centerline, [[0, 1.5], [20, 1.5]], atol=0.05)


def test_latitudes_and_longitudes_are_projected_to_their_zone(tmp_path: Path) -> None:
    text = re.sub(r'lat="([-.0-9]+)" lon="([-.0-9]+)"', moved_to_49_north, osm("degrees"))
    line = read(tmp_path, text).lanes[0].centerline
    # the textbook's place of 49 degrees north on the central meridian of a zone
    np.testing.assert_allclose(line[0], [500_000.0, 5_427_455.8 + 1.5], atol=0.1)


def moved_to_49_north(found: re.Match[str]) -> str:
    return f'lat="{float(found[1]) + 49}" lon="{float(found[2]) + 9}"'


def test_priority(tmp_path: Path) -> None:
    rule = (
        '<relation id="31"><member type="relation" ref="21" role="yield"/>'
        '<member type="relation" ref="22" role="right_of_way"/>'
        '<tag k="type" v="regulatory_element"/><tag k="subtype" v="right_of_way"/></relation>'
    )
    road = read(tmp_path, osm(rules=rule))
    assert road.knows.priority
    assert [way.must_yield for way in road.connections] == [True]


def test_the_map_is_found_by_the_folders_name(tmp_path: Path) -> None:
    for folder in ("maps", "place"):
        (tmp_path / folder).mkdir()
    (tmp_path / "maps" / "place.osm").write_text(osm())
    head = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n"
    rows = "".join(f"1,{i},{100 * i},car,{i},1.5,10,0,0,4,2\n" for i in range(30))
    (tmp_path / "place" / "vehicle_tracks_000.csv").write_text(head + rows)
    (recording,) = read_recordings(tmp_path / "place")
    assert isinstance(recording.road, Road)
    assert recording.road.name == "place"


@pytest.mark.parametrize(
    ("found", "instead"),
    [
        ('<nd ref="9"/><nd ref="7"/>', '<nd ref="9"/><nd ref="99"/>'),  # a node that is not there
        ('<nd ref="9"/><nd ref="7"/>', '<nd ref="9"/>'),
        ('ref="16" role="right"', 'ref="77" role="right"'),
        ('ref="16" role="right"', 'ref="16" role="rihgt"'),
        ('k="subtype" v="walkway"', 'k="speed_limit" v="fast"'),
    ],
)
def test_one_bad_lanelet_is_left_out(tmp_path: Path, found: str, instead: str) -> None:
    text = osm()
    assert found in text
    road = read(tmp_path, text.replace(found, instead))
    assert [lane.id for lane in road.lanes] == ["21", "22", "23"]
    assert "1 lanelets are left out, first" in road.doubts[0]
