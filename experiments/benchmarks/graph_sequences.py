"""Traffic graphs to measure on: vehicles at constant speed, and those of a simulated city."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import Any, Final, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.graph import TrafficGraph
from scenarios.city import city_agents, city_scenario
from scenarios.networks.build import grid_net
from sim.engines import get_engine

Floats: TypeAlias = NDArray[np.float64]
Ids: TypeAlias = NDArray[np.int64]


LAYOUTS: Final = ("road", "crossing", "city")
"""Where the vehicles may be."""

STEP_S: Final = 0.1
"""Time between observations, s."""

FILLING_S: Final = 35.0
"""Time until the vehicles of a city have entered, s (they depart in the first 30 s)."""

KEPT: Final = 100
"""Frames of a city: one period of the accumulated graph."""

SPARE: Final = 1.1
"""Vehicles sent into a city over those wanted in each frame; some leave or find no room to
enter."""


def check_layout(layout: str, sizes: Sequence[int]) -> None:
    """Refuse a layout that is not known, or whose road cannot be had, before hours of work."""
    if layout not in LAYOUTS:
        expected = ", ".join(LAYOUTS[:-1]) + " or " + LAYOUTS[-1]
        raise InputError(f"graph: found {layout!r}, expected {expected}")
    if layout == "city":
        for d in sizes:
            grid_net(city_blocks(d))


def city_blocks(d: int) -> int:
    """Junctions along each side of a city for d vehicles: 1000 fill 8 x 8, as in the loop's bench.

    Examples:
        >>> [city_blocks(d) for d in (25, 1000, 4000, 10000)]
        [3, 8, 16, 25]
    """
    return max(3, round(8.0 * float(np.sqrt(d / 1000.0))))


@functools.lru_cache(maxsize=2)
def city_traffic(d: int, seed: int = 0) -> tuple[tuple[Ids, Floats], ...]:
    """Vehicles that SUMO drives through a grid of city blocks, every 0.1 s.

    Args:
        d: vehicles of each frame: those that entered first.
        seed: of the routes and the drivers.

    Returns:
        `KEPT` times the (d,) ids and the (d, 2) positions, m. Some vehicles leave on the way, and
        others take their places.

    Raises:
        InputError: if netgenerate is needed and missing, or not enough vehicles found room.
    """
    duration_s = FILLING_S + KEPT * STEP_S
    scenario = city_scenario(city_blocks(d), d, seed, duration_s)
    agents = city_agents(scenario, int(np.ceil(SPARE * d)) + 1, seed)
    frames = []
    for frame in get_engine("sumo")(scenario, agents, seed):
        if frame.time_s < FILLING_S + 0.5 * STEP_S:
            continue
        if len(frame) < d:
            raise InputError(
                f"city: found {len(frame)} vehicles after {frame.time_s:.1f} s, expected {d}"
            )
        frames.append((frame.ids[:d], frame.xy[:d]))
    return tuple(frames)


def traffic(layout: str, d: int, steps: int, seed: int = 0) -> Iterator[tuple[Ids, Floats]]:
    """Ids and positions of d vehicles, every 0.1 s."""
    if layout == "city":
        yield from city_traffic(d, seed)[:steps]
    else:
        ids = np.arange(d)
        for xy in traffic_positions(layout, d, steps, seed):
            yield ids, xy


def traffic_positions(layout: str, d: int, steps: int, seed: int = 0) -> Iterator[Floats]:
    """Positions of d vehicles, every 0.1 s.

    Args:
        layout: "road" (one way, three lanes, 20 m apart per lane on average, 25 m/s) or "crossing"
            (four arms of three lanes, 12 m apart, three in ten standing).
        d: vehicles.
        steps: observations.
        seed: of the places and speeds.

    Yields:
        (d, 2) positions, m.

    Raises:
        InputError: for an unknown layout.
    """
    rng = np.random.default_rng(seed)
    lane = 3.5 * rng.integers(0, 3, d)
    if layout == "road":
        along, speed, turn = rng.random(d) * d / 3 * 20.0, rng.normal(25.0, 3.0, d), np.zeros(d)
    elif layout == "crossing":
        reach = d / 12 * 12.0 + 30.0
        along = rng.random(d) * 2 * reach - reach
        speed = rng.normal(10.0, 3.0, d) * (rng.random(d) < 0.7)
        turn = rng.integers(0, 4, d) * np.pi / 2
        lane += 1.75
    else:
        raise InputError(f"graph: found {layout!r}, expected {', '.join(LAYOUTS)}")
    for _ in range(steps):
        xy = np.stack(
            [
                along * np.cos(turn) + lane * np.sin(turn),
                along * np.sin(turn) - lane * np.cos(turn),
            ],
            axis=1,
        )
        yield xy + rng.normal(0.0, 0.05, xy.shape)
        along = along + speed * STEP_S


def graph_sequence(
    layout: str, kind: str, d: int, steps: int, skip: int = 0, seed: int = 0
) -> Iterator[TrafficGraph]:
    """Traffic graphs of `traffic`, four neighbours, reset at 100.

    Args:
        layout: one of `LAYOUTS`.
        kind: "instantaneous" or "accumulated".
        d: vehicles.
        steps: graphs wanted.
        skip: observations before the first of them.
        seed: of the positions.

    Yields:
        The graphs.
    """
    graph = TrafficGraph.empty(neighbors=4, reset=100, kind=cast(Any, kind))
    for step, (ids, xy) in enumerate(traffic(layout, d, skip + steps, seed)):
        graph = graph.observe(ids, xy)
        if step >= skip:
            yield graph
