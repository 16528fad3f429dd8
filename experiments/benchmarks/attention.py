"""How late drivers react, how their headway drifts, when they collide, and what they overlook.

A platoon follows a driver that brakes for no reason now and then. All followers have the numbers of
one behaviour but for the reaction time. Beside it stands the longest delay at which the law is
linearly string stable: there, a disturbance does not grow from driver to driver.

Lights, pedestrians and vehicles with priority are met by drivers who overlook a given share of
them.

References:
    Treiber, Kesting, Helbing (2006), Delays, inaccuracies and anticipation in microscopic traffic
        models, Physica A 360, 71.
    Wilson, Ward (2011), Car-following models: fifty years of linear stability analysis,
        Transportation Planning and Technology 34, 3.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.optimize import approx_fprime
from scipy.stats import binomtest

from behaviors.driver_models import idm_desired_gap, idm_free_acceleration, idm_interaction
from behaviors.errors import lookup
from behaviors.labels import BEHAVIORS, SHIPPED, Behavior, read_behaviors
from behaviors.profiles import Profile
from experiments.data.parallel import in_parallel
from experiments.score.rows import Cell, Row, tidy_row
from scenarios import get_scenario
from sim.engines import get_engine
from sim.episode.annotate import incidents
from sim.episode.observables import detector_inputs
from sim.episode.yielding import COULD_STOP_MPS2
from sim.frames import AgentKind, EventKind, FloatArray, Tracks
from sim.road import Road
from sim.safety import conflicts
from sim.scenario import DIMENSIONS_M, AgentSpec, sample_agents

REACTION_TIMES_S: Final = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5)
"""Reaction times of the followers, s."""

FOLLOWERS, STOPS_PER_MIN = 9, 3.0
"""Drivers behind the first one, and how often that wants to brake for no reason."""

BRAKES_MPS2, REACTS_MPS2, WITHIN_S = -1.0, -0.5, 8.0
"""Accelerations from which the first driver brakes, and the second reacts; a later braking is not a
reaction (our choice)."""

LAG_S: Final = 5.0
"""Lag of the headway's autocorrelation, s."""

LIMIT_MPS, CROWDED = 13.89, 0.7
"""Speed limit of the platoon, m/s, and speed of undisturbed traffic as a share of that desired."""

OVERLOOKED: Final = (0.0, 0.1, 0.3, 1.0)
"""Overlook probabilities of the drivers who meet others."""

ENCOUNTERS: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    "light": ("four_way_intersection", {"flow": 900.0, "pedestrians_per_h": 0.0}),
    "pedestrian": ("straight_road", {"flow": 500.0, "lanes": 1, "pedestrians_per_h": 400.0}),
    "priority": ("priority_intersection", {"flow": 750.0, "pedestrians_per_h": 0.0}),
}
"""Where each is met: a scenario and its options."""

MEET_S, TAKEN_S = 3.0, 1.0
"""Two vehicles meet if one comes to the other's way this soon after it, s. Without priority, going
first by less than the second is to overlook the other (our choice; careful drivers leave 1.5 s)."""

LEAST_MPS, NEAR_M, SLOWS = 5.0, 45.0, 0.7
"""A driver faster than the first meets pedestrians at a crossing within the second. It slows for
them if its speed falls below the third, a share (our choice)."""


def _platoon(
    profile: Profile, engine: str, seed: int, duration_s: float
) -> tuple[int, FloatArray, list[float]]:
    """Collisions, (k,) reactions of the second driver, s, and each follower's autocorrelation."""
    road = get_scenario("straight_road")(
        lanes=1, crossing=False, pedestrians_per_h=0.0, length_m=5000.0, duration_s=duration_s
    )
    route = next(flow.route for flow in road.flows if not flow.walking)
    first = dataclasses.replace(
        Behavior.CAREFUL.profile, speed_factor=0.9, stop_rate_per_min=STOPS_PER_MIN
    )
    length, width, _ = DIMENSIONS_M[AgentKind.CAR]
    agents = [
        AgentSpec(i, AgentKind.CAR, Behavior.CAREFUL, profile if i else first, route, 3.0 * i,
                  length, width, seed=1000 * seed + i)
        for i in range(FOLLOWERS + 1)
    ]  # fmt: skip
    frames = list(get_engine(engine)(road, agents, seed))
    hits = sum(one.kind is EventKind.COLLISION for frame in frames for one in frame.events)
    tracks = Tracks.from_frames(frames)
    accel = np.diff(tracks.speed, axis=1) / tracks.step_s
    begins = np.flatnonzero((accel[0, 1:] < BRAKES_MPS2) & ~(accel[0, :-1] < BRAKES_MPS2)) + 1
    begins = begins[~(accel[1, begins] < REACTS_MPS2)]
    ahead, lag = round(WITHIN_S / tracks.step_s), round(LAG_S / tracks.step_s)
    found = [np.flatnonzero(accel[1, at : at + ahead] < REACTS_MPS2)[:1] for at in begins]
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = np.hypot(*(tracks.xy[:-1] - tracks.xy[1:]).transpose(2, 0, 1)) - length
        headway = np.where(tracks.speed[1:] > 3.0, gap / tracks.speed[1:], np.nan)
    linked = [one.shift(lag).corr(one, min_periods=lag + 1) for one in map(pd.Series, headway)]
    return hits, np.concatenate([*found, np.empty(0)]) * tracks.step_s, linked


def _encounters(
    what: str, behavior: Behavior, probability: float, engine: str, seed: int, duration_s: float
) -> tuple[int, int]:
    """How many encounters with a key of `ENCOUNTERS` drivers ignored, and how many there were.

    The drivers of one behaviour overlook others with a probability.
    """
    name, options = ENCOUNTERS[what]
    own = {"overlooking": behavior.table() | {"overlook_probability": probability}}
    scenario = get_scenario(name)(
        behaviors=own, mix="overlooking=1", duration_s=duration_s, **options
    )
    tracks = Tracks.from_frames(get_engine(engine)(scenario, sample_agents(scenario, seed), seed))
    count = {"light": _lights, "pedestrian": _pedestrians, "priority": _priorities}[what]
    ignored, kept = count(tracks, scenario.road)
    return ignored, ignored + kept


def _lights(tracks: Tracks, road: Road) -> tuple[int, int]:
    """Red lights run, and lights at which a driver stood first in line."""
    kinds = [one.kind for one in incidents(tracks, road)]
    return kinds.count(EventKind.RED_RUN), kinds.count(EventKind.STOPPED)


def _priorities(tracks: Tracks, road: Road) -> tuple[int, int]:
    """Vehicles without priority that go just before one with it, and those that go after it."""
    met = conflicts(tracks, road)
    touch = met.gap_m <= 0.0
    decided = (met.priority >= 0) & ((met.pet_s <= MEET_S) | touch)
    after = met.passed_first == met.priority
    ignored = decided & ~after & ((met.pet_s <= TAKEN_S) | touch)
    return int(ignored.sum()), int((decided & after).sum())


def _pedestrians(tracks: Tracks, road: Road) -> tuple[int, int]:
    """Drivers who pass somebody who waits or walks at full speed, and those who slow down."""
    seen = detector_inputs(tracks, road)
    way, speed = seen.crossing_distance, seen.speed
    comes = seen.driving & seen.crossing_used & (seen.gap > way) & (speed > LEAST_MPS)
    comes &= (way > speed**2 / (2.0 * COULD_STOP_MPS2)) & (way < NEAR_M)
    ignored = kept = 0
    for agent in range(tracks.ids.size):
        rows = seen.row_index.rows(agent)
        first = np.flatnonzero(comes[rows])[:1]
        passed = np.flatnonzero(np.diff(np.minimum(way[rows], 1e3)) > NEAR_M / 2)
        if not first.size or not (passed >= first[0]).any():
            continue
        span = slice(rows.start + first[0], rows.start + passed[passed >= first[0]][0] + 1)
        slows = speed[span].min() < SLOWS * speed[span.start]
        kept += bool(slows)
        ignored += bool(not slows and seen.crossing_used[span.stop - 1])
    return ignored, kept


def _delay_limit_s(p: Profile) -> float:
    """The longest delay at which IDM is linearly string stable, s; 0 if it never is.

    A delay d multiplies the response by exp(-i w d). At the limit, the gain from a leader's
    speed to the follower's first exceeds 1 at some frequency w.
    """
    desired = LIMIT_MPS * p.speed_factor
    speed = CROWDED * desired

    def accel(state: FloatArray) -> float:
        gap, own, leader = state.tolist()
        wanted = idm_desired_gap(
            own, leader, p.min_gap_m, p.time_headway_s, p.max_accel_mps2, p.comfort_decel_mps2
        )
        free = idm_free_acceleration(own, desired, p.max_accel_mps2)
        return free - p.max_accel_mps2 * idm_interaction(gap, wanted)

    gap = (p.min_gap_m + speed * p.time_headway_s) / np.sqrt(1.0 - CROWDED**4)
    by_gap, by_own, by_leader = approx_fprime(np.array([gap, speed, speed]), accel)
    w, delays_s = np.geomspace(1e-3, 10.0, 2000), np.arange(0.0, 3.0, 0.01)
    late = np.exp(-1j * w * delays_s[:, None])
    gain = (by_gap + 1j * w * by_leader) * late / (-(w**2) + (by_gap - 1j * w * by_own) * late)
    unstable = np.append((np.abs(gain) > 1.0 + 1e-6).any(axis=1), True)
    return float(delays_s[max(int(unstable.argmax()) - 1, 0)])


def measure(
    behavior: str, engine: str, behaviors: str | None = None, seeds: int = 5,
    duration_s: float = 300.0, jobs: int | None = None,
) -> Iterator[list[Row]]:  # fmt: skip
    """Rows of platoons by ``reaction_time_s``, of the law's limit, and of what is overlooked.

    Each figure is of so many seeds' episodes with drivers of one behaviour, which may be one of
    one's own. The last rows are by what is met and the ``overlook_probability``.
    """
    own = *read_behaviors(",".join(SHIPPED)), *read_behaviors(behaviors)
    driver = lookup({str(one): one for one in (*BEHAVIORS, *own)}, behavior, "behavior")
    keys: dict[str, Cell] = {"engine": engine, "behavior": behavior}
    for reaction_s in REACTION_TIMES_S:
        profile = dataclasses.replace(driver.profile, reaction_time_s=reaction_s)
        tasks = [(profile, engine, seed, duration_s) for seed in range(seeds)]
        hits, reactions, linked = zip(*in_parallel(_platoon, tasks, jobs), strict=True)
        place: dict[str, Cell] = {**keys, "reaction_time_s": reaction_s}
        rows = [tidy_row(place, "collisions", sum(hits))]
        if (reaction := np.concatenate(reactions)).size:
            low, middle, high = np.percentile(reaction, [10, 50, 90])
            rows.append(tidy_row(place, "reaction_s", middle, low, high, reaction.size))
        if np.isfinite(linked).any():
            rows.append(tidy_row(place, "headway_autocorrelation", float(np.nanmean(linked))))
        yield rows
    yield [tidy_row(keys, "string_stable_up_to_s", _delay_limit_s(driver.profile))]
    for what in ENCOUNTERS:
        for chance in OVERLOOKED:
            tried = [(what, driver, chance, engine, seed, duration_s) for seed in range(seeds)]
            ignored, met = np.sum(list(in_parallel(_encounters, tried, jobs)), axis=0).tolist()
            value = low = high = None
            if met:
                low, high = binomtest(ignored, met).proportion_ci(method="wilson")
                value = ignored / met
            place = {**keys, "met": what, "overlook_probability": chance}
            yield [tidy_row(place, "ignored_share", value, low, high, met)]
