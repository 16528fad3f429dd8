"""The traffic graph against its definition: brute-force edges, a Laplacian, accumulation."""

from __future__ import annotations

import sys
from subprocess import run

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from behaviors.errors import InputError
from graphrqi.graph import Sighting, TrafficGraph, change_between


def brute_force_edges(
    ids: NDArray[np.int64], xy: NDArray[np.float64], neighbors: int | None, radius_m: float | None
) -> set[tuple[int, int]]:
    edges = set()
    for i in range(len(ids)):
        square = (xy[:, 0] - xy[i, 0]) ** 2 + (xy[:, 1] - xy[i, 1]) ** 2
        if radius_m is not None:
            chosen = [j for j in range(len(ids)) if j != i and square[j] <= radius_m * radius_m]
        else:
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
    return xy


@pytest.mark.parametrize(
    "layout", ["road", "lattice", "coincident", "straggler", "arms", "far clusters", "line"]
)
def test_edges_equal_brute_force(layout: str) -> None:
    rng = np.random.default_rng(len(layout))
    for _ in range(40):
        n = int(rng.integers(0, 70))
        ids = rng.permutation(2000)[:n] - 1000
        xy = place(layout, n, rng)
        k, r = int(rng.integers(1, 9)), float(rng.choice([0.5, 1, 2, 10, 300]))
        nearest = TrafficGraph.empty(neighbors=k, kind="instantaneous").observe(ids, xy)
        assert edge_set(nearest) == brute_force_edges(ids, xy, k, None)
        reach = TrafficGraph.empty(radius_m=r, kind="instantaneous").observe(ids, xy)
        assert edge_set(reach) == brute_force_edges(ids, xy, None, r)


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
    assert edge_set(graph) == brute_force_edges(ids, xy, neighbors, None)
    assert np.array_equal(graph.ids, ids)


def test_laplacian_is_degree_minus_adjacency() -> None:
    rng = np.random.default_rng(1)
    xy = rng.random((50, 2)) * 100
    graph = TrafficGraph.empty(scale_m=20.0, radius_m=30.0).observe(np.arange(50), xy)
    a, laplacian = graph.adjacency.toarray(), graph.laplacian.toarray()
    distance = np.linalg.norm(xy[:, None] - xy, axis=2)
    expected = np.where((distance <= 30.0) & ~np.eye(50, dtype=bool), np.exp(-distance / 20.0), 0)
    np.testing.assert_allclose(a, expected, rtol=1e-12)
    np.testing.assert_array_equal(laplacian, laplacian.T)
    np.testing.assert_allclose(laplacian, np.diag(expected.sum(0)) - expected, atol=1e-12)
    np.testing.assert_allclose(graph.degree, expected.sum(0))
    assert graph.weights.size == len(graph.edges)


def test_edges_do_not_depend_on_the_order_of_the_vehicles() -> None:
    rng = np.random.default_rng(2)
    xy = rng.integers(0, 5, size=(40, 2)).astype(float)
    ids = rng.permutation(40)
    turn = rng.permutation(40)
    rule = TrafficGraph.empty(neighbors=3)
    assert edge_set(rule.observe(ids, xy)) == edge_set(rule.observe(ids[turn], xy[turn]))


@pytest.mark.parametrize("scale_m", [None, 15.0])
def test_accumulation_keeps_vehicles_and_edges_until_the_reset(scale_m: float | None) -> None:
    rng = np.random.default_rng(3)
    graph = TrafficGraph.empty(neighbors=2, reset=5, scale_m=scale_m)
    kept: dict[tuple[int, int], float] = {}
    seen: list[int] = []
    for step in range(17):
        n = int(rng.integers(0, 20))
        ids = rng.permutation(30)[:n]
        xy = rng.random((n, 2)) * 50
        if step % 5 == 0:
            kept, seen = {}, []
        seen += [int(i) for i in ids if i not in seen]
        place_of = dict(zip(ids.tolist(), xy, strict=True))
        for a, b in brute_force_edges(ids, xy, 2, None):
            distance = float(np.linalg.norm(place_of[a] - place_of[b]))
            kept[a, b] = 1.0 if scale_m is None else float(np.exp(-distance / scale_m))
        before = graph
        graph = graph.observe(ids, xy)
        assert graph.ids.tolist() == seen
        found = {
            (min(a, b), max(a, b)): w
            for (a, b), w in zip(graph.edges.tolist(), graph.weights.tolist(), strict=True)
        }
        assert found == pytest.approx(kept)
        change = graph.change()
        assert set(change.arrived.tolist()) == set(graph.ids.tolist()) - set(before.ids.tolist())
        assert set(change.departed.tolist()) == set(before.ids.tolist()) - set(graph.ids.tolist())
        assert graph.observations == step % 5 + 1


def test_change_rebuilds_the_laplacian() -> None:
    rng = np.random.default_rng(4)
    graph = TrafficGraph.empty(kind="instantaneous")
    for _ in range(10):
        n = int(rng.integers(1, 30))
        after = graph.observe(rng.permutation(40)[:n], rng.random((n, 2)))
        change = change_between(graph, after)
        everyone = np.union1d(graph.ids, after.ids)
        total = np.zeros((everyone.size, everyone.size))
        for sign, one in ((-1.0, graph), (1.0, after)):
            rows = np.searchsorted(everyone, one.ids)
            total[np.ix_(rows, rows)] += sign * one.laplacian.toarray()
        for (a, b), weight in zip(change.edges, change.weights, strict=True):
            w = (everyone == a).astype(float) - (everyone == b)
            total -= weight * np.outer(w, w)
        assert np.abs(total).max() == 0.0
        graph = after


def test_from_edges_merges_duplicates_and_keeps_the_largest_weight() -> None:
    graph = TrafficGraph.from_edges(
        [5, -1, 2**62], [(5, -1), (-1, 5), (2**62, 5), (5, 2**62)], [1.0, 3.0, 2.0, 0.0]
    )
    assert graph.laplacian.toarray().tolist() == [[5, -3, -2], [-3, 3, 0], [-2, 0, 2]]


def test_more_neighbours_than_there_are_vehicles() -> None:
    graph = TrafficGraph.empty(neighbors=2**70).observe([1, 2, 3], [[0, 0], [1, 0], [9, 0]])
    assert edge_set(graph) == {(1, 2), (1, 3), (2, 3)}


@pytest.mark.parametrize("ids", [[], [4]])
def test_no_edges(ids: list[int]) -> None:
    graph = TrafficGraph.from_edges(ids, [])
    assert graph.laplacian.shape == (len(ids), len(ids))
    assert graph.edges.shape == (0, 2)
    observed = TrafficGraph.empty().observe(ids, np.zeros((len(ids), 2)))
    assert observed.laplacian.toarray().tolist() == graph.laplacian.toarray().tolist()


@pytest.mark.parametrize(
    ("ids", "edges", "weights", "message"),
    [
        ([1, 1], [], None, "ids: found 1 twice"),
        ([1, 2], [(1, 1)], None, "1 joined to itself"),
        ([1, 2], [(1, 3)], None, "found vehicle 3"),
        ([1, 2], [(1, 2)], [-1.0], "weights: found -1.0"),
        ([1, 2], [(1, 2)], [np.nan], "weights: found nan"),
        ([1, 2, 3], [(1, 2), (2, 3)], [1e308, 1e308], "weights: found 1e\\+308"),
        ([1, 2], [(1, 2), (1,)], None, "edges: found"),
        ([[1], [2, 3]], [], None, "ids: found"),
        ([1, 2], [(1, 2)], [1.0, 2.0], "weights: found shape"),
        ([1, 2], [(1, 2, 3)], None, "edges: found shape"),
        ([1.5, 2.0], [], None, "whole numbers"),
        ([[1], [2]], [], None, "ids: found shape"),
    ],
)
def test_bad_edges_are_refused(
    ids: list[int], edges: list[tuple[int, ...]], weights: list[float] | None, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        TrafficGraph.from_edges(ids, edges, weights)


@pytest.mark.parametrize(
    ("ids", "xy", "message"),
    [
        ([1, 1], [[0, 0], [1, 1]], "ids: found 1 twice"),
        ([1, 2], [[0, 0], [np.nan, 1]], "vehicle 2"),
        ([1, 2], [[0, np.inf], [0, 1]], "vehicle 1"),
        ([1, 2], [[0, 0]], "xy: found shape"),
        ([1], [["a", "b"]], "xy: found"),
        ([1], [[1j, 2.0]], "xy: found complex"),
        ([1, 2], [[1, 2], [3]], "xy: found"),
    ],
)
def test_bad_observations_are_refused(ids: list[int], xy: list[list[float]], message: str) -> None:
    with pytest.raises(InputError, match=message):
        TrafficGraph.empty().observe(ids, xy)


@pytest.mark.parametrize(
    "options",
    [
        {"neighbors": 0},
        {"reset": 0},
        {"radius_m": 0.0},
        {"scale_m": -1.0},
        {"kind": "sometimes"},
        {"radius_m": "near"},
        {"scale_m": np.ones(2)},
    ],
)
def test_bad_rules_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(InputError, match=next(iter(options))):
        TrafficGraph.empty(**options)  # type: ignore[arg-type]


def test_a_graph_made_from_edges_does_not_observe() -> None:
    with pytest.raises(InputError, match="empty"):
        TrafficGraph.from_edges([1], []).observe([1], [[0, 0]])


def test_positions_are_not_kept_by_reference() -> None:
    ids = np.arange(3)
    graph = TrafficGraph.empty().observe(ids, np.eye(3)[:, :2])
    ids[0] = 99
    assert graph.ids.tolist() == [0, 1, 2]
    xy = np.array([[0.0, 0.0], [1.0, 0.0], [9.0, 0.0]])
    seen = Sighting.of([0, 1, 2], xy)
    xy[1] = 100.0
    assert seen.nearest(1)[1].tolist() == [1, 0, 1]


def test_import_loads_nothing_heavy() -> None:
    code = (
        "import sys, graphrqi, graphrqi.graph, graphrqi.spectrum;"
        "print([m for m in ('numba', 'scipy', 'torch', 'sklearn') if m in sys.modules])"
    )
    done = run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_graph_shows_itself() -> None:
    graph = TrafficGraph.empty(neighbors=1)
    assert repr(graph) == "TrafficGraph(0 vehicles, 0 edges, accumulated over 0 observations)"
    xy = np.stack([np.arange(500.0), np.zeros(500)], axis=1)
    graph = graph.observe(np.arange(500), xy).observe(np.arange(500), xy)
    assert repr(graph).endswith("accumulated over 2 observations)")
    assert "500 vehicles with ids 0 to 499, 499 edges" in repr(graph)
    assert len(repr(graph)) < 400
    assert graph._repr_html_().count("<tr>") == 12  # a head, ten vehicles, how many more
