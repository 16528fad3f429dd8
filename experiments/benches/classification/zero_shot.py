"""TRAF without a TRAF label: how well a model that was trained elsewhere ranks drivers of a video.

The score is the area under the ROC curve of the style over pairs of drivers of the same video, so
that offsets of a video do not count. Beside it stand a classifier that is trained on the labels of
the other videos, and a mean of ranks that needs no training at all.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS
from experiments.benches.classification.recorded import last_beliefs, log_odds
from experiments.benches.classification.rows import keys_of
from experiments.benches.real_data import Video, evaluate_traf, read_video
from experiments.benches.statistics import auc_within
from experiments.data.parallel import in_parallel
from experiments.score.rows import Cell, Row, tidy_row
from graphrqi.features.unit_free import NAMES
from graphrqi.model_files import load_model
from graphrqi.posterior import AGGRESSIVE, aggressive_share
from graphrqi.units import image_scale, in_metres
from sim.formats import traf, traf_sheets

FloatArray = NDArray[np.float64]

PROTOCOL: Final = "zero-shot"

TRAINED: Final = "unit-free"
"""View of `experiments.benches.real_data` that is trained on the other videos."""

RANKS: Final = {
    "speed over neighbours": 1.0, "top speed over neighbours": 1.0, "speed rank": 1.0,
    "acceleration": 1.0, "across flow": 1.0, "passed": 1.0, "was passed": -1.0, "nearest": -1.0,
}  # fmt: skip
"""Columns of the unit-free features whose ranks are averaged, and their signs, as the traits name
them: overtaking, over-speeding, weaving, driving close (before any label was seen)."""


@dataclass(frozen=True, slots=True)
class Answered:
    """A video with what a model of elsewhere believes.

    Attributes:
        video: labels and unit-free features of the labelled agents.
        belief: (n, 6) about them when they were last seen; NaN without an answer.
    """

    video: Video
    belief: FloatArray


def answered_video(path: Path, annotations: Path, model: str) -> Answered | None:
    """Follow one video with a stream; None if nobody annotated it.

    Args:
        path: track file.
        annotations: folder of the sheets.
        model: a shipped model's name or a folder.
    """
    video = read_video(path, annotations, (TRAINED,))
    if video is None:
        return None
    tracks = next(iter(traf.read(path))).tracks
    beliefs, _ = last_beliefs(in_metres(tracks, image_scale(tracks)), load_model(model))
    sheets = traf_sheets.sheets_of(annotations, traf_sheets.video_number(path) or 0)
    codes = traf_sheets.labels(tracks, sheets, "lenient")
    return Answered(video, beliefs[codes >= 0])


def mean_rank(features: FloatArray) -> FloatArray:
    """(n,) mean of the ranks of ``RANKS`` among agents with unit-free features (n, F)."""
    from scipy.stats import rankdata

    columns = [sign * features[:, NAMES.index(name)] for name, sign in RANKS.items()]
    return np.asarray(np.mean([rankdata(column) for column in columns], axis=0))


def _auc_rows(
    scores: Sequence[tuple[str, FloatArray, NDArray[np.bool_]]], method: str
) -> list[Row]:
    """One row for each video, and the mean over videos."""
    values, rows = [], []
    for name, score, aggressive in scores:
        value = auc_within(score, aggressive, np.zeros(score.size, dtype=np.int64))
        values.append(value)
        keys = keys_of(PROTOCOL, name, method, None)
        rows.append(tidy_row(keys, "auc", *value, score.size))
    return [*rows, mean_row(values, method, sum(score.size for _, score, _ in scores))]


def mean_row(values: Sequence[tuple[float, float, float]], method: str, n: int) -> Row:
    """The mean over videos, with the interval that those of the videos make."""
    known = np.array([value for value in values if np.isfinite(value[0])])
    keys = keys_of(PROTOCOL, "all", method, None, "mean over videos")
    if not known.size:
        return tidy_row(keys, "auc", None, None, None, n)
    half = np.sqrt((((known[:, 2] - known[:, 1]) / 2) ** 2).sum()) / len(known)
    mean = known[:, 0].mean()
    return tidy_row(keys, "auc", mean, mean - half, mean + half, n)


def zero_shot_rows(
    folder: Path,
    model: str,
    jobs: int | None = None,
    most: int | None = None,
    say: Callable[[str], None] = lambda said: print(said, file=sys.stderr),
) -> list[Row]:
    """Score a model on videos whose labels it never saw.

    Args:
        folder: with ``tracks`` and ``annotations``, or with a folder ``traf`` that has them.
        model: a shipped model's name or a folder.
        jobs: processes; None for one per core.
        most: videos; None for all.
        say: takes a line about what is left out.

    Returns:
        Rows of the area under the ROC curve for each video and for all, of the model, of a
        classifier that was trained on the other videos, and of the mean rank; and how aggressive
        the model takes everyone for, on average.
    """
    load_model(model)  # refuses an unknown name before anything is read
    inside = folder if (folder / "tracks").is_dir() else folder / "traf"
    paths = sorted((inside / "tracks").glob("*_gt.txt"))
    paths = [
        p
        for p in paths
        if traf_sheets.sheets_of(inside / "annotations", traf_sheets.video_number(p) or 0)
    ]
    arguments = [(path, inside / "annotations", model) for path in paths[:most]]
    parts = in_parallel(answered_video, arguments, jobs) if arguments else ()
    answered = [part for part in parts if part is not None]
    if not answered:
        say(f"{PROTOCOL} skipped: found no annotated video in {inside}")
        return []
    name = Path(model).name
    truth = [AGGRESSIVE[a.video.codes] for a in answered]
    beliefs = [np.where(np.isfinite(a.belief), a.belief, 1.0 / len(BEHAVIORS)) for a in answered]
    rows = _auc_rows(
        [(a.video.name, log_odds(b), t) for a, b, t in zip(answered, beliefs, truth, strict=True)],
        name,
    )
    every = np.concatenate([aggressive_share(b) for b in beliefs])
    keys = keys_of(PROTOCOL, "all", name, None)
    rows.append(tidy_row(keys, "mean_p_aggressive", float(every.mean()), None, None, every.size))
    rows += _auc_rows(
        [
            (a.video.name, mean_rank(a.video.features[TRAINED]), t)
            for a, t in zip(answered, truth, strict=True)
        ],
        "mean of ranks",
    )
    if len(answered) > 1:
        rows += _trained_rows([a.video for a in answered], jobs)
    return rows


def _trained_rows(videos: Sequence[Video], jobs: int | None) -> list[Row]:
    """The same of a classifier that is trained on the other videos' labels."""
    found = evaluate_traf(videos, views=(TRAINED,), tasks=(2,), jobs=jobs)
    folds = [row for row in found if row["metric"] == "auc" and row["fold"] != "all"]
    method = f"{TRAINED}, trained on the other videos"
    values = [(_number(row["value"]), _number(row["low"]), _number(row["high"])) for row in folds]
    sizes = [int(str(row["n"])) for row in folds]
    rows = [
        tidy_row(keys_of(PROTOCOL, str(row["fold"]), method, None), "auc", *value, n)
        for row, value, n in zip(folds, values, sizes, strict=True)
    ]
    return [*rows, mean_row(values, method, sum(sizes))]


def _number(cell: Cell) -> float:
    return float("nan") if cell is None else float(cell)
