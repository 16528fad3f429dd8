"""The engines: simulators that make frames from a scenario and its agents.

An engine is a function ``run(scenario, agents, seed) -> Iterator[Frame]``. It yields a frame every
``scenario.step_s``, ``scenario.steps`` in all, the first at ``step_s``; closing the iterator early
closes the simulation. The registry refuses agents and seeds that no engine can drive before it
calls the engine, so an engine need not check them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Final, TypeAlias

from behaviors.registry import Registry
from sim.frames import Frame
from sim.scenario import AgentSpec, Scenario, check_agents

Engine: TypeAlias = Callable[[Scenario, Sequence[AgentSpec], int], Iterator[Frame]]


def _checked(name: str, run: Engine) -> Engine:
    @functools.wraps(run)
    def start(scenario: Scenario, agents: Sequence[AgentSpec], seed: int) -> Iterator[Frame]:
        check_agents(scenario, agents, seed)
        return run(scenario, agents, seed)

    return start


ENGINES: Final[Registry[Engine]] = Registry(
    "engine",
    "graphrqi.engines",
    {
        "sumo": "sim.sumo.engine:run",
        "sumo-idm": "sim.sumo.engine:run_idm",
        "highway": "sim.highway.run:run",
        "highway-krauss": "sim.highway.run:run_krauss",
    },
    made=_checked,
)
"""Every engine by name."""


def get_engine(name: str) -> Engine:
    """The ``run`` function of the engine of that name, a key of ``ENGINES``."""
    return ENGINES[name]
