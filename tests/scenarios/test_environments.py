"""The gymnasium environments: the API, determinism, what they observe, draw and refuse."""

from __future__ import annotations

import importlib
import inspect
import subprocess
import sys
import warnings
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import scenarios
from behaviors import BEHAVIORS, InputError
from behaviors.populations import read_population
from scenarios import ENVIRONMENTS
from scenarios.environments.observation import observable_agents
from sim.highway.ego import is_off_road
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


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("observation", OPTIONS)
def test_keeps_gymnasiums_contract_wrapped_and_unwrapped(name, observation):
    env = make(name, observation=observation)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*different from the unwrapped version.*")
        check_env(env, skip_render_check=True)


@pytest.mark.parametrize("name", IDS)
def test_draws_images_that_are_not_blank(name):
    env = make(name, render_mode="rgb_array")
    check_env(env.unwrapped)
    env.reset(seed=0)
    env.step(1)
    image = env.render()
    config = env.unwrapped.config
    assert image.shape == (config["screen_height"], config["screen_width"], 3)
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 8
    white = (image == 255).all(axis=2)  # only the ego vehicle is white
    assert white.sum() > 50
    env.close()


@pytest.mark.parametrize("name", IDS)
def test_every_kind_of_action_works(name):
    for kind in ("DiscreteAction", "ContinuousAction"):
        env = make(name, action={"type": kind})
        drive(env, 0, steps=3)
    env = make(name, action={"type": "DiscreteMetaAction", "lateral": False})
    assert env.action_space.n == 3


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


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_same_seed_same_episode_in_a_vector(mode):
    name = "graphrqi/StraightRoad-v0"
    alone, _ = drive(make(name), 5, steps=3, action=1)
    vector = gymnasium.make_vec(
        f"scenarios:{name}", num_envs=2, vectorization_mode=mode, config=QUICK
    )
    try:
        seen = [vector.reset(seed=[5, 6])[0]]
        seen += [vector.step(np.array([1, 1]))[0] for _ in range(3)]
    finally:
        vector.close()
    assert_same(alone, [{key: value[0] for key, value in one.items()} for one in seen])


def test_the_intersection_works_in_an_asynchronous_vector():
    vector = gymnasium.make_vec(
        "scenarios:graphrqi/FourWayIntersection-v0",
        num_envs=2,
        vectorization_mode="async",
        config={**QUICK, "observation": "graph"},
    )
    try:
        observation, _ = vector.reset(seed=0)
        assert observation["adjacency"].shape == (2, 16, 16)
        vector.step(vector.action_space.sample())
    finally:
        vector.close()


def test_a_fixed_traffic_seed_gives_the_same_traffic_every_episode():
    env = make("graphrqi/StraightRoad-v0", seed=11, warmup_s=12.0)
    one, _ = env.reset(seed=0)
    other, _ = env.reset(seed=1)
    np.testing.assert_array_equal(one["agents"], other["agents"])
    assert one["agents"].any()


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


def test_a_named_classifier_is_made_anew_for_every_episode(monkeypatch):
    made = []

    class Stream(Uniform):
        def update(self, frame):
            return self(frame)

    def load():
        made.append(Stream())
        return made[-1]

    monkeypatch.setitem(sys.modules, "classifier_of_a_test", SimpleNamespace(load=load))
    env = make(
        "graphrqi/StraightRoad-v0", observation="posterior", classifier="classifier_of_a_test:load"
    )
    env.reset(seed=0)
    env.reset(seed=1)
    assert len(made) == 2  # an episode each; making the environment drives nobody
    assert all(np.all(np.diff(stream.times) > 0) for stream in made)


def test_a_picture_is_made_without_a_word(capfd, monkeypatch):
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    env = make("graphrqi/StraightRoad-v0", render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().std() > 5.0
    env.close()
    assert capfd.readouterr().err == ""


def test_a_picture_is_made_where_there_is_no_display(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = make("graphrqi/StraightRoad-v0", render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().std() > 5.0
    env.close()


def test_the_shipped_classifier_tells_what_it_believes():
    config = {**QUICK, "observation": "posterior", "warmup_s": 15.0, "flow": "dense"}
    env = gymnasium.make("graphrqi/StraightRoad-v0", config=config)
    env.reset(seed=0)
    seen = [env.step(1)[0]["agents"] for _ in range(15)]
    beliefs = np.concatenate([r[(r[:, 0] == 1) & (r[:, 9] == 0), 10:] for r in seen])
    assert beliefs.shape[0] > 15
    np.testing.assert_allclose(beliefs.sum(axis=1), 1.0, rtol=1e-5)
    assert beliefs.min() >= 0.0
    assert beliefs.max() > 2.0 / len(BEHAVIORS)  # it knows more than nothing


def test_the_graph_joins_each_to_its_nearest():
    env = make(
        "graphrqi/StraightRoad-v0", observation="graph", flow="dense", observed=8, warmup_s=15.0
    )
    observation, _ = env.reset(seed=1)
    adjacency, mask = observation["adjacency"], observation["mask"]
    nodes = int(mask.sum())
    assert nodes > 5
    np.testing.assert_array_equal(adjacency, adjacency.T)
    assert (np.diag(adjacency) == 0).all()
    assert (adjacency[nodes:] == 0).all()
    assert (adjacency[:nodes].sum(axis=1) >= 4).all()
    assert adjacency[0, 1] == 1  # the ego vehicle and the nearest other


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


@pytest.mark.parametrize("goal", ["left", "right"])
def test_another_arm_is_not_the_goal(goal):
    env, steps = steer("graphrqi/FourWayIntersection-v0", [0.03, 0.0], goal=goal)
    _, reward, ended, _, info = steps[-1]
    assert ended
    assert not any(step[4]["arrived"] for step in steps)
    assert env.vehicle.lane_index[:2] == ("north_out<", "north_out>")
    assert info["rewards"]["off_road"] == 1.0  # it drove off the end of that arm
    assert reward == pytest.approx(-5.0)
    assert all(step[4]["rewards"]["progress"] == 0.0 for step in steps[-50:])
    assert len({step[0]["ego"][12] for step in steps[-50:]}) == 1  # as far as it ever was
    assert all(np.isfinite(step[1]) for step in steps)


STRAIGHT_AHEAD = tuple(
    f"graphrqi/{name}-v0"
    for name in (
        "StraightRoad", "FourWayIntersection", "PriorityIntersection", "AllWayStop",
        "RightBeforeLeft",
    )
)  # fmt: skip
"""Where a minute without steering is enough."""


@pytest.mark.parametrize("name", STRAIGHT_AHEAD)
def test_the_end_of_its_own_way_is_where_it_arrives(name):
    _, steps = steer(name, [0.03, 0.0])
    _, _, ended, _, info = steps[-1]
    assert ended
    assert info["arrived"]
    assert info["rewards"]["off_road"] == 0.0
    assert info["rewards"]["progress"] > 0.5


@pytest.mark.parametrize("name", IDS)
def test_leaving_the_road_backwards_is_noticed(name):
    env, steps = steer(name, [-1.0, 0.0])
    s, _ = env.vehicle.lane.local_coordinates(env.vehicle.position)
    assert steps[-1][2]
    assert -8.0 < s < -env.vehicle.LENGTH / 2
    assert steps[-1][4]["rewards"]["off_road"] == 1.0
    assert all(step[4]["rewards"]["off_road"] == 0.0 for step in steps[:-1])


def test_backing_from_an_arm_into_the_junction_is_not_leaving_the_road():
    env = make("graphrqi/FourWayIntersection-v0", flow=0, warmup_s=0.0).unwrapped
    env.reset(seed=0)
    vehicle, lane = env.vehicle, ("north_out<", "north_out>", 0)
    vehicle.lane_index, vehicle.lane = lane, env.road.network_info.lanes[lane]
    vehicle.position = vehicle.lane.position(-vehicle.LENGTH, 0.0)
    assert not is_off_road(env.road, vehicle)


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
        ({"observaton": "kinematics"}, "observation"),
        ({"observation": "kinematic"}, "kinematics"),
        ({"mix": "timd=1"}, "timd"),
        ({"mix": {"timid": 0.5}}, "mix"),
        ({"flow": "heavy"}, "flow"),
        ({"observed": 0}, "observed"),
        ({"policy_frequency": 3}, "policy_frequency"),
        ({"duration_s": -1}, "duration_s"),
        ({"seed": -1}, "seed"),
        ({"classifier": 3}, "classifier"),
        ({"action": {"type": "Discrete"}}, "DiscreteAction"),
        ({"action": {"type": "DiscreteMetaAction", "target_speed": 3}}, "target_speeds"),
        ({"action": "DiscreteMetaAction"}, "action"),
        ({"action": {"type": "DiscreteMetaAction", "target_speeds": []}}, "action: found"),
        ({"action": {"type": "DiscreteMetaAction", "target_speeds": [5.0]}}, "action: found"),
        ({"action": {"type": "DiscreteMetaAction", "target_speeds": "fast"}}, "action: found"),
        ({"action": {"type": "DiscreteAction", "actions_per_axis": 0}}, "action: found"),
        (
            {"action": {"type": "DiscreteMetaAction", "lateral": False, "longitudinal": False}},
            "action: found",
        ),
        (
            {"action": {"type": "ContinuousAction", "lateral": False, "longitudinal": False}},
            "action: found",
        ),
        ({"action": {"type": "ContinuousAction", "steering_range": 1}}, "action: found"),
        ({"observation": "posterior", "classifier": "os:nope"}, "classifier: found 'os:nope'"),
        ({"observation": "posterior", "classifier": "os:name"}, "classifier: found 'os:name'"),
        ({"observation": "posterior", "classifier": "no_such_module:f"}, "classifier: found"),
        ({"observation": "posterior", "classifier": ":f"}, "classifier: found ':f'"),
        ({5: 1}, "configuration key '5'"),
        ({"observed": True}, "observed: found True, expected a valid integer"),
        ({"observed": 2.5}, "observed: found 2.5"),
        ({"duration_s": float("nan")}, "duration_s: found nan"),
        ({"duration_s": "long"}, "duration_s: found 'long'"),
        ({"warmup_s": -0.5}, "warmup_s: found -0.5"),
        ({"simulation_frequency": 9}, "simulation_frequency: found 9"),
        ({"scaling": 0.0}, "scaling: found 0.0"),
        ({"centering_position": [0.5]}, r"centering_position: found \[0.5\]"),
        ({"manual_control": 1}, "manual_control: found 1"),
        (5, "config: found 5"),
    ],
    ids=str,
)
@pytest.mark.parametrize("name", IDS)
def test_refuses_a_configuration_that_means_nothing_by_name(name, config, named):
    with pytest.raises(InputError, match=named):
        gymnasium.make(name, config=config)


def test_refuses_bad_options_at_reset_and_a_bad_goal():
    env = make("graphrqi/StraightRoad-v0")
    with pytest.raises(InputError, match="config"):
        env.reset(options={"confg": {}})
    with pytest.raises(InputError, match="spread"):
        env.reset(options={"config": {"spread": -1.0}})
    with pytest.raises(InputError, match="config: found 5"):
        env.reset(options={"config": 5})
    with pytest.raises(InputError, match="options: found 5"):
        env.reset(options=5)
    with pytest.raises(InputError, match="classifier: found 'os:getcwd'"):
        env.reset(options={"config": {"observation": "posterior", "classifier": "os:getcwd"}})
    with pytest.raises(InputError, match="did you mean 'straight'"):
        gymnasium.make("graphrqi/FourWayIntersection-v0", config={"goal": "strait"})
    with pytest.raises(InputError, match="manual_control: found 'yes'"):
        gymnasium.make("graphrqi/StraightRoad-v0", config={"manual_control": "yes"})


def test_traffic_is_drawn_from_a_population():
    env = make("graphrqi/StraightRoad-v0", population="profiles", seed=1, duration_s=5.0).unwrapped
    env.reset(seed=0)
    drawn = sample_agents(env.scenario, 1, read_population("profiles"))
    assert tuple(env._agents.values()) == drawn
    env.configure({"population": None})
    assert env.scenario.population is None


def test_reset_takes_changes_to_the_configuration():
    env = make("graphrqi/StraightRoad-v0").unwrapped
    observation, _ = env.reset(seed=0, options={"config": {"observed": 5}})
    assert observation["agents"].shape == (5, 10)
    assert env.observation_space.contains(observation)


def test_registering_twice_changes_nothing():
    before = dict(gymnasium.registry)
    scenarios.register_environments()
    assert dict(gymnasium.registry) == before


def test_the_docstring_specifies_the_environment():
    for source in ENVIRONMENTS.values():
        module, name = source.split(":")
        environment = getattr(importlib.import_module(module), name)
        text = inspect.getdoc(environment)
        for word in (
            "Observation:",
            "Actions:",
            "Reward per step:",
            "Terminated",
            "Version history",
        ):
            assert text.count(word) == 1, word
        words = " ".join(text.split())
        for key, value in environment.default_config().items():
            assert words.count(f" {key} ({value!r}): ") == 1, key


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("config", [5, "goal", [("goal", "left")]])
def test_configure_refuses_what_is_no_mapping_in_one_line(name, config):
    with pytest.raises(InputError, match=r"\Aconfig: found .*, expected a mapping or None\Z"):
        make(name).unwrapped.configure(config)


def test_a_key_of_the_other_environment_is_unknown():
    with pytest.raises(InputError, match="unknown configuration key 'goal'"):
        gymnasium.make("graphrqi/StraightRoad-v0", config={"goal": "left"})
    with pytest.raises(InputError, match="unknown configuration key 'goal'"):
        gymnasium.make("graphrqi/Roundabout-v0", config={"goal": "left"})


def test_actions_are_ignored_while_the_keyboard_steers():
    def end(action, **config):
        env = make("graphrqi/StraightRoad-v0", flow=0, warmup_s=0.0, **config)
        env.reset(seed=0)
        return [env.step(action)[0]["ego"][0] for _ in range(10)][-1]

    assert end(4) < end(1)
    assert end(4, manual_control=True) == end(1)


def test_registering_loads_nothing_heavy():
    code = (
        "import sys, scenarios; "
        "print(sorted({'highway_env', 'libsumo', 'torch', 'pygame'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_highway_env_is_left_as_it_was():
    import highway_env.envs.common.abstract
    import highway_env.envs.common.graphics
    import highway_env.road.lane
    import highway_env.road.regulation
    import highway_env.road.road
    import highway_env.vehicle.behavior
    import highway_env.vehicle.objects  # noqa: F401

    def snapshot():
        import sys

        found = {}
        for module in [m for n, m in sys.modules.items() if n.startswith("highway_env")]:
            for name, kind in inspect.getmembers(module, inspect.isclass):
                if kind.__module__.startswith("highway_env"):
                    for key, value in vars(kind).items():
                        found[kind.__module__, name, key] = (id(value), repr(value))
        return found

    before = snapshot()
    for name in IDS:
        env = make(name, render_mode="rgb_array")
        drive(env, 0, steps=2)
        env.render()
        env.close()
    after = snapshot()
    assert {key: after[key] for key in before} == before


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


@pytest.mark.parametrize("broken", [np.nan, np.inf])
def test_an_action_that_is_not_finite_changes_nothing(broken: float) -> None:
    config = {**QUICK, "action": {"type": "ContinuousAction"}}
    env = gymnasium.make("graphrqi/StraightRoad-v0", config=config)
    env.reset(seed=1)
    with pytest.raises(InputError, match=r"action: found .*, expected finite numbers of shape"):
        env.unwrapped.step(np.array([broken, 0.0]))
    observation, reward, *_ = env.unwrapped.step(np.array([0.0, 0.0]))
    assert all(np.isfinite(values).all() for values in observation.values())
    assert np.isfinite(reward)


@pytest.mark.parametrize("wrong", [-1, 99, 1e308, float("nan"), None, "left", (0, 0)])
def test_an_action_of_no_number_changes_nothing(wrong: object) -> None:
    env = gymnasium.make("graphrqi/StraightRoad-v0", config=QUICK)
    env.reset(seed=1)
    with pytest.raises(InputError, match=r"action: found .*, expected 0 to 4"):
        env.unwrapped.step(wrong)
    assert env.unwrapped.time == 0
