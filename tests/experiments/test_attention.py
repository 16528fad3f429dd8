"""What drivers perceive: drifting errors, late reactions, lapses; and their types in SUMO."""

from __future__ import annotations

import libsumo
import numpy as np
import pandas
import pytest

from behaviors.profiles import ERROR_TIME_S
from experiments.data.vtypes import export_types
from scenarios import get_scenario
from sim.engines import get_engine
from sim.frames import Tracks
from sim.highway.decide import _error, _late
from sim.highway.driving import driver_key
from sim.highway.state import blank_vehicles
from sim.scenario import sample_agents

STEP_S = 0.5


def errors_of_highway(drivers: int, steps: int) -> np.ndarray:
    cars = blank_vehicles(drivers).view(np.recarray)
    cars.key = [driver_key(seed) for seed in range(drivers)]
    found = np.empty((drivers, steps))
    for step in range(steps):
        cars.clock = STEP_S * step
        found[:, step] = [_error.py_func(car) for car in cars]
    return found


def errors_of_sumo(drivers: int, steps: int) -> np.ndarray:
    own = {"unsure": {"like": "careful", "perception_noise": 0.1}}
    road = get_scenario("straight_road")(
        length_m=20_000.0, duration_s=30 + STEP_S * steps, step_s=STEP_S, flow=7200.0,
        pedestrians_per_h=0.0, crossing=False, lanes=5, behaviors=own, mix="unsure=1",
    )  # fmt: skip
    agents = sample_agents(road, 0)[:drivers]
    found = []
    for frame in get_engine("sumo")(road, agents, 0):
        if frame.time_s > 30:
            key = "device.driverstate.errorState"
            found.append([libsumo.vehicle.getParameter(str(i), key) for i in frame.ids])
    return np.array(found, dtype=float).T


@pytest.mark.parametrize("errors_of", [errors_of_highway, errors_of_sumo])
def test_the_error_of_perception_is_an_ornstein_uhlenbeck_process(errors_of):
    errors = errors_of(40, 600)
    assert errors.std() == pytest.approx(1.0, abs=0.12)
    for lag_s in (5.0, 20.0):
        lag = round(lag_s / STEP_S)
        linked = np.mean(errors[:, lag:] * errors[:, :-lag]) / np.mean(errors**2)
        assert linked == pytest.approx(np.exp(-lag_s / ERROR_TIME_S), abs=0.12)


@pytest.mark.parametrize("step_s", [0.1, 0.05])
def test_a_driver_does_what_it_wanted_a_reaction_time_ago(step_s):
    car = blank_vehicles(1).view(np.recarray)[0]
    car.reaction_time_s, car.clock = 1.5, 40.0
    done = []
    for step in range(round(4 / step_s)):
        done.append(_late.py_func(car, float(step)))
        car.clock += step_s
    late = np.arange(len(done)) - np.array(done)
    assert late[round(2 / step_s) :] * step_s == pytest.approx(1.5, abs=0.06)
    assert max(done[: round(1.4 / step_s)]) <= 1


@pytest.mark.parametrize("engine", ["sumo", "highway"])
def test_a_driver_whose_attention_lapses_goes_on_as_it_was(engine):
    still = []
    for rate in (0.0, 20.0):
        own = {"away": {"like": "careful", "lapse_rate_per_min": rate, "lapse_s": 4.0}}
        road = get_scenario("straight_road")(
            duration_s=60.0, pedestrians_per_h=0.0, behaviors=own, mix="away=1", flow=2400.0
        )
        tracks = Tracks.from_frames(get_engine(engine)(road, sample_agents(road, 0), 0))
        change = np.diff(tracks.speed, axis=1)
        still.append(np.mean(change[np.isfinite(change)] == 0.0))
    assert still[1] - still[0] > 0.3  # 4 of every 7 s are a lapse


def test_exported_types_drive_in_sumo(tmp_path):
    types, table = export_types("distracted", tmp_path / "out")
    drivers = pandas.read_csv(table, comment="#").set_index("driver")
    (tmp_path / "routes.xml").write_text(
        '<routes><flow id="f" type="drivers" from="east_in" to="east_out" begin="0" end="60"'
        ' period="1" departLane="random"/></routes>'
    )
    net = get_scenario("straight_road")().road.source
    libsumo.start(
        ["sumo", "-n", str(net), "-a", str(types), "-r", str(tmp_path / "routes.xml"),
         "--no-step-log", "--no-warnings"]
    )  # fmt: skip
    try:
        libsumo.simulationStep(60.0)
        driven = {libsumo.vehicle.getTypeID(one) for one in libsumo.vehicle.getIDList()}
        headways = {name: libsumo.vehicletype.getTau(name) for name in driven}
    finally:
        libsumo.close()
    assert set(drivers.behavior[list(driven)]) > {"distracted", "careful"}
    assert headways == pytest.approx(drivers.idm_T_s[list(driven)].to_dict())
