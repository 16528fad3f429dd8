"""The benchmark on real recordings: sheets, and small files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from openpyxl import Workbook
from sklearn.metrics import cohen_kappa_score

from behaviors.labelling import style_of
from behaviors.labels import Behavior, Trait
from experiments.benchmarks.real_data import measure, read_traf
from sim.formats import argo, traf
from sim.formats.argo import remove_ego_motion
from sim.formats.traf import labels, read_sheet, sheets_of


def write_sheet(path: Path, rows: list[list[object]]) -> Path:
    """A workbook with numbers, one row per list; None leaves a cell empty."""
    path.parent.mkdir(parents=True, exist_ok=True)
    book = Workbook()
    for row in rows:
        book.active.append(row)
    book.save(path)
    return path


def make_video(folder: Path, number: int, agents: int = 14, frames: int = 160) -> None:
    """Agents 0, 2, 4, ... are calm, the others fast and unsteady; the sheets say so."""
    rng = np.random.default_rng(number)
    y = rng.integers(100, 400, agents)
    x = rng.uniform(0, 200, agents)
    lines, rows = [], []
    for frame in range(1, frames + 1):
        fields = [frame, agents]
        for i in range(agents):
            wild = i % 2
            x[i] += 1.0 + wild * (0.8 + 0.8 * np.sin(frame / 9.0 + i))
            fields += [round(x[i] % 600), int(y[i]), 24, 18, i]
        lines.append(",".join(map(str, fields)))
    for i in range(agents):
        code = 101 if i % 2 else 1
        rows.append([i, 0, i % 2, 1, code])
    (folder / "tracks").mkdir(parents=True, exist_ok=True)
    (folder / "tracks" / f"TRAF53_{number}_gt.txt").write_text("\n".join(lines) + "\n")
    write_sheet(folder / "annotations" / f"c{number}.xlsx", rows)


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("recordings")
    for number in (1, 2, 3):
        make_video(folder / "traf", number)
    return folder


# --- sheets -------------------------------------------------------------------------------------


def test_sheet_without_header(tmp_path):
    path = write_sheet(
        tmp_path / "c8.xlsx",
        [
            [0, 6, 1, 1, 104, None, None, 104],
            [2],
            [3, 0, 0, 2, 1, 2],
            [4, 1, 1, 1, 3],
            [5, 1, 0, 0],
        ],
    )
    sheet = read_sheet(path)
    assert (sheet.annotator, sheet.video) == ("c", 8)
    assert sheet.traits == {
        0: (Trait.CUTTING_IN,),
        3: (Trait.UNIFORM_SPEED, Trait.FOLLOWING_RULES),
        4: (Trait.NOT_MOVING,),
    }


def test_labels_of_sheets(tmp_path):
    lines = []
    for frame in range(1, 30):
        boxes = [(10 + 2 * frame, 50, 20, 10, 1)]
        if not 10 < frame < 20:
            boxes.append((300 if frame >= 20 else 20, 200, 20, 10, 2))
        lines.append(f"{frame},{len(boxes)}," + ",".join(str(v) for box in boxes for v in box))
    path = tmp_path / "TRAF53_9_gt.txt"
    path.write_text("\n".join(lines) + "\n")
    calm = [[2, 0, 0, 1, 1], [8, 0, 0, 1, 1]]
    sheets = (
        read_sheet(write_sheet(tmp_path / "c9.xlsx", [[1, 0, 1, 1, 100], *calm])),
        read_sheet(write_sheet(tmp_path / "v9.xlsx", [[1, 0, 0, 1, 1], calm[0]])),
    )
    assert sheets_of(tmp_path, 9) == sheets
    tracks = next(iter(traf.read(path))).tracks
    assert labels(tracks, sheets, "lenient").tolist() == [-1, Behavior.CAREFUL.code]


# --- the bench ----------------------------------------------------------------------------------


def test_bench_finds_what_is_there(data):
    views = ("nine-numbers", "majority")
    rows = [row for part in measure(data, "behavior", 1, views, (2,)) for row in part]
    score = {(r["method"], r["metric"]): r["value"] for r in rows}
    assert score["nine-numbers", "balanced_accuracy"] > 0.9
    assert score["nine-numbers", "auc"] > 0.95
    assert score["majority", "balanced_accuracy"] == 0.5
    assert {r["protocol"] for r in rows} == {"leave-one-video-out"}
    assert {r["n"] for r in rows} == {42}


# --- ARGO ---------------------------------------------------------------------------------------


def test_ego_motion_is_undone(tmp_path):
    """Eight parked cars and one that drives, seen from a car that turns."""
    rng = np.random.default_rng(1)
    parked = rng.uniform(-40, 40, (8, 2))
    time_s = np.arange(40) / 10.0
    driving = np.stack([-20 + 6.0 * time_s, 3.0 + 0 * time_s], axis=1)
    world = np.concatenate([np.repeat(parked[:, None], 40, 1), driving[None]])
    angle = 0.4 * time_s
    turn = np.stack([np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)], 1).reshape(
        -1, 2, 2
    )
    ego = np.stack([8.0 * time_s, np.sin(time_s)], axis=1)
    seen = np.einsum("tij,ntj->nti", turn, world - ego) + 1500.0
    text = "frame,id,x,y\n" + "".join(
        f"{t},{i},{seen[i, t, 0]!r},{seen[i, t, 1]!r}\n" for t in range(40) for i in range(9)
    ).replace("np.float64(", "").replace(")", "")
    path = tmp_path / "argo1_tracks.csv"
    path.write_text(text)
    (tmp_path / "argo1_labels.csv").write_text("id,code\n0,3\n3,1\n8,5\n")
    (recording,) = argo.read(path)
    tracks = recording.tracks
    assert tracks.behavior.tolist() == [3, -1, -1, -1, -1, -1, -1, -1, 4]
    assert "1 agents are aggressive" in recording.notes[-1]
    assert remove_ego_motion(tracks).xy == pytest.approx(tracks.xy, abs=1e-6)
    moved = np.hypot(*(tracks.xy[:, -1] - tracks.xy[:, 0]).T)
    assert moved[:8].max() < 1e-6
    assert moved[8] == pytest.approx(6.0 * 3.9, abs=1e-6)
    assert tracks.speed[8, 20] == pytest.approx(6.0, abs=1e-6)


# --- the recordings themselves ------------------------------------------------------------------


def test_traf_labels_are_as_many_as_known(shared_data: Path):
    found = read_traf(shared_data / "traf", ("majority",), jobs=1)
    codes = np.concatenate([video.codes for video in found])
    assert np.bincount(codes, minlength=6).tolist() == [53, 13, 52, 266, 2, 6]
    strict = read_traf(shared_data / "traf", ("majority",), "strict", jobs=1)
    assert sum(video.codes.size for video in strict) < codes.size


def test_traf_annotators_agree_as_far_as_known(shared_data: Path):
    sheets = {s.annotator: s for s in sheets_of(shared_data / "traf" / "annotations", 8)}
    both = sorted(set(sheets["c"].traits) & set(sheets["u"].traits))
    kappa = cohen_kappa_score(
        [style_of(sheets["c"].traits[i]) for i in both],
        [style_of(sheets["u"].traits[i]) for i in both],
    )
    assert kappa == pytest.approx(0.33, abs=0.01)
