"""Odd maps of all kinds, packed in `data/odd_maps`: whoever enters one gets through it.

They have what maps of strangers have and ours do not: dead ends, closed rings, coinciding points,
parts that do not meet, bridges, traffic on the left, lanes of 20 m, streets without limits.
"""

from __future__ import annotations

import dataclasses
import gzip
from pathlib import Path

import numpy as np
import pytest

from scenarios.own.flows import EdgeGraph
from scenarios.own.scenario_file import own_road
from scenarios.own.survey import survey
from sim.engines import get_engine
from sim.frames import Frame
from sim.scenario import sample_agents

MAPS = sorted((Path(__file__).parent.parent / "data" / "odd_maps").iterdir())
VEHICLES = 10
ENTER_S = 30.0
JUMP_MPS = 80.0
"""A vehicle that moves faster than this between two frames has jumped, m/s."""


def jumps(before: Frame, frame: Frame) -> int:
    _, then, now = np.intersect1d(before.ids, frame.ids, assume_unique=True, return_indices=True)
    moved_m = np.hypot(*(frame.xy[now] - before.xy[then]).T)
    return int((moved_m > JUMP_MPS * (frame.time_s - before.time_s)).sum())


@pytest.mark.slow
@pytest.mark.parametrize("path", MAPS, ids=[path.name for path in MAPS])
@pytest.mark.parametrize("engine", ["sumo", "highway"])
def test_whoever_enters_an_odd_map_gets_through_it(path: Path, engine: str, tmp_path: Path) -> None:
    unpacked = tmp_path / path.stem
    unpacked.write_bytes(gzip.decompress(path.read_bytes()))
    assert survey(unpacked).road.lanes
    scenario = own_road(net=unpacked, flow=VEHICLES * 3600.0 / ENTER_S, duration_s=1500.0)
    agents = sample_agents(scenario, 0)[:VEHICLES]
    travel_s = EdgeGraph(scenario.road).travel_s
    longest_s = max(sum(travel_s[edge] for edge in agent.route) for agent in agents)
    scenario = dataclasses.replace(scenario, duration_s=max(1500.0, 4.0 * longest_s + ENTER_S))
    last_depart_s = max(agent.depart_s for agent in agents)
    entered, before = set[int](), None
    for frame in get_engine(engine)(scenario, agents, 0):
        entered.update(frame.ids.tolist())
        assert before is None or not jumps(before, frame)
        before = frame
        if not len(frame) and frame.time_s > last_depart_s + 65.0 * (len(entered) < len(agents)):
            break
    assert before is not None
    assert before.ids.tolist() == [], "somebody is stuck"
    assert len(entered) >= len(agents) - 1
