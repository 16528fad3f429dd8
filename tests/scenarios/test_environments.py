"""The gymnasium environments: the API, determinism, what they observe, draw and refuse."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from behaviors import BEHAVIORS, InputError
from behaviors.populations import read_population
from graphrqi.stream import load_stream
from scenarios import ENVIRONMENTS
from scenarios.environments.observation import observable_agents
from sim.scenario import sample_agents

QUICK = {"warmup_s": 4.0, "duration_s": 3.0}
IDS = tuple(ENVIRONMENTS)
OPTIONS = ("kinematics", "behavior", "posterior", "graph")


class Uniform:
    """A classifier that has learnt nothing, and counts the frames it is given."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def __call__(self, frame):
        self.times.append(frame.time_s)
        return self

    def of(self, ids):
        return np.full((ids.size, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))


def make(name: str, *, render_mode: str | None = None, **config):
    if config.get("observation") == "posterior":
        config.setdefault("classifier", Uniform())
    return gymnasium.make(name, render_mode=render_mode, config={**QUICK, **config})


def drive(env, seed: int, steps: int = 10, action: int | None = None):
    env.action_space.seed(seed)
    seen = [env.reset(seed=seed)[0]]
    rewards = []
    for _ in range(steps):
        observation, reward, ended, cut, _ = env.step(
            env.action_space.sample() if action is None else action
        )
        seen.append(observation)
        rewards.append(reward)
        if ended or cut:
            break
    return seen, rewards


def assert_same(one, other):
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        assert a.keys() == b.keys()
        for key in a:
            np.testing.assert_array_equal(a[key], b[key], err_msg=key)


@pytest.mark.parametrize(("name", "observation"), list(zip(IDS, 3 * OPTIONS, strict=False)))
def test_keeps_gymnasiums_contract_wrapped_and_unwrapped(name, observation):
    env = make(name, observation=observation)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*different from the unwrapped version.*")
        check_env(env, skip_render_check=True)


@pytest.mark.parametrize("name", IDS)
def test_same_seed_same_episode_and_another_one_otherwise(name):
    config = {"warmup_s": 25.0, "flow": "dense"}
    env = make(name, **config)
    first, rewards = drive(env, 3)
    again, same_rewards = drive(env, 3)
    assert_same(first, again)
    assert rewards == same_rewards
    fresh, _ = drive(make(name, **config), 3)
    assert_same(first, fresh)
    other, _ = drive(env, 4)
    pairs = zip(first, other, strict=False)
    assert not all(np.array_equal(a["agents"], b["agents"]) for a, b in pairs)


def test_many_worlds_are_single_ones():
    worlds = gymnasium.make_vec("graphrqi/TwoWayRoad-v0", num_envs=2, config=QUICK)
    seen = [worlds.reset(seed=3)[0], worlds.step(np.array([1, 1]))[0]]
    for i in range(2):
        single, _ = drive(make("graphrqi/TwoWayRoad-v0"), 3 + i, steps=1, action=1)
        assert_same([{key: values[i] for key, values in one.items()} for one in seen], single)


def test_true_behaviours_are_one_hot_and_those_of_the_mix():
    env = make("graphrqi/StraightRoad-v0", observation="behavior", mix="timid=1", flow="dense")
    observation, _ = env.reset(seed=0)
    rows = observation["agents"]
    driving = (rows[:, 0] == 1) & (rows[:, 9] == 0)
    assert driving.any()
    expected = np.zeros(6)
    expected[BEHAVIORS.index("timid")] = 1
    assert (rows[driving, 10:] == expected).all()
    assert (rows[~driving, 10:] == 0).all()


def test_kinematics_tell_where_others_are_in_the_ego_vehicles_frame():
    env = make("graphrqi/FourWayIntersection-v0", flow=6000, warmup_s=20.0).unwrapped
    env.reset(seed=2)
    observation = [env.step(1)[0] for _ in range(15)][-1]
    ego = env.vehicle
    other = observable_agents(env.road, ego)[0]
    x, y = other.position - ego.position  # y to the south
    ahead = x * np.cos(ego.heading) + y * np.sin(ego.heading)
    left = x * np.sin(ego.heading) - y * np.cos(ego.heading)
    np.testing.assert_allclose(observation["agents"][0, 1:3] * 100.0, [ahead, left], atol=1e-4)


def test_the_classifier_is_given_every_simulated_frame():
    classifier = Uniform()
    env = make("graphrqi/StraightRoad-v0", observation="posterior", classifier=classifier)
    env.reset(seed=0)
    before = len(classifier.times)
    observation = env.step(1)[0]
    assert len(classifier.times) == before + 2  # 10 Hz simulated, 5 Hz decided
    np.testing.assert_allclose(np.diff(classifier.times[-10:]), 0.1, atol=1e-9)
    rows = observation["agents"]
    driving = (rows[:, 0] == 1) & (rows[:, 9] == 0)
    np.testing.assert_allclose(rows[driving, 10:], 1 / 6, rtol=1e-6)


def test_a_classifier_is_made_anew_for_every_episode_and_tells_what_it_believes():
    streams = []

    def load():
        streams.append(load_stream())
        return streams[-1]

    config = {**QUICK, "observation": "posterior", "warmup_s": 15.0, "flow": "dense"}
    env = gymnasium.make("graphrqi/StraightRoad-v0", config={**config, "classifier": load})
    env.reset(seed=1)
    env.reset(seed=0)
    assert len(streams) == 2  # an episode each; making the environment drives nobody
    seen = [env.step(1)[0]["agents"] for _ in range(15)]
    beliefs = np.concatenate([r[(r[:, 0] == 1) & (r[:, 9] == 0), 10:] for r in seen])
    assert beliefs.shape[0] > 15
    np.testing.assert_allclose(beliefs.sum(axis=1), 1.0, rtol=1e-5)
    assert beliefs.min() >= 0.0
    assert beliefs.max() > 2.0 / len(BEHAVIORS)  # it knows more than nothing


def test_driving_into_somebody_ends_the_episode_and_costs():
    env = make("graphrqi/StraightRoad-v0", mix="timid=1", flow="dense", duration_s=60.0)
    env.reset(seed=0)
    total = 0
    for _ in range(300):
        _, reward, ended, cut, info = env.step(3)
        total += info["collisions"]
        if ended or cut:
            break
    assert info["crashed"]
    assert ended
    assert total == 1
    assert reward < -5
    assert info["events"][-1][0] == "collision"


def test_standing_still_earns_nothing_and_time_runs_out():
    env = make("graphrqi/StraightRoad-v0", flow=0, duration_s=20.0)
    env.reset(seed=0)
    rewards = []
    for _ in range(100):
        _, reward, ended, cut, info = env.step(4)
        rewards.append(reward)
        if ended or cut:
            break
    assert cut
    assert not ended
    assert info["time_s"] == pytest.approx(20.0)
    assert rewards[-1] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("goal", ["straight", "left", "right"])
def test_the_goal_can_be_reached(goal):
    env = make("graphrqi/FourWayIntersection-v0", flow=0, goal=goal, duration_s=120.0, warmup_s=0.0)
    env.reset(seed=0)
    target = 2 if goal == "straight" else 4  # turns are taken slowly
    _, _, ended, _, info = env.step(target)
    while not ended and info["time_s"] < 119:
        wanted = 6.0 if goal != "straight" else 12.0
        speed = env.unwrapped.vehicle.target_speed
        action = 3 if speed < wanted - 1 else 4 if speed > wanted + 1 else 1
        _, _, ended, _, info = env.step(action)
    assert info["arrived"], info
    assert not info["crashed"]


def steer(name: str, action: list[float], **config):
    """Drive alone with one continuous action to the end; the environment and every step."""
    env = make(
        name, action={"type": "ContinuousAction"}, flow=0, warmup_s=0.0, duration_s=60.0, **config
    )
    env.reset(seed=0)
    steps = []
    while not steps or not (steps[-1][2] or steps[-1][3]):
        steps.append(env.step(np.array(action, dtype=np.float32)))
    return env.unwrapped, steps


@pytest.mark.parametrize("name", IDS)
def test_leaving_the_road_backwards_is_noticed(name):
    env, steps = steer(name, [-1.0, 0.0])
    s, _ = env.vehicle.lane.local_coordinates(env.vehicle.position)
    assert steps[-1][2]
    assert -8.0 < s < -env.vehicle.LENGTH / 2
    assert steps[-1][4]["rewards"]["off_road"] == 1.0
    assert all(step[4]["rewards"]["off_road"] == 0.0 for step in steps[:-1])


def test_running_a_red_light_is_noted_and_costs():
    env = make("graphrqi/FourWayIntersection-v0", flow=0, duration_s=80.0, warmup_s=0.0)
    env.reset(seed=0)
    runs, costs = 0, []
    env.unwrapped.road.time_s = 15.0  # north and south turn red at 30 s
    for _ in range(200):
        _, reward, ended, _, info = env.step(1)
        runs += info["red_runs"]
        if info["red_runs"]:
            costs.append(reward)
        if ended:
            break
    assert runs == 1
    assert costs[0] < -1.5


@pytest.mark.parametrize(
    ("config", "named"),
    [
        ({"observaton": "kinematics"}, "did you mean 'observation'"),
        ({"observation": "kinematic"}, "kinematics"),
        ({"observation": "posterior"}, "classifier: found None"),
        ({"observation": "posterior", "classifier": "os:name"}, "classifier: found 'os:name'"),
        ({"mix": "timd=1"}, "timd"),
        ({"flow": "heavy"}, "flow"),
        ({"observed": True}, "observed: found True, expected a valid integer"),
        ({"policy_frequency": 3}, "policy_frequency"),
        ({"duration_s": float("nan")}, "duration_s: found nan"),
        ({"goal": "strait"}, "expected 'straight', 'left' or 'right'"),
        ({"goal": "left"}, "this road has no goals"),
        ({"action": {"type": "Discrete"}}, "DiscreteAction"),
        ({"action": {"type": "DiscreteMetaAction", "target_speeds": [5.0]}}, "action: found"),
        ({"action": {"type": "ContinuousAction", "steering_range": 1}}, "action: found"),
        ({"centering_position": [0.5]}, r"centering_position: found \[0.5\]"),
        ({5: 1}, "5: found 5, expected"),
        (5, "config: found 5"),
    ],
    ids=str,
)
def test_refuses_a_configuration_that_means_nothing_by_name(config, named):
    with pytest.raises(InputError, match=named):
        gymnasium.make("graphrqi/StraightRoad-v0", config=config)


def test_traffic_is_drawn_from_a_population():
    env = make("graphrqi/StraightRoad-v0", population="profiles", seed=1, duration_s=5.0).unwrapped
    env.reset(seed=0)
    drawn = sample_agents(env.scenario, 1, read_population("profiles"))
    assert tuple(env.agents.values()) == drawn
    env.configure({"population": None})
    assert env.scenario.population is None


def test_records_a_video(tmp_path):
    pytest.importorskip("moviepy", reason="moviepy is not installed")
    from gymnasium.wrappers import RecordVideo

    env = make("graphrqi/StraightRoad-v0", render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        video = RecordVideo(env, str(tmp_path), episode_trigger=lambda episode: True)
        video.unwrapped.set_record_video_wrapper(video)
        video.reset(seed=0)
        for _ in range(5):
            video.step(1)
        video.close()
    (made,) = tmp_path.glob("*.mp4")
    assert made.stat().st_size > 1000
