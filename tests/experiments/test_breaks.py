"""Recordings with breaks in time, or with frames far apart: nothing is told of what nobody saw."""

from __future__ import annotations

import numpy as np
import pytest

from behaviors.labels import BEHAVIORS
from experiments.score.predictions import future
from graphrqi.posterior import Posterior
from graphrqi.predict import predict
from scenarios import SCENARIOS
from sim.episode.annotate import annotate, annotate_recording
from sim.formats.common.doubts import doubt_of_times
from sim.frames import KINDS, AgentKind, Tracks
from sim.road import Road


@pytest.fixture(scope="module")
def road() -> Road:
    return SCENARIOS["four_way_intersection"]().road


def recorded(time_s: np.ndarray, x: np.ndarray, kind: AgentKind = AgentKind.CAR) -> Tracks:
    """One agent that goes east; recordings have no signals."""
    t = time_s.size
    xy = np.stack([x, np.full(t, -1.6)], axis=1)[None]
    return Tracks.of_dense(
        ids=[0], names=("a",), kind=[KINDS.index(kind)], length=[4.5], width=[1.8], time_s=time_s,
        xy=xy, heading=np.zeros((1, t)), speed=np.full((1, t), 5.0), valid=np.ones((1, t)),
        signals=np.empty((0, t), dtype=np.int8),
    )  # fmt: skip


def with_gap(gap_s: float) -> Tracks:
    """Three seconds at 10 Hz, a break, and three seconds more."""
    times = np.arange(30) / 10
    return recorded(np.append(times, gap_s + times), -90 + 5 * np.append(times, 6 + times))


def test_parts_between_breaks_are_looked_at_by_themselves(road: Road) -> None:
    tracks = with_gap(300.0)
    parts = list(tracks.between_breaks())
    assert [part.time_s.size for part in parts] == [30, 30]
    assert [part.step_s for part in parts] == pytest.approx([0.1, 0.1])
    alone = [annotate(tracks.part(np.array([0]), s), road, recorded=True)
             for s in (slice(30), slice(30, None))]  # fmt: skip
    events, shown = annotate_recording(tracks, road)
    assert events == alone[0].events + alone[1].events
    assert shown == alone[0].shown_traits + alone[1].shown_traits
    # a driver seen for 3 s shows nothing that takes 15 s
    assert not [one for one in shown if one.end_s - one.begin_s > 3.0]


@pytest.mark.parametrize("step_s", [10.1, 400.0])
def test_nothing_is_told_from_frames_that_are_far_apart(road: Road, step_s: float) -> None:
    tracks = recorded(np.arange(20) * step_s, np.arange(20) - 90.0)
    assert annotate_recording(tracks, road) == ((), ())


@pytest.mark.parametrize("gap_s", [1e3, 1e8])
@pytest.mark.parametrize("with_map", [True, False])
def test_a_prediction_after_a_break_is_that_of_what_came_after(
    road: Road, gap_s: float, with_map: bool
) -> None:
    tracks, where = with_gap(gap_s), road if with_map else None
    after = tracks.part(np.array([0]), slice(30, None))
    nobody = Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))
    found, expected = (predict(history, nobody, where) for history in (tracks, after))
    np.testing.assert_array_equal(found.xy, expected.xy)


def test_nobody_knows_where_agents_were_in_a_break() -> None:
    truth = future(with_gap(300.0), np.array([0]), 25, np.array([0.5, 0.6, 100.0]))
    assert np.isfinite(truth[0, :, 0]).tolist() == [True, False, False]


def test_a_break_does_not_contradict_the_clock() -> None:
    assert doubt_of_times(with_gap(1e5)) is None
