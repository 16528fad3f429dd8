"""Whether a map fits: traffic on its own map, beside it, far from it, and on another's."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from experiments.data.exchange import import_recordings
from scenarios import SCENARIOS
from sim.formats import read_recordings
from sim.formats.common.stated_rate import displacement_over_speed, with_true_times
from sim.frames import Tracks
from sim.road import Road
from sim.road.lane_graph import LaneGraph
from sim.road.map_fit import map_fit, shifted
from sim.store.dataset import open_dataset

STEPS = 60


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
    return Tracks(
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
    assert fit.shift_m == (0.0, 0.0)
    assert fit.limits_rule
    assert fit.fits


@pytest.mark.parametrize("shift", [(3.0, -2.0), (-40.0, 25.0), (4_000.0, -70_000.0)])
def test_one_translation_is_found(road: Road, shift: tuple[float, float]) -> None:
    tracks = traffic(road)
    fit = map_fit(road, dataclasses.replace(tracks, xy=tracks.xy + shift))
    assert fit.share < 0.6
    assert fit.shifted_share > 0.95
    np.testing.assert_allclose(fit.shift_m, shift, atol=1.0)
    assert "shifted" in fit.notes()[0]
    moved = shifted(road, fit.shift_m)
    again = map_fit(moved, dataclasses.replace(tracks, xy=tracks.xy + shift))
    assert again.shift_m == (0.0, 0.0)


def test_a_map_turned_or_of_another_place_does_not_fit(road: Road) -> None:
    tracks = traffic(road)
    turn = np.array([[math.cos(0.6), -math.sin(0.6)], [math.sin(0.6), math.cos(0.6)]])
    turned = dataclasses.replace(tracks, xy=tracks.xy @ turn.T, heading=tracks.heading + 0.6)
    assert not map_fit(road, turned).fits
    backwards = dataclasses.replace(tracks, heading=tracks.heading + math.pi)
    assert map_fit(road, backwards).share < 0.5


@pytest.mark.parametrize(("of_limit", "rules"), [(1.05, True), (0.9, True), (0.45, False)])
def test_whether_limits_rule(road: Road, of_limit: float, rules: bool) -> None:
    fit = map_fit(road, traffic(road, of_limit=of_limit))
    assert fit.limit_ratio == pytest.approx(of_limit, abs=0.02)
    assert fit.limits_rule == rules


def test_nothing_can_be_told_of_those_who_stand(road: Road) -> None:
    fit = map_fit(road, dataclasses.replace(traffic(road), speed=np.zeros((12, STEPS))))
    assert math.isnan(fit.share)
    assert fit.fits
    assert fit.limits_rule


def _interaction(path: Path, tracks: Tracks) -> None:
    lines = ["track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width"]
    for i in range(len(tracks.names)):
        for t in range(STEPS):
            (x, y), h, v = tracks.xy[i, t], tracks.heading[i, t], tracks.speed[i, t]
            speed = f"{v * math.cos(h)},{v * math.sin(h)}"
            lines.append(f"{i},{t},{100 * t},car,{x},{y},{speed},{h},4.5,1.8")
    path.write_text("\n".join([*lines, ""]))


def test_import_refuses_or_shifts_a_map(
    tmp_path: Path, road: Road, capsys: pytest.CaptureFixture[str]
) -> None:
    tracks = traffic(road, of_limit=0.4)
    recording = tmp_path / "vehicle_tracks_000.csv"
    _interaction(recording, tracks)
    import_recordings(recording, tmp_path / "a", net=road.source, quiet=True)
    dataset = open_dataset(tmp_path / "a")
    (entry,) = dataset.episodes()
    kept = dataset.road(entry)
    assert kept is not None
    assert not kept.knows.limits_rule
    assert np.isnan(LaneGraph.of(kept).limit).all()
    assert "limits do not rule" in str(entry.options["notes"])

    _interaction(recording, dataclasses.replace(tracks, xy=tracks.xy + np.array([30.0, 500.0])))
    import_recordings(recording, tmp_path / "b", net=road.source, quiet=True)
    dataset = open_dataset(tmp_path / "b")
    kept = dataset.road(dataset.episodes()[0])
    assert kept is not None
    np.testing.assert_allclose(kept.bounds[:2], np.add(road.bounds[:2], (30, 500)), atol=1.0)

    other = SCENARIOS["straight_road"]().road.source
    with pytest.raises(InputError, match=r"straight_road.*% of the moving positions") as caught:
        import_recordings(recording, tmp_path / "c", net=other, quiet=True)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "c").exists()


def test_a_wrong_step_is_found_and_said(road: Road) -> None:
    tracks = traffic(road, of_limit=0.5)
    assert displacement_over_speed(tracks) == pytest.approx(1.0, abs=0.02)
    assert with_true_times(tracks)[0] is tracks
    for stated_s, true_s in ((0.5, 0.1), (0.04, 0.1)):
        told, notes = with_true_times(
            dataclasses.replace(tracks, time_s=np.arange(STEPS) * stated_s)
        )
        assert told.step_s == pytest.approx(true_s)
        assert f"said to be {stated_s:g} s" in notes[0]
    assert notes
    kmh, notes = with_true_times(dataclasses.replace(tracks, speed=3.6 * tracks.speed))
    assert kmh.step_s == pytest.approx(0.1)
    assert "km/h" in notes[0]
    np.testing.assert_allclose(np.median(kmh.speed), np.median(tracks.speed), rtol=0.05)


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
