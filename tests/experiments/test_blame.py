"""Blame by counterfactual: verdicts on a known near miss, and what they say beside the rules."""

from __future__ import annotations

import sys

import pytest

from experiments.generate.configuration import GenerateConfig
from experiments.generate.episode import Task
from experiments.what_if import blame
from scenarios import SCENARIOS
from sim.engines import get_engine
from sim.episode.annotate import incidents
from sim.frames import EventKind, Tracks
from sim.scenario import sample_agents


@pytest.mark.skipif(sys.platform != "linux", reason="branches need Linux")
def test_an_impatient_follower_answers_for_its_near_miss(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blame, "NEAREST", 1)
    scenario = SCENARIOS["four_way_intersection"](flow="dense", duration_s=38.0)
    config = GenerateConfig(scenarios=("four_way_intersection",), episodes=1)
    seed = Task(config, "four_way_intersection", 0).seed
    agents = sample_agents(scenario, seed)
    tracks = Tracks.from_frames(get_engine("sumo")(scenario, agents, seed))
    found = incidents(tracks, scenario.road)
    near = [e for e in found if e.kind in (EventKind.NEAR_MISS, EventKind.COLLISION)]
    assert len(near) == 1
    told = list(blame.judge(scenario, agents, seed))
    assert {line["agent"] for line in told} == {near[0].agent}
    assert [line["role"] for line in told] == ["agent", "other", "bystander"]
    follower = told[0]
    assert follower["driver"] == near[0].agent
    assert (follower["prevents"], follower["placebo"]) == (True, False)
    assert told[-1]["prevents"] is False
    assert follower["behavior"] == "impatient"
