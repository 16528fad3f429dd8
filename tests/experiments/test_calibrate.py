"""``graphrqi calibrate`` from a recording to its folder."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from behaviors.errors import InputError
from behaviors.populations import NUMBERS, read_population
from experiments.benches.calibration import behind_rows
from experiments.calibration import SCHEMA, write_calibration, write_shipped
from experiments.score.calibration import population_rows
from graphrqi.calibrate.drives import Stretch
from graphrqi.calibrate.laws import Law
from sim.store.lock import FILLING, LOCK
from tests.experiments.shared import content

HEADWAY_S = 1.2


def recording(path: Path, seconds: float) -> Path:
    """Four cars behind one another, each by IDM at a headway of 1.2 s behind the one ahead."""
    steps = round(10 * seconds)
    x, v = -30.0 * np.arange(4), np.full(4, 14.0)
    lines = ["TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME"]
    for k in range(steps):
        lines += [f"{k / 10:.1f},t{a},OTHERS,{x[a]:.4f},0.0,PIT" for a in range(4)]
        gap = np.append(np.inf, x[:-1] - x[1:] - 4.5)
        ahead = np.append(v[0], v[:-1])
        wanted = 2.5 + np.maximum(HEADWAY_S * v + v * (v - ahead) / (2.0 * np.sqrt(3.0)), 0.0)
        accel = 1.5 * (1.0 - (v / 22.0) ** 4 - (wanted / gap) ** 2)
        accel[0] = 1.5 * np.sin(0.4 * k / 10)
        faster = np.maximum(v + 0.1 * accel, 0.0)
        x, v = x + 0.05 * (v + faster), faster
    path.write_text("\n".join([*lines, ""]))
    return path


def test_the_population_that_ships_can_be_made_again(tmp_path: Path) -> None:
    """Of the recordings that it was made of; here of others."""
    source, out = recording(tmp_path / "a.csv", 30.0), tmp_path / "us101.toml"
    write_shipped(source, out, quiet=True)
    made = read_population(out)
    assert (made.name, made.law, made.drivers) == ("us101", "idm", 3)
    assert made.source.startswith("3 drives on US-101")
    ships = read_population("us101")
    assert ships.source == made.source.replace("3 drives", f"{ships.drivers:,} drives")


def test_known_drivers_behind_recorded_leaders_are_found_again() -> None:
    """Behind leaders that brake and accelerate, from recordings that tremble or do not."""
    rng = np.random.default_rng(3)
    time_s = np.arange(0.0, 40.0, 0.1)
    drivers = []
    for i in range(24):
        rear = 40.0 + 12.0 * time_s + 18.0 * np.sin(0.35 * time_s + i)
        level = np.interp(time_s, time_s[::9], rng.normal(0.0, 0.1, time_s[::9].size))
        drivers.append([Stretch(time_s, rear - 25.0 + level * (i % 2), rear)])
    rows = list(behind_rows("road", drivers, 0))
    of = {(row["number"], row["noise"], row["metric"]): float(row["value"]) for row in rows}
    for number in ("time_headway_s", "max_accel_mps2"):
        for noise in ("", "close"):
            told, true = (of[number, noise, metric] for metric in ("told", "true"))
            assert told == pytest.approx(true, rel=0.35)
    assert {row["n"] for row in rows} == {24}


def test_a_recording_is_calibrated_into_a_folder(tmp_path: Path) -> None:
    source, out = recording(tmp_path / "a.csv", 30.0), tmp_path / "out"
    calibrated = write_calibration(source, out, "argoverse1", quiet=True)
    table = pq.read_table(out / "drivers.parquet")
    assert table.schema.equals(SCHEMA)
    assert set(table.column("name").to_pylist()) == {"t1", "t2", "t3"}
    assert table.num_rows == 3 * len(Law) * len(NUMBERS)
    headway = calibrated.laws[Law.IDM].summary().mean[:, NUMBERS.index("time_headway_s")]
    np.testing.assert_allclose(headway, HEADWAY_S, atol=0.2)
    card = json.loads((out / "calibration.json").read_bytes())
    assert card["drivers"] == 3
    assert 0.0 <= card["law_told_idm"] + card["law_told_krauss"] <= 1.0
    assert card["law_told_idm"] == calibrated.law_told(Law.IDM)
    better = (out / f"population_{card['better_law']}.toml").read_text()
    assert (out / "population.toml").read_text() == better
    assert set(tomllib.loads(better)["numbers"]) == set(NUMBERS)
    assert len(population_rows(calibrated)) == len(Law) * len(NUMBERS)


def test_a_calibration_that_was_stopped_is_run_again(tmp_path: Path) -> None:
    source, out = recording(tmp_path / "a.csv", 20.0), tmp_path / "out"
    write_calibration(source, out, "argoverse1", quiet=True)
    before = content(out)
    write_calibration(source, out, "argoverse1", quiet=True)
    assert content(out) == before
    recording(source, 21.0)
    with pytest.raises(InputError, match=r"found another calibration there .*new or empty folder"):
        write_calibration(source, out, "argoverse1", quiet=True)
    (out / "calibration.json").unlink()
    with pytest.raises(InputError, match="found something there, expected a new or empty folder"):
        write_calibration(source, out, "argoverse1", quiet=True)
    (out / LOCK).write_text(f"process 1 on a machine, {FILLING}")  # of one that was killed
    recording(source, 20.0)
    write_calibration(source, out, "argoverse1", quiet=True)
    assert content(out) == before


def test_nobody_to_calibrate_is_said(tmp_path: Path) -> None:
    source = recording(tmp_path / "a.csv", 3.0)
    with pytest.raises(InputError, match="found no driver that follows another one"):
        write_calibration(source, tmp_path / "out", "argoverse1", quiet=True)
