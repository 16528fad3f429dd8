"""Maps of Argoverse 2: hand-written, our own written and read back, and real."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios import SCENARIOS
from sim.episode.annotate import annotate
from sim.episode.observables import observe
from sim.frames import AgentKind, Event
from sim.road import Road
from sim.road.lane_graph import DIRECTIONS, LaneGraph
from sim.road.maps.argoverse2 import read_map, static_map


def points(*xy: tuple[float, float]) -> list[dict[str, float]]:
    return [{"x": x, "y": y, "z": 20.0} for x, y in xy]


def segment(identity: int, line: list[tuple[float, float]], **changes: Any) -> dict[str, Any]:
    """A lane 3 m wide; its borders are those of a straight one between its ends."""
    begin, end = np.array(line[0]), np.array(line[-1])
    aside = 1.5 * np.array([begin[1] - end[1], end[0] - begin[0]]) / np.hypot(*(end - begin))
    left, right = ([tuple(p + s * aside) for p in (begin, end)] for s in (1, -1))
    return {
        "id": identity,
        "is_intersection": False,
        "lane_type": "VEHICLE",
        "centerline": points(*line),
        "left_lane_boundary": points(*left),
        "right_lane_boundary": points(*right),
        "left_neighbor_id": None,
        "right_neighbor_id": None,
        "predecessors": [],
        "successors": [],
        "left_lane_mark_type": "NONE",
        "right_lane_mark_type": "NONE",
        **changes,
    }


def hand_written() -> dict[str, Any]:
    """Two lanes and a bicycles' lane east, a junction: on, or left and north; a crosswalk."""
    segments = [
        segment(11, [(0, 0), (100, 0)], left_neighbor_id=12, right_neighbor_id=13, successors=[21]),
        segment(12, [(0, 3), (100, 3)], left_neighbor_id=19, right_neighbor_id=11,
                successors=[22, 23]),
        segment(13, [(0, -2), (100, -2)], left_neighbor_id=11, lane_type="BIKE"),
        segment(19, [(100, 6), (0, 6)], left_neighbor_id=12),  # the other way
        segment(21, [(100, 0), (120, 0)], is_intersection=True, successors=[31, 99]),
        segment(22, [(100, 3), (120, 3)], is_intersection=True, successors=[32]),
        segment(23, [(100, 3), (110, 5), (115, 13)], is_intersection=True, successors=[33]),
        segment(31, [(120, 0), (220, 0)], left_neighbor_id=32, successors=[41]),
        segment(32, [(120, 3), (220, 3)], right_neighbor_id=31, successors=[42]),
        segment(33, [(115, 13), (115, 113)]),
        segment(41, [(220, 0), (240, 0)], is_intersection=True),  # cut off by the map's border
        segment(42, [(220, 3), (240, 3)], is_intersection=True, successors=[22]),  # in a circle
    ]  # fmt: skip
    edges = {"edge1": points((150, -4), (150, 8)), "edge2": points((154, 8), (154, -4))}
    return {
        "drivable_areas": {},
        "lane_segments": {str(s["id"]): s for s in segments},
        "pedestrian_crossings": {"7": {"id": 7, **edges}},
    }


def put(folder: Path, archive: object) -> Path:
    path = folder / "log_map_archive_s.json"
    path.write_text(archive if isinstance(archive, str) else json.dumps(archive), encoding="utf-8")
    return path


def road_of(folder: Path, archive: object) -> Road:
    road = read_map(put(folder, archive))
    assert road is not None
    return road


def test_a_hand_written_map(tmp_path: Path) -> None:
    road = road_of(tmp_path, hand_written())
    graph, at = LaneGraph.of(road), road.lane_index
    ids = (11, 12, 13, 19, 21, 22, 23, 31, 32, 33, 41, 42)
    assert [lane.id for lane in road.lanes] == [str(i) for i in ids]
    assert graph.left[at["11"]] == at["12"]
    assert graph.right[at["12"]] == at["11"]
    assert graph.left[at["12"]] == -1  # the other way
    assert graph.right[at["11"]] == -1  # for bicycles
    ways = {(c.from_lane, c.via, c.to_lane, c.direction) for c in road.connections}
    assert ways == {
        ("11", ("21",), "31", "straight"),
        ("12", ("22",), "32", "straight"),
        ("12", ("23",), "33", "left"),
        ("31", (), "41", "straight"),
        ("32", ("42",), "22", "straight"),  # and no farther: it came from there
    }
    assert graph.successors[at["12"]].tolist() == [at["22"], at["23"]]
    assert DIRECTIONS[graph.direction[at["23"]]] == "left"
    assert {lane.edge for lane in road.lanes if lane.internal} >= {road.lanes[at["22"]].edge}
    assert [lane.width_m for lane in road.lanes] == pytest.approx([3.0] * len(ids))
    assert all(math.isnan(lane.speed_limit_mps) for lane in road.lanes)
    (crossing,) = road.crossings
    np.testing.assert_allclose(crossing.centerline, [[152, -4], [152, 8]])
    assert crossing.width_m == 4.0
    assert not crossing.priority
    assert road.signal_groups == ()


@pytest.mark.parametrize("name", sorted(SCENARIOS))
def test_what_is_written_of_a_road_reads_back(tmp_path: Path, name: str) -> None:
    road = SCENARIOS[name]().road
    back = road_of(tmp_path, static_map(road))
    lanes = [lane for lane in road.lanes if not lane.walking]
    assert len(back.lanes) == len(lanes)
    for one, other in zip(lanes, back.lanes, strict=True):
        np.testing.assert_array_equal(one.centerline, other.centerline)
        assert one.internal == other.internal
        if one.length_m > 0.0:  # SUMO has ways of no length, which have no sides to write
            assert one.width_m == pytest.approx(other.width_m)
    for one, other in zip(road.crossings, back.crossings, strict=True):
        np.testing.assert_allclose(one.centerline[[0, -1]], other.centerline, atol=1e-9)
        assert one.width_m == pytest.approx(other.width_m)
    kept = np.array([not lane.walking for lane in road.lanes])
    number = np.append(np.cumsum(kept) - 1, -1)  # -1 stays -1
    graph, again = LaneGraph.of(road), LaneGraph.of(back)
    for field in ("left", "right", "ahead", "behind"):
        expected = number[getattr(graph, field)[kept]]
        np.testing.assert_array_equal(getattr(again, field), expected, field)
    expected = graph.direction[kept]
    if name == "motorway_ramps":  # SUMO calls its exit a turn; such maps tell turns by their bend
        (exit_path,) = np.flatnonzero(expected)
        assert lanes[exit_path].internal
        expected = np.zeros_like(expected)
    np.testing.assert_array_equal(again.direction, expected)
    for i, ways in enumerate(graph.successors[kept]):
        assert set(number[ways]) - {-1} == set(again.successors[i]) - {-1}


def test_the_real_map(tmp_path: Path, shared_data: Path) -> None:
    from experiments.data.exchange import export_dataset, import_recordings
    from experiments.data.verify import verify_dataset
    from sim.store.dataset import open_dataset

    import_recordings(shared_data / "argoverse2", tmp_path / "data", quiet=True)
    dataset = open_dataset(tmp_path / "data")
    assert verify_dataset(dataset.path) == []
    (entry,) = dataset.episodes()
    road, tracks = dataset.road(entry), dataset.read(entry).tracks
    assert road is not None
    steps = tracks
    seen = observe(steps, road)
    # parked cars are beside the lanes, and some come from beyond the map
    moves = (steps.kind == AgentKind.CAR.code)[steps.index.agent] & (steps.row_speed > 2.0)
    x0, y0, x1, y1 = road.bounds
    moves &= ((steps.row_xy >= (x0, y0)) & (steps.row_xy <= (x1, y1))).all(axis=1)
    assert moves.sum() > 100
    assert (seen.lane[moves] >= 0).mean() > 0.8
    assert np.nanmedian(np.abs(seen.offset[moves])) < 0.7
    assert np.nanmedian(np.abs(seen.lane_heading[moves])) < 0.1
    events: list[Event] = list(annotate(steps, road, recorded=True).events)
    assert not [e for e in events if e.kind in ("red run", "did not yield")]  # nobody knows
    export_dataset(tmp_path / "data", tmp_path / "again", "argoverse2", quiet=True)
    (archive,) = (tmp_path / "again").rglob("log_map_archive_*.json")
    again = read_map(archive)
    assert again is not None
    for one, other in zip(road.lanes, again.lanes, strict=True):
        np.testing.assert_array_equal(one.centerline, other.centerline)
        assert one.internal == other.internal
