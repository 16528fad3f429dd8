"""The roads that the predictor for recordings is trained on beside random worlds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.training import roads
from sim.store.dataset import open_dataset


def test_roundabouts_and_towns_have_bends_and_skew_junctions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(roads, "ROUNDABOUTS", ((13.0, 1), (30.0, 2)))
    monkeypatch.setattr(roads, "ROUNDABOUT_EPISODES", 1)
    monkeypatch.setattr(roads, "ROUNDABOUT_S", 6.0)
    monkeypatch.setattr(roads, "TOWNS", 2)
    monkeypatch.setattr(roads, "TOWN_S", 6.0)
    monkeypatch.setattr(roads, "MOTORWAYS", ("motorway",))
    monkeypatch.setattr(roads, "MOTORWAY_EPISODES", 1)
    monkeypatch.setattr(roads, "MOTORWAY_S", 6.0)
    made = roads.generate_roads(tmp_path, 5, quiet=True)
    kinds = ("roundabouts", "towns", "motorways")
    assert [folder.name for folder in made] == [f"recorded-{kind}" for kind in kinds]
    rings, towns, motorways = (open_dataset(folder) for folder in made)
    assert [len(list(one.episodes())) for one in (rings, towns, motorways)] == [2, 2, 1]
    shapes = set()
    for entry in rings.episodes():
        ring = [lane for lane in rings.road(entry).lanes if lane.edge == "east_north"]
        radius_m = np.linalg.norm(ring[0].centerline, axis=1).mean()
        shapes.add((10 * round(float(radius_m) / 10.0), len(ring)))
    assert shapes == {(10, 1), (30, 2)}
    first, second = (towns.road(entry) for entry in towns.episodes())
    assert len(first.lanes) != len(second.lanes)
    for road in (first, second):
        ways = np.array([lane.centerline[-1] - lane.centerline[0] for lane in road.lanes])
        angles = np.degrees(np.arctan2(ways[:, 1], ways[:, 0])) % 90.0
        assert np.ptp(angles) > 45.0

    nets = {file: file.stat().st_mtime_ns for file in tmp_path.glob("town-*.net.xml")}
    assert len(nets) == 2
    assert roads.generate_roads(tmp_path, 5, quiet=True) == made
    assert nets == {file: file.stat().st_mtime_ns for file in nets}
