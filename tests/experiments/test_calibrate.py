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
from experiments.calibration import SCHEMA, write_calibration, write_shipped
from experiments.scoring.calibration import population_rows
from graphrqi.calibrate.laws import Law
from sim.store.lock import FILLING, LOCK
from tests.experiments.shared import call, content

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
    page = (out / "report.html").read_text()
    assert "best fitted: t" in page
    assert "worst fitted: t" in page
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
    (out / "report.html").unlink()
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


def test_populations_are_laid_beside_the_profiles(tmp_path: Path) -> None:
    people = read_population("profiles")
    (tmp_path / "people.toml").write_text(people.to_toml())
    out = tmp_path / "rows.json"
    assert call("populations", "profiles", tmp_path / "people.toml", "--json", out) == 0
    rows = json.loads(out.read_bytes())
    assert [row["number"] for row in rows] == [*NUMBERS, *NUMBERS]
    headway = next(row for row in rows if row["number"] == "time_headway_s")
    assert headway["threatening"] < headway["careful"] < headway["timid"]
    assert headway["careful"] == pytest.approx(people.quantile("time_headway_s", 1.45), abs=1e-3)
