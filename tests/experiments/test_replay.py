"""What a replay gathers, packs and films."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from behaviors.labels import BEHAVIORS
from experiments.replay.page import write_page, write_replay
from experiments.replay.pictures import write_picture
from experiments.replay.scene import chosen_entry, gather, graph_history, read_beliefs
from experiments.score.tables import LABELS
from graphrqi.features.spectral import NEIGHBORS, RESET
from graphrqi.graph import TrafficGraph
from graphrqi.spectrum import SOLVERS
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeMeta
from sim.store.writing import new_dataset


@pytest.fixture(scope="module")
def scene(make_scene):
    return make_scene()


@pytest.fixture(scope="module")
def dataset(scene, tmp_path_factory):
    """The scene's tracks as a recording with and one without a road."""
    out = tmp_path_factory.mktemp("replay") / "data"
    named = dataclasses.replace(scene.tracks, names=tuple(f"v{i}" for i in scene.tracks.ids))
    with new_dataset(out, {}) as writer:
        for name, engine, road in (
            ("mapped", "argo", scene.road.source),
            ("pixels", "traf", None),
        ):
            meta = EpisodeMeta(scenario=name, engine=engine, options={"recording": name})
            writer.write_recording(meta, named, road)
    return out


def entry_of(dataset, name):
    return chosen_entry(open_dataset(dataset), name)


def labels_file(path, dataset, name):
    """A labels file that is sure of one behaviour more at each look."""
    entry = entry_of(dataset, name)
    tracks = open_dataset(dataset).read(entry).tracks
    rows = [
        {
            "agent": agent, "time_s": float(time_s), "behavior": "timid", "episode": entry.id,
            **{f"p_{b.value}": float(b is BEHAVIORS[5]) for b in BEHAVIORS},
        }
        for agent in tracks.ids[:3].tolist()
        for time_s in tracks.time_s[10:]
    ]  # fmt: skip
    pq.write_table(pa.Table.from_pylist(rows, schema=LABELS), path)
    return entry, tracks


def test_labels_are_read_where_they_speak_and_nowhere_else(dataset, tmp_path):
    entry, tracks = labels_file(tmp_path / "labels.parquet", dataset, "mapped")
    beliefs = read_beliefs(tmp_path / "labels.parquet", entry.id, tracks)
    known = np.isfinite(beliefs.probability).all(axis=2)
    assert known[:3, 2:].all()
    assert not known[3:].any()
    assert not known[:, :2].any()
    assert beliefs.at(5.0).most_likely.tolist() == [5, 5, 5]


def test_the_graph_is_the_papers(scene):
    watched = graph_history(scene.tracks)
    look = 7
    graph = TrafficGraph.empty(neighbors=NEIGHBORS, reset=RESET, kind="accumulated")
    for step in range(int(np.searchsorted(scene.tracks.time_s, watched.time_s[look])) + 1):
        rows = np.flatnonzero(scene.tracks.valid[:, step])
        graph = graph.observe(scene.tracks.ids[rows], scene.tracks.xy[rows, step])
    live = watched.edges[(watched.edges[:, 2] <= look) & (watched.edges[:, 3] > look), :2]
    expected = np.searchsorted(scene.tracks.ids, graph.edges)
    assert {frozenset(e) for e in live.tolist()} == {frozenset(e) for e in expected.tolist()}
    spectrum = SOLVERS["eigh"](graph, num_pairs=1, end="largest")
    w = np.abs(np.asarray(graph.laplacian @ spectrum.eigenvectors[:, 0]))
    assert watched.w[np.searchsorted(scene.tracks.ids, graph.ids), look] == pytest.approx(
        w, abs=1e-5
    )


def test_data_on_the_page_cannot_end_its_script(scene, tmp_path):
    write_page(scene, tmp_path / "page.html", "true")
    page = (tmp_path / "page.html").read_text()
    assert page.count("</script>") == 2
    assert "<img" not in page
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    assert json.loads(data.group(1))["agents"][0]["name"] == scene.tracks.names[0]
    assert not re.search(r"(src|href)\s*=\s*[\"']?(https?:)?//", page)


def test_recordings_without_a_road_say_so_and_pixels_stay_pixels(dataset, tmp_path):
    labels_file(tmp_path / "labels.parquet", dataset, "pixels")
    opened = open_dataset(dataset)
    scene = gather(
        opened, entry_of(dataset, "pixels"), model="none", labels=tmp_path / "labels.parquet",
        predictor="constant-velocity",
    )  # fmt: skip
    assert scene.unit == "px"
    assert scene.entry.name == "pixels"
    assert scene.futures is not None
    said = " ".join(scene.notes)
    assert "no road is known" in said
    assert "pixels" in said
    write_page(scene, tmp_path / "page.html", "predicted")
    assert '"road":null' in (tmp_path / "page.html").read_text()


def test_an_mp4_plays_for_as_long_as_it_should(scene, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    write_picture(scene, tmp_path / "v.mp4", "predicted", 4.0, 5.0)
    frames, seconds = ffmpeg.count_frames_and_secs(str(tmp_path / "v.mp4"))
    assert frames == 11
    assert seconds == pytest.approx(1.1, abs=0.1)


def test_the_command_writes_page_and_film(dataset, tmp_path):
    labels_file(tmp_path / "labels.parquet", dataset, "mapped")
    written = write_replay(
        dataset, tmp_path / "r.html", episode="mapped", labels=tmp_path / "labels.parquet",
        predictor="constant-velocity", picture=tmp_path / "v.gif", begin_s=4.0, end_s=4.5,
        quiet=True,
    )  # fmt: skip
    assert [path.name for path in written] == ["r.html", "v.gif"]
    assert all(path.stat().st_size > 5000 for path in written)
