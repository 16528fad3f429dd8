"""Windows of observation from the episodes of a dataset, made in parallel."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from experiments.console.notices import LOGGER
from experiments.data.parallel import in_parallel
from experiments.data.units import image_scale, in_metres
from graphrqi.methods import make_observer
from graphrqi.places.other_traffic import Traffic, check_traffic
from graphrqi.samples import NoSamplesError, Samples, collect
from sim.frames import Tracks
from sim.store.dataset import Dataset, Episode, open_dataset
from sim.store.schema import EpisodeEntry, Split

SIMULATED_FORMATS: Final = ("sumo-fcd",)
"""Formats in which other simulations are imported."""

OBSERVED_S: Final = 10.0
"""Length of observation that scores are given for."""


def traffic_of(entry: EpisodeEntry, said: str | None = None) -> Traffic:
    """Whether an episode is simulated by an engine, recorded, or other traffic.

    Random worlds and what other simulations wrote are other traffic. ``said`` counts more.
    """
    if said is not None:
        return check_traffic(said)
    if "family" in entry.options or entry.engine in SIMULATED_FORMATS:
        return "other"
    return "simulated" if entry.recording is None else "recorded"


def measured(episode: Episode) -> Tracks:
    """An episode's tracks in metres: random worlds may be seen in pixels of an unknown scale."""
    if not episode.entry.options.get("pixels_per_m"):
        return episode.tracks
    return in_metres(episode.tracks, image_scale(episode.tracks))


def places_of(datasets: Sequence[Dataset]) -> list[str]:
    """Scenario of each episode number of `gather`, with its engine where there are several."""
    episodes = [e for d in datasets for e in d.manifest.episodes]
    if len({e.engine for e in episodes}) == 1:
        return [e.scenario for e in episodes]
    return [f"{e.scenario}, {e.engine}" for e in episodes]


def gather(
    datasets: Sequence[Dataset],
    split: Split,
    method: str,
    *,
    windows_s: Sequence[float] = (OBSERVED_S,),
    every_s: float = 1.0,
    per_moment: int | None = None,
    seed: int = 0,
    jobs: int | None = None,
    quiet: bool = True,
    classes: tuple[Behavior, ...] = BEHAVIORS,
) -> Samples:
    """Samples of every episode of a split, made in parallel.

    Windows have the lengths ``windows_s`` and end ``every_s`` apart; of the lengths, ``per_moment``
    are drawn for each driver and moment, or all are taken. Episodes are numbered as in the
    manifests; those without samples are left out, each in a line on stderr. Codes stand for
    ``classes``, and drivers of other behaviours give no sample.

    Raises:
        InputError: if the split has no episode.
        NoSamplesError: if no episode has labels and a driver that is seen for long enough.
    """
    every = [(d.path, e) for d in datasets for e in d.manifest.episodes]
    arguments = [
        (path, entry, number, method, (windows_s, every_s, per_moment, seed + number), classes)
        for number, (path, entry) in enumerate(every)
        if entry.split == split
    ]
    if not arguments:
        paths = ", ".join(str(d.path) for d in datasets)
        raise InputError(
            f"{paths}: found no {split} episode, expected at least one; generate more episodes"
        )
    what = f"{method}: observing {split} episodes"
    found = list(in_parallel(_episode_samples, arguments, jobs, what, quiet))
    parts = [part for part in found if not isinstance(part, str)]
    left_out = [reason for reason in found if isinstance(reason, str)]
    if not parts:
        raise NoSamplesError(left_out[0])
    for reason in left_out:
        LOGGER.warning("left out %s", reason)
    return Samples.join(parts)


def _episode_samples(
    folder: Path, entry: EpisodeEntry, number: int, method: str, taken: tuple[Any, ...],
    classes: tuple[Behavior, ...],
) -> Samples | str:  # fmt: skip
    """Samples of one episode, as `graphrqi.samples.collect` gives them, or why there are none."""
    tracks = measured(open_dataset(folder).read(entry))
    if tracks.behavior is not None and tracks.classes != classes:
        code = [classes.index(b) if b in classes else -1 for b in tracks.classes]
        codes = np.array([*code, -1], dtype=np.int8)[tracks.behavior]
        tracks = dataclasses.replace(tracks, behavior=codes)
    try:
        return collect(tracks, make_observer(method), number, *taken)
    except NoSamplesError as reason:
        return f"{folder}: episode {entry.id}: {reason}"
