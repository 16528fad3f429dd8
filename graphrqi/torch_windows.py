"""Windows of a dataset's drivers for PyTorch: what was, what follows, and who drives.

Shards are streamed: of each episode only its own rows are read, when it is its turn, and only one
episode and a buffer of windows are in memory. Reading in several workers needs no copy of anything:
each worker reads its own episodes, and tensors share memory with the arrays that they are made of.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import torch
from numpy.typing import NDArray
from torch.utils.data import IterableDataset, get_worker_info

from behaviors.errors import InputError
from sim.frames import Tracks
from sim.store.catalogue import rows_where
from sim.store.dataset import Dataset, open_dataset
from sim.store.schema import Split

Window = dict[str, Any]

STEP_TOLERANCE: Final = 1e-3
"""How far the ratio of two steps may be from a whole number."""


@dataclass(frozen=True)
class WindowOptions:
    """Which windows there are.

    Attributes:
        history_s: length of the past, s; its last moment is the present.
        future_s: length of what follows, s.
        step_s: time between two moments, s; a multiple of the episodes' own step.
        every_s: time between two presents of an agent, s.
        whole: whether to leave out windows in which the agent is not always there.
    """

    history_s: float = 2.0
    future_s: float = 3.0
    step_s: float = 0.1
    every_s: float = 1.0
    whole: bool = True

    def __post_init__(self) -> None:
        """Refuse lengths that are no times."""
        for name, value in asdict(self).items():
            if name != "whole" and not 0.0 < value < 1e6:
                raise InputError(f"{name}: found {value:g}, expected a positive number of seconds")


def windows_of(tracks: Tracks, options: WindowOptions) -> Iterator[Window]:
    """Every window of an episode, by present, then agent.

    Args:
        tracks: the episode.
        options: which windows.

    Yields:
        ``history`` (H, 4) x, y in m relative to ``origin``, heading in rad, speed in m/s, float32;
        ``history_valid`` (H,); ``future`` (F, 2) m relative to ``origin``; ``future_valid`` (F,);
        ``origin`` (2,) the agent's position at the present, m, float64; ``agent`` its id;
        ``time_s`` of the present; ``kind`` its code; ``behavior`` its code, -1 if not known. Where
        an agent is not there, numbers are 0.

    Raises:
        InputError: if ``step_s`` is no multiple of the episode's step.
    """
    if tracks.time_s.size < 2:
        return
    ratio = options.step_s / tracks.step_s
    stride = round(ratio)
    if stride < 1 or abs(ratio - stride) > STEP_TOLERANCE * stride:
        raise InputError(
            f"step_s: found {options.step_s:g}, expected a multiple of the episode's "
            f"{tracks.step_s:g} s"
        )
    past = round(options.history_s / options.step_s)
    ahead = round(options.future_s / options.step_s)
    between = max(1, round(options.every_s / tracks.step_s))
    labels = tracks.behavior
    for now in range(past * stride, tracks.time_s.size - ahead * stride, between):
        before = slice(now - past * stride, now + 1, stride)
        after = slice(now + stride, now + ahead * stride + 1, stride)
        here = tracks.valid[:, now].copy()
        if options.whole:
            here &= tracks.valid[:, before].all(axis=1) & tracks.valid[:, after].all(axis=1)
        for row in np.flatnonzero(here):
            origin = tracks.xy[row, now]
            seen, follows = tracks.valid[row, before], tracks.valid[row, after]
            columns = (
                *(tracks.xy[row, before] - origin).T,
                tracks.heading[row, before],
                tracks.speed[row, before],
            )
            yield {
                "history": _tensor(np.stack(columns, axis=1), seen),
                "history_valid": torch.from_numpy(seen.copy()),
                "future": _tensor(tracks.xy[row, after] - origin, follows),
                "future_valid": torch.from_numpy(follows.copy()),
                "origin": torch.from_numpy(np.array(origin)),
                "agent": int(tracks.ids[row]),
                "time_s": float(tracks.time_s[now]),
                "kind": int(tracks.kind[row]),
                "behavior": -1 if labels is None else int(labels[row]),
            }


def _tensor(values: NDArray[np.float64], valid: NDArray[np.bool_]) -> torch.Tensor:
    return torch.from_numpy(np.where(valid[:, None], values, 0.0).astype(np.float32))


class TorchWindows(IterableDataset[Window]):
    """The windows of a dataset, for `torch.utils.data.DataLoader`.

    Order depends on the seed, the epoch and the number of workers alone. Every window comes once
    per epoch, whatever the number of workers.
    """

    def __init__(
        self,
        path: str | Path,
        options: WindowOptions | None = None,
        *,
        split: Split | None = None,
        scenario: str | None = None,
        behavior: str | None = None,
        mix: str | Mapping[str, float] | None = None,
        flow: str | float | None = None,
        seed: int | None = None,
        buffer: int = 2048,
    ) -> None:
        """Open the catalogue, and nothing else.

        Args:
            path: the dataset, a folder or a URL.
            options: which windows; None for the usual ones.
            split: as in `sim.store.dataset.Dataset.episodes`, like the next four.
            scenario: as there.
            behavior: as there: it chooses episodes, not agents.
            mix: as there.
            flow: as there.
            seed: of the order; None for the catalogue's order.
            buffer: how many windows are mixed with each other where there is a seed.

        Raises:
            InputError: if it is no dataset, a filter is wrong, or no episode fits.
        """
        super().__init__()
        self._path = path
        self._options = options or WindowOptions()
        self._filters = {"split": split, "scenario": scenario, "behavior": behavior, "mix": mix,
                         "flow": flow}  # fmt: skip
        self._seed, self._buffer, self._epoch = seed, max(1, buffer), 0
        self._opened: tuple[Dataset, pa.Table] | None = None
        if not self._rows()[1].num_rows:
            raise InputError(f"{path}: found no episode that fits, expected at least one")

    def __getstate__(self) -> dict[str, Any]:
        """A worker of another process opens the catalogue itself."""
        return {**self.__dict__, "_opened": None}

    def _rows(self) -> tuple[Dataset, pa.Table]:
        if self._opened is None:
            dataset = open_dataset(self._path)
            fitting = rows_where(dataset.catalogue, **self._filters)  # type: ignore[arg-type]
            self._opened = dataset, fitting
        return self._opened

    def set_epoch(self, epoch: int) -> None:
        """Choose the order of an epoch; with workers, before the loader is iterated over."""
        self._epoch = epoch

    def __iter__(self) -> Iterator[Window]:
        """The windows of this worker's episodes, with ``episode``, ``scenario`` and ``split``.

        Raises:
            InputError: if an episode cannot be read.
        """
        worker = get_worker_info()
        number, of = (0, 1) if worker is None else (worker.id, worker.num_workers)
        dataset, rows = self._rows()
        order = self._order(rows)[number::of]
        windows = self._read(dataset, rows, order)
        if self._seed is None:
            return windows
        return _mixed(
            windows, np.random.default_rng([self._seed, self._epoch, number]), self._buffer
        )

    def _order(self, rows: pa.Table) -> NDArray[np.int64]:
        """Which row comes when: shard by shard, in random order if there is a seed."""
        if self._seed is None:
            return np.arange(rows.num_rows)
        rng = np.random.default_rng([self._seed, self._epoch])
        keys = [rows.column(name).cast(pa.string()) for name in ("scenario", "split", "shard")]
        joined = pc.binary_join_element_wise(*keys, "/").combine_chunks().dictionary_encode()
        shard = joined.indices.to_numpy()
        place = rng.permutation(int(shard.max()) + 1)[shard]
        return np.lexsort((rng.random(shard.size), place))

    def _read(self, dataset: Dataset, rows: pa.Table, order: NDArray[np.int64]) -> Iterator[Window]:
        for row in order:
            (entry,) = dataset.entries(rows.slice(int(row), 1))
            said = {"episode": entry.id, "scenario": entry.scenario, "split": entry.split}
            for window in windows_of(dataset.read(entry).tracks, self._options):
                yield {**said, **window}


def _mixed(windows: Iterator[Window], rng: np.random.Generator, size: int) -> Iterator[Window]:
    """The same windows in a random order, of which so many are in memory."""
    kept: list[Window] = []
    for window in windows:
        if len(kept) < size:
            kept.append(window)
            continue
        at = int(rng.integers(size))
        yield kept[at]
        kept[at] = window
    for at in rng.permutation(len(kept)):
        yield kept[at]
