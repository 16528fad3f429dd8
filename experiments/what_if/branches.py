"""What if one driver had driven differently: one episode, continued in several ways, as a dataset.

The dataset holds the factual episode, whole and with the same bytes as ``generate`` makes of it,
and one counterfactual episode for each change, from the instant of the branch on. Their ``options``
say in ``branch`` what differs: ``at_s``, ``agent``, and ``behavior`` or ``action``.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from behaviors.errors import InputError
from behaviors.labels import Behavior
from experiments.console.progress import Progress
from experiments.data.data_card import write_data_card
from experiments.generate.configuration import GenerateConfig
from experiments.generate.episode import Task
from sim.scenario import sample_agents
from sim.store.dataset import is_dataset, open_dataset
from sim.store.schema import EpisodeMeta, Manifest
from sim.store.writing import made_with, new_dataset
from sim.sumo.branches import ENGINE_LAWS, Trunk
from sim.sumo.control import Action

NAMED_DRIVERS: Final = 12
"""Most drivers that an error names (they fit a line or two)."""


def branch_of(entry: EpisodeMeta) -> dict[str, Any] | None:
    """What differs in an episode (``at_s``, ``agent``, ``behavior`` or ``action``), if anything."""
    found = entry.options.get("branch")
    return found if isinstance(found, dict) else None


def change_of(entry: EpisodeMeta) -> str:
    """The behaviour or action that differs in an episode, or "factual"."""
    branch = branch_of(entry) or {}
    return str(branch.get("behavior") or branch.get("action") or "factual")


def make_what_if(
    episode: GenerateConfig,
    folder: Path,
    *,
    at_s: float,
    agent: int,
    changes: Sequence[Behavior | Action],
    index: int = 0,
    quiet: bool = False,
) -> Manifest:
    """Make the factual and every counterfactual episode in a folder.

    Args:
        episode: what the factual episode is generated from; exactly one scenario.
        folder: new, empty, or with the same what-if, which is left as it is.
        at_s: the instant from which on the driver differs, s; a multiple of the time between
            frames.
        agent: the driver's id.
        changes: behaviours to go on with and actions to take at that instant, one counterfactual
            episode each.
        index: which of the scenario's episodes.
        quiet: whether to show no progress.

    Raises:
        InputError: on other systems than Linux, or for what cannot be branched.
    """
    episode.check()
    if episode.engine not in ENGINE_LAWS:
        raise InputError(f"engine: found {episode.engine!r}, expected {' or '.join(ENGINE_LAWS)}")
    if not changes:
        raise InputError("changes: found none, expected --behavior or --action at least once")
    if len(set(changes)) != len(changes):
        raise InputError(f"changes: found {', '.join(changes)}, expected each once")
    scenario = episode.scenario(episode.scenarios[0], index)
    steps = at_s / scenario.step_s
    if not 1 <= round(steps) < scenario.steps or abs(steps - round(steps)) > 1e-6:
        raise InputError(
            f"at_s: found {at_s:g}, expected a multiple of {scenario.step_s:g} s between "
            f"{scenario.step_s:g} and {(scenario.steps - 1) * scenario.step_s:g}"
        )
    configuration: dict[str, Any] = {
        "what_if": {
            "episode": episode.model_dump(mode="json", exclude_none=True),
            "index": index,
            "at_s": at_s,
            "agent": agent,
            "actions": [str(one) for one in changes if isinstance(one, Action)],
            "behaviors": [str(one) for one in changes if isinstance(one, Behavior)],
        },
        "made_with": dict(made_with(episode.engine)),
        **({"behaviors": episode.behaviors} if episode.behaviors else {}),
    }
    if is_dataset(folder) and open_dataset(folder).header.configuration == configuration:
        return open_dataset(folder).manifest  # it is there already
    task = Task(episode, episode.scenarios[0], index)
    agents, factual = sample_agents(scenario, task.seed), task.meta(scenario)
    end_s = scenario.steps * scenario.step_s
    with (
        Trunk(scenario, agents, task.seed, episode.engine) as trunk,
        new_dataset(folder, configuration) as out,
        Progress("driving what would have been", 1 + len(changes), quiet) as shown,
    ):
        trunk.driver(agent)  # refuses one who is not in the episode
        before = trunk.advance(at_s)
        now = before[-1]
        if agent not in now.ids:
            there = ", ".join(map(str, now.ids[now.driving][:NAMED_DRIVERS].tolist()))
            raise InputError(
                f"agent {agent}: found it not on the road at {at_s:g} s, expected one that is"
                + (f", such as {there}" if there else "; nobody is there yet")
            )
        every = (None, *changes)
        branches = [
            trunk.branch(end_s) if change is None else trunk.branch(end_s, agent, change)
            for change in every
        ]
        for change, branch in zip(every, branches, strict=True):
            meta, drivers, since_s = factual, list(agents), None
            if change is not None:
                kind, since_s = "action" if isinstance(change, Action) else "behavior", at_s
                what = {"at_s": at_s, "agent": agent, kind: str(change)}
                meta = factual.model_copy(update={"options": {**factual.options, "branch": what}})
            if isinstance(change, Behavior):
                other = trunk.alternative(agent, change)
                drivers = [other if one.id == agent else one for one in agents]
            with branch:
                frames = itertools.chain(before, branch)
                entry = out.write_episode(meta, frames, drivers, scenario.road.source, since_s)
            shown.advance(entry.agents, entry.agent_steps)
    write_data_card(folder)
    return open_dataset(folder).manifest
