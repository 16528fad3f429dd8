"""The bench measures what it says, on graphs too small to time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from experiments.benches.spectrum.bench import BENCH, Settings
from experiments.benches.spectrum.convergence import convergence_rows
from experiments.benches.spectrum.costs import missed_pairs, why_not
from experiments.benches.spectrum.picture import plot_spectrum, spectrum_table
from experiments.benches.spectrum.sequences import (
    city_blocks,
    traffic,
    traffic_positions,
)
from experiments.console.tables import MADE
from experiments.score.rows import FIGURE
from graphrqi.graph import TrafficGraph
from graphrqi.spectrum import SOLVERS


def test_rows_table_and_plot(tmp_path: Path) -> None:
    rows = BENCH.run(
        Settings((25, 40), 4, ("largest",), ("road",), ("instantaneous",), 3, budget_s=0.2, study=0)
    )
    keys = [*MADE, "solver", "d", "graph", "kind", "end", *FIGURE]
    keys.append("reason")
    assert all(list(row) == keys for row in rows)
    json.dumps(rows, allow_nan=False)
    measured = {(row["solver"], row["metric"]) for row in rows}
    for solver in SOLVERS:
        for metric in ("cpu_ms", "wall_ms", "residual_max", "missed_pairs", "ratio_to_eigh"):
            assert (solver, metric) in measured
    assert ("positions-to-features", "cpu_ms") in measured
    by = {(r["solver"], r["metric"], r["d"]): r["value"] for r in rows}
    for solver in ("graphrqi", "graphrqi-exact", "svd", "lapack-dsyevr"):
        assert by[solver, "missed_pairs", 40] == 0
    assert by["graphrqi", "certified_share", 40] == 1.0
    assert by["graphrqi-paper", "residual_max", 40] > 0.01
    assert len(spectrum_table(rows)) >= len(SOLVERS)
    plot_spectrum(rows, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 10_000


def test_what_would_take_too_long_is_skipped_and_says_why() -> None:
    kept: list[list[object]] = []
    settings = Settings(
        (25, 1100), 4, ("largest",), ("road",), ("instantaneous",), 1, ("graphrqi", "svd"), study=0
    )
    rows = BENCH.run(settings, lambda so_far: kept.append(list(so_far)))
    assert all(part == rows[: len(part)] for part in kept)
    assert 0 < len(kept[0]) < len(kept[1]) < len(rows)
    skipped = [row for row in rows if row["reason"] is not None]
    assert [(row["solver"], row["d"], row["value"]) for row in skipped] == [("svd", 1100, None)]
    assert {line["1100 (ms)"] for line in spectrum_table(rows) if line["solver"] == "svd"} == {
        "skipped"
    }
    assert why_not("arpack", 1000, [(100, 2.0), (400, 4.0)]) is None


def test_missed_pairs_counts_multiplicity() -> None:
    pairs = TrafficGraph.from_edges(range(8), [(0, 1), (2, 3), (4, 5), (6, 7)])
    right = SOLVERS["eigh"](pairs, 4)
    less = SOLVERS["eigh"](TrafficGraph.from_edges(range(8), [(0, 1), (2, 3)]), 4)
    assert missed_pairs(right, right) == 0
    assert missed_pairs(right, less) == 2


@pytest.mark.parametrize("d", [60, 100])
@pytest.mark.parametrize("layout", ["road", "crossing"])
def test_plain_iterations_converge_cubically(layout: str, d: int) -> None:
    rows = {row["metric"]: row["value"] for row in convergence_rows(layout, d)}
    assert rows["residual_after_3"] < 1e-5 * rows["residual_after_0"]
    assert 2.5 <= rows["order_of_convergence"] <= 3.5


def test_positions_move_and_unknown_layouts_are_refused() -> None:
    first, second = traffic_positions("crossing", 30, 2)
    assert first.shape == (30, 2)
    assert np.isfinite(first).all()
    assert (np.linalg.norm(second - first, axis=1) < 5.0).all()
    with pytest.raises(InputError, match="roundabout"):
        next(traffic_positions("roundabout", 3, 1))


def test_a_city_has_as_many_vehicles_in_every_frame_and_is_certified() -> None:
    frames = list(traffic("city", 30, 100))
    assert len(frames) == 100
    ids, xy = (np.stack(part) for part in zip(*frames, strict=True))
    assert ids.shape == (100, 30)
    assert (np.diff(ids, axis=1) > 0).all()
    same = (ids[1:] == ids[:-1]).all(axis=1)
    moved = np.linalg.norm(np.diff(xy, axis=0)[same], axis=2)
    assert moved.max() < 3.0
    assert (moved > 0.5).any(axis=0).sum() > 10
    both = ("instantaneous", "accumulated")
    solvers = ("graphrqi", "eigh", "arpack")
    rows = BENCH.run(Settings((30,), 4, ("largest",), ("city",), both, 4, solvers, study=0))
    by = {(row["solver"], row["kind"], row["metric"]): row["value"] for row in rows}
    for kind in both:
        assert by["graphrqi", kind, "certified_share"] == 1.0
        assert by["graphrqi", kind, "missed_pairs"] == 0
        assert by["graphrqi", kind, "residual_max"] < 1e-7


def test_unknown_layouts_are_refused_before_anything_is_measured() -> None:
    with pytest.raises(InputError, match="found 'roundabout', expected road, crossing or city"):
        BENCH.run(Settings(graphs=("road", "roundabout")))
    assert [city_blocks(d) for d in (1, 1000, 9000)] == [3, 8, 24]
