"""Numbers of recorded scenes: read, balanced, and written from recordings."""

import numpy as np
import pytest

from behaviors.errors import InputError
from experiments.recorded_scenes import SENSORS, seen_scenes
from experiments.training.recorded_scenes import OPEN_DATA, SCENES, read_scenes, scenes_of
from graphrqi.features.relative.observer import SCENE_NAMES
from sim.formats.common.recording import Recording
from sim.frames import KINDS, AgentKind, Tracks


def platoon(seconds: float) -> Tracks:
    """Five cars behind one another at 10 m/s."""
    time_s = np.arange(0.0, seconds, 0.1)
    xy = np.zeros((5, time_s.size, 2))
    xy[..., 0] = 30.0 * np.arange(5)[:, None] + 10.0 * time_s
    ones = np.ones(xy.shape[:2])
    return Tracks(
        time_s=time_s, ids=np.arange(5), names=tuple("abcde"),
        kind=np.full(5, KINDS.index(AgentKind.CAR)),
        length=np.full(5, 4.5), width=np.full(5, 1.8), xy=xy, heading=0.0 * ones,
        speed=10.0 * ones, valid=ones > 0.0, signals=np.zeros((0, time_s.size), dtype=np.int8),
    )  # fmt: skip


def test_every_open_place_counts_alike():
    places = [line.partition(",")[0] for line in SCENES.read_text().splitlines()[1:]]
    assert set(places) == set(OPEN_DATA)
    scenes = read_scenes()
    assert scenes.shape == (len(OPEN_DATA) * max(map(places.count, OPEN_DATA)), len(SCENE_NAMES))
    assert np.isfinite(scenes).all()


def test_scenes_come_every_some_seconds():
    scenes = np.array(list(scenes_of(platoon(20.0))))
    assert scenes.shape == (5, len(SCENE_NAMES))
    assert scenes[-1, SCENE_NAMES.index("drivers")] == pytest.approx(5.0)
    assert scenes[-1, SCENE_NAMES.index("share moving")] == pytest.approx(1.0)


def test_a_file_of_another_version_is_refused(tmp_path):
    path = tmp_path / "scenes.csv"
    path.write_text("place,noise\nroad,0.1\n")
    with pytest.raises(InputError, match="found columns"):
        read_scenes(path)


def test_a_recording_is_seen_as_it_is_and_through_sensors_of_its_own():
    tracks = platoon(20.0)
    scenes = seen_scenes(Recording("platoon", tracks), "m", 3)
    as_it_is = np.array(list(scenes_of(tracks)))
    assert (scenes[:5] == as_it_is).all()
    noise = scenes[5:, SCENE_NAMES.index("noise")]
    assert noise.size >= 3 * SENSORS  # a sensor may lose the last frames
    assert noise.max() > 0.01 > as_it_is[:, SCENE_NAMES.index("noise")].max()
    assert (seen_scenes(Recording("platoon", tracks), "m", 3) == scenes).all()
    others = seen_scenes(Recording("platoon", tracks), "m", 4)
    assert others.shape != scenes.shape or (others != scenes).any()
