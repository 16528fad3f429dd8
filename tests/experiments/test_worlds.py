"""Random worlds: drawn by seed, driven, stored as seen, and usable like any dataset."""

from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.data.generate import generate
from experiments.data.verify import find_flaws
from experiments.data.windows import gather
from experiments.data.worlds.episode import WorldsConfig, WorldTask, read_worlds_config
from experiments.data.worlds.world import draw_world
from scenarios.networks.written import limited_net, ramp_net, straight_net
from sim.frames import Tracks
from sim.road.net import read_road
from sim.store.dataset import Dataset, open_dataset
from sim.sumo.settings import LAWS

CONFIG = WorldsConfig(worlds=5, seed=4, duration_s=15.0)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("worlds") / "data"
    generate(CONFIG, folder, jobs=1, quiet=True)
    return open_dataset(folder)


def test_many_worlds_hold_every_law_family_and_discipline():
    worlds = [draw_world(seed) for seed in range(400)]
    assert {w.settings.law for w in worlds} == set(LAWS)
    assert {w.road.family for w in worlds} == {"straight", "junction", "ramp"}
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
    assert len(dataset.manifest.episodes) == CONFIG.worlds
    assert find_flaws(dataset) == []
    for entry in dataset.manifest.episodes:
        world = WorldTask(CONFIG, entry.index).world
        episode = dataset.read(entry)
        assert entry.options["law"] == world.settings.law
        assert entry.options["noise_m"] == world.sensor.noise_m
        assert episode.tracks.step_s == pytest.approx(world.sensor.step_s)
        assert episode.tracks.valid.any()
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
    fewer = CONFIG.model_copy(update={"worlds": 3})
    generate(fewer, tmp_path, jobs=2, quiet=True)
    grown = generate(CONFIG, tmp_path, jobs=2, quiet=True)
    assert grown == dataset.manifest
    with pytest.raises(InputError, match="holds 5 worlds, found 3"):
        generate(fewer, tmp_path, jobs=1, quiet=True)


def test_options_that_worlds_draw_themselves_are_refused():
    assert read_worlds_config(None, 3, seed=2, flow=None).seed == 2
    with pytest.raises(InputError, match="found --scenario beside it"):
        read_worlds_config(None, 3, scenarios=["straight_road"])
    with pytest.raises(InputError, match=r"--worlds: .*greater than or equal to 1"):
        read_worlds_config(None, 0)


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
    with pytest.raises(InputError, match="lanes: found 0"):
        straight_net(0, 20.0, 400.0)


def test_another_limit_leaves_slow_turns_slow(tmp_path: Path):
    net = tmp_path / "road.net.xml"
    net.write_text(limited_net("four_way_intersection", 18.0))
    limits = {lane.speed_limit_mps for lane in read_road(net).lanes if lane.cars}
    assert limits == {18.0, 9.26, 6.51}


def test_noise_has_the_deviation_and_the_correlation_asked_for():
    from experiments.data.disturbances import correlated_noise

    n, t = 50, 400
    tracks = Tracks(
        ids=np.arange(n), names=tuple(map(str, range(n))), kind=np.zeros(n), length=np.ones(n),
        width=np.ones(n), time_s=np.arange(t) * 0.1, xy=np.zeros((n, t, 2)),
        heading=np.zeros((n, t)), speed=np.zeros((n, t)), valid=np.ones((n, t), dtype=bool),
        signals=np.zeros((0, t)),
    )  # fmt: skip
    error = correlated_noise(tracks, 0.2, np.random.default_rng(0), 0.5).xy
    assert error.std() == pytest.approx(0.2, rel=0.05)
    later = (error[:, 5:] * error[:, :-5]).mean() / error.var()
    assert later == pytest.approx(np.exp(-1.0), abs=0.06)
