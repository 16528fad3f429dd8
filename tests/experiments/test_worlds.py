"""Random worlds: drawn by seed, driven, stored as seen, and usable like any dataset."""

from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.data.disturbances import (
    correlated_noise,
    frame_rate,
    renamed_tracks,
)
from experiments.data.verify import verify_dataset
from experiments.data.windows import gather
from experiments.generate import RANDOM_WORLD
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.generate.world_roads import FAMILIES, JUNCTIONS, ramp_net, straight_net
from experiments.generate.worlds import Sensor, draw_world
from sim.frames import Tracks
from sim.road.net import read_road
from sim.store.dataset import Dataset, open_dataset
from sim.sumo.vehicle_types import LAWS

CONFIG = GenerateConfig(scenarios=(RANDOM_WORLD,), episodes=5, seed=4, duration_s=15.0)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("worlds") / "data"
    generate(CONFIG, folder, jobs=1, quiet=True)
    return open_dataset(folder)


def test_many_worlds_hold_every_law_family_and_discipline():
    worlds = [draw_world(seed) for seed in range(400)]
    assert {w.law for w in worlds} == {*LAWS, "highway-env IDM", "highway-env Krauss"}
    assert {w.road.family for w in worlds} == set(FAMILIES)
    assert {(w.road.control, w.road.lanes) for w in worlds if w.road.control} == {
        (control, lanes) for control, nets in JUNCTIONS.items() for lanes in nets
    }
    assert {w.sensor.found_as for w in worlds} == {"same", "new"}
    assert any(w.sensor.pixels_per_m for w in worlds)
    assert any(w.sensor.left_hand for w in worlds)
    assert {w.road.lanes for w in worlds} == {1, 2, 3, 4, 5}
    assert min(w.road.limit_mps for w in worlds) < 7.0
    assert max(w.road.limit_mps for w in worlds) > 34.0
    assert any(w.settings.keep_right > 1 for w in worlds)
    assert min(w.sensor.step_s for w in worlds) == 0.04
    assert max(w.sensor.step_s for w in worlds) == 0.4
    for world in worlds:
        assert sum(world.population.mix.values()) == pytest.approx(1.0, abs=1e-9)
        assert 0 <= world.sensor.noise_m <= 0.5


def test_episodes_can_be_opened_trained_on_and_verified(dataset: Dataset):
    assert len(dataset.manifest.episodes) == CONFIG.episodes
    assert verify_dataset(dataset.path) == []
    for entry in dataset.manifest.episodes:
        world = draw_world(entry.seed, 15.0)
        episode = dataset.read(entry)
        assert entry.options["law"] == world.law
        assert entry.options["noise_m"] == world.sensor.noise_m
        assert episode.tracks.step_s == pytest.approx(world.sensor.step_s)
        assert episode.tracks.valid.any()
        assert (dataset.road(entry) is not None) == world.sensor.has_map
        labels = episode.tracks.behavior
        assert labels is not None
        truth = {a.id: a.behavior for a in episode.agents}
        for agent, code in zip(episode.tracks.ids, labels, strict=True):
            assert truth[int(agent)] == (None if code < 0 else BEHAVIORS[code])
    samples = gather([dataset], "train", "graphrqi-plus", windows_s=(3.0,), jobs=1)
    assert np.isfinite(samples.time_s).all()
    assert len(samples)


def test_the_same_seed_gives_the_same_bytes_with_any_number_of_workers(
    dataset: Dataset, tmp_path: Path
):
    fewer = CONFIG.model_copy(update={"episodes": 3})
    generate(fewer, tmp_path, jobs=1, quiet=True)
    grown = generate(CONFIG, tmp_path, jobs=2, quiet=True)
    assert grown == dataset.manifest
    with pytest.raises(InputError, match="holds 5 episodes per scenario, found 3"):
        generate(fewer, tmp_path, jobs=1, quiet=True)


@pytest.mark.parametrize("lanes", [1, 4])
def test_written_nets_are_roads_with_the_lanes_and_limit_asked_for(lanes: int, tmp_path: Path):
    net = tmp_path / "road.net.xml"
    net.write_text(ramp_net(lanes, 30.0, 1500.0))
    road = read_road(net)
    assert len([lane for lane in road.lanes if lane.edge == "between"]) == lanes + 1
    assert {lane.speed_limit_mps for lane in road.lanes} == {30.0}
    assert len(road.connections) == 2 * lanes + 2
    net.write_text(straight_net(lanes, 20.0, 400.0))
    road = read_road(net)
    assert [lane.length_m for lane in road.lanes] == [400.0] * lanes


def driving(n: int = 50, t: int = 400) -> Tracks:
    """Cars of 5 m that drive eastwards at 10 m/s for 40 s, one behind the other."""
    xy = np.zeros((n, t, 2))
    xy[..., 0] = np.arange(t) * 1.0 + 20.0 * np.arange(n)[:, None]
    return Tracks.of_dense(
        ids=np.arange(n), names=tuple(map(str, range(n))), kind=np.zeros(n), length=np.full(n, 5.0),
        width=np.full(n, 2.0), time_s=np.arange(t) * 0.1, xy=xy, heading=np.zeros((n, t)),
        speed=np.full((n, t), 10.0), valid=np.ones((n, t), dtype=bool), signals=np.zeros((0, t)),
        behavior=np.arange(n) % 6,
    )  # fmt: skip


def test_noise_has_the_deviation_and_the_correlation_asked_for():
    tracks = driving()
    error = correlated_noise(tracks, 0.2, np.random.default_rng(0), 0.5).xy - tracks.xy
    assert error.std() == pytest.approx(0.2, rel=0.05)
    later = (error[:, 5:] * error[:, :-5]).mean() / error.var()
    assert later == pytest.approx(np.exp(-1.0), abs=0.06)


def test_agents_that_are_found_again_have_new_ids_and_their_old_labels():
    tracks = driving()
    pieces = renamed_tracks(tracks, 6.0, np.random.default_rng(2))
    assert pieces.ids.size > 2 * tracks.ids.size
    assert 0.5 < pieces.valid.sum() / tracks.valid.sum() < 1.0
    assert (pieces.valid.sum(axis=0) <= tracks.ids.size).all()
    assert pieces.behavior is not None
    assert tracks.behavior is not None
    for name, code, seen, xy in zip(
        pieces.names, pieces.behavior, pieces.valid, pieces.xy, strict=True
    ):
        agent = int(name.partition("/")[0])
        assert code == tracks.behavior[agent]
        assert np.array_equal(xy[seen], tracks.xy[agent, seen])


def test_speeds_and_headings_are_measured_from_the_positions_seen():
    rng = np.random.default_rng(3)
    exact = Sensor(step_s=0.1).seen(driving(), rng)
    assert exact.speed == pytest.approx(np.full(exact.speed.shape, 10.0))
    noisy = Sensor(step_s=0.1, noise_m=0.3).seen(driving(), rng)
    assert 0.5 < (noisy.speed - 10.0).std() < 3.0
    mirrored = Sensor(step_s=0.1, has_map=False, left_hand=True, turned_rad=1.0).seen(
        driving(), rng
    )
    assert np.abs(mirrored.heading) == pytest.approx(np.full(mirrored.heading.shape, 1.0))
    image = Sensor(step_s=0.1, has_map=False, pixels_per_m=8.0).seen(driving(), rng)
    assert image.speed.mean() == pytest.approx(80.0, rel=0.01)
    assert set(image.length) == {40.0}
    boxes = Sensor(step_s=0.1, has_map=False, has_sizes=False, pixels_per_m=8.0)
    assert set(boxes.seen(driving(), rng).length) == {36.0}
    unknown = Sensor(step_s=0.1, has_map=False, has_sizes=False).seen(driving(), rng)
    assert set(unknown.length) == {4.5}


@pytest.mark.parametrize(("rate_hz", "frames"), [(25.0, 998), (10.0, 400), (5.0, 200), (2.5, 100)])
def test_other_frame_rates_show_the_same_motion(rate_hz: float, frames: int):
    tracks = driving(n=3)
    swerving = tracks.xy + np.sin(tracks.time_s)[None, :, None] * np.array([0.0, 2.0])
    shown = np.ones((3, 400), dtype=bool)
    shown[1, 100:150] = False
    tracks = tracks.with_dense(xy=np.where(shown[..., None], swerving, np.nan), valid=shown)
    seen = frame_rate(tracks, rate_hz, np.random.default_rng(0))
    assert seen.time_s.size == frames
    assert np.diff(seen.time_s) == pytest.approx(np.full(frames - 1, 1 / rate_hz))
    assert seen.xy[0, :, 0] == pytest.approx(seen.time_s * 10.0)
    assert seen.xy[0, :, 1] == pytest.approx(2.0 * np.sin(seen.time_s), abs=1e-3)
    hidden = (seen.time_s > 9.91) & (seen.time_s < 14.99)
    assert not seen.valid[1, hidden].any()
    assert seen.valid[1, ~hidden].all()
