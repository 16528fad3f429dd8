"""ScenarioNet's pickles: plain data are read as they are, and nothing else happens."""

from __future__ import annotations

import io
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios import SCENARIOS
from sim.engines import get_engine
from sim.formats import get_writer, read_recordings, recognise
from sim.formats.common.recording import Recording
from sim.formats.scenarionet import PlainUnpickler, Unknown
from sim.frames import KINDS, AgentKind, Signal, Tracks
from sim.road import Road
from sim.scenario import sample_agents
from tests.sim.scenes import scenarionet_scene


def read(path: Path, content: Any) -> Recording:
    path.write_bytes(content if isinstance(content, bytes) else pickle.dumps(content))
    (recording,) = read_recordings(path)
    return recording


class Touch:
    """An object whose pickle would make a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


# --- pickles ------------------------------------------------------------------------------------


def test_nothing_in_a_pickle_is_run(tmp_path: Path) -> None:
    harm = tmp_path / "harm"
    found, one = PlainUnpickler(io.BytesIO(pickle.dumps([Touch(harm), 1]))).load()
    assert isinstance(found, Unknown)
    assert one == 1
    assert not harm.exists()
    pickle.loads(pickle.dumps(Touch(harm)))
    assert harm.exists()  # the same bytes do harm where they are unpickled


# --- scenarios ----------------------------------------------------------------------------------


def test_a_scenario_of_a_converter(tmp_path: Path) -> None:
    recording = read(tmp_path / "sd_turn.pkl", scenarionet_scene())
    tracks, road = recording.tracks, recording.road
    assert recording.name == "turn"
    assert tracks.names == ("car", "walker")
    assert [KINDS[k] for k in tracks.kind] == [AgentKind.CAR, AgentKind.PEDESTRIAN]
    assert tracks.time_s.tolist() == [0.0, 0.1, 0.2, 0.3, 0.4]
    assert tracks.valid.tolist() == [[True, False, True, True, True]] * 2
    assert tracks.xy[0, 4].tolist() == [4.0, 0.0]
    assert tracks.speed[0, 4] == 10.0
    assert (tracks.length[0], tracks.width[0]) == (4.5, 1.75)
    assert "1 objects" in " ".join(recording.notes)
    assert isinstance(road, Road)
    lanes = {lane.id: lane for lane in road.lanes}
    assert set(lanes) == {"7", "8", "9"}
    assert lanes["7"].width_m == pytest.approx(3.25)
    assert lanes["7"].speed_limit_mps == pytest.approx(25 * 0.44704)
    assert [(c.from_lane, c.to_lane) for c in road.connections] == [("7", "9")]
    assert len(road.crossings) == 1
    assert tracks.signals is not None
    shown = [Signal.RED, Signal.RED, Signal.OFF, Signal.GREEN, Signal.YELLOW]
    assert tracks.signals.tolist() == [[signal.code for signal in shown]]


def test_our_export_is_read_back(tmp_path: Path) -> None:
    scenario = SCENARIOS["four_way_intersection"](duration_s=6.0)
    agents = sample_agents(scenario, seed=0)
    frames = list(get_engine("sumo")(scenario, agents, seed=0))
    behaviors = {agent.id: agent.behavior for agent in agents}
    tracks = Tracks.from_frames(frames, behaviors=behaviors)
    (path,) = get_writer("scenarionet")(tmp_path, "episode", tracks, scenario.road)
    assert recognise(path) == "scenarionet"
    (recording,) = read_recordings(path)
    back, road = recording.tracks, recording.road
    order = [back.names.index(name) for name in tracks.names]
    np.testing.assert_array_equal(back.valid[order], tracks.valid)
    np.testing.assert_allclose(back.time_s, tracks.time_s - tracks.time_s[0], atol=1e-4)
    np.testing.assert_allclose(back.xy[order], tracks.xy, atol=1e-3)
    np.testing.assert_allclose(back.speed[order], tracks.speed, atol=1e-4)
    assert back.behavior is not None
    assert tracks.behavior is not None
    assert back.behavior[order].tolist() == tracks.behavior.tolist()
    assert isinstance(road, Road)
    driven = [lane for lane in scenario.road.lanes if not lane.walking]
    assert len(road.lanes) == len(driven)
    widths = sorted(lane.width_m for lane in driven)
    assert sorted(lane.width_m for lane in road.lanes) == pytest.approx(widths)
    assert sum(lane.internal for lane in road.lanes) == sum(lane.internal for lane in driven)
