"""Nets of any kind: lanes that are not for cars, and roads that go round."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from sim.engines import get_engine
from sim.road import Road
from sim.road.net import read_road
from sim.scenario import RouteFlow, Scenario, sample_agents

HEAD = (
    '<net version="1.20"><location netOffset="0.00,0.00" convBoundary="-500,-500,500,500" '
    'origBoundary="-500,-500,500,500" projParameter="!"/>'
)


def lane(edge: str, index: int, points: list[tuple[float, float]], more: str = "") -> str:
    length = sum(math.dist(a, b) for a, b in itertools.pairwise(points))
    shape = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
    return (
        f'<lane id="{edge}_{index}" index="{index}" {more} speed="13.89" length="{length:.2f}" '
        f'shape="{shape}"/>'
    )


def straight(path: Path, *allowed: str) -> Road:
    """A road of 300 m, its lanes from the right."""
    lanes = [
        lane("a", i, [(0, 3.2 * i), (300, 3.2 * i)], f'allow="{who}"' if who else "")
        for i, who in enumerate(allowed)
    ]
    ends = [
        f'<junction id="{name}" type="dead_end" x="{x}" y="0" incLanes="" intLanes="" '
        f'shape="{x},-2 {x},2"/>'
        for name, x in (("p", 0), ("q", 300))
    ]
    edge = f'<edge id="a" from="p" to="q" priority="-1">{"".join(lanes)}</edge>'
    path.write_text(HEAD + edge + "".join(ends) + "</net>")
    return read_road(path)


def ring(path: Path) -> Road:
    """Four edges of one lane round a circle of 60 m."""

    def arc(begin: float, end: float) -> list[tuple[float, float]]:
        return [(60 * math.cos(a), 60 * math.sin(a)) for a in np.linspace(begin, end, 17)]

    angle = [k * math.pi / 2 for k in range(5)]
    parts = [
        f'<edge id=":j{k % 4}_0" function="internal">'
        + lane(f":j{k % 4}_0", 0, arc(angle[k] - 0.03, angle[k] + 0.03))
        + "</edge>"
        for k in range(1, 5)
    ]
    parts += [
        f'<edge id="e{k}" from="j{k}" to="j{(k + 1) % 4}" priority="-1">'
        + lane(f"e{k}", 0, arc(angle[k] + 0.03, angle[k + 1] - 0.03))
        + "</edge>"
        for k in range(4)
    ]
    for k in range(4):
        x, y = 60 * math.cos(angle[k]), 60 * math.sin(angle[k])
        corners = [(-2, -2), (2, -2), (2, 2), (-2, 2)]
        shape = " ".join(f"{x + a:.2f},{y + b:.2f}" for a, b in corners)
        parts.append(
            f'<junction id="j{k}" type="priority" x="{x:.2f}" y="{y:.2f}" '
            f'incLanes="e{(k - 1) % 4}_0" intLanes=":j{k}_0_0" shape="{shape}">'
            '<request index="0" response="0" foes="0" cont="0"/></junction>'
        )
    way = 'fromLane="0" toLane="0" dir="s" state="M"'
    parts += [
        f'<connection from="e{(k - 1) % 4}" to="e{k}" via=":j{k}_0_0" {way}/>' for k in range(4)
    ]
    parts += [f'<connection from=":j{k}_0" to="e{k}" {way}/>' for k in range(4)]
    path.write_text(HEAD + "".join(parts) + "</net>")
    return read_road(path)


def drive(engine: str, road: Road, *route: str) -> tuple[set[int], list[np.ndarray]]:
    """Who was seen, and where everybody was."""
    scenario = Scenario("here", road, (RouteFlow(route, 1200.0),), duration_s=30.0)
    frames = list(get_engine(engine)(scenario, sample_agents(scenario, 3), 3))
    return {int(i) for f in frames for i in f.ids}, [f.xy for f in frames]


@pytest.mark.parametrize("engine", ["sumo", "highway"])
@pytest.mark.parametrize("who", ["bicycle", "bus", "tram"])
def test_cars_keep_off_lanes_of_others(tmp_path: Path, engine: str, who: str) -> None:
    road = straight(tmp_path / "a.net.xml", who, "")
    assert [lane.cars for lane in road.lanes] == [False, True]
    ids, places = drive(engine, road, "a")
    assert len(ids) > 5
    assert min(xy[:, 1].min(initial=9.0) for xy in places) > 1.6


@pytest.mark.parametrize("engine", ["sumo", "highway"])
@pytest.mark.parametrize("first", [0, 2])
def test_cars_drive_round_a_ring(tmp_path: Path, engine: str, first: int) -> None:
    route = [f"e{(first + k) % 4}" for k in range(4)]
    ids, places = drive(engine, ring(tmp_path / "ring.net.xml"), *route)
    assert len(ids) > 5
    assert max(abs(np.hypot(*xy.T) - 60.0).max(initial=0.0) for xy in places) < 3.0
    assert {*np.sign(np.concatenate(places)[:, 1])} == {-1.0, 1.0}


def test_who_drives_a_second_round_leaves_after_it(tmp_path: Path) -> None:
    road = ring(tmp_path / "ring.net.xml")
    route = ("e0", "e1", "e2", "e3", "e0", "e1")
    scenario = Scenario("here", road, (RouteFlow(route, 1200.0),), duration_s=90.0)
    agents = sample_agents(scenario, 3)[:2]
    frames = list(get_engine("highway")(scenario, agents, 3))
    mine = np.array([f.xy[f.ids == agents[0].id][0] for f in frames if agents[0].id in f.ids])
    turned = np.unwrap(np.arctan2(mine[:, 1], mine[:, 0]))
    assert (turned[-1] - turned[0]) / (2.0 * math.pi) == pytest.approx(1.5, abs=0.05)
