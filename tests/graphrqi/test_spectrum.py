"""One contract for all solvers; the right ones against LAPACK; the certificate against frauds."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from behaviors.errors import InputError
from experiments.benchmarks.spectrum import (
    graph_sequence,
)
from graphrqi.graph import TrafficGraph
from graphrqi.spectrum import SOLVERS, Spectrum, certify
from graphrqi.spectrum.contract import End, null_space
from graphrqi.spectrum.rivals import _shifted_solves
from tests.graphrqi.hostile_graphs import hostile_graphs

RIGHT = ("graphrqi", "graphrqi-exact", "eigh", "svd")
"""Solvers that promise every answer."""
ENDS: tuple[End, ...] = ("largest", "smallest")

SHAPES = {
    "nothing": TrafficGraph.from_edges([], []),
    "one vehicle": TrafficGraph.from_edges([7], []),
    "two apart": TrafficGraph.from_edges([7, -3], []),
    "one edge": TrafficGraph.from_edges([7, -3], [(7, -3)]),
    "star": TrafficGraph.from_edges(range(60), [(0, i) for i in range(1, 60)]),
    "ring": TrafficGraph.from_edges(range(80), [(i, (i + 1) % 80) for i in range(80)]),
    "complete": TrafficGraph.from_edges(range(40), [(i, j) for i in range(40) for j in range(i)]),
    "pairs": TrafficGraph.from_edges(range(100), [(i, i + 1) for i in range(0, 100, 2)]),
    "isolated": TrafficGraph.from_edges(range(50), []),
    "path and isolated": TrafficGraph.from_edges(range(70), [(i, i + 1) for i in range(40)]),
}


def errors_against_lapack(found: Spectrum, num_pairs: int) -> Any:
    """Relative errors of eigenvalues and residuals, and departure from orthonormality.

    The matrix is made anew from the graph's edges.
    """
    graph = found.graph
    d = graph.ids.size
    row = {vehicle: i for i, vehicle in enumerate(graph.ids.tolist())}
    matrix = np.zeros((d, d))
    for a, b in graph.edges.tolist():
        ends = np.ix_([row[a], row[b]], [row[a], row[b]])
        matrix[ends] += np.array([[1.0, -1.0], [-1.0, 1.0]])
    values = np.linalg.eigvalsh(matrix) if d else np.zeros(0)
    scale = max(1.0, values.max(initial=0.0))
    values = (values[::-1] if found.end == "largest" else values)[:num_pairs]
    vectors = found.eigenvectors
    assert found.eigenvalues.shape == values.shape
    assert vectors.shape == (d, values.size)
    parts = (
        (found.eigenvalues - values) / scale,
        np.linalg.norm(matrix @ vectors - vectors * found.eigenvalues, axis=0) / scale,
        vectors.T @ vectors - np.eye(values.size),
    )
    return np.array([np.abs(part).max(initial=0.0) for part in parts])


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("end", ENDS)
def test_every_solver_keeps_the_contract(name: str, end: End) -> None:
    previous: Spectrum | None = None
    for shape, graph in SHAPES.items():
        for k in (1, 8, 200):
            found = SOLVERS[name](graph, k, end, previous)
            d = graph.ids.size
            assert found.eigenvalues.shape == (min(k, d),), (shape, k)
            assert found.eigenvectors.shape == (d, min(k, d)), (shape, k)
            assert found.residuals.shape == (min(k, d),), (shape, k)
            order = np.sort(found.eigenvalues)
            assert np.array_equal(found.eigenvalues, order[::-1] if end == "largest" else order), (
                shape,
                k,
            )
            true = np.linalg.norm(
                graph.laplacian @ found.eigenvectors - found.eigenvectors * found.eigenvalues,
                axis=0,
            )
            np.testing.assert_allclose(found.residuals, true, atol=1e-10)
            assert np.array_equal(found.ids, graph.ids)
            if name in RIGHT:
                assert found.certified, (shape, k, found.note)
            if found.certified:
                assert errors_against_lapack(found, k).max() < 1e-8, (shape, k)
            previous = found


@pytest.mark.parametrize("name", ["graphrqi", "graphrqi-exact"])
@pytest.mark.parametrize("kind", ["instantaneous", "accumulated"])
@pytest.mark.parametrize("end", ENDS)
def test_sequences_stay_right(name: str, kind: str, end: End) -> None:
    previous: Spectrum | None = None
    for graph in graph_sequence("crossing", kind, 60, 30):
        previous = SOLVERS[name](graph, 8, end, previous)
        assert previous.certified
        assert errors_against_lapack(previous, 8).max() < 1e-8


def test_a_thousand_hostile_graphs() -> None:
    last: dict[str, Spectrum] = {}
    fallbacks = 0
    for graph, k, end, warm in hostile_graphs(1000, largest=400, seed=11):
        found = SOLVERS["graphrqi"](graph, k, end, last.get(end) if warm else None, 1e-8)
        last[end] = found
        assert found.certified
        assert (errors_against_lapack(found, k) < [1e-8, 1e-8, 1e-9]).all()
        fallbacks += found.note.startswith("fell back")
    assert fallbacks <= 10


@settings(max_examples=80, deadline=None)
@given(st.data())
def test_any_graph(data: st.DataObject) -> None:
    d = data.draw(st.integers(0, 90))
    vertex = st.integers(0, max(d - 1, 0))
    drawn = data.draw(st.lists(st.tuples(vertex, vertex), max_size=3 * d)) if d else []
    edges = [(a, b) for a, b in drawn if a != b]
    k = data.draw(st.integers(1, 32))
    end: End = data.draw(st.sampled_from(ENDS))
    found = SOLVERS["graphrqi"](TrafficGraph.from_edges(range(d), edges), k, end)
    assert found.certified
    assert errors_against_lapack(found, k).max() < 1e-8


def test_repeated_eigenvalues_at_the_cut() -> None:
    cliques = [(10 * c + i, 10 * c + j) for c in range(20) for i in range(10) for j in range(i)]
    graph = TrafficGraph.from_edges(range(200), cliques)
    found = SOLVERS["graphrqi"](graph, 8)
    assert found.certified
    np.testing.assert_allclose(found.eigenvalues, 10.0, atol=1e-8)


@pytest.mark.parametrize("end", ENDS)
def test_more_equal_eigenvalues_than_shifts_are_ever_tried(end: End) -> None:
    star = TrafficGraph.from_edges(range(1400), [(0, i) for i in range(1, 1400)])
    found = SOLVERS["graphrqi"](star, 421, end)
    assert found.certified
    expected = np.ones(421)
    expected[0] = 1400.0 if end == "largest" else 0.0
    np.testing.assert_allclose(found.eigenvalues, expected, atol=1e-8)


@pytest.mark.slow
def test_kernels_stay_within_their_arrays(tmp_path: Path) -> None:
    """Compiled once more with numba's check of every index."""
    program = """
import numpy as np
from experiments.benchmarks.spectrum import graph_sequence
from graphrqi.graph import TrafficGraph
from graphrqi.spectrum import SOLVERS

star = TrafficGraph.from_edges(range(900), [(0, i) for i in range(1, 900)])
for end in ("largest", "smallest"):
    assert SOLVERS["graphrqi"](star, 410, end).certified
    for name, kind in (("road", "accumulated"), ("crossing", "instantaneous")):
        for k, d in ((1, 70), (8, 300), (40, 500), (8, 1500)):
            previous = None
            for graph in graph_sequence(name, kind, d, 4):
                previous = SOLVERS["graphrqi"](graph, k, end, previous)
                assert previous.certified
rng = np.random.default_rng(0)
graph = TrafficGraph.empty(neighbors=3)
for n in (0, 1, 2, 90, 40):
    xy = np.stack([500.0 * rng.random(n), 3.5 * rng.integers(0, 4, n)], axis=1)
    graph = graph.observe(rng.permutation(200)[:n], xy)
"""
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    run = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr


def test_the_previous_answer_may_be_of_other_vehicles() -> None:
    before, after = graph_sequence("road", "instantaneous", 120, 2)
    previous = SOLVERS["graphrqi"](before, 8)
    turned = np.random.default_rng(0).permutation(120)
    other = TrafficGraph.from_edges(after.ids[turned] + 40, after.edges + 40)
    found = SOLVERS["graphrqi"](other, 8, previous=previous)
    assert found.certified
    assert errors_against_lapack(found, 8).max() < 1e-8


@pytest.mark.parametrize("name", SOLVERS)
def test_same_call_same_answer_to_the_bit(name: str) -> None:
    graphs = [*graph_sequence("road", "accumulated", 100, 3), SHAPES["pairs"]]
    answers = []
    for _ in range(2):
        previous: Spectrum | None = None
        for graph in graphs:
            previous = SOLVERS[name](graph, 8, previous=previous)
        assert previous is not None
        answers.append(previous)
    assert np.array_equal(answers[0].eigenvectors, answers[1].eigenvectors)


@pytest.mark.parametrize("end", ENDS)
def test_a_missing_pair_is_never_certified(end: End) -> None:
    for graph in graph_sequence("road", "accumulated", 90, 10):
        found = SOLVERS["eigh"](graph, 9, end)
        for left_out in range(8):
            kept = [i for i in range(9) if i != left_out]
            gap = abs(found.eigenvalues[left_out] - found.eigenvalues[8])
            if gap < 1e-6:
                continue
            fraud = replace(
                found,
                eigenvalues=found.eigenvalues[kept],
                eigenvectors=found.eigenvectors[:, kept],
                residuals=found.residuals[kept],
            )
            assert not certify(fraud).certified


@pytest.mark.parametrize("end", ENDS)
def test_the_order_of_an_answer_does_not_matter_to_its_certificate(end: End) -> None:
    graph = TrafficGraph.from_edges(range(50), [(i, i + 1) for i in range(49)])
    values, vectors = np.linalg.eigh(graph.laplacian.toarray())
    complete = slice(45, 50) if end == "largest" else slice(0, 5)
    gap = [44, 46, 47, 48, 49] if end == "largest" else [5, 3, 2, 1, 0]
    for kept, whole in ((complete, True), (gap, False)):
        for turn in (1, -1):
            some = values[kept][::turn].copy(), vectors[:, kept][:, ::turn].copy()
            found = Spectrum(graph.ids, *some, np.zeros(5), False, graph, end)
            assert certify(found).certified is whole


def test_a_null_vector_over_all_components_is_known_for_one() -> None:
    """Spread over many, it is like none of their indicators; then its zero was counted twice."""
    paths = [[(i * 8 + j, i * 8 + j + 1) for j in range(i + 1)] for i in range(7)]
    edges = [edge for path in paths for edge in path]
    graph = TrafficGraph.from_edges(sorted({end for edge in edges for end in edge}), edges)
    full = SOLVERS["eigh"](graph, graph.ids.size, "smallest")
    null = full.eigenvectors[:, :7].sum(axis=1) / np.sqrt(7)
    values = np.concatenate([[0.0], full.eigenvalues[7:13]])
    vectors = np.column_stack([null, full.eigenvectors[:, 7:13]])
    missing = Spectrum(graph.ids, values, vectors, np.zeros(7), False, graph, "smallest")
    assert not certify(missing).certified


def test_most_right_answers_are_certified() -> None:
    certified = [
        certify(replace(SOLVERS["eigh"](graph, 8, end), certified=False)).certified
        for graph in graph_sequence("crossing", "accumulated", 90, 15)
        for end in ENDS
    ]
    assert sum(certified) >= 28


def test_wrong_vectors_are_never_certified() -> None:
    graph = next(graph_sequence("road", "instantaneous", 90, 1))
    found = SOLVERS["eigh"](graph, 8)
    wrong = replace(found, eigenvalues=found.eigenvalues + 1e-6)
    assert not certify(wrong).certified
    twice = found.eigenvectors.copy()
    twice[:, 1] = twice[:, 0]
    assert not certify(replace(found, eigenvectors=twice)).certified


def test_smallest_end_starts_with_the_component_indicators() -> None:
    graph = TrafficGraph.from_edges(range(60), [(i, i + 1) for i in range(59) if i % 20 != 19])
    found = SOLVERS["graphrqi"](graph, 5, "smallest")
    np.testing.assert_array_equal(found.eigenvalues[:3], 0.0)
    np.testing.assert_allclose(found.eigenvectors[:, :3], null_space(graph))
    assert (found.eigenvalues[3:] > 1e-3).all()


def test_the_exact_update_is_the_dense_inverse() -> None:
    rng = np.random.default_rng(5)
    values, weights = rng.random(30) * 9, np.array([1.0, -1.0, 1.0])
    w = rng.normal(size=(30, 3))
    shifts, x = rng.random(4) * 9, rng.normal(size=(30, 4))
    found = _shifted_solves(values, w, weights, shifts, x, 9.0)
    for j, shift in enumerate(shifts):
        matrix = np.diag(values - shift) + (w * weights) @ w.T
        np.testing.assert_allclose(found[:, j], np.linalg.solve(matrix, x[:, j]), rtol=1e-9)


def test_the_printed_update_is_wrong_and_says_so() -> None:
    previous: Spectrum | None = None
    residuals = []
    for graph in graph_sequence("road", "accumulated", 60, 15, skip=20):
        previous = SOLVERS["graphrqi-paper"](graph, 8, previous=previous)
        residuals.append(previous.residuals.max())
    assert residuals[0] < 1e-10
    assert residuals[-1] > 0.1


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_pairs": 0}, "num_pairs: found 0"),
        ({"end": "middle"}, "end: found 'middle'"),
        ({"tol": 0.0}, "tol: found 0.0"),
    ],
    ids=["no pairs", "no end", "no tolerance"],
)
def test_bad_arguments_are_refused(name: str, arguments: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        SOLVERS[name](SHAPES["ring"], **arguments)  # type: ignore[arg-type]


def test_the_page_about_the_spectrum_is_true() -> None:
    import doctest

    page = Path(__file__).parents[2] / "docs" / "spectrum.md"
    result = doctest.testfile(str(page), module_relative=False)
    assert result.attempted >= 12
    assert result.failed == 0
