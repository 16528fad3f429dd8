"""The bench over maps: what it finds, what it counts, and what it takes for a map."""

from __future__ import annotations

import dataclasses
import importlib.util
from pathlib import Path

import pytest

from behaviors import InputError
from experiments.benches.roads.bench import BENCH, maps_in
from experiments.benches.roads.lane_maps import argoverse2_map, commonroad_map, lanelet2_map
from experiments.benches.roads.trip import ride
from scenarios.networks.build import FOLDER, NET
from scenarios.networks.written import straight_net
from sim.road.files import read_road_file
from sim.road.net import read_road


def test_maps_of_a_folder_are_driven_on_and_broken_ones_refused_in_one_line(tmp_path):
    (tmp_path / "good.net.xml").write_text(straight_net(2, 20.0, 200.0))
    (tmp_path / "broken.osm").write_text("<osm")
    (tmp_path / "town.rou.xml").write_text("<routes/>")
    settings = dataclasses.replace(BENCH.full, maps=str(tmp_path), vehicles=3, jobs=1)
    rows = BENCH.run(settings)
    figures = {(r["map"], r["engine"], r["metric"]): r for r in rows}
    for engine in ("sumo", "highway"):
        found = {name: figures["good.net.xml", engine, name]["value"]
                 for name in ("entered", "stayed", "teleports", "tracebacks")}  # fmt: skip
        assert found == {"entered": 3.0, "stayed": 0.0, "teleports": 0.0, "tracebacks": 0.0}
    assert figures["broken.osm", "sumo", "refused"]["value"] == 1.0
    assert "\n" not in figures["broken.osm", "sumo", "refused"]["what"]
    assert not any(row["map"] == "town.rou.xml" for row in rows)
    assert BENCH.table is not None
    assert len(BENCH.table(rows)) > 3


def test_a_folder_without_maps_is_refused(tmp_path):
    with pytest.raises(InputError, match="found no map"):
        maps_in(tmp_path)


@pytest.mark.parametrize(
    ("write", "name"),
    [(lanelet2_map, "a.osm"), (commonroad_map, "a.xml"), (argoverse2_map, "a.json")],
)
def test_a_road_lane_by_lane_is_read_back_with_its_ways(write, name, tmp_path):
    road = read_road(FOLDER / "roundabout" / NET)
    (tmp_path / name).write_text(write(road))
    back = read_road_file(tmp_path / name)
    assert len([lane for lane in back.lanes if not lane.walking]) == len(
        [lane for lane in road.lanes if lane.cars and not lane.walking]
    )
    assert sum(lane.length_m for lane in back.lanes) == pytest.approx(
        sum(lane.length_m for lane in road.lanes if not lane.walking), rel=0.02
    )


@pytest.mark.skipif(importlib.util.find_spec("sumo") is None, reason="needs netconvert")
def test_vehicles_turn_sharp_corners_and_pass_over_each_other_on_bridges(tmp_path: Path):
    from experiments.benches.roads.odd_maps import write_odd_maps

    maps = {path.name: path for path in write_odd_maps(tmp_path)}
    trip = ride(maps["motorway_junction.osm"], "highway", 20, 0)
    assert (trip.stayed, trip.teleports, trip.crashed) == ((), 0, "")
    bridge = ride(maps["bridge_over_street.osm"], "highway", 20, 0)
    assert (bridge.entered, bridge.stayed, bridge.collisions) == (20, (), 0)
