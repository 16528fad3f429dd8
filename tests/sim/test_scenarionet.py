"""ScenarioNet's pickles: plain data are read as they are, and nothing else happens."""

from __future__ import annotations

import collections
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from behaviors.errors import InputError
from scenarios import SCENARIOS
from sim.engines import get_engine
from sim.formats import get_writer, read_recordings, recognise
from sim.formats.common.recording import Recording
from sim.formats.scenarionet.plain_pickle import NotPlainError, Opaque, loads
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

VALUES: dict[str, Any] = {
    "numbers": [1, -2, 2**40, 2.5, True, None],
    "words": ("a", "ä", b"\xff", {"b": {"c"}}, frozenset({3})),
    "floats": np.arange(6, dtype=np.float32).reshape(2, 3),
    "by columns": np.asfortranarray(np.arange(6).reshape(2, 3)),
    "big-endian": np.arange(3, dtype=">i2"),
    "array of words": np.array(["ab", "c"]),
    "nothing": np.zeros((0, 2)),
    "number of numpy": np.float64(3.5),
    "flag of numpy": np.bool_(True),
    "counts": collections.defaultdict(int, {"x": 1}),
    "ordered": collections.OrderedDict(a=1),
    "many": list(range(3000)),
}


@pytest.mark.parametrize("protocol", range(6))
def test_plain_data_are_read_as_pickle_reads_them(protocol: int) -> None:
    same = np.arange(4.0)
    written = {**VALUES, "one": same, "the same": same}
    found = loads(pickle.dumps(written, protocol=protocol))
    assert found.keys() == written.keys()
    for key, value in written.items():
        assert np.array_equal(found[key], value), key
        if isinstance(value, np.ndarray):
            assert found[key].dtype == value.dtype, key
    assert isinstance(found["number of numpy"], float)
    words = loads(pickle.dumps(np.array(["a", None], dtype=object), protocol=protocol))
    assert words == ["a", None]


def test_nothing_in_a_pickle_is_run(tmp_path: Path) -> None:
    harm = tmp_path / "harm"
    assert loads(pickle.dumps([Touch(harm), 1])) == [Opaque("posix mkdir"), 1]
    assert not harm.exists()
    pickle.loads(pickle.dumps(Touch(harm)))
    assert harm.exists()  # the same bytes do harm where they are unpickled


@pytest.mark.parametrize(
    "data",
    [b"", b"\x80\x04", b"\x80\x04.", b"\x80\x04t.", b"\x80\x04]a.", b"\x80\x04h\x05.",
     b"\x80\x04K\x01)R.", b"\x80\x04}K\x01K\x02K\x03e.", b"\x80\x04]}b.", b"not a pickle"],
)  # fmt: skip
def test_broken_pickles_are_refused(data: bytes) -> None:
    with pytest.raises(NotPlainError, match="found"):
        loads(data)


@pytest.mark.parametrize("alter", range(9))
def test_arrays_are_as_large_as_their_bytes(alter: int) -> None:
    data = pickle.dumps(np.arange(5, dtype=np.int64), protocol=4)
    altered = [
        data.replace(b"K\x05\x85", b"J\xff\xff\xff\x7f\x85"),
        data.replace(b"\x8c\x02i8", b"\x8c\x02O8"),
        data.replace(b"\x8c\x02i8", b"\x8c\x02V8"),
        data.replace(b"J\xff\xff\xff\xffK\x00t", b"J\xff\xff\xff\xffK\xfft"),
        data.replace(b"<\x94NNNJ", b"<\x94)NNJ"),
        data.replace(b"K\x00t\x94b", b"K\x00NNt\x94b"),
        data.replace(b"\x94t\x94b.", b"\x94Nt\x94b."),
        data.replace(b"\x8c\x01<", b"\x8c\x01x"),
        data.replace(b"NNNJ\xff\xff\xff\xff", b"NNNJ\x04\x00\x00\x00"),
    ][alter]
    assert altered != data
    with pytest.raises(NotPlainError):
        loads(altered)


def test_values_that_are_repeated_without_end_cost_nothing(tmp_path: Path) -> None:
    assert len(loads(pickle.dumps(NESTED))) == 2
    lines = pickle.dumps({"key": 1}).replace(
        pickle.dumps("key")[11:-2], pickle.dumps(TUPLES)[11:-1]
    )
    with pytest.raises(NotPlainError, match="found a tuple as a key"):
        loads(lines)
    recording = read(tmp_path / "sd_odd.pkl", {**scenarionet_scene(), "id": NESTED})
    assert recording.name == "sd_odd"


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


def cut(value: Any, *keys: str) -> dict[str, Any]:
    """The sample with one value in another place."""
    scene = scenarionet_scene()
    at: Any = scene
    for key in keys[:-1]:
        at = at[key]
    at[keys[-1]] = value
    return scene


NESTED: list[Any] = [0.0]
TUPLES: tuple[Any, ...] = (0.0,)
for _ in range(40):
    NESTED, TUPLES = [NESTED, NESTED], (TUPLES, TUPLES)
STATE = ("tracks", "car", "state")


@pytest.mark.parametrize(
    "scene",
    [
        {}, [], cut(4, "length"), cut(-1, "length"), cut(10**9, "length"),
        cut(np.array([0.0, 0.1, 0.1, 0.3, 0.4]), "metadata", "ts"),
        cut(np.full((5, 3), np.nan), *STATE, "position"), cut(np.zeros((4, 3)), *STATE, "position"),
        cut(NESTED, *STATE, "position"), cut(NESTED, "length"), cut(["x"] * 5, *STATE, "heading"),
        cut(None, "tracks", "car", "state"), cut(7, "tracks"),
        cut(np.full((2, 2), 1e300), "map_features", "7", "polyline"),
        cut(NESTED, "map_features", "7", "polyline"),
        cut(1e300, "map_features", "7", "speed_limit_mph"),
        cut(-1.0, "map_features", "7", "width"), cut([], "map_features", "55", "polygon"),
    ],
)  # fmt: skip
def test_odd_scenarios_are_refused_in_one_line(tmp_path: Path, scene: Any) -> None:
    with pytest.raises(InputError, match=r"sd_odd\.pkl: [^\n]+$"):
        read(tmp_path / "sd_odd.pkl", scene)


def test_altered_files_are_read_or_refused(tmp_path: Path) -> None:
    data = bytearray(pickle.dumps(scenarionet_scene(), protocol=4))
    rng = np.random.default_rng(0)
    path, refused = tmp_path / "sd_odd.pkl", 0
    for _ in range(300):
        altered = bytearray(data[: rng.integers(1, 2 * len(data))])
        for at in rng.integers(len(altered), size=rng.integers(1, 4)):
            altered[at] = rng.integers(256)
        try:
            read(path, bytes(altered))
        except InputError:
            refused += 1
    assert 0 < refused < 300
