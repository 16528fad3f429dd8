"""Whether a map fits: traffic on its own map, beside it, far from it, and on another's."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from experiments.data.exchange import import_recordings
from experiments.data.recorded_roads import map_fit
from scenarios import SCENARIOS
from sim.formats import get_writer, read_recordings
from sim.formats.common.doubts import doubt_of_times
from sim.frames import Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph
from sim.store.dataset import open_dataset

STEPS = 60
SHIFT_M = (40.0, -25.0)


def traffic(road: Road, vehicles: int = 12, of_limit: float = 1.0) -> Tracks:
    """Vehicles along lanes of a road, at a share of the limit, 30 cm beside the centre line."""
    lanes = [i for i, lane in enumerate(road.lanes) if not lane.walking and lane.length_m > 60]
    rows = []
    for k in range(vehicles):
        lane = lanes[k % len(lanes)]
        speed = of_limit * road.lanes[lane].speed_limit_mps
        room_m = max(road.lanes[lane].length_m - 5.0, 1.0)
        s = (5.0 * k + 0.1 * speed * np.arange(STEPS)) % room_m
        xy, heading = LaneGraph.of(road).position(np.full(STEPS, lane), s, np.full(STEPS, 0.3))
        rows.append((xy, heading, np.full(STEPS, speed)))
    return Tracks.of_dense(
        ids=np.arange(vehicles),
        names=tuple(str(k) for k in range(vehicles)),
        kind=np.zeros(vehicles, dtype=np.int8),
        length=np.full(vehicles, 4.5),
        width=np.full(vehicles, 1.8),
        time_s=np.arange(STEPS) / 10,
        xy=np.stack([row[0] for row in rows]),
        heading=np.stack([row[1] for row in rows]),
        speed=np.stack([row[2] for row in rows]),
        valid=np.ones((vehicles, STEPS), dtype=bool),
        signals=np.empty((0, STEPS), dtype=np.int8),
        behavior=None,
    )


@pytest.fixture(scope="module")
def road() -> Road:
    return SCENARIOS["four_way_intersection"]().road


def test_traffic_on_its_own_map(road: Road) -> None:
    fit = map_fit(road, traffic(road))
    assert fit.share > 0.99
    assert fit.limits_rule
    assert fit.fits


def test_a_map_turned_or_of_another_place_does_not_fit(road: Road) -> None:
    tracks = traffic(road)
    turn = np.array([[math.cos(0.6), -math.sin(0.6)], [math.sin(0.6), math.cos(0.6)]])
    turned = tracks.with_dense(xy=tracks.xy @ turn.T, heading=tracks.heading + 0.6)
    assert not map_fit(road, turned).fits
    backwards = tracks.with_dense(heading=tracks.heading + math.pi)
    assert map_fit(road, backwards).share < 0.5


@pytest.mark.parametrize(("of_limit", "rules"), [(1.05, True), (0.9, True), (0.45, False)])
def test_whether_limits_rule(road: Road, of_limit: float, rules: bool) -> None:
    fit = map_fit(road, traffic(road, of_limit=of_limit))
    assert fit.limit_ratio == pytest.approx(of_limit, abs=0.02)
    assert fit.limits_rule == rules


def exported(folder: Path, tracks: Tracks) -> Path:
    """Traffic as a file of SUMO's."""
    folder.mkdir()
    return get_writer("sumo-fcd")(folder, "a", tracks, None)[0]


def test_a_shifted_map_is_refused_until_the_shift_is_given(road: Road, tmp_path: Path) -> None:
    tracks = traffic(road)
    file = exported(tmp_path / "in", tracks.with_dense(xy=tracks.xy + np.array(SHIFT_M)))
    with pytest.raises(InputError, match=r"net\.xml: the map does not fit .* --shift X,Y"):
        import_recordings(file, tmp_path / "out", net=road.source, quiet=True)
    import_recordings(file, tmp_path / "out", net=road.source, quiet=True, shift_m=SHIFT_M)
    (entry,) = (dataset := open_dataset(tmp_path / "out")).episodes()
    stored = dataset.road(entry)
    assert stored is not None
    assert map_fit(stored, dataset.read(entry).tracks).share > 0.99
    moved = road.lanes[0].centerline + np.array(SHIFT_M)
    assert stored.lanes[0].centerline == pytest.approx(moved)


@pytest.mark.parametrize("offset", [(-389000.0, -5819000.0), (0.0, -400.0), (1200.5, 80.25)])
def test_a_net_is_shifted_by_its_own_offset(
    road: Road, tmp_path: Path, offset: tuple[float, float]
) -> None:
    net = tmp_path / "town.net.xml"
    said = 'netOffset="{},{}"'.format(*offset)
    net.write_text(re.sub(r'netOffset="[^"]*"', said, road.source.read_text(), count=1))
    tracks = traffic(road)
    file = exported(tmp_path / "in", tracks.with_dense(xy=tracks.xy - np.array(offset)))
    (entry,) = import_recordings(file, tmp_path / "out", net=net, quiet=True).episodes
    assert any("as its own offset says" in str(note) for note in entry.options["notes"])


def test_a_wrong_rate_is_refused_until_the_rate_is_given(road: Road, tmp_path: Path) -> None:
    tracks = traffic(road)
    assert doubt_of_times(tracks) is None
    file = exported(tmp_path / "in", dataclasses.replace(tracks, time_s=tracks.time_s / 4))
    with pytest.raises(InputError, match=r"a\.xml: found agents that go 4\.00 times .* --rate HZ"):
        import_recordings(file, tmp_path / "out", quiet=True)
    import_recordings(file, tmp_path / "out", quiet=True, rate_hz=10.0)
    (entry,) = (dataset := open_dataset(tmp_path / "out")).episodes()
    stored = dataset.read(entry).tracks
    assert stored.time_s == pytest.approx(tracks.time_s)
    assert stored.speed == pytest.approx(tracks.speed)


def test_real_recordings_fit_their_maps_and_no_others(shared_data: Path) -> None:
    real = shared_data / "real"
    found = {}
    for place in ("ngsim_us101/NGSIM-US101__NGSIM_US101_7", "ngsim_lankershim/*2_4_T-1"):
        (file,) = real.glob(f"{place}.xml.gz")
        (recording,) = read_recordings(file)
        assert isinstance(recording.road, Road)
        found[place] = (recording.road, recording.tracks)
    for place, (own, _) in found.items():
        for other, (_, tracks) in found.items():
            assert map_fit(own, tracks).fits == (place == other)
