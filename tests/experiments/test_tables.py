"""Rows as JSON: valid whatever was measured."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from experiments.rows import write_json


def test_what_is_not_finite_is_null(tmp_path: Path) -> None:
    row = {"metric": "auc", "value": float("nan"), "low": np.inf, "high": np.float64("nan"), "n": 0}
    write_json([row, {"metric": "m", "value": 0.5}], tmp_path / "rows.json")
    first, second = json.loads((tmp_path / "rows.json").read_text())
    assert first == {"metric": "auc", "value": None, "low": None, "high": None, "n": 0}
    assert second["value"] == 0.5
