"""The labelled recordings of real traffic: every choice made inside the training videos.

TRAF is scored leaving one video out. Labels come from the annotators' traits, conflicts resolved
the ``lenient`` way. For each held-out video the learner is chosen by leaving one of the *other*
videos out, over the `SETTINGS`; the held-out labels take no part in anything. Features are
standardised within each video (its labels are not needed for that), so neither pixels nor cameras
are compared.

Balanced accuracy, macro-F1 and the recalls are of answers at even odds (posterior over the shares
of the training classes); weighted accuracy is of the most likely class, for which it is meant. The
AUC compares agents of the same video only. Intervals are by bootstrap over agents: five videos are
too few to resample.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError, lookup
from behaviors.labelling import Resolution
from behaviors.labels import BEHAVIORS, Style
from experiments.benches.contract import Bench, option
from experiments.benches.prediction.knowledge import measure_knowledge
from experiments.benches.prediction.recordings import measure_recordings
from experiments.data.parallel import in_parallel
from experiments.report.worst_cases import Case, worst_cases_page, worst_of
from experiments.rows import Cell, Row, tidy_row
from experiments.scoring.metrics import (
    auc_within,
    balanced_accuracy,
    bootstrap,
    calibration_error,
    confusion,
    macro_f1,
    recall_of,
    reliability,
    weighted_accuracy,
)
from graphrqi.classify import make_classifier
from graphrqi.features.observer import Observer
from graphrqi.features.unit_free import standardised, unit_free_features
from graphrqi.methods import METHODS
from sim.formats import traf, traf_sheets
from sim.formats.common.recording import CAR_LENGTH_M
from sim.frames import Tracks
from sim.store.atomic import write_whole

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
CodeArray = NDArray[np.int8]

DATA_VARIABLE: Final = "GRAPHRQI_DATA"
"""Environment variable with the folder of the recordings."""

SETTINGS: Final[tuple[tuple[str, Mapping[str, Any]], ...]] = (
    ("logistic", {"inverse_penalty": 0.001}),
    ("logistic", {"inverse_penalty": 0.01}),
    ("logistic", {"inverse_penalty": 0.1}),
    ("forest", {"trees": 100, "min_leaf": 8}),
    ("forest", {"trees": 100, "min_leaf": 15}),
)
"""The learners among which the training videos choose."""

TASKS: Final[dict[int, tuple[int, ...]]] = {
    2: tuple(0 if b.style is Style.AGGRESSIVE else 1 for b in BEHAVIORS),
    4: tuple(i if b.style is Style.AGGRESSIVE else 3 for i, b in enumerate(BEHAVIORS)),
    6: tuple(range(len(BEHAVIORS))),
}
"""Classes of each task, by number of classes: the style; the aggressive ones and the rest; all."""

EVERY_FRAMES: Final = 3
"""Frames of video per step of an observer (8 steps a second)."""

MOST_CASES: Final = 1000
"""Most cases that are kept; when there are more, all but the worst of each family are dropped."""

LOOK_STEPS: Final = 5
"""Steps between looks at what an observer has gathered."""


@dataclass(frozen=True, slots=True)
class Video:
    """One annotated video.

    Attributes:
        name: of the video.
        codes: (n,) resolved labels of the labelled agents, codes into ``BEHAVIORS``.
        features: (n, F) of each view, standardised over all agents of the video.
    """

    name: str
    codes: CodeArray
    features: Mapping[str, FloatArray]


# --- views: what a method sees of a track's whole life -------------------------------------------


def _unit_free(tracks: Tracks) -> FloatArray:
    return unit_free_features(tracks.xy, np.stack([tracks.length, tracks.width], axis=1))


def _identity(tracks: Tracks) -> FloatArray:
    """Number, first and last time: what must tell nothing about how someone drives."""
    first = tracks.valid.argmax(axis=1)
    last = tracks.time_s.size - 1 - tracks.valid[:, ::-1].argmax(axis=1)
    return np.stack([tracks.ids, first, last], axis=1).astype(np.float64)


def _nothing(tracks: Tracks) -> FloatArray:
    return np.zeros((tracks.ids.size, 1))


def _observed(make: Callable[[str], Observer], tracks: Tracks) -> FloatArray:
    """What an observer knows of each agent when it is last looked at.

    Pixels are scaled so that an agent of median size is as long as a car: observers expect metres.
    """
    observer = make("graphrqi")
    scale = CAR_LENGTH_M / float(np.median(np.sqrt(tracks.length * tracks.width)))
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


_OBSERVED: Final = ("graphrqi", "graphrqi-invariant", "dane", "cheung", "graphrqi-plus")

VIEWS: Final[dict[str, Callable[[Tracks], FloatArray]]] = {
    "majority": _nothing,
    "leak-probe": _identity,
    **{name: partial(_observed, METHODS[name].observer) for name in _OBSERVED},
    "unit-free": _unit_free,
}
"""Features by name of the method whose they are; ``unit-free`` are made for such recordings."""


# --- reading ------------------------------------------------------------------------------------


def read_video(
    path: Path, annotations: Path, views: Sequence[str], rule: Resolution = "lenient"
) -> Video | None:
    """Read one video with its labels.

    Args:
        path: track file.
        annotations: folder of the sheets.
        views: keys of ``VIEWS``.
        rule: how annotators' conflicts are resolved.

    Returns:
        The video, or None if nobody annotated it.
    """
    number = traf_sheets.video_number(path)
    sheets = () if number is None else traf_sheets.sheets_of(annotations, number)
    if not sheets:
        return None
    tracks = next(iter(traf.read(path))).tracks
    codes = traf_sheets.labels(tracks, sheets, rule)
    known = codes >= 0
    features = {name: standardised(lookup(VIEWS, name, "view")(tracks))[known] for name in views}
    name = path.stem.removesuffix("_gt")
    return Video(name, codes[known], features)


def read_traf(
    folder: Path, views: Sequence[str], rule: Resolution = "lenient", jobs: int | None = None
) -> list[Video]:
    """Read every annotated video in a folder with ``tracks`` and ``annotations``.

    Args:
        folder: of the TRAF release.
        views: keys of ``VIEWS``.
        rule: how annotators' conflicts are resolved.
        jobs: processes; None for one per core.

    Returns:
        The videos by name.
    """
    paths = sorted((folder / "tracks").glob("*_gt.txt"))
    arguments = [(path, folder / "annotations", tuple(views), rule) for path in paths]
    if not arguments:
        return []
    return [video for video in in_parallel(read_video, arguments, jobs) if video is not None]


# --- learning and scoring -----------------------------------------------------------------------


def _posterior(
    setting: int, training: Sequence[Video], held: Video, view: str, task: int
) -> FloatArray:
    """(n, C) posteriors of a held-out video."""
    classes = np.array(TASKS[task], dtype=np.int8)
    features = np.concatenate([v.features[view] for v in training])
    codes = classes[np.concatenate([v.codes for v in training])]
    if view == "majority" or np.unique(codes).size < 2:
        learner = make_classifier("majority", task)
    else:
        name, options = SETTINGS[setting]
        learner = make_classifier(name, task, **options)
    learner.fit(features, codes, None, seed=0)
    return learner.posterior(held.features[view])


def _shares(videos: Sequence[Video], task: int) -> FloatArray:
    codes = np.array(TASKS[task])[np.concatenate([v.codes for v in videos])]
    return np.asarray(np.maximum(np.bincount(codes, minlength=task), 0.5) / codes.size)


def _figure_of_merit(setting: int, training: Sequence[Video], view: str, task: int) -> float:
    """How well a setting does, leaving each training video out in turn: AUC, or macro-F1."""
    probability, truth, group = [], [], []
    for number, video in enumerate(training):
        others = [v for v in training if v is not video]
        found = _posterior(setting, others, video, view, task)
        probability.append(found if task == 2 else found / _shares(others, task))
        truth.append(np.array(TASKS[task], dtype=np.int8)[video.codes])
        group.append(np.full(video.codes.size, number))
    p, y, g = np.concatenate(probability), np.concatenate(truth), np.concatenate(group)
    if task == 2:
        return auc_within(p[:, 0], y == 0, g)[0]
    return float(macro_f1(confusion(y, p.argmax(axis=1), g, task).sum(axis=0)))


def choose(training: Sequence[Video], view: str, task: int) -> int:
    """The setting that does best inside the training videos (the first when there is one video)."""
    if view == "majority" or len(training) < 2:
        return 0
    merits = [_figure_of_merit(s, training, view, task) for s in range(len(SETTINGS))]
    return int(np.nanargmax(merits)) if not np.isnan(merits).all() else 0


@dataclass(frozen=True, slots=True)
class _Answers:
    """Of one method on some agents."""

    truth: CodeArray
    probability: FloatArray
    even: FloatArray
    majority: CodeArray
    group: IntArray


def _answers(
    videos: Sequence[Video], held: Sequence[str], view: str, task: int, together: bool
) -> list[_Answers]:
    """Answers on each held-out video."""
    out = []
    for number, name in enumerate(held):
        video = next(v for v in videos if v.name == name)
        left_out = held if together else [name]
        training = [v for v in videos if v.name not in left_out]
        setting = choose(training, view, task)
        probability = _posterior(setting, training, video, view, task)
        shares = _shares(training, task)
        n = video.codes.size
        out.append(
            _Answers(
                np.array(TASKS[task], dtype=np.int8)[video.codes],
                probability,
                probability if view == "majority" else probability / shares,
                np.full(n, shares.argmax(), dtype=np.int8),
                np.full(n, number),
            )
        )
    return out


def _join(parts: Sequence[_Answers]) -> _Answers:
    return _Answers(
        *(np.concatenate([getattr(p, name) for p in parts]) for name in _Answers.__slots__)
    )


def _rows(found: _Answers, task: int, keys: Mapping[str, Cell]) -> list[Row]:
    agent = np.arange(found.truth.size)
    even = confusion(found.truth, found.even.argmax(axis=1), agent, task)
    likely = confusion(found.truth, found.probability.argmax(axis=1), agent, task)
    constant = confusion(found.truth, found.majority.astype(np.int64), agent, task)
    bins = reliability(found.truth, found.probability, agent)
    values = {
        "macro_f1": bootstrap(macro_f1, even),
        "balanced_accuracy": bootstrap(balanced_accuracy, even),
        "weighted_accuracy": bootstrap(weighted_accuracy, likely),
        "majority_weighted_accuracy": bootstrap(weighted_accuracy, constant),
        "ece": bootstrap(calibration_error, bins),
    }
    names = {2: ("aggressive", "conservative")}.get(
        task, (*(b.value for b in BEHAVIORS[:3]), "conservative")
    )
    if task == len(BEHAVIORS):
        names = tuple(b.value for b in BEHAVIORS)
    for code, name in enumerate(names):
        if (found.truth == code).any():
            values[f"recall_{name}"] = bootstrap(recall_of(code), even)
    if task == 2:
        values["auc"] = auc_within(found.probability[:, 0], found.truth == 0, found.group)

    n = int(found.truth.size)
    return [
        tidy_row(keys, metric, *value, n)
        for metric, value in values.items()
        if not np.isnan(value[0])
    ]


PUBLISHED: Final[dict[tuple[str, str], float]] = {("graphrqi", "weighted_accuracy"): 0.783}
"""What the paper reports on TRAF, by method and metric (six classes)."""


def evaluate_traf(
    videos: Sequence[Video],
    test_videos: Sequence[str] = (),
    views: Sequence[str] = tuple(VIEWS),
    tasks: Sequence[int] = tuple(TASKS),
    jobs: int | None = 1,
) -> list[Row]:
    """Score every view on every task.

    Args:
        videos: all annotated ones, at least two.
        test_videos: names of videos never trained on; empty leaves each one out in turn.
        views: keys of ``VIEWS``.
        tasks: keys of ``TASKS``.
        jobs: processes; None for one per core.

    Returns:
        Flat rows, fold by fold and for all folds pooled.

    Raises:
        InputError: if a test video is not there or nothing is left to train on.
    """
    by_name = {video.name: video for video in videos}
    held = [lookup(by_name, name, "video") for name in test_videos] or list(videos)
    if len(videos) - (len(held) if test_videos else 1) < 1:
        raise InputError(f"videos: found {len(videos)}, expected some to train on beside the tests")
    arguments = [(videos, held, view, task, bool(test_videos)) for view in views for task in tasks]
    return [row for rows in in_parallel(_score, arguments, jobs) for row in rows]


def _score(
    videos: Sequence[Video], held: Sequence[Video], view: str, task: int, together: bool
) -> list[Row]:
    """Rows of one view on one task."""
    parts = _answers(videos, [v.name for v in held], view, task, together)
    keys: dict[str, Cell] = {
        "dataset": "traf",
        "protocol": "held-out-videos" if together else "leave-one-video-out",
        "method": view,
        "classes": task,
    }
    rows: list[Row] = []
    for video, part in zip(held, parts, strict=True):
        rows += _rows(part, task, {**keys, "fold": video.name})
    rows += _rows(_join(parts), task, {**keys, "fold": "all"})
    published = PUBLISHED.get((view, "weighted_accuracy"))
    if task == len(BEHAVIORS) and published is not None and not together:
        keys["fold"] = "all"
        rows.append(tidy_row(keys, "published_weighted_accuracy", published, None, None, None))
    return rows


@dataclass(frozen=True, slots=True)
class Settings:
    """Which recordings are scored, and how.

    Attributes:
        data: folder with ``traf``, or for prediction of datasets; None for ``GRAPHRQI_DATA``.
        task: ``behavior``, ``prediction``, or ``knowledge``: whether knowing the driver improves a
            prediction.
        leave_out: for prediction, what is left out of the training in turn: each ``dataset``,
            each ``place``, or ``nothing``.
        epochs: for prediction, of each training.
        seed: for prediction, of trainings and noise.
        worst: for prediction, a page of the worst cases of each family that is written at the end.
        test_videos: names of videos never trained on; () leaves each one out in turn.
        views: keys of ``VIEWS``.
        tasks: keys of ``TASKS``.
        jobs: processes; None for one per core.
    """

    data: Path | None = option(None, "Folder of recordings [default: GRAPHRQI_DATA].")
    task: str = option(
        "behavior",
        "behavior; prediction: where vehicles go; knowledge: does knowing drivers improve it.",
    )
    leave_out: str = option("dataset", "For prediction: dataset, place or nothing.")
    epochs: int = option(4, "For prediction: of each training.")
    seed: int = 0
    worst: Path | None = option(None, "For prediction: page of the worst cases.", "FILE.html")
    test_videos: tuple[str, ...] = option((), "Videos that are only tested on.")
    views: tuple[str, ...] = tuple(VIEWS)
    tasks: tuple[int, ...] = tuple(TASKS)
    jobs: int | None = None


def measure(settings: Settings) -> Iterator[list[Row]]:
    """Score methods on the labelled recordings.

    Yields:
        All rows; nothing, and a line on stderr, where there is no data.
    """
    data = settings.data
    if data is None and os.environ.get(DATA_VARIABLE):
        data = Path(os.environ[DATA_VARIABLE])
    if settings.task in ("prediction", "knowledge"):
        if data is None:
            sys.stderr.write(f"real-data: skipped: found no --data and no {DATA_VARIABLE}\n")
            return
        if settings.task == "knowledge":
            yield from measure_knowledge(data, settings.seed)
            return
        yield from _measure_prediction(data, settings)
        return
    if settings.task != "behavior":
        raise InputError(
            f"task: found {settings.task!r}, expected behavior, prediction or knowledge"
        )
    if data is None or not (data / "traf" / "tracks").is_dir():
        where = f"no --data and no {DATA_VARIABLE}" if data is None else f"no {data}/traf/tracks"
        print(f"real-data: traf skipped: found {where}", file=sys.stderr)
        return
    videos = read_traf(data / "traf", settings.views, jobs=settings.jobs)
    if not videos:
        print(f"real-data: traf skipped: {data}/traf has no annotated video", file=sys.stderr)
        return
    yield evaluate_traf(videos, settings.test_videos, settings.views, settings.tasks, settings.jobs)


def _measure_prediction(data: Path, settings: Settings) -> Iterator[list[Row]]:
    """Score predictors, and write the page of the worst cases if one is wanted."""
    if settings.worst is not None and settings.worst.suffix.lower() != ".html":
        raise InputError(f"--worst: found {settings.worst.name!r}, expected a name ending in .html")
    cases: list[Case] = []

    def keep(case: Case) -> None:
        cases.append(case)
        if len(cases) > MOST_CASES:
            cases[:] = worst_of(cases)

    yield from measure_recordings(
        data, settings.leave_out, settings.epochs, settings.seed,
        on_case=None if settings.worst is None else keep,
    )  # fmt: skip
    if settings.worst is not None:
        predictor = "graphrqi-predict"
        if settings.leave_out != "nothing":
            predictor += f", trained without the {settings.leave_out}"
        write_whole(settings.worst, worst_cases_page(cases, predictor).encode())


BENCH: Final = Bench(
    name="real-data",
    summary="Score methods on labelled recordings, leaving one video out at a time.",
    keys=("dataset", "protocol", "method", "classes", "fold"),
    full=Settings(),
    quick=Settings(views=("majority", "leak-probe", "unit-free"), tasks=(2,)),
    measure=measure,
    needs=DATA_VARIABLE,
)
