"""The engines: what makes frames from a scenario and its agents.

An engine is a function ``run(scenario, agents, seed) -> Iterator[Frame]``. Frames come every
``scenario.step_s`` from time ``step_s`` on, until ``scenario.duration_s``; closing the iterator
early closes the simulation. Engines are named by strings and loaded when first asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final, TypeAlias

from behaviors.registry import Registry
from sim.frames import Frame
from sim.scenario import AgentSpec, Scenario

Engine: TypeAlias = Callable[[Scenario, Sequence[AgentSpec], int], Iterator[Frame]]

ENGINES: Final[Registry[Engine]] = Registry(
    "engine",
    "graphrqi.engines",
    {
        "sumo": "sim.sumo.engine:run",
        "sumo-idm": "sim.sumo.engine:run_idm",
        "highway": "sim.highway.engine:run",
        "highway-krauss": "sim.highway.engine:run_krauss",
    },
)
"""Every engine by name."""


def get_engine(name: str) -> Engine:
    """The engine of that name.

    Args:
        name: a key of ``ENGINES``.

    Returns:
        The engine's ``run`` function.

    Raises:
        InputError: if there is no such engine.
    """
    return ENGINES[name]
