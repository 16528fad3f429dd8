"""The benchmarks of speed, spectra and predictions, at sizes that only show that they work."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from behaviors.labels import BEHAVIORS
from experiments.benchmarks import generate, loop, spectrum
from experiments.benchmarks.graph_sequences import city_blocks, traffic, traffic_positions
from experiments.benchmarks.prediction import BELIEFS, compare
from experiments.score.parts import show_parts
from experiments.score.predictions import GROUPS, MEASURES, Errors
from experiments.score.rows import Row, tidy_row
from graphrqi.graph import TrafficGraph
from graphrqi.posterior import Posterior
from graphrqi.spectrum import SOLVERS
from sim.frames import Frame, Tracks


def test_rows_are_kept_after_every_part(tmp_path: Path, capsys) -> None:
    path = tmp_path / "rows.json"
    counts = []

    def parts():
        for value in (1.0, 2.0):
            yield [tidy_row({"who": "a"}, "m", value, None, None, 1)]
            counts.append(len(json.loads(path.read_text())))

    rows = show_parts("echo", parts(), path)
    assert counts == [1, 2]
    assert {row["command"] for row in rows} == {"echo"}
    assert "who" in capsys.readouterr().out
    show_parts("echo", [], Path("-"))
    assert json.loads(capsys.readouterr().out) == []


# --- loop ---------------------------------------------------------------------------------------


def test_every_stage_of_the_real_loop_is_timed() -> None:
    (rows,) = loop.measure_road(("sumo",), duration_s=6.0, repeats=1)
    stages = {*loop.STAGES, "all"}
    assert {row["stage"] for row in rows} == stages
    value = {(row["stage"], row["metric"]): row["value"] for row in rows}
    assert all(0.0 < value[s, "ms_median"] <= value[s, "ms_p99"] for s in stages - {"remember"})
    together = sum(1 / value[s, "real_time_factor"] for s in loop.STAGES)
    assert np.isclose(together, 1 / value["all", "real_time_factor"])


def test_a_city_is_measured_and_costs_are_compared() -> None:
    small = loop.measure_city(3, 12, "sumo")
    assert small.lanes == 276
    assert 0.0 < small.agents <= 12.0
    large = small._replace(vehicles=24, agents=2 * small.agents, spent_ms=4 * small.spent_ms)
    (row,) = loop.slopes([small, large], "sumo")
    assert (row["metric"], row["value"]) == ("slope_agents", pytest.approx(2.0))
    assert {row["stage"] for row in loop.city_rows(small, "sumo")} == {*loop.STAGES, "all", "open"}


def test_the_engine_stands_beside_highway_envs_own_road() -> None:
    rows = loop.stock_rows(duration_s=10.0, frames=3)
    value = {(row["engine"], row["metric"]): row["value"] for row in rows}
    own, stock = (value[e, "agent_steps_per_cpu_s"] for e in ("highway", "highway-env's own"))
    assert value["highway", "ratio_to_stock"] == pytest.approx(own / stock)


# --- generate -----------------------------------------------------------------------------------


def test_costs_of_an_episode() -> None:
    cost = generate.episode_costs("straight_road", 0, 10.0)
    assert cost["over_bare_stepping"] > 0.0
    assert 1.0 < cost["bytes_per_agent_step"] < 10_000.0


# --- spectrum -----------------------------------------------------------------------------------


def spectrum_rows(sizes: tuple[int, ...], graph: str, *solvers: str) -> list[Row]:
    return [row for part in spectrum.measure(sizes, (graph,), solvers, 3) for row in part]


def test_solvers_are_measured_on_the_same_graphs(monkeypatch) -> None:
    rows = spectrum_rows((25, 40), "road")
    keys = ["solver", "d", "graph", "kind", "end", "metric", "value", "low", "high", "n"]
    assert all(list(row) == keys for row in rows)
    assert {row["solver"] for row in rows} == {*SOLVERS, "lapack-dsyevr"}
    by = {(r["solver"], r["end"], r["metric"], r["d"]): r["value"] for r in rows}
    for solver in ("graphrqi", "graphrqi-exact", "svd", "lapack-dsyevr"):
        assert by[solver, "largest", "missed_pairs", 40] == 0
    assert by["graphrqi", "largest", "certified_share", 40] == 1.0
    assert by["graphrqi-paper", "largest", "residual_max", 40] > 0.01
    assert len(spectrum.table(rows)) >= 4 * len(SOLVERS)


def test_what_would_take_too_long_is_skipped(capsys) -> None:
    rows = spectrum_rows((25, 1100), "road", "graphrqi", "svd")
    skipped = {(row["solver"], row["d"]) for row in rows if row["value"] is None}
    assert skipped == {("svd", 1100)}
    assert "svd: skipped: needs d^2 numbers" in capsys.readouterr().err
    lines = [line for line in spectrum.table(rows) if line["solver"] == "svd"]
    assert {line["1100 (ms)"] for line in lines} == {"skipped"}


def test_missed_pairs_counts_multiplicity() -> None:
    pairs = TrafficGraph.from_edges(range(8), [(0, 1), (2, 3), (4, 5), (6, 7)])
    right = SOLVERS["eigh"](pairs, 4)
    less = SOLVERS["eigh"](TrafficGraph.from_edges(range(8), [(0, 1), (2, 3)]), 4)
    assert spectrum.missed_pairs(right, right) == 0
    assert spectrum.missed_pairs(right, less) == 2


def test_positions_move() -> None:
    first, second = traffic_positions("crossing", 30, 2)
    assert first.shape == (30, 2)
    assert (np.linalg.norm(second - first, axis=1) < 5.0).all()


def test_a_city_has_as_many_vehicles_in_every_frame() -> None:
    assert [city_blocks(d) for d in (1, 1000, 9000)] == [3, 8, 24]
    ids, xy = (np.stack(part) for part in zip(*traffic("city", 30, 100), strict=True))
    assert ids.shape == (100, 30)
    same = (ids[1:] == ids[:-1]).all(axis=1)
    moved = np.linalg.norm(np.diff(xy, axis=0)[same], axis=2)
    assert moved.max() < 3.0
    assert (moved > 0.5).any(axis=0).sum() > 10


# --- prediction ---------------------------------------------------------------------------------


def made_up(ade: float, collisions: float = 0.1) -> Errors:
    total = np.zeros((len(GROUPS), 3, len(MEASURES)))
    total[0, -1, MEASURES.index("ade_m")] = 10 * ade
    total[0, -1, MEASURES.index("collisions")] = 10 * collisions
    count = np.zeros(len(GROUPS))
    count[0] = 10
    return Errors(total, count)


def test_each_kind_of_beliefs_is_what_it_says() -> None:
    frame = Frame(
        time_s=0.0, ids=np.arange(6), xy=np.zeros((6, 2)), heading=np.zeros(6), speed=np.ones(6),
        length=np.full(6, 4.0), width=np.full(6, 2.0), kind=np.zeros(6),
    )  # fmt: skip
    tracks = Tracks.from_frames([frame], dict(enumerate(BEHAVIORS)))
    rows = np.random.default_rng(0).dirichlet(np.ones(6), 6)
    classified = Posterior(np.arange(6), rows)
    told = {kind: make(tracks, classified).of(tracks.ids) for kind, make in BELIEFS.items()}
    assert np.array_equal(told["classifier"], rows)
    assert np.array_equal(told["truth"], np.eye(6))
    assert told["uniform"] == pytest.approx(1 / 6)
    assert not np.array_equal(told["shuffled"], rows)
    assert np.sort(told["shuffled"][:, 0]) == pytest.approx(np.sort(rows[:, 0]))


def test_ratios_and_shares_compare_what_was_run() -> None:
    told = "graphrqi-predict"
    episodes = [
        {("constant-velocity", "classifier"): made_up(4 * d, 0.4),
         (told, "uniform"): made_up(1.4 * d), (told, "classifier"): made_up(1.1 * d),
         (told, "truth"): made_up(1.0 * d), (told, "shuffled"): made_up(2.8 * d)}
        for d in (0.8, 1.0, 1.2)
    ]  # fmt: skip
    rows = compare(episodes, "here", "test")
    value = {(r["predictor"], r["metric"]): r for r in rows if r["beliefs"] == "classifier"}
    shuffled = [r for r in rows if r["beliefs"] == "shuffled"]
    assert [r["metric"] for r in shuffled] == ["ade_m_over_uniform_beliefs"]
    assert shuffled[0]["value"] == pytest.approx(2.0)
    assert value[told, "ade_m_over_constant-velocity"]["value"] == pytest.approx(0.275)
    assert value[told, "collisions_over_constant-velocity"]["value"] == pytest.approx(0.25)
    assert value[told, "label_gain_share"]["value"] == pytest.approx(0.75)
    assert (told, "ade_m_over_lstm") not in value
    assert compare([], "here", "test") == []
