"""``graphrqi calibrate`` from a recording to its folder."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from behaviors.errors import InputError
from behaviors.populations import NUMBERS, read_population
from experiments.calibration import SCHEMA, population_rows, write_calibration
from graphrqi.calibrate.fit import Law
from tests.experiments.shared import call

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


def test_a_recording_is_calibrated_into_a_folder(tmp_path: Path) -> None:
    source, out = recording(tmp_path / "a.csv", 30.0), tmp_path / "out"
    calibrated = write_calibration(source, out, "argoverse1", quiet=True)
    headway = NUMBERS.index("time_headway_s")
    assert calibrated.better is Law.IDM
    population = read_population(out / "population.toml")
    assert (population.law, population.drivers, population.name) == ("idm", 3, "a")
    assert population.median[headway] == pytest.approx(HEADWAY_S, rel=0.25)
    table = pq.read_table(out / "drivers.parquet")
    assert table.schema.equals(SCHEMA)
    rows = table.to_pandas()
    assert len(rows) == 3 * len(Law) * len(NUMBERS)
    assert (rows["low"] <= rows["median"]).all()
    assert (rows["median"] <= rows["high"]).all()
    found = population_rows(calibrated)
    assert len(found) == len(Law) * len(NUMBERS)
    errors = {row["law"]: row["second_half_m"] for row in found}
    assert errors["idm"] < errors["krauss"]
    with pytest.raises(InputError, match="new or empty folder"):
        write_calibration(source, out, "argoverse1", quiet=True)


def test_the_command_writes_tidy_rows(tmp_path: Path) -> None:
    source, rows = recording(tmp_path / "a.csv", 20.0), tmp_path / "rows.json"
    assert call("calibrate", source, "--out", tmp_path / "out", "--json", rows, "--quiet") == 0
    assert {row["number"] for row in json.loads(rows.read_bytes())} == set(NUMBERS)
