"""Observations of the ego vehicle: itself, the others, their behaviours and the traffic graph."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from sim.frames import FloatArray, Signal
from sim.highway.ego import Observation
from sim.highway.traffic import TrafficRoad, Walker

RANGE_M: Final = 100.0
"""How far from the ego vehicle others are observed, m."""

SPEED_MPS: Final = 20.0
"""Speeds are divided by this, m/s."""

SIZE_M: Final = (12.0, 3.0)
"""Lengths and widths are divided by these, m: those of a bus."""

ROUTE_M: Final = 1000.0
"""The distance left to the goal is divided by this, m."""

EGO_FEATURES: Final[tuple[str, ...]] = (
    "speed", "offset", "heading", "limit", "lanes_left", "lanes_right", "stop_line",
    "red", "yellow", "green", "crossing", "crossing_used", "distance_left",
)  # fmt: skip
"""The columns of the observation ``ego``."""

AGENT_FEATURES: Final[tuple[str, ...]] = (
    "present", "x", "y", "vx", "vy", "cos_heading", "sin_heading", "length", "width", "walking",
)  # fmt: skip
"""The columns of the observation ``agents``, before those of the behaviours."""

NEIGHBOURS: Final = 4
"""How many nearest agents each agent is joined to in the traffic graph (as in the paper)."""


def observation_space(option: str, observed: int) -> spaces.Dict:
    """The space of a `TrafficConfig.observation` of so many other agents."""
    more = len(BEHAVIORS) if option in ("behavior", "posterior") else 0
    parts: dict[str, spaces.Space[Any]] = {
        "ego": spaces.Box(-1.0, 1.0, (len(EGO_FEATURES),), np.float32),
        "agents": spaces.Box(-1.0, 1.0, (observed, len(AGENT_FEATURES) + more), np.float32),
    }
    if option == "graph":
        parts["mask"] = spaces.Box(0, 1, (observed + 1,), np.int8)
        parts["adjacency"] = spaces.Box(0, 1, (observed + 1, observed + 1), np.int8)
    return spaces.Dict(parts)


def observable_agents(road: TrafficRoad, ego: Any) -> list[Any]:
    """The other vehicles and pedestrians within `RANGE_M`, nearest first."""
    others = [one for one in (*road.vehicles, *road.walkers) if one is not ego]
    if not others:
        return []
    away = np.hypot(*(np.array([one.position for one in others]) - ego.position).T)
    order = np.lexsort((np.array([one.agent for one in others]), away))
    return [others[i] for i in order if away[i] <= RANGE_M]


def observe_ego(road: TrafficRoad, ego: Any, distance_left_m: float) -> NDArray[np.float32]:
    """The observation ``ego``: one value per entry of `EGO_FEATURES`."""
    network, lane = road.network, ego.lane_index
    s, lateral = ego.lane.local_coordinates(ego.position)
    facing = ego.lane.heading_at(s) - ego.heading
    facing = math.pi - (math.pi - facing) % (2.0 * math.pi)
    lanes = len(road.network.graph[lane[0]][lane[1]])
    sides = (0, 0) if lane in network.exit_of else (lane[2], lanes - 1 - lane[2])
    line, lit, crossing, used = _ahead(road, ego, s + ego.LENGTH / 2)
    values = (
        ego.speed / SPEED_MPS,
        -lateral / float(ego.lane.width_at(s)),
        facing / math.pi,
        float(ego.lane.speed_limit) / SPEED_MPS,
        sides[0] / 4.0,
        sides[1] / 4.0,
        min(max(line, 0.0), RANGE_M) / RANGE_M,
        *lit,
        crossing / RANGE_M,
        used,
        distance_left_m / ROUTE_M,
    )
    return _unit(np.array(values))


def _ahead(road: TrafficRoad, ego: Any, front: float) -> tuple[float, FloatArray, float, float]:
    """Stop line and crossing ahead of a front bumper, which is at ``front`` m on its lane."""
    network, lane = road.network, ego.lane_index
    lit = np.zeros(3)
    line = crossing = RANGE_M
    used = 0.0
    strips = [(strip.crossing, strip.near - front) for strip in network.strips_of(lane)]
    path = None if lane in network.exit_of else network.onward_lane(lane, ego.stretches)
    if path is not None:
        line = ego.lane.length - front
        group = int(network.arrays.lanes["signal"][network.number[path]])
        if group >= 0 and 0.0 <= line <= RANGE_M:
            state = int(road.signals[group])
            if state != Signal.OFF.code:
                lit[state] = 1.0
        strips += [(strip.crossing, strip.near + line) for strip in network.strips_of(path)]
    for number, near in strips:
        if 0.0 <= near < crossing:
            crossing = near
            used = float(number in road.crossings_in_use())
    return line, lit, crossing, used


def observe_agents(
    ego: Any, others: list[Any], behaviors: FloatArray | None, observed: int
) -> NDArray[np.float32]:
    """(observed, 10 or 16) the observation ``agents``: a row for each of the others, then zeros.

    ``behaviors`` are (n, 6) probabilities of the behaviours, or None for no such columns.
    """
    rows = np.zeros((observed, len(AGENT_FEATURES) + (0 if behaviors is None else len(BEHAVIORS))))
    if others:
        cos, sin = math.cos(ego.heading), math.sin(ego.heading)
        turn = np.array([[cos, sin], [sin, -cos]])  # forward, left: highway-env's y is to the right
        place = np.array([one.position - ego.position for one in others]) @ turn.T
        moving = np.array([one.velocity - ego.velocity for one in others]) @ turn.T
        heading = ego.heading - np.array([one.heading for one in others])
        found = [
            np.ones(len(others)),
            place / RANGE_M,
            moving / SPEED_MPS,
            np.cos(heading),
            np.sin(heading),
            np.array([(one.LENGTH, one.WIDTH) for one in others]) / SIZE_M,
            np.array([isinstance(one, Walker) for one in others]),
        ]
        rows[: len(others)] = np.column_stack(found if behaviors is None else [*found, behaviors])
    return _unit(rows)


def observe_graph(ego: Any, others: list[Any], observed: int) -> Observation:
    """The observations ``mask`` and ``adjacency`` of nearest neighbours, symmetric."""
    mask = np.zeros(observed + 1, dtype=np.int8)
    mask[: len(others) + 1] = 1
    adjacency = np.zeros((observed + 1, observed + 1), dtype=np.int8)
    xy = np.array([ego.position, *(one.position for one in others)])
    away = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))
    np.fill_diagonal(away, np.inf)
    for i in range(len(xy)):
        for j in np.argsort(away[i], kind="stable")[: min(NEIGHBOURS, len(xy) - 1)]:
            adjacency[i, j] = adjacency[j, i] = 1
    return {"mask": mask, "adjacency": adjacency}


def exchange_sides(found: Observation) -> None:
    """Exchange left and right in an observation of traffic that is driven in its mirror."""
    ego, agents = found["ego"], found["agents"]
    for name in ("offset", "heading"):
        ego[EGO_FEATURES.index(name)] *= -1.0
    left, right = (EGO_FEATURES.index(f"lanes_{side}") for side in ("left", "right"))
    ego[[left, right]] = ego[[right, left]]
    agents[:, [AGENT_FEATURES.index(name) for name in ("y", "vy", "sin_heading")]] *= -1.0


def _unit(values: FloatArray) -> NDArray[np.float32]:
    return np.clip(values, -1.0, 1.0).astype(np.float32)
