"""The engines: what makes frames from a scenario and its agents.

An engine is a function ``run(scenario, agents, seed) -> Iterator[Frame]``. Frames come every
``scenario.step_s`` from time ``step_s`` on, until ``scenario.duration_s``; closing the iterator
early closes the simulation. Engines are named by strings and loaded when first asked for.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Sequence
from typing import Final, TypeAlias, cast

from behaviors.errors import lookup
from sim.frames import Frame
from sim.scenario import AgentSpec, Scenario

Engine: TypeAlias = Callable[[Scenario, Sequence[AgentSpec], int], Iterator[Frame]]

ENGINES: Final[dict[str, str]] = {
    "sumo": "sim.sumo.engine:run",
    "sumo-idm": "sim.sumo.engine:run_idm",
    "highway": "sim.highway.engine:run",
    "highway-krauss": "sim.highway.engine:run_krauss",
}
"""Where each engine lives, as "module:function"."""


def get_engine(name: str) -> Engine:
    """The engine of that name.

    Args:
        name: a key of ``ENGINES``.

    Returns:
        The engine's ``run`` function.

    Raises:
        InputError: if there is no such engine.
    """
    module, function = lookup(ENGINES, name, "engine").split(":")
    return cast(Engine, getattr(importlib.import_module(module), function))
