"""Does knowing who drives how help to drive? A planned vehicle among the six behaviours.

In every episode the same planner (`graphrqi.predict.planner`) drives the ego vehicle of a gymnasium
environment among the same traffic three times: taking everybody for the average driver, by the
classifier's beliefs, and by the true behaviours. Near misses are counted afterwards, in what was
driven, not in what was planned.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.driver_models import krauss_safe_speed
from behaviors.labels import BEHAVIORS
from experiments.benches.contract import Bench, option
from experiments.data.parallel import in_parallel
from experiments.score.metrics import bootstrap, ratio
from experiments.score.rows import Cell, Row, tidy_row
from graphrqi.methods import Model
from graphrqi.model_files import load_model
from graphrqi.predict.planner import ACT_S, Plan, plan
from graphrqi.predict.rollout.driver_table import default_table
from graphrqi.predict.scene.scene import make_scene
from graphrqi.stream import DEFAULT_MODEL, HISTORY_STEPS, BehaviorStream
from sim.episode.buffer import FrameBuffer
from sim.episode.observables import leaders, observe
from sim.episode.rows import TrajectoryRows
from sim.frames import FloatArray, Frame, IntArray, Tracks
from sim.road import Road
from sim.scenario import sample_agents

ENVIRONMENTS: Final[dict[str, str]] = {
    "straight_road": "graphrqi/StraightRoad-v0",
    "four_way_intersection": "graphrqi/FourWayIntersection-v0",
}
"""Where it is driven."""

ARMS: Final = ("blind", "classified", "true")
"""What the planner is told of the others: nothing, the classifier's beliefs, or the truth."""

SETTING: Final[dict[str, Any]] = {"flow": "dense", "duration_s": 90.0}
"""How the environments are configured (in light traffic nothing happens)."""

NEAR_MISS_S: Final = 1.5
"""Time to collision below which somebody ahead or behind counts as a near miss, s."""

APART_S: Final = 1.0
"""Near misses less than this apart are one, s."""

LOOK_AHEAD_M, LOOK_AHEAD_S = 8.0, 1.2
"""The steering looks at the centre line this far ahead (Coulter 1992's pure pursuit; the lengths
are ours: a lane change takes some 3 s)."""

MOST_ACCEL_MPS2: Final = 8.0
"""The ego vehicle's accelerator and brake reach this, m/s2."""

EMERGENCY_DECEL_MPS2, EMERGENCY_S, EMERGENCY_GAP_M = 7.0, 0.2, 0.5
"""The emergency brake counts on this deceleration, brakes within this time and leaves this gap (as
hard as dry asphalt allows, so that the plan and not the brake avoids near misses)."""

METRICS: Final = (
    "near_misses", "near_misses_ahead", "near_misses_behind", "env_near_misses", "collisions",
    "red_runs", "mean_speed_mps", "arrived", "time_to_goal_s", "label_accuracy",
)  # fmt: skip
"""What is measured of an episode."""


@functools.lru_cache(maxsize=2)
def _model(name: str) -> Model:
    """A classifier, read once."""
    return load_model(name)


class BeliefTracker:
    """Sees every frame of an environment, and remembers and, if asked to, classifies what it saw.

    Environments call it as their classifier; their observation of beliefs stays uniform, since the
    planner asks the stream itself, when it plans.

    Args:
        model: the classifier; None: nobody is classified.
    """

    def __init__(self, model: str | None) -> None:
        self.model = model
        self._begin()

    def _begin(self) -> None:
        self.stream = None if self.model is None else BehaviorStream(_model(self.model))
        self.buffer = FrameBuffer(HISTORY_STEPS)
        self.frames: list[Frame] = []

    def __call__(self, frame: Frame) -> BeliefTracker:
        """Take the next frame; one from before the last begins a new episode."""
        if self.frames and frame.time_s <= self.frames[-1].time_s:
            self._begin()
        self.frames.append(frame)
        self.buffer.push(frame)
        if self.stream is not None:
            self.stream.push(frame)
        return self

    def of(self, ids: IntArray) -> FloatArray:
        """Uniform beliefs."""
        return np.full((ids.size, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))


def steering(plan: Plan, xy: FloatArray, heading: float, speed: float, length: float) -> float:
    """The front wheels' angle that leads onto the plan's line, rad, positive to the left.

    Pure pursuit: a circle through a point on the line ahead, driven by highway-env's bicycle.
    """
    reach = max(LOOK_AHEAD_M, LOOK_AHEAD_S * speed)
    away = np.hypot(*(plan.centre - xy).T)
    ahead = np.flatnonzero(away >= reach)
    nearest = int(away.argmin())
    ahead = ahead[ahead > nearest]
    goal = plan.centre[ahead[0] if ahead.size else -1] - xy
    angle = math.atan2(goal[1], goal[0]) - heading
    curvature = 2.0 * math.sin(angle) / max(float(np.hypot(*goal)), 1.0)
    slip = math.asin(max(-0.7, min(0.7, curvature * length / 2.0)))
    return math.atan(2.0 * math.tan(slip))


def safe_accel(frame: Frame, road: Road, me: int) -> float:
    """The most at which one can still stop behind the leader, if that one brakes to a stop, m/s2.

    The emergency brake of every arm: what others are believed to do may be wrong. The safe speed is
    Krauss's.
    """
    every, gaps = leaders(frame, road)
    leader, speed = int(every[me]), float(frame.speed[me])
    if leader < 0:
        return math.inf
    room = max(float(gaps[me]) - EMERGENCY_GAP_M, 0.0)
    safe = krauss_safe_speed(room, float(frame.speed[leader]), EMERGENCY_S, EMERGENCY_DECEL_MPS2)
    return (safe - speed) / EMERGENCY_S


class PlannedEgo:
    """The planner at the wheel, told nothing, beliefs or the truth of everybody else.

    Args:
        arm: one of `ARMS`.
        tracker: has seen every frame of the environment; the last one is the present.
        truth: code of the true behaviour by agent id.
        road: where it is.
        ego_id: agent id of the vehicle that is driven.

    Attributes:
        right: for each belief so far whether it was the truth.
    """

    def __init__(
        self, arm: str, tracker: BeliefTracker, truth: Mapping[int, int], road: Road, ego_id: int
    ) -> None:
        self._arm, self._tracker, self._truth = arm, tracker, truth
        self._road, self._ego_id = road, ego_id
        self._current: Plan | None = None
        self._next_s = 0.0
        self.right: list[float] = []

    def action(self, time_s: float) -> NDArray[np.float32]:
        """(2,) acceleration and steering for highway-env's ``ContinuousAction``.

        Args:
            time_s: since the vehicle entered, s; a new plan is made every `ACT_S`.
        """
        frame = self._tracker.frames[-1]
        row = np.flatnonzero(frame.ids == self._ego_id)
        if time_s >= self._next_s - 1e-6 and row.size:
            beliefs, hits = _beliefs(self._arm, self._tracker, frame, self._truth)
            self.right += hits
            history = self._tracker.buffer.tracks()
            planned = _planned(history, self._road, self._ego_id, beliefs)
            self._current = planned or self._current
            self._next_s = time_s + ACT_S
        action = np.zeros(2, dtype=np.float32)
        if self._current is not None and row.size:
            me = int(row[0])
            turn = steering(
                self._current, frame.xy[me], float(frame.heading[me]), float(frame.speed[me]),
                float(frame.length[me]),
            )  # fmt: skip
            accel = min(self._current.accel, safe_accel(frame, self._road, me))
            action[0] = accel / MOST_ACCEL_MPS2
            action[1] = -turn / (math.pi / 4)  # highway-env's y points to the right
        return np.clip(action, -1.0, 1.0)


def drive(
    scenario: str, arm: str, seed: int, model: str = DEFAULT_MODEL,
    changes: Mapping[str, float] | None = None,
) -> dict[str, float]:  # fmt: skip
    """Drive one episode.

    Args:
        scenario: a key of `ENVIRONMENTS`.
        arm: one of `ARMS`.
        seed: of the traffic.
        model: the classifier.
        changes: to the environment's configuration.

    Returns:
        The `METRICS`; NaN where there is none.
    """
    import gymnasium

    import scenarios  # noqa: F401  registers the environments

    tracker = BeliefTracker(model if arm == "classified" else None)
    limits = {"type": "ContinuousAction", "acceleration_range": [-MOST_ACCEL_MPS2, MOST_ACCEL_MPS2]}
    config: dict[str, Any] = {
        "seed": seed, "observation": "posterior", "classifier": tracker, "observed": 1,
        "action": limits, "policy_frequency": 10, **SETTING, **(changes or {}),
    }  # fmt: skip
    env = gymnasium.make(ENVIRONMENTS[scenario], config=config, disable_env_checker=True)
    env.reset(seed=seed)
    inner: Any = env.unwrapped
    agents = sample_agents(inner.scenario, seed)
    truth = {a.id: a.behavior.code for a in agents if a.behavior is not None}
    ego_id = max((a.id for a in agents), default=-1) + 1
    road: Road = inner.scenario.road
    ego = PlannedEgo(arm, tracker, truth, road, ego_id)
    begun = len(tracker.frames)
    counts = {"env_near_misses": 0, "collisions": 0, "red_runs": 0}
    arrived = False
    ended = cut = False
    time_s = 0.0
    while not (ended or cut):
        _, _, ended, cut, info = env.step(ego.action(time_s))
        time_s = info["time_s"]
        counts["env_near_misses"] += info["near_misses"]
        counts["collisions"] += info["collisions"]
        counts["red_runs"] += info["red_runs"]
        arrived = info["arrived"]
    env.close()
    driven = Tracks.from_frames(tracker.frames[begun:])
    ahead, behind = near_misses(driven, road, ego_id)
    me = int(np.searchsorted(driven.ids, ego_id))
    return {
        "near_misses": float(ahead + behind),
        "near_misses_ahead": float(ahead),
        "near_misses_behind": float(behind),
        **{name: float(count) for name, count in counts.items()},
        "mean_speed_mps": float(np.nanmean(driven.speed[me])),
        "arrived": float(arrived),
        "time_to_goal_s": float(time_s) if arrived else float("nan"),
        "label_accuracy": float(np.mean(ego.right)) if ego.right else float("nan"),
    }


def _planned(history: Tracks, road: Road, ego_id: int, beliefs: FloatArray) -> Plan | None:
    """Plan from what is seen; None where the ego vehicle is on no lane."""
    scene = make_scene(history, road)
    ego = int(np.searchsorted(scene.ids, ego_id))
    if not scene.on_path[ego]:
        return None
    return plan(scene, ego, beliefs, default_table())


def _beliefs(
    arm: str, tracker: BeliefTracker, frame: Frame, truth: Mapping[int, int]
) -> tuple[FloatArray, list[float]]:
    """What the planner is told of everybody in a frame, and which of the labels are right."""
    n = frame.ids.size
    if arm == "blind":
        return np.full((n, len(BEHAVIORS)), 1.0 / len(BEHAVIORS)), []
    if arm == "true":
        told = np.full((n, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))
        for i, agent in enumerate(frame.ids):
            if int(agent) in truth:
                told[i] = np.eye(len(BEHAVIORS))[truth[int(agent)]]
        return told, []
    assert tracker.stream is not None
    posterior = tracker.stream.posterior()
    hits = [
        float(code == truth[int(agent)])
        for agent, code in zip(posterior.ids, posterior.most_likely, strict=True)
        if int(agent) in truth
    ]
    return posterior.of(frame.ids), hits


def near_misses(driven: Tracks, road: Road, ego_id: int) -> tuple[int, int]:
    """How often somebody ahead or behind came nearer than `NEAR_MISS_S` to colliding.

    Args:
        driven: the episode.
        road: where.
        ego_id: whose near misses.

    Returns:
        Those with the leader and those with the follower.
    """
    me = int(np.searchsorted(driven.ids, ego_id))
    steps = TrajectoryRows.of(driven)
    seen, row_index = observe(steps, road), steps.row_index
    close = (seen.gap >= 0.0) & (seen.time_to_collision < NEAR_MISS_S)
    mine = row_index.agent == me
    behind = mine[seen.leader] & (seen.leader >= 0)
    return (
        _events(row_index.step[close & mine], driven.step_s),
        _events(np.unique(row_index.step[close & behind]), driven.step_s),
    )


def _events(at: np.ndarray[Any, np.dtype[np.int64]], step_s: float) -> int:
    """How many events make up these times' indices: those closer than `APART_S` are one."""
    return int(at.size > 0) + int((np.diff(at) > APART_S / step_s).sum())


@dataclass(frozen=True, slots=True)
class Settings:
    """How many episodes are driven.

    Attributes:
        model: the classifier.
        seeds: episodes per environment and arm.
        first_seed: seed of the first episode; the planner was tuned on other ones.
        jobs: processes; None for one per core.
        changes: to the environments' configuration, by name.
    """

    model: str = option(DEFAULT_MODEL, "The classifier.")
    seeds: int = option(100, "Episodes per environment and arm.")
    first_seed: int = option(500_000, "Seed of the first episode.")
    jobs: int | None = option(None, "Processes [default: one per core].")
    changes: tuple[tuple[str, float], ...] = ()


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Drive every environment by every arm.

    Yields:
        Rows of each environment: means per episode; beside the blind arm's ``METRIC_minus_blind``
        and ``near_misses_over_blind``, paired by seed.
    """
    seeds = range(settings.first_seed, settings.first_seed + settings.seeds)
    for scenario in ENVIRONMENTS:
        arguments = [
            (scenario, arm, seed, settings.model, dict(settings.changes))
            for seed in seeds for arm in ARMS
        ]  # fmt: skip
        found = list(in_parallel(drive, arguments, settings.jobs))
        table = np.array([[one[m] for m in METRICS] for one in found])
        yield compare(scenario, table.reshape(len(seeds), len(ARMS), len(METRICS)))


def compare(environment: str, table: FloatArray) -> list[Row]:
    """Rows of (seeds, arms, metrics) numbers, with intervals over seeds."""
    rows: list[Row] = []
    for a, arm in enumerate(ARMS):
        keys = {"environment": environment, "arm": arm}
        for m, metric in enumerate(METRICS):
            own, blind = table[:, a, m], table[:, 0, m]
            rows += _ratio_rows(keys, metric, own[:, None])
            if a and np.isfinite(blind).any():
                rows += _ratio_rows(keys, f"{metric}_minus_blind", (own - blind)[:, None])
        if a:
            m = METRICS.index("near_misses")
            rows += _ratio_rows(keys, "near_misses_over_blind", table[:, [a, 0], m])
    return rows


def _ratio_rows(keys: Mapping[str, Cell], metric: str, values: FloatArray) -> list[Row]:
    """The mean of one column, or the ratio of two, over the episodes in which it is known."""
    values = values[np.isfinite(values).all(axis=1)]
    if not len(values):
        return []
    found = bootstrap(ratio, np.column_stack([values, np.ones(len(values))]))
    return [tidy_row(keys, metric, *found, len(values))] if np.isfinite(found[0]) else []


BENCH: Final = Bench(
    name="navigation",
    summary="Drive among others, with and without knowing who drives how.",
    keys=("environment", "arm"),
    full=Settings(),
    quick=Settings(seeds=2, changes=(("duration_s", 3.0), ("warmup_s", 3.0))),
    measure=measure,
)
