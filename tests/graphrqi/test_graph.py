"""The traffic graph against its definition: brute-force edges, a Laplacian, accumulation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.graph import TrafficGraph
from graphrqi.spectrum.rivals import change_between


def brute_force_edges(
    ids: NDArray[np.int64], xy: NDArray[np.float64], neighbors: int
) -> set[tuple[int, int]]:
    edges = set()
    for i in range(len(ids)):
        square = (xy[:, 0] - xy[i, 0]) ** 2 + (xy[:, 1] - xy[i, 1]) ** 2
        chosen = [j for j in np.lexsort((ids, square)) if j != i][:neighbors]
        edges |= {(min(ids[i], ids[j]), max(ids[i], ids[j])) for j in chosen}
    return {(int(a), int(b)) for a, b in edges}


def edge_set(graph: TrafficGraph) -> set[tuple[int, int]]:
    return {(min(a, b), max(a, b)) for a, b in graph.edges.tolist()}


def place(layout: str, n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    xy = rng.normal(size=(n, 2)) * [100.0, 5.0]
    match layout:
        case "lattice":
            return rng.integers(0, 4, size=(n, 2)).astype(float)
        case "coincident":
            return np.repeat(rng.integers(0, 3, size=(n, 1)).astype(float), 2, axis=1)
        case "straggler":
            xy[:1] = [9e8, -9e8]
        case "arms":
            return np.where(rng.random((n, 1)) < 0.5, xy * [1, 0], xy[:, ::-1] * [0, 1])
        case "far clusters":
            return xy * 1e-3 + rng.integers(0, 2, size=(n, 1)) * 1e8
        case "line":
            return xy * [1, 0]
        case "square to the search":
            return np.outer(xy[:, 0], [-np.sin(1.0), np.cos(1.0)])
    return xy


@pytest.mark.parametrize(
    "layout",
    [
        "road",
        "lattice",
        "coincident",
        "straggler",
        "arms",
        "far clusters",
        "line",
        "square to the search",
    ],
)
def test_edges_equal_brute_force(layout: str) -> None:
    rng = np.random.default_rng(len(layout))
    for _ in range(40):
        n = int(rng.integers(0, 70))
        ids = rng.permutation(2000)[:n] - 1000
        xy = place(layout, n, rng)
        k = int(rng.integers(1, 9))
        nearest = TrafficGraph.empty(neighbors=k, kind="instantaneous").observe(ids, xy)
        assert edge_set(nearest) == brute_force_edges(ids, xy, k)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.integers(-(2**63), 2**63 - 1),
            st.floats(-1e9, 1e9, allow_nan=False),
            st.floats(-1e9, 1e9, allow_nan=False),
        ),
        max_size=25,
        unique_by=lambda row: row[0],
    ),
    st.integers(1, 6),
)
def test_any_ids_and_positions(rows: list[tuple[int, float, float]], neighbors: int) -> None:
    ids = np.array([row[0] for row in rows], np.int64)
    xy = np.array([row[1:] for row in rows], float).reshape(-1, 2)
    graph = TrafficGraph.empty(neighbors=neighbors, kind="instantaneous").observe(ids, xy)
    assert edge_set(graph) == brute_force_edges(ids, xy, neighbors)
    assert np.array_equal(graph.ids, ids)


def test_laplacian_is_degree_minus_adjacency() -> None:
    xy = np.random.default_rng(1).random((50, 2)) * 100
    graph = TrafficGraph.empty().observe(np.arange(50), xy)
    expected = np.zeros((50, 50))
    for a, b in brute_force_edges(np.arange(50), xy, 4):
        expected[a, b] = expected[b, a] = 1.0
    np.testing.assert_array_equal(graph.adjacency.toarray(), expected)
    np.testing.assert_array_equal(graph.degree, expected.sum(0))
    np.testing.assert_array_equal(graph.laplacian.toarray(), np.diag(expected.sum(0)) - expected)


def test_edges_do_not_depend_on_the_order_of_the_vehicles() -> None:
    rng = np.random.default_rng(2)
    xy = rng.integers(0, 5, size=(40, 2)).astype(float)
    ids = rng.permutation(40)
    turn = rng.permutation(40)
    rule = TrafficGraph.empty(neighbors=3)
    assert edge_set(rule.observe(ids, xy)) == edge_set(rule.observe(ids[turn], xy[turn]))


def test_accumulation_keeps_vehicles_and_edges_until_the_reset() -> None:
    rng = np.random.default_rng(3)
    graph = TrafficGraph.empty(neighbors=2, reset=5)
    kept: set[tuple[int, int]] = set()
    seen: list[int] = []
    for step in range(17):
        n = int(rng.integers(0, 20))
        ids = rng.permutation(30)[:n]
        xy = rng.random((n, 2)) * 50
        if step % 5 == 0:
            kept, seen = set(), []
        seen += [int(i) for i in ids if i not in seen]
        kept |= brute_force_edges(ids, xy, 2)
        graph = graph.observe(ids, xy)
        assert graph.ids.tolist() == seen
        assert edge_set(graph) == kept
        assert graph.observations == step % 5 + 1


def test_change_rebuilds_the_laplacian() -> None:
    rng = np.random.default_rng(4)
    graph = TrafficGraph.empty(kind="instantaneous")
    for _ in range(10):
        n = int(rng.integers(1, 30))
        after = graph.observe(rng.permutation(40)[:n], rng.random((n, 2)))
        edges, signs = change_between(graph, after)
        everyone = np.union1d(graph.ids, after.ids)
        total = np.zeros((everyone.size, everyone.size))
        for sign, one in ((-1.0, graph), (1.0, after)):
            rows = np.searchsorted(everyone, one.ids)
            total[np.ix_(rows, rows)] += sign * one.laplacian.toarray()
        for (a, b), sign in zip(edges, signs, strict=True):
            w = (everyone == a).astype(float) - (everyone == b)
            total -= sign * np.outer(w, w)
        assert np.abs(total).max() == 0.0
        graph = after


@pytest.mark.parametrize(
    ("ids", "edges", "message"),
    [
        ([1, 1], [], "ids: found 1 twice"),
        ([1, 2], [(1, 1)], "1 joined to itself"),
        ([1, 2], [(1, 3)], "found vehicle 3"),
        ([1, 2], [(1, 2, 3)], "edges: found shape"),
        ([1.5, 2.0], [], "whole numbers"),
    ],
)
def test_bad_edges_are_refused(ids: list[int], edges: list[tuple[int, ...]], message: str) -> None:
    with pytest.raises(InputError, match=message):
        TrafficGraph.from_edges(ids, edges)
