"""The benchmarks of speed, spectra and predictions, at sizes that only show that they work."""

from __future__ import annotations

import numpy as np
import pytest

from behaviors.labels import BEHAVIORS
from experiments.benchmarks import conflicts, generate, loop, spectrum
from experiments.benchmarks.prediction import BELIEFS, compare
from experiments.score.predictions import GROUPS, MEASURES, Errors
from experiments.score.rows import Row
from graphrqi.posterior import Posterior
from graphrqi.spectrum import SOLVERS
from sim.frames import Frame, Tracks

# --- loop ---------------------------------------------------------------------------------------


def test_every_stage_of_the_real_loop_is_timed() -> None:
    rows, *engines = loop.measure(("sumo",), duration_s=12.0, repeats=1)
    stages = {*loop.STAGES, "all"}
    assert {row["stage"] for row in rows} == stages
    value = {(row["stage"], row["metric"]): row["value"] for row in rows}
    assert all(0.0 < value[s, "ms_median"] <= value[s, "ms_p99"] for s in stages - {"remember"})
    together = sum(1 / value[s, "real_time_factor"] for s in loop.STAGES)
    assert np.isclose(together, 1 / value["all", "real_time_factor"])
    for part in engines:
        own, stock, ratio = (row["value"] for row in part)
        assert ratio == pytest.approx(own / stock)


# --- conflicts ----------------------------------------------------------------------------------


def test_following_conflicts_agree_with_those_of_sumo() -> None:
    (rows,) = conflicts.measure((0,), 60.0, ("straight_road",))
    value = {(r["kind"], r["found_by"], r["metric"]): r["value"] for r in rows}
    assert value["following", "both", "conflicts"] > 5
    assert value["following", "both", "ttc_s_difference"] == pytest.approx(0.0, abs=0.05)
    assert value["following", "both", "drac_mps2_difference"] == pytest.approx(0.0, abs=0.05)


# --- generate -----------------------------------------------------------------------------------


def test_costs_of_an_episode() -> None:
    cost = generate.episode_costs("straight_road", 0, 10.0)
    assert 1.0 < cost["bytes_per_agent_step"] < 10_000.0


# --- spectrum -----------------------------------------------------------------------------------


def spectrum_rows(sizes: tuple[int, ...], graph: str, *solvers: str) -> list[Row]:
    return [row for part in spectrum.measure(sizes, (graph,), solvers, 3) for row in part]


def test_solvers_are_measured_on_the_same_graphs() -> None:
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


# --- prediction ---------------------------------------------------------------------------------


def made_up(ade: float) -> Errors:
    total = np.zeros((len(GROUPS), 3, len(MEASURES)))
    total[0, -1, MEASURES.index("ade_m")] = 10 * ade
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


def test_ratios_compare_what_was_run() -> None:
    ours = "graphrqi-predict"
    episodes = [
        {("constant-velocity", "classifier"): made_up(4 * d),
         (ours, "uniform"): made_up(1.4 * d), (ours, "classifier"): made_up(1.1 * d)}
        for d in (0.8, 1.0, 1.2)
    ]  # fmt: skip
    value = {row["metric"]: row["value"] for row in compare(episodes, "here", "test")}
    assert value["ade_m_over_constant-velocity"] == pytest.approx(0.275)
    assert value["ade_m_over_uniform_beliefs"] == pytest.approx(1.1 / 1.4)
    assert "ade_m_over_lstm" not in value
    assert compare([], "here", "test") == []
