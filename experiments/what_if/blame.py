"""Blame by counterfactual: whose careful driving would have prevented a collision or near miss?

For each incident of an episode, the episode is branched some seconds before it, once for every
driver who was near, and that driver goes on carefully. If the incident does not happen, that driver
alone could have prevented it. Traffic is chaotic, so a second branch separates luck from care:
in it, the driver keeps the own behaviour with other numbers (placebo).

References:
    Pearl (2009), Causality, chapter 9: "but for" causes. Halpern and Pearl (2005), British Journal
    for the Philosophy of Science 56, 843: actual causes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import Behavior
from experiments.score.rows import Cell
from experiments.what_if.outcomes import INCIDENTS
from sim.episode.annotate import incidents
from sim.frames import Event, Frame, Tracks
from sim.scenario import AgentSpec, Scenario
from sim.sumo.branches import Trunk

LEAD_S: Final = 8.0
"""How long before an incident a driver becomes careful, s (as long as a rule broken before a
collision counts as its cause, and time enough to restore a headway)."""

AFTER_S: Final = 4.0
"""An incident that happens up to so much later is still the same one, s."""

NEAREST: Final = 4
"""How many drivers beside the two parties are tried: those nearest to either."""


def judge(
    scenario: Scenario, agents: Sequence[AgentSpec], seed: int, engine: str = "sumo"
) -> Iterator[dict[str, Cell]]:
    """Try every driver near each incident of an episode on "sumo" or "sumo-idm".

    Yields:
        A line for each incident and driver, in order of time. ``time_s``, ``incident``, ``agent``,
        ``other`` and ``rule`` are those of the incident, by `sim.episode.annotate`. ``driver`` is
        who was made careful, with its ``role`` ("agent" or "other" as in the incident, or
        "bystander") and its own ``behavior``. ``prevents`` says whether the incident does not
        happen then: False where the driver is careful already, None where it could not be changed
        (not on the road yet, or on the wrong side of it). ``placebo`` says the same with the driver
        merely drawn anew.

    Raises:
        InputError: on other systems than Linux, or if the simulation fails.
    """
    end_s = scenario.steps * scenario.step_s
    with Trunk(scenario, agents, seed, engine) as trunk:
        frames = trunk.advance(end_s)
    every = incidents(Tracks.from_frames(frames), scenario.road)
    found = [event for event in every if event.kind in INCIDENTS]
    if not found:
        return
    kept = round(2.0 * LEAD_S / scenario.step_s)  # as much as a cause may lie back
    before: list[Frame] = []

    def prevents(event: Event, agent: int, to: Behavior, until_s: float) -> bool | None:
        """Whether an incident does not happen if a driver goes on with a behaviour."""
        with trunk.branch(until_s, agent, to) as branch:
            try:
                after = tuple(branch)
            except InputError:
                return None
        return not _same_again(event, [*before[-kept:], *after], scenario)

    with Trunk(scenario, agents, seed, engine) as trunk:
        for event in found:
            until_s = min(event.time_s + AFTER_S, end_s)
            happened = frames[: round(until_s / scenario.step_s)]
            if not _same_again(event, happened, scenario):
                continue  # some are seen only with the rest of the episode in sight
            at_s = max(1, round((event.time_s - LEAD_S) / scenario.step_s)) * scenario.step_s
            if not before or at_s > before[-1].time_s + 1e-9:
                before += trunk.advance(at_s)
            for agent, role in _candidates(event, frames, scenario, trunk):
                behavior = trunk.driver(agent).behavior
                assert behavior is not None
                careful = behavior is not Behavior.CAREFUL and prevents(
                    event, agent, Behavior.CAREFUL, until_s
                )
                chance = None if careful is None else prevents(event, agent, behavior, until_s)
                yield {
                    "time_s": round(event.time_s, 2), "incident": event.kind.value,
                    "agent": event.agent, "other": event.other, "rule": event.words,
                    "driver": agent, "role": role, "behavior": behavior.value,
                    "prevents": careful, "placebo": chance,
                }  # fmt: skip


def _same_again(event: Event, frames: Sequence[Frame], scenario: Scenario) -> bool:
    """Whether the two parties of an incident have one as grave, from `LEAD_S` before it on.

    A collision in place of a near miss is no prevention.
    """
    grave = INCIDENTS[: INCIDENTS.index(event.kind) + 1]
    return any(
        one.kind in grave
        and {one.agent, one.other} == {event.agent, event.other}
        and one.time_s > event.time_s - LEAD_S
        for one in incidents(Tracks.from_frames(frames), scenario.road)
    )


def _candidates(
    event: Event, frames: Sequence[Frame], scenario: Scenario, trunk: Trunk
) -> list[tuple[int, str]]:
    """Ids and roles of the drivers who are tried: the parties, and those nearest to them."""
    frame = frames[min(round(event.time_s / scenario.step_s), len(frames)) - 1]
    parties = [(event.agent, "agent")]
    parties += [] if event.other is None else [(event.other, "other")]
    there = np.isin(frame.ids, [agent for agent, _ in parties])
    near: list[tuple[int, str]] = []
    if there.any():
        away = np.linalg.norm(frame.xy[:, None] - frame.xy[there][None], axis=2).min(axis=1)
        order = np.argsort(away, kind="stable")
        rows = [row for row in order.tolist() if not there[row] and frame.driving[row]]
        near = [(int(frame.ids[row]), "bystander") for row in rows[:NEAREST]]
    return [(agent, role) for agent, role in (*parties, *near) if agent in trunk.drivers]
