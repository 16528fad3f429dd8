"""The labelled recordings of real traffic: every choice made inside the training videos.

TRAF is scored leaving one video out. Labels come from the annotators' traits, conflicts resolved
the ``lenient`` way. For each held-out video the learner is chosen by leaving one of the *other*
videos out, over the `SETTINGS`. Features are standardised within each video, so neither pixels nor
cameras are compared.

Balanced accuracy and macro-F1 are of answers at even odds; weighted accuracy is of the most likely
class, for which it is meant. The AUC compares agents of the same video only. Intervals are by
bootstrap over agents: five videos are too few to resample.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from behaviors.errors import InputError, lookup
from behaviors.labelling import Resolution
from behaviors.labels import BEHAVIORS, Style
from experiments.benchmarks import recorded_beliefs, recorded_prediction
from experiments.data.parallel import in_parallel
from experiments.rival import nine_numbers
from experiments.score.metrics import (
    auc_over_episodes,
    balanced_accuracy,
    bootstrap,
    confusion,
    macro_f1,
    weighted_accuracy,
)
from experiments.score.rows import Cell, Row, tidy_row
from graphrqi.classify import CLASSIFIERS
from graphrqi.features.observer import Observer
from graphrqi.methods import METHODS
from sim.formats import traf
from sim.formats.common.recording import CAR_LENGTH_M
from sim.frames import CodeArray, FloatArray, IntArray, Tracks

SETTINGS: Final[tuple[tuple[str, float], ...]] = (
    ("logistic", 0.001), ("logistic", 0.01), ("logistic", 0.1), ("forest", 8), ("forest", 15),
)  # fmt: skip
"""The learners among which the training videos choose: logistic regression by one over its penalty,
and a forest of 100 trees by its smallest leaf."""

TASKS: Final[dict[int, tuple[int, ...]]] = {
    2: tuple(0 if b.style is Style.AGGRESSIVE else 1 for b in BEHAVIORS),
    6: tuple(range(len(BEHAVIORS))),
}
"""Classes of each task, by number of classes: the style, or all."""

EVERY_FRAMES, LOOK_STEPS = 3, 5
"""Frames of video per step of an observer (8 steps a second), and steps between looks at what it
has gathered."""


class Video(NamedTuple):
    """(n,) codes of a video's labelled agents, and (n, F) features of each view.

    They are standardised over all agents of the video.
    """

    codes: CodeArray
    features: Mapping[str, FloatArray]


def _identity(tracks: Tracks) -> FloatArray:
    """Number, first and last time: which must not help to say how someone drives."""
    last = tracks.time_s.size - 1 - tracks.valid[:, ::-1].argmax(axis=1)
    return np.stack([tracks.ids, tracks.valid.argmax(axis=1), last], axis=1).astype(np.float64)


def _observed(make: Callable[[str], Observer], tracks: Tracks) -> FloatArray:
    """What an observer, which expects metres, knows of each agent when it is last looked at."""
    observer, scale = make("graphrqi"), _metres_per_pixel(tracks)
    out = np.zeros((tracks.ids.size, len(observer.feature_names)))
    for step, t in enumerate(range(0, tracks.time_s.size, EVERY_FRAMES)):
        rows = np.flatnonzero(tracks.valid[:, t])
        drives = np.ones(rows.size, dtype=bool)
        observer.update(tracks.time_s[t], tracks.ids[rows], tracks.xy[rows, t] * scale, drives)
        if step % LOOK_STEPS == LOOK_STEPS - 1:
            seen = observer.observation()
            at = np.searchsorted(tracks.ids, seen.ids)
            out[at] = observer.features(seen.seconds, seen.sums, seen.instant)
    return out


def _nine(tracks: Tracks) -> FloatArray:
    """The plain rival's numbers (`experiments.rival`), 0 where not known."""
    scale = _metres_per_pixel(tracks)
    scaled = {name: getattr(tracks, name) * scale for name in ("xy", "length", "width")}
    return np.nan_to_num(nine_numbers(tracks.with_dense(**scaled), None))


def _metres_per_pixel(tracks: Tracks) -> float:
    """With this scale, an agent of median size is as long as a car."""
    return CAR_LENGTH_M / float(np.median(np.sqrt(tracks.length * tracks.width)))


VIEWS: Final[dict[str, Callable[[Tracks], FloatArray]]] = {
    "majority": lambda tracks: np.zeros((tracks.ids.size, 1)),
    "leak-probe": _identity,
    **{
        name: partial(_observed, METHODS[name].observer)
        for name in ("graphrqi", "graphrqi-invariant", "dane", "cheung", "graphrqi-plus")
    },
    "nine-numbers": _nine,
}
"""Features by name of the method whose they are."""


def _read_video(
    path: Path, annotations: Path, views: Sequence[str], rule: Resolution = "lenient"
) -> Video | None:
    """Read one video with its labels."""
    number = traf.video_number(path)
    sheets = () if number is None else traf.sheets_of(annotations, number)
    if not sheets:
        return None
    tracks = next(iter(traf.read(path))).tracks
    codes = traf.labels(tracks, sheets, rule)
    features = {}
    for name in views:
        table = pd.DataFrame(lookup(VIEWS, name, "view")(tracks))
        scaled = (table - table.mean()) / (table.std(ddof=0) + 1e-9)
        features[name] = scaled.clip(-4.0, 4.0).fillna(0.0).to_numpy(np.float64)[codes >= 0]
    return Video(codes[codes >= 0], features)


def read_traf(
    folder: Path, views: Sequence[str], rule: Resolution = "lenient", jobs: int | None = None
) -> list[Video]:
    """Read every annotated video in a folder with ``tracks`` and ``annotations``."""
    paths = sorted((folder / "tracks").glob("*_gt.txt"))
    arguments = [(path, folder / "annotations", tuple(views), rule) for path in paths]
    return [video for video in in_parallel(_read_video, arguments, jobs) if video is not None]


def _posterior(
    setting: int, training: Sequence[Video], held: Video, view: str, task: int
) -> FloatArray:
    """(n, C) posteriors of a held-out video."""
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    classes = np.array(TASKS[task], dtype=np.int8)
    features = np.concatenate([v.features[view] for v in training])
    codes = classes[np.concatenate([v.codes for v in training])]
    if view == "majority" or np.unique(codes).size < 2:
        share = np.bincount(codes, minlength=task) / codes.size
        return np.tile(share, (held.codes.size, 1))
    name, option = SETTINGS[setting]
    if name == "forest":
        forest = CLASSIFIERS[name](task, trees=100, min_leaf=int(option))
        forest.fit(features, codes, None, seed=0)
        return forest.posterior(held.features[view])
    learner = make_pipeline(StandardScaler(), LogisticRegression(C=option, max_iter=1000))
    learner.fit(features, codes)
    posterior = np.zeros((held.codes.size, task))
    posterior[:, learner.classes_] = learner.predict_proba(held.features[view])
    return posterior


def _left_out(
    videos: Sequence[Video], view: str, task: int, setting: int | None
) -> tuple[NDArray[Any], ...]:
    """Answers about each video by the others, with a setting or that which these choose.

    (n,) true classes, (n, C) posteriors, the same at even odds, (n,) majority classes and videos.
    """
    classes, folds = np.array(TASKS[task], dtype=np.int8), []
    for number, video in enumerate(videos):
        training = [other for other in videos if other is not video]
        used = _chosen(training, view, task) if setting is None else setting
        probability = _posterior(used, training, video, view, task)
        known = classes[np.concatenate([v.codes for v in training])]
        shares = np.maximum(np.bincount(known, minlength=task), 0.5) / known.size
        even = probability if view == "majority" else probability / shares
        n = video.codes.size
        majority = np.full(n, shares.argmax(), dtype=np.int64)
        folds.append((classes[video.codes], probability, even, majority, np.full(n, number)))
    return tuple(np.concatenate(column) for column in zip(*folds, strict=True))


def _chosen(training: Sequence[Video], view: str, task: int) -> int:
    """The setting that does best inside the training videos (the first when there is one video)."""
    if view == "majority" or len(training) < 2:
        return 0
    merits = []
    for setting in range(len(SETTINGS)):
        truth, probability, even, _, video = _left_out(training, view, task, setting)
        if task == 2:
            merits.append(_auc_within(probability[:, 0], truth == 0, video)[0])
        else:
            counts = confusion(truth, even.argmax(axis=1), video, task)
            merits.append(float(macro_f1(counts.sum(axis=0))))
    return int(np.nanargmax(merits)) if not np.isnan(merits).all() else 0


def _scored(videos: Sequence[Video], view: str, task: int) -> list[Row]:
    """Rows of one view on one task, over all videos, each left out in turn."""
    truth, probability, even, majority, video = _left_out(videos, view, task, None)
    counts = [
        confusion(truth, answer, np.arange(truth.size), task)
        for answer in (even.argmax(axis=1), probability.argmax(axis=1), majority)
    ]
    values = {
        "macro_f1": bootstrap(macro_f1, counts[0]),
        "balanced_accuracy": bootstrap(balanced_accuracy, counts[0]),
        "weighted_accuracy": bootstrap(weighted_accuracy, counts[1]),
        "majority_weighted_accuracy": bootstrap(weighted_accuracy, counts[2]),
    }
    if task == 2:
        values["auc"] = _auc_within(probability[:, 0], truth == 0, video)
    keys: dict[str, Cell] = {
        "dataset": "traf", "protocol": "leave-one-video-out", "method": view, "classes": task,
    }  # fmt: skip
    return [tidy_row(keys, name, *value, int(truth.size)) for name, value in values.items()]


def _auc_within(
    score: FloatArray, positive: NDArray[np.bool_], group: IntArray
) -> tuple[float, float, float]:
    """Area under the ROC curve over pairs (n,) of the same group, and its interval over agents."""
    return auc_over_episodes(score, positive, np.arange(score.size), group)


def measure(
    data: Path, task: str = "behavior", jobs: int | None = None,
    views: Sequence[str] = tuple(VIEWS), classes: Sequence[int] = tuple(TASKS), epochs: int = 4,
    simulate: bool = True,
) -> Iterator[list[Row]]:  # fmt: skip
    """Rows of the recordings in a folder.

    The task is "behavior" (every view, a key of `VIEWS`, and number of classes, on the labelled
    ones in its ``traf``), or another bench of recordings: "classification" or "prediction".
    """
    parts: dict[str, Callable[[], Iterator[list[Row]]]] = {
        "behavior": lambda: _behaviors(data / "traf", views, classes, jobs),
        "classification": lambda: recorded_beliefs.measure(data, jobs=jobs),
        "prediction": lambda: recorded_prediction.measure(data, epochs, simulate=simulate),
    }
    return lookup(parts, task, "task")()


def _behaviors(
    folder: Path, views: Sequence[str], classes: Sequence[int], jobs: int | None
) -> Iterator[list[Row]]:
    videos = read_traf(folder, views, jobs=jobs)
    if len(videos) < 2:
        raise InputError(
            f"{folder}/tracks: found {len(videos)} annotated videos, expected two or more"
        )
    arguments = [(videos, view, each) for view in views for each in classes]
    yield from in_parallel(_scored, arguments, jobs)
