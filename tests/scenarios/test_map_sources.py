"""Limits and the side of traffic of maps, as their files write them."""

from __future__ import annotations

import dataclasses
import math
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios import ENVIRONMENTS, SCENARIOS
from scenarios.environments.config import TrafficConfig
from scenarios.environments.environment import TrafficEnv
from scenarios.environments.observation import exchange_sides
from scenarios.networks.build import find_program
from scenarios.own.flows import EdgeGraph
from scenarios.own.survey import survey
from sim.engines import get_engine
from sim.frames import PEDESTRIAN
from sim.road import Connection, Lane, Road
from sim.road.maps.sources import FREE_MPS, drives_left, limit_of, prepared
from sim.road.net import read_road
from sim.scenario import Scenario, sample_agents


@pytest.mark.parametrize(
    ("text", "kmh"),
    [
        ("50", 50), ("50 km/h", 50), ("30kmh", 30), ("30 mph", 48.28), ("30mph", 48.28),
        ("50;30", 30), ("70|50|50", 50), ("30 mph;20 mph", 32.19), ("DE:zone:20", 20),
        ("DE:zone30", 30), ("zone:30", 30), ("DE:urban", 50), ("DE:rural", 100), ("FR:rural", 80),
        ("RU:urban", 60), ("GB:nsl_single", 96.56), ("walk", 7), ("none", 130), ("12.5", 12.5),
        ("signals", None), ("variable", None), ("fast", None), ("", None), ("0", None),
        ("50 @ (22:00-06:00)", None), ("5 knots", 9.26),
    ],
)  # fmt: skip
def test_limits_as_openstreetmap_writes_them(text: str, kmh: float | None) -> None:
    found = limit_of(text)
    assert (found is None) == (kmh is None)
    if kmh is not None:
        assert found is not None
        assert found * 3.6 == pytest.approx(kmh, abs=0.02)


def street_map(tags: dict[str, str], place: tuple[float, float] = (52.5, 13.3)) -> bytes:
    written = "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())
    nodes = "".join(
        f'<node id="{i}" lat="{place[0]}" lon="{place[1] + 0.004 * i}"/>' for i in (1, 2, 3)
    )
    ways = f'<way id="10"><nd ref="1"/><nd ref="2"/><nd ref="3"/>{written}</way>'
    return f'<osm version="0.6">{nodes}{ways}</osm>'.encode()


@pytest.mark.parametrize(
    ("tags", "unlimited"),
    [
        ({"maxspeed": "50;30"}, 0),
        ({"source:maxspeed": "DE:urban"}, 0),
        ({"maxspeed:forward": "50", "maxspeed:backward": "30"}, 0),
        ({"maxspeed:type": "GB:nsl_single"}, 0),
        ({}, 1),
        ({"maxspeed": "signals"}, 1),
        ({"maxspeed:conditional": "30 @ (22:00-06:00)"}, 1),
    ],
)
def test_roads_without_a_limit_are_counted(tags: dict[str, str], unlimited: int) -> None:
    content = street_map({"highway": "primary", **tags})
    found = prepared(Path("town.osm"), "openstreetmap", content)
    assert found.unlimited == unlimited
    assert any("limits of 1 of 1" in text for text in found.warnings) == bool(unlimited)


@pytest.mark.parametrize(
    ("place", "left"),
    [
        ((51.5, -0.12), True), ((35.7, 139.7), True), ((-33.9, 151.2), True),
        ((-36.8, 174.8), True),
        ((28.6, 77.2), True), ((52.5, 13.3), False), ((48.9, 2.4), False), ((50.95, 1.85), False),
        ((37.6, 127.0), False), ((40.7, -74.0), False), ((39.9, 116.4), False),
    ],
)  # fmt: skip
def test_places_where_traffic_drives_on_the_left(place: tuple[float, float], left: bool) -> None:
    assert drives_left(*place) == left
    content = street_map({"highway": "primary"}, place)
    found = prepared(Path("town.osm"), "openstreetmap", content)
    assert any("on the left" in text for text in found.warnings) == left
    assert not found.left_hand
    assert prepared(Path("town.osm"), "openstreetmap", content, left_hand=True).left_hand


def test_a_tag_says_the_side() -> None:
    content = street_map({"highway": "primary", "driving_side": "left"})
    assert prepared(Path("town.osm"), "openstreetmap", content).left_hand


def opendrive(types: str = "", speed: str = "", rule: str = "") -> bytes:
    lane = (
        '<lane id="{}" type="driving" level="false">'
        '<width sOffset="0" a="3.5" b="0" c="0" d="0"/>' + speed + "</lane>"
    )
    return (
        '<OpenDRIVE><header revMajor="1" revMinor="6" north="400" south="-400" east="400" '
        f'west="-400"/><road name="r" length="300" id="1" junction="-1" {rule}>{types}<planView>'
        '<geometry s="0" x="0" y="0" hdg="0" length="300"><line/></geometry></planView><lanes>'
        f'<laneSection s="0"><left>{lane.format(1)}</left><center><lane id="0" type="none" '
        f'level="false"/></center><right>{lane.format(-1)}</right></laneSection></lanes></road>'
        "</OpenDRIVE>"
    ).encode()


def limit(most: str, unit: str = "", at: float = 0) -> str:
    written = f' unit="{unit}"' if unit else ""
    return f'<type s="{at}" type="town"><speed max="{most}"{written}/></type>'


@pytest.mark.parametrize(
    ("types", "speed", "expected", "known"),
    [
        (limit("100", "km/h"), "", {27.78}, True),
        (limit("30", "mph"), "", {13.41}, True),
        (limit("20"), "", {20.0}, True),
        (limit("no limit"), "", {round(FREE_MPS, 2)}, True),
        (limit("undefined"), "", {13.89}, False),
        ("", "", {13.89}, False),
        (limit("100", "km/h") + limit("50", "km/h", 150), "", {27.78, 13.89}, True),
        (limit("100", "km/h"), '<speed sOffset="0" max="30" unit="km/h"/>', {8.33}, True),
    ],
)
def test_limits_of_opendrive(
    tmp_path: Path, types: str, speed: str, expected: set[float], known: bool
) -> None:
    path = tmp_path / "road.xodr"
    path.write_bytes(opendrive(types, speed))
    found = survey(path)
    limits = {round(lane.speed_limit_mps, 2) for lane in found.road.lanes if not lane.internal}
    assert limits == expected
    assert found.knows.limits == known


@pytest.mark.parametrize("rule", ['rule="LHT"', 'rule="RHT"', ""])
def test_opendrives_rule_is_driven(tmp_path: Path, rule: str) -> None:
    path = tmp_path / "road.xodr"
    path.write_bytes(opendrive(limit("50", "km/h"), rule=rule))
    road = survey(path).road
    assert road.left_hand == ("LHT" in rule)
    for lane in road.lanes:
        eastward = lane.centerline[-1, 0] > lane.centerline[0, 0]
        on_the_left = eastward == (lane.centerline[:, 1].mean() > 0)
        assert on_the_left == road.left_hand


def mirrored_net(net: Path, folder: Path) -> Road:
    """A SUMO net in a mirror along the x axis, with traffic on the left, as netconvert makes it."""
    netconvert = find_program("netconvert")
    subprocess.run([netconvert, "-s", net, "--plain-output-prefix", folder / "p"], check=True)
    for file in folder.glob("p.*.xml"):
        places = re.compile(r'(?<=\by=")[-0-9.]+|(?<=[0-9],)[-0-9.]+(?=[ "])')
        file.write_text(places.sub(lambda y: f"{-float(y[0]):.2f}", file.read_text()))
    kinds = {"node": "nod", "edge": "edg", "connection": "con", "tllogic": "tll"}
    files = [part for kind, end in kinds.items() for part in (f"--{kind}-files", f"p.{end}.xml")]
    options = ("--lefthand", "--offset.disable-normalization", "--no-turnarounds")
    corners = ("--junctions.corner-detail", "5", "--junctions.limit-turn-speed", "5.5")
    command = [netconvert, *files, *options, *corners, "-o", "left.net.xml"]
    subprocess.run(command, cwd=folder, check=True)
    return read_road(folder / "left.net.xml")


@pytest.mark.parametrize("engine", ["highway", "sumo"])
@pytest.mark.parametrize("name", ["four_way_intersection", "roundabout", "priority_intersection"])
def test_left_hand_traffic_is_the_mirror_of_right_hand_traffic(
    tmp_path: Path, name: str, engine: str
) -> None:
    right = SCENARIOS[name](duration_s=20.0, flow="dense")
    road = right.road.mirrored if engine == "highway" else mirrored_net(right.road.source, tmp_path)
    assert road.left_hand
    left = dataclasses.replace(right, road=road)
    agents = sample_agents(right, seed=1)
    drive = get_engine(engine)
    frames = [list(drive(scenario, agents, 1)) for scenario in (right, left)]
    for one, other in zip(*frames, strict=True):
        assert np.array_equal(one.ids, other.ids)
        away = np.abs(one.xy - other.xy * [1.0, -1.0]).max(axis=1, initial=0)
        walks = one.kind == PEDESTRIAN  # SUMO's keep to the right of their sidewalk in any traffic
        assert (away <= np.where(walks & (engine == "sumo"), 2.0, 1e-9)).all()
        assert np.abs(np.exp(1j * one.heading) - np.exp(-1j * other.heading)).max(initial=0) < 1e-9


class LeftHandEnv(TrafficEnv):
    def _scenario_of(self, checked: TrafficConfig) -> Scenario:
        made = super()._scenario_of(checked)
        return dataclasses.replace(made, road=made.road.mirrored)


@pytest.mark.parametrize(
    ("kind", "actions", "mirrored"),
    [
        ("DiscreteMetaAction", [0, 3, 2], [2, 3, 0]),
        ("ContinuousAction", [[0.3, 0.02], [0.3, -0.03]], [[0.3, -0.02], [0.3, 0.03]]),
        ("DiscreteAction", [4, 3], [4, 5]),
    ],
)
def test_an_ego_vehicle_in_left_hand_traffic_sees_and_steers_in_a_mirror(
    kind: str, actions: list[Any], mirrored: list[Any]
) -> None:
    config = {"action": {"type": kind}, "warmup_s": 5.0}
    row = ENVIRONMENTS["graphrqi/Motorway-v0"]
    right, left = TrafficEnv(config, **row), LeftHandEnv(config, **row)
    right.reset(seed=3)
    left.reset(seed=3)
    for action, other in zip(actions, mirrored, strict=True):
        one, two = right.step(action), left.step(other)
        assert one[1] == pytest.approx(two[1])
        assert two[0]["ego"][1] == pytest.approx(-one[0]["ego"][1], abs=1e-6)
        exchange_sides(two[0])
        for key, seen in one[0].items():
            np.testing.assert_allclose(seen, two[0][key], atol=1e-6)


@pytest.mark.parametrize(("inner_m", "inside"), [(300.0, False), (3000.0, True), (9000.0, True)])
def test_vehicles_begin_inside_where_entries_are_few(inner_m: float, inside: bool) -> None:
    lengths = {"in": 50.0, "a": inner_m, "b": inner_m, "out": 50.0}
    lanes = tuple(
        Lane(f"{edge}_0", edge, 0, np.array([[0.0, 0.0], [size, 0.0]]), 3.2, 13.9)
        for edge, size in lengths.items()
    )
    ways = (("in", "a"), ("a", "b"), ("b", "a"), ("b", "out"))
    links = tuple(Connection(f"{a}_0", f"{b}_0", (), "straight") for a, b in ways)
    graph = EdgeGraph(Road("town", lanes, links, (), (), Path("town.net.xml")))
    assert graph.entries == ["in"]
    assert ("a" in graph.sources) == inside
    assert ("a" in graph.sinks) == inside
    assert math.isclose(sum(graph.ways_out("in").values()), len(graph.ways_out("in")))
