"""Searches by cell find what a search of everything finds."""

from __future__ import annotations

import numpy as np
import pytest

from scenarios.networks.build import FOLDER, NET
from sim.road import Road
from sim.road.cells import near_pairs
from sim.road.lane_graph import LaneGraph
from sim.road.net import read_road


def road_of(name: str) -> Road:
    return read_road(FOLDER / name / NET)


def best_of_all(road: Road, xy: np.ndarray, heading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The best cost over all straight pieces of lanes, and the cost of each lane's best piece."""
    costs = np.full((len(xy), len(road.lanes)), np.inf)
    for i, lane in enumerate(road.lanes):
        if lane.walking:
            continue
        for a, b in zip(lane.centerline[:-1], lane.centerline[1:], strict=True):
            size = np.hypot(*(b - a))
            if size <= 1e-9:
                continue
            ux, uy = (b - a) / size
            along = np.clip((xy - a) @ (ux, uy), 0.0, size)
            away = np.hypot(*(xy - a - along[:, None] * (ux, uy)).T)
            turned = 1.0 - np.cos(heading) * ux - np.sin(heading) * uy
            costs[:, i] = np.minimum(costs[:, i], away + (4.0 if lane.internal else 0.7) * turned)
    return costs.min(axis=1), costs


@pytest.mark.parametrize("name", ["grid_3", "straight_road", "four_way_intersection"])
def test_the_lane_that_fits_best_is_found_wherever_one_is(name: str) -> None:
    road, rng = road_of(name), np.random.default_rng(0)
    x0, y0, x1, y1 = road.bounds
    anywhere = rng.uniform((x0 - 200.0, y0 - 200.0), (x1 + 200.0, y1 + 200.0), (200, 2))
    points = np.concatenate([lane.centerline for lane in road.lanes])
    near = points[rng.integers(len(points), size=300)] + rng.normal(0.0, 2.0, (300, 2))
    xy = np.concatenate([anywhere, near])
    heading = rng.uniform(-np.pi, np.pi, len(xy))
    found = LaneGraph.of(road).project(xy, heading)
    best, costs = best_of_all(road, xy, heading)
    assert costs[np.arange(len(xy)), found.lane] == pytest.approx(best, abs=1e-9)


def test_pairs_are_those_whose_boxes_touch() -> None:
    rng = np.random.default_rng(1)
    low = rng.uniform(-50.0, 50.0, (60, 2))
    boxes = np.concatenate([low, low + rng.exponential(8.0, (60, 2))], axis=1)
    one, other = boxes[:25], boxes[25:]
    touch = [
        (i, j)
        for i, a in enumerate(one)
        for j, b in enumerate(other)
        if (a[:2] <= b[2:]).all() and (b[:2] <= a[2:]).all()
    ]
    assert len(touch) > 10
    for size in (0.5, 5.0, 500.0):
        assert list(map(tuple, near_pairs(one, other, size).tolist())) == touch
    assert near_pairs(one, np.empty((0, 4)), 1.0).shape == (0, 2)


@pytest.mark.parametrize("name", ["grid_3", "four_way_priority", "four_way_right_before_left"])
def test_who_has_priority_is_what_the_net_says(name: str) -> None:
    import sumolib

    road = road_of(name)
    net = sumolib.net.readNet(str(FOLDER / name / NET), withInternal=True)
    links = {
        (str(link.getFromLane().getID()), str(link.getToLane().getID())): link
        for edge in net.getEdges(withInternal=False)
        for lane in edge.getLanes()
        for link in lane.getOutgoing()
    }
    checked = 0
    for connection in road.connections:
        mine = links[connection.from_lane, connection.to_lane]
        for number, other in enumerate(road.connections):
            its = links[other.from_lane, other.to_lane]
            if other is connection or its.getJunction() is not mine.getJunction():
                assert number not in connection.yields_to
            elif other.signal == connection.signal:
                stronger = mine.getJunction().forbids(its, mine)
                assert (number in connection.yields_to) == stronger
                checked += stronger
    assert checked > 0
