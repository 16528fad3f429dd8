"""What if one driver had driven differently: one episode, continued in several ways, as a dataset.

The dataset holds the factual episode, whole and with the same bytes as ``generate`` makes of it,
and one counterfactual episode for each change, from the instant of the branch on. Their ``options``
say in ``branch`` what differs: ``at_s``, ``agent``, and ``behavior`` or ``action``.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field

from behaviors.errors import InputError
from behaviors.labels import Behavior
from experiments.console.progress import Progress
from experiments.data.data_card import write_data_card
from experiments.generate.configuration import GenerateConfig
from experiments.generate.episode import Task
from sim.frames import Frame
from sim.scenario import Scenario, sample_agents
from sim.store.dataset import is_dataset, open_dataset
from sim.store.schema import EpisodeMeta, Manifest
from sim.store.writing import made_with, new_dataset
from sim.sumo.branches import ENGINE_LAWS, Trunk, check_platform
from sim.sumo.control import Action

NAMED_DRIVERS: Final = 12
"""Most drivers that an error names (they fit a line or two)."""


class WhatIf(BaseModel):
    """One driver, one instant, and what is to differ.

    Attributes:
        episode: what the factual episode is generated from; exactly one scenario.
        index: which of the scenario's episodes.
        at_s: the instant from which on the driver differs, s; a multiple of the time between
            frames.
        agent: the driver's id.
        behaviors: the behaviours to go on with, one counterfactual episode each.
        actions: the actions to take at that instant, one counterfactual episode each.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)

    episode: GenerateConfig
    index: Annotated[int, Field(ge=0)] = 0
    at_s: float
    agent: int
    behaviors: tuple[Behavior, ...] = ()
    actions: tuple[Action, ...] = ()

    @property
    def changes(self) -> tuple[Behavior | Action, ...]:
        """Everything to try, in order."""
        return (*self.behaviors, *self.actions)

    def check(self) -> Scenario:
        """Refuse what cannot be branched, and return the episode's scenario."""
        check_platform()
        self.episode.check()
        if self.episode.engine not in ENGINE_LAWS:
            raise InputError(
                f"engine: found {self.episode.engine!r}, expected {' or '.join(ENGINE_LAWS)}"
            )
        if not self.changes:
            raise InputError("changes: found none, expected --behavior or --action at least once")
        if len(set(self.changes)) != len(self.changes):
            raise InputError(f"changes: found {', '.join(self.changes)}, expected each once")
        scenario = self.episode.scenario(self.episode.scenarios[0], self.index)
        steps = self.at_s / scenario.step_s
        if not 1 <= round(steps) < scenario.steps or abs(steps - round(steps)) > 1e-6:
            raise InputError(
                f"at_s: found {self.at_s:g}, expected a multiple of {scenario.step_s:g} s between "
                f"{scenario.step_s:g} and {(scenario.steps - 1) * scenario.step_s:g}"
            )
        return scenario


def branch_of(entry: EpisodeMeta) -> dict[str, Any] | None:
    """What differs in an episode (``at_s``, ``agent``, ``behavior`` or ``action``), if anything."""
    found = entry.options.get("branch")
    return found if isinstance(found, dict) else None


def change_of(entry: EpisodeMeta) -> str:
    """The behaviour or action that differs in an episode, or "factual"."""
    branch = branch_of(entry) or {}
    return str(branch.get("behavior") or branch.get("action") or "factual")


def make_what_if(config: WhatIf, folder: Path, quiet: bool = False) -> Manifest:
    """Make the factual and every counterfactual episode in a folder.

    The folder is new, empty, or has the same what-if, which is left as it is.
    """
    scenario = config.check()
    configuration: dict[str, Any] = {
        "what_if": {
            **config.model_dump(mode="json", exclude_none=True, exclude={"behaviors"}),
            "behaviors": [str(one) for one in config.behaviors],
        },
        "made_with": dict(made_with(config.episode.engine)),
        **({"behaviors": config.episode.behaviors} if config.episode.behaviors else {}),
    }
    if is_dataset(folder) and open_dataset(folder).header.configuration == configuration:
        return open_dataset(folder).manifest  # it is there already
    task = Task(config.episode, config.episode.scenarios[0], config.index)
    agents, factual = sample_agents(scenario, task.seed), task.meta(scenario)
    end_s = scenario.steps * scenario.step_s
    with (
        Trunk(scenario, agents, task.seed, config.episode.engine) as trunk,
        new_dataset(folder, configuration) as out,
        Progress("driving what would have been", 1 + len(config.changes), quiet) as shown,
    ):
        trunk.driver(config.agent)  # refuses one who is not in the episode
        before = trunk.advance(config.at_s)
        _check_present(config, before[-1])
        changes = (None, *config.changes)
        branches = [
            trunk.branch(end_s) if change is None else trunk.branch(end_s, config.agent, change)
            for change in changes
        ]
        for change, branch in zip(changes, branches, strict=True):
            meta, drivers, since_s = factual, list(agents), None
            if change is not None:
                kind, since_s = "action" if isinstance(change, Action) else "behavior", config.at_s
                what = {"at_s": config.at_s, "agent": config.agent, kind: str(change)}
                meta = factual.model_copy(update={"options": {**factual.options, "branch": what}})
            if isinstance(change, Behavior):
                other = trunk.alternative(config.agent, change)
                drivers = [other if one.id == config.agent else one for one in agents]
            with branch:
                frames = itertools.chain(before, branch)
                entry = out.write_episode(meta, frames, drivers, scenario.road.source, since_s)
            shown.advance(entry.agents, entry.agent_steps)
    write_data_card(folder)
    return open_dataset(folder).manifest


def _check_present(config: WhatIf, frame: Frame) -> None:
    """Refuse a driver who is not on the road at the instant of the branch."""
    if config.agent in frame.ids:
        return
    present = [int(agent) for agent in frame.ids[frame.driving]]
    some = ", ".join(map(str, present[:NAMED_DRIVERS]))
    more = ", ..." if len(present) > NAMED_DRIVERS else ""
    raise InputError(
        f"agent {config.agent}: found it not on the road at {config.at_s:g} s, expected one that "
        + (f"is, such as {some}{more}" if some else "is; nobody is there yet")
    )
