"""Windows of observation from the episodes of a dataset, made in parallel."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from experiments.parallel import in_parallel
from experiments.progress import Progress
from graphrqi.methods import METHODS
from graphrqi.samples import Samples, collect
from sim.dataset import Dataset, open_dataset
from sim.schema import EpisodeEntry, Split

OBSERVED_S: Final = 10.0
"""Length of observation that scores are given for."""


def episode_samples(
    folder: Path,
    entry: EpisodeEntry,
    number: int,
    method: str,
    solver: str,
    windows_s: Sequence[float],
    every_s: float,
    per_moment: int | None,
    seed: int,
) -> Samples:
    """Samples of one episode; see `graphrqi.samples.collect`."""
    tracks = open_dataset(folder).read(entry).tracks
    observer = METHODS[method].observer(solver)
    return collect(tracks, observer, number, windows_s, every_s, per_moment, seed + number)


def gather(
    dataset: Dataset,
    split: Split,
    method: str,
    *,
    scenario: str | None = None,
    solver: str = "graphrqi",
    windows_s: Sequence[float] = (OBSERVED_S,),
    every_s: float = 1.0,
    per_moment: int | None = None,
    seed: int = 0,
    jobs: int | None = None,
    quiet: bool = True,
) -> Samples:
    """Samples of every episode of a split, made in parallel.

    Args:
        dataset: where from.
        split: which part.
        method: whose observer to use.
        scenario: only this one; None for all.
        solver: a key of ``SOLVERS``.
        windows_s: lengths of observation.
        every_s: time between the ends of windows.
        per_moment: how many lengths to draw per driver and moment; None for all.
        seed: of that draw.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        The samples; episodes are numbered as in the manifest.

    Raises:
        InputError: if the split has no episode or no driver is seen long enough.
    """
    numbered = {e.id: i for i, e in enumerate(dataset.manifest.episodes)}
    entries = dataset.episodes(split, scenario)
    if not entries:
        where = f" of scenario {scenario}" if scenario else ""
        raise InputError(
            f"{dataset.path}: found no {split} episode{where}, expected at least one; "
            "generate more episodes"
        )
    arguments = [
        (dataset.path, e, numbered[e.id], method, solver, tuple(windows_s), every_s, per_moment,
         seed)
        for e in entries
    ]  # fmt: skip
    parts: list[Samples] = []
    with Progress(f"{method}: observing {split} episodes", len(entries), quiet) as progress:
        for part in in_parallel(episode_samples, arguments, jobs):
            parts.append(part)
            progress.advance()
    return Samples.join(parts)
