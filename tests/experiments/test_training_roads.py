"""The roads that the predictor for recordings is trained on beside random worlds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments import model
from sim.store.dataset import open_dataset


def test_roundabouts_have_rings_of_their_radius_and_lanes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(model, "ROUNDABOUTS", ((13.0, 1), (30.0, 2)))
    short = {"episodes": 1, "duration_s": 6.0}
    monkeypatch.setattr(model, "RINGS", model.RINGS | short)
    free = {"scenarios": ("motorway",), **short}
    monkeypatch.setattr(model, "FREE_ROADS", model.FREE_ROADS | free)
    made = model.generate_roads(tmp_path, quiet=True)
    assert [folder.name for folder in made] == ["recorded-free", "recorded-roundabouts"]
    motorways, rings = (open_dataset(folder) for folder in made)
    assert [len(list(one.episodes())) for one in (motorways, rings)] == [1, 2]
    shapes = set()
    for entry in rings.episodes():
        ring = [lane for lane in rings.road(entry).lanes if lane.edge == "east_north"]
        radius_m = np.linalg.norm(ring[0].centerline, axis=1).mean()
        shapes.add((10 * round(float(radius_m) / 10.0), len(ring)))
    assert shapes == {(10, 1), (30, 2)}
