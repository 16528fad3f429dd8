"""Episodes as OpenSCENARIO with OpenDRIVE: read back by other code than wrote them.

An environment `.venv-asam` with ASAM's checkers runs these, too (docs/check_asam.py).
"""

from __future__ import annotations

import functools
import itertools
import math
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from behaviors import BEHAVIORS
from scenarios import SCENARIOS
from sim.engines import get_engine
from sim.formats import get_writer
from sim.frames import KINDS, SIGNALS, AgentKind, Tracks
from sim.road import Road
from sim.scenario import sample_agents

pytest.importorskip("scenariogeneration")

EPISODES = [
    ("four_way_intersection", "sumo"), ("four_way_intersection", "highway"),
    ("motorway_ramps", "sumo"), ("roundabout", "highway"), ("straight_road", "sumo"),
]  # fmt: skip


@functools.cache
def episode(name: str, engine: str) -> tuple[Tracks, Road]:
    """Some seconds of a scenario with vehicles of several kinds."""
    kinds = "car=.6,truck=.2,bus=.1,bicycle=.1"
    if name == "motorway_ramps":
        kinds = "car=.8,truck=.2"
    long_s = 40.0 if name == "roundabout" else 12.0  # until some are on the ring
    scenario = SCENARIOS[name](duration_s=long_s, step_s=0.5, kinds=kinds, flow="dense")
    agents = sample_agents(scenario, 0)
    tracks = Tracks.from_frames(
        get_engine(engine)(scenario, agents, 0), {agent.id: agent.behavior for agent in agents}
    )
    return tracks, scenario.road


@pytest.fixture(params=EPISODES, ids="-".join)
def written(request, tmp_path):
    tracks, road = episode(*request.param)
    road_file, scenario = get_writer("openscenario")(tmp_path, "one", tracks, road)
    return tracks, road, road_file, scenario


def number(element: ET.Element, name: str) -> float:
    return float(element.attrib[name])


def test_everybody_follows_what_was_recorded_and_is_what_it_was(written):
    tracks, _, road_file, scenario = written
    root = ET.parse(scenario).getroot()
    assert root.find("RoadNetwork/LogicFile").get("filepath") == road_file.name
    objects = {one.get("name"): one for one in root.iter("ScenarioObject")}
    assert len(objects) == len(tracks.ids)
    groups = {
        group.find("Actors/EntityRef").get("entityRef"): group
        for group in root.iter("ManeuverGroup")
        if group.find("Actors/EntityRef") is not None
    }
    pedestrians = 0
    for row, agent in enumerate(tracks.ids):
        name = f"agent {agent}"
        box = objects[name].find(".//BoundingBox/Dimensions")
        assert number(box, "length") == tracks.length[row]
        assert number(box, "width") == tracks.width[row]
        pedestrians += objects[name].find("Pedestrian") is not None
        behavior = [p.get("value") for p in objects[name].iter("Property")]
        expected = [] if tracks.behavior[row] < 0 else [str(BEHAVIORS[tracks.behavior[row]])]
        assert behavior == expected
        there = np.flatnonzero(tracks.valid[row])
        seen = [
            (number(v, "time"), *(number(v.find("Position/WorldPosition"), a) for a in "xyh"))
            for v in groups[name].iter("Vertex")
        ]
        if there.size == 1:
            at = groups[name].find(".//AddEntityAction/Position/WorldPosition")
            seen = [(tracks.time_s[there[0]], *(number(at, a) for a in "xyh"))]
        expected_rows = np.column_stack(
            [tracks.time_s[there], tracks.xy[row, there], tracks.heading[row, there]]
        )
        np.testing.assert_array_equal(np.array(seen), expected_rows)
    assert pedestrians == sum(KINDS[k] is AgentKind.PEDESTRIAN for k in tracks.kind)


def test_signals_show_what_they_showed(written):
    tracks, road, road_file, scenario = written
    groups = {
        one.get("id"): road.signal_groups.index(one.get("name"))
        for one in ET.parse(road_file).getroot().iter("signal")
    }
    root = ET.parse(scenario).getroot()
    shown = np.full((len(road.signal_groups), len(tracks.time_s)), "", dtype=object)
    for action in root.find("Storyboard/Init").iter("TrafficSignalStateAction"):
        shown[groups[action.get("name")]] = action.get("state")
    for event in root.iter("Event"):
        action = event.find(".//TrafficSignalStateAction")
        if action is not None:
            time_s = number(event.find(".//SimulationTimeCondition"), "value")
            shown[groups[action.get("name")], tracks.time_s >= time_s] = action.get("state")
    for group in set(groups.values()):
        assert shown[group].tolist() == [str(SIGNALS[c]) for c in tracks.signals[group]]
    controlled = {link.signal for link in road.connections} - {-1}
    assert set(groups.values()) == controlled


def areas(road_file: Path) -> list[np.ndarray]:
    """For every lane of every road, its pieces: (4, 2) corners of each."""
    found = []
    for road in ET.parse(road_file).getroot().iter("road"):
        pieces = [
            [number(g, a) for a in ("s", "x", "y", "hdg", "length")] for g in road.iter("geometry")
        ]
        offset = road.find("lanes/laneOffset")
        for s, x, y, heading, length in pieces:
            along = np.array([math.cos(heading), math.sin(heading)])
            left = np.array([-along[1], along[0]])
            begin, end = np.array([x, y]), np.array([x, y]) + length * along
            edge = [number(offset, "a") + number(offset, "b") * u for u in (s, s + length)]
            for lane in road.findall("lanes/laneSection/right/lane"):
                width = lane.find("width")
                wide = [number(width, "a") + number(width, "b") * u for u in (s, s + length)]
                inner = list(edge)
                edge = [a - b for a, b in zip(edge, wide, strict=True)]
                found.append(
                    np.array([begin + inner[0] * left, end + inner[1] * left,
                              end + edge[1] * left, begin + edge[0] * left])
                )  # fmt: skip
    return found


def inside(corners: np.ndarray, points: np.ndarray, margin_m: float) -> np.ndarray:
    """Whether points are in a four-sided figure that runs clockwise, or nearly."""
    kept = np.ones(len(points), dtype=bool)
    for a, b in itertools.pairwise([*corners, corners[0]]):
        size = math.dist(a, b)
        if size > 1e-9:
            d = (b - a) / size
            kept &= d[0] * (points[:, 1] - a[1]) - d[1] * (points[:, 0] - a[0]) <= margin_m
    return kept


def test_vehicles_are_on_lanes_of_the_road_file(written):
    tracks, _, road_file, _ = written
    crashed = {i for event in tracks.events for i in (event.agent, event.other)}  # off the road
    usual = np.isin(tracks.ids, [i for i in crashed if i is not None], invert=True)
    usual &= tracks.kind != KINDS.index(AgentKind.PEDESTRIAN)
    driving = usual[tracks.index.agent]
    points = tracks.row_xy[driving]
    covered = np.zeros(len(points), dtype=bool)
    for corners in areas(road_file):
        covered |= inside(corners, points, 0.3)
    assert len(points) > 50
    assert covered.mean() > 0.995


def test_the_same_episode_gives_the_same_bytes(written, tmp_path):
    tracks, road, *files = written
    again = tmp_path / "again"
    again.mkdir()
    for one, other in zip(
        files, get_writer("openscenario")(again, "one", tracks, road), strict=True
    ):
        assert one.read_bytes() == other.read_bytes()


@pytest.mark.asam
def test_asams_own_checkers_find_no_error(written):
    *_, scenario = written
    root = Path(__file__).parents[2]
    checkers, program = root / ".venv-asam", root / "docs" / "check_asam.py"
    if not checkers.is_dir():
        pytest.skip(f"no checkers in {checkers}")
    done = subprocess.run(
        [sys.executable, str(program), str(checkers), str(scenario.parent)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
