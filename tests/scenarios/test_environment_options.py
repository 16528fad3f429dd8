"""Every environment with every option keeps the contracts of gymnasium, stable-baselines3 and
PettingZoo.

By default some of the settings are checked, each with another environment; the marker `slow` has
all of them with all environments.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from behaviors import BEHAVIORS
from graphrqi.stream import load_stream
from scenarios import ENVIRONMENTS
from scenarios.environments.config import TrafficConfig
from scenarios.networks.build import NET

IDS = tuple(ENVIRONMENTS)
QUICK = {"warmup_s": 1.0, "duration_s": 2.0, "flow": "light"}
ROUNDABOUT = Path(__file__).parents[2] / "scenarios/networks/roundabout" / NET
WAY = ["south_in", "south_east", "east_north", "north_out"]
SLOWLY = {"type": "DiscreteMetaAction", "target_speeds": [0.0, 5.0]}


class Uniform:
    """A classifier that has learnt nothing."""

    def __call__(self, frame):
        return self

    def of(self, ids):
        return np.full((ids.size, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))


UNIFORM = Uniform()
BELIEVED = {"observation": "posterior", "classifier": UNIFORM}
DRAWN = {"render_mode": "rgb_array"}

VALUES = {
    "observation": [
        {"observation": "kinematics"},
        {"observation": "behavior"},
        {"observation": "graph"},
        BELIEVED,
    ],
    "observed": [{"observed": 1}, {"observed": 40, "observation": "graph"}],
    "action": [
        {"action": {"type": "DiscreteMetaAction", "lateral": False}},
        {"action": {"type": "DiscreteMetaAction", "longitudinal": False}},
        {"action": SLOWLY},
        {"action": {"type": "DiscreteAction"}},
        {"action": {"type": "DiscreteAction", "actions_per_axis": 5}},
        {"action": {"type": "ContinuousAction"}},
        {"action": {"type": "ContinuousAction", "longitudinal": False}},
        {"action": {"type": "ContinuousAction", "clip": False, "dynamical": True}},
        {"action": {"type": "StockDriver"}},
    ],
    "flow": [{"flow": 0}, {"flow": "medium"}, {"flow": "dense"}, {"flow": 900.5}],
    "mix": [{"mix": "timid=1"}, {"mix": "aggressive=.5,timid=.5"}, {"mix": {"reckless": 1.0}}],
    "population": [{"population": "us101"}, {"population": "profiles", "flow": "dense"}],
    "behaviors": [{"behaviors": "novice", "mix": "novice=.5,timid=.5"}],
    "spread": [{"spread": 0.0}, {"spread": 1.0}],
    "net": [{"net": str(ROUNDABOUT)}],
    "routes": [{"net": str(ROUNDABOUT), "routes": "ROUTES", "flow": 600}],
    "scenario": [{"scenario": "motorway_ramps"}, {"scenario": "SCENARIO"}],
    "ego_route": [{"net": str(ROUNDABOUT), "ego_route": WAY}],
    "seed": [{"seed": 5}],
    "duration_s": [{"duration_s": 1.0}],
    "warmup_s": [{"warmup_s": 0.0}],
    "simulation_frequency": [{"simulation_frequency": 15, "policy_frequency": 15}],
    "policy_frequency": [{"policy_frequency": 1}],
    "classifier": [
        BELIEVED,
        {"observation": "posterior", "classifier": load_stream},
    ],
    "screen_width": [{"screen_width": 64, **DRAWN}],
    "screen_height": [{"screen_height": 64, **DRAWN}],
    "scaling": [{"scaling": 2.0, **DRAWN}],
    "centering_position": [{"centering_position": [0.5, 0.9], **DRAWN}],
    "render_agent": [{"render_agent": False, **DRAWN}],
    "offscreen_rendering": [{"offscreen_rendering": True, **DRAWN}],
    "manual_control": [{"manual_control": True}],
    "real_time_rendering": [{"real_time_rendering": True, **DRAWN}],
    "goal": [{"goal": "left"}, {"goal": "right"}],
}
"""Settings to check, by the option that they are about; all of them have a default."""


def has_goals(name: str) -> bool:
    """Whether an environment takes the option ``goal``."""
    return isinstance(ENVIRONMENTS[name]["routes"], dict)


GRID = [
    pytest.param(name, option, number, id=f"{name.split('/')[1]}-{option}-{number}")
    for name in IDS
    for option, settings in VALUES.items()
    if option != "goal" or has_goals(name)
    for number in range(len(settings))
]
SAMPLE = GRID[:: len(GRID) // 12]
OTHERS = [pytest.param(*one, marks=pytest.mark.slow) for one in GRID if one not in SAMPLE]
"""Every so many: one of each environment or so, each with another option."""


@pytest.fixture
def files(tmp_path):
    """What stands for a route file and a scenario's file in the settings."""
    routes, scenario = tmp_path / "town.rou.xml", tmp_path / "town.toml"
    routes.write_text(
        f'<routes><flow id="a" begin="0" end="60" number="20"><route edges="{" ".join(WAY)}"/>'
        "</flow></routes>"
    )
    scenario.write_text('scenario = "roundabout"\nlanes = 2\nflow = "dense"\n')
    return {"ROUTES": str(routes), "SCENARIO": str(scenario)}


def test_every_option_of_every_environment_is_checked():
    assert TrafficConfig.model_fields.keys() == VALUES.keys()


@pytest.mark.parametrize(("name", "option", "number"), [*SAMPLE, *OTHERS])
def test_keeps_every_contract(name, option, number, files, monkeypatch):
    config = {**QUICK, **VALUES[option][number]}
    config = {k: files.get(v, v) if isinstance(v, str) else v for k, v in config.items()}
    render_mode = config.pop("render_mode", None)
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")  # no keyboard here
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        warnings.filterwarnings("ignore", message=".*different from the unwrapped version.*")
        check_env(
            gymnasium.make(name, render_mode=render_mode, config=config).unwrapped,
            skip_render_check=render_mode is None,
        )
        checked_by_baselines(name, config)
        checked_by_pettingzoo(name, config, render_mode)


def checked_by_baselines(name: str, config: dict) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = gymnasium.make(name, config=config)
    # it advises against tables as observations, which its policies flatten
    warnings.filterwarnings("ignore", message=".*unconventional shape.*")
    checker.check_env(env, warn=True, skip_render_check=True)


def checked_by_pettingzoo(name: str, config: dict, render_mode: str | None) -> None:
    checker = pytest.importorskip("pettingzoo.test")
    from scenarios.environments.parallel import parallel_env

    env = parallel_env(name, egos=2, every_s=0.5, config=config, render_mode=render_mode)
    checker.parallel_api_test(env, num_cycles=30)
    env.close()
