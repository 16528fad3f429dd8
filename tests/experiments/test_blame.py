"""Blame by counterfactual: verdicts on a known near miss, and what they say beside the rules."""

from __future__ import annotations

import sys

import pytest

from behaviors.labels import Behavior
from experiments.benches.blame import rows_of
from experiments.data.configuration import GenerateConfig
from experiments.data.episode import Task
from experiments.what_if.blame import Verdict, agreements, judge, verdict_rows
from scenarios import SCENARIOS
from sim.engines import get_engine
from sim.episode.incidents import incidents
from sim.episode.rows import TrajectoryRows
from sim.frames import Event, EventKind, Tracks
from sim.scenario import sample_agents

CRASH = Event(EventKind.COLLISION, 20.0, 4, 7, "followed too closely")
NEAR = Event(EventKind.NEAR_MISS, 30.0, 5, 6)


def verdict(event: Event, agent: int, role: str, prevents: bool | None, placebo: bool | None):
    return Verdict(event, agent, role, Behavior.RECKLESS, prevents, placebo)


def test_agreement_counts_where_exactly_one_party_prevents() -> None:
    crash, near = agreements(
        [
            verdict(CRASH, 4, "agent", False, False),
            verdict(CRASH, 7, "other", True, False),
            verdict(CRASH, 9, "bystander", True, True),
            verdict(NEAR, 5, "agent", True, True),
            verdict(NEAR, 6, "other", True, False),
        ]
    )
    assert crash.agrees is False
    assert crash.preventable
    assert crash.by_bystander
    assert crash.lucky == pytest.approx(1 / 3)
    assert near.agrees is None  # both do
    assert not near.by_bystander


def test_who_could_not_be_tried_decides_nothing() -> None:
    (told,) = agreements(
        [verdict(CRASH, 4, "agent", None, None), verdict(CRASH, 7, "other", True, False)]
    )
    assert told.agrees is None
    assert told.by_blamed is None
    assert told.preventable


def test_rows_are_shares_over_incidents() -> None:
    episodes = [
        agreements(
            [verdict(CRASH, 4, "agent", True, False), verdict(CRASH, 7, "other", False, True)]
        ),
        agreements([verdict(CRASH, 4, "agent", False, False)]),
        [],
    ]
    value = {row["metric"]: row["value"] for row in rows_of("here", EventKind.COLLISION, episodes)}
    assert value["incidents"] == 2
    assert value["by_blamed"] == value["preventable"] == 0.5
    assert value["agreement"] == 1.0
    assert value["luck"] == 0.25
    assert rows_of("here", EventKind.NEAR_MISS, episodes)[0]["value"] == 0
    assert len(rows_of("here", EventKind.NEAR_MISS, episodes)) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="branches need Linux")
def test_an_impatient_follower_answers_for_its_near_miss() -> None:
    scenario = SCENARIOS["four_way_intersection"](flow="dense", duration_s=38.0)
    config = GenerateConfig(scenarios=("four_way_intersection",), episodes=1)
    seed = Task(config, "four_way_intersection", 0).seed
    agents = sample_agents(scenario, seed)
    tracks = Tracks.from_frames(get_engine("sumo")(scenario, agents, seed))
    found = incidents(TrajectoryRows.of(tracks), scenario.road)
    near = [e for e in found if e.kind in (EventKind.NEAR_MISS, EventKind.COLLISION)]
    assert len(near) == 1
    told = list(judge(scenario, agents, seed, bystanders=1))
    assert {v.event.agent for v in told} == {near[0].agent}
    assert [v.role for v in told] == ["agent", "other", "bystander"]
    follower = told[0]
    assert follower.agent == near[0].agent
    assert (follower.prevents, follower.placebo) == (True, False)
    assert told[-1].prevents is False
    rows = verdict_rows(told)
    assert rows[0]["behavior"] == follower.behavior
    assert rows[0]["driver"] == near[0].agent
