"""What a large dataset costs: opening and asking a catalogue, and each episode of a generation.

The catalogue is synthetic: as many rows as asked for, with ids, labels and options like those of
generated ones, and shards that do not exist. The generations are real, with short episodes, so
that what the dataset costs counts beside what the simulation costs. What a generation of one
episode costs is taken off, since starting a worker would hide how the cost grows.
"""

from __future__ import annotations

import multiprocessing
import resource
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from behaviors.labels import BEHAVIORS
from experiments.benches.contract import Bench, option
from experiments.data.configuration import GenerateConfig
from experiments.data.generate import generate_shards
from experiments.score.rows import Cell, Row, tidy_row
from sim.frames import KINDS
from sim.store.dataset import open_dataset
from sim.store.entries import header_of, write_catalogue
from sim.store.places import Folder
from sim.store.schema import BLOCK_EPISODES, CATALOGUE, TABLES, FileEntry, split_of

SCENARIOS: Final = ("straight_road", "four_way_intersection")
KEYS: Final = ("part", "episodes")

WARM_EPISODES: Final = 20
"""Episodes that are made before any is timed (drivers of each kind meet in them)."""


@dataclass(frozen=True)
class Settings:
    """How much is measured.

    Attributes:
        rows: of the synthetic catalogue.
        episodes: sizes of the generations, ascending.
        duration_s: of each of their episodes, s.
        engine: which simulator; highway starts at once, so that what a dataset costs counts most.
        jobs: worker processes.
    """

    rows: int = option(10**6, "Rows of the synthetic catalogue.")
    episodes: tuple[int, ...] = option((100, 1000, 10_000), "Sizes of the generations.")
    duration_s: float = option(0.5, "Length of each episode, s.")
    engine: str = option("highway", "Which simulator.")
    jobs: int = option(1, "Worker processes.")


def synthetic_catalogue(folder: Path, rows: int) -> None:
    """Write a catalogue of episodes that do not exist.

    Args:
        folder: of the dataset.
        rows: how many episodes.
    """
    rng = np.random.default_rng(0)
    index = np.arange(rows) // len(SCENARIOS)
    scenario = np.arange(rows) % len(SCENARIOS)
    block = index // BLOCK_EPISODES
    cycle = np.array([split_of(i) for i in range(5)])[index % 5]
    order = np.lexsort((index, scenario))
    columns: dict[str, object] = {
        "id": [f"{number:016x}" for number in rng.permutation(rows)],
        "scenario": np.array(SCENARIOS)[scenario],
        "engine": np.full(rows, "sumo"),
        "split": cycle,
        "index": index,
        "seed": rng.integers(2**31, size=rows, dtype=np.uint64),
        "flow": np.array(["light", "medium", "dense"])[rng.integers(3, size=rows)],
        "frames": np.full(rows, 600),
        "agents": rng.integers(5, 60, size=rows),
        "agent_steps": rng.integers(1000, 30_000, size=rows),
        "road": np.array([f"{number:064x}" for number in range(len(SCENARIOS))])[scenario],
        "exact": np.zeros(rows, dtype=bool),
        "shard": np.array([
            f"{b * BLOCK_EPISODES:06}-{(b + 1) * BLOCK_EPISODES - 1:06}"
            for b in range(int(block.max()) + 1)
        ])[block],
        "row_group": (index % BLOCK_EPISODES).astype(np.int32),
        "options": np.full(rows, '{"duration_s": 60.0, "spread": 0.15, "step_s": 0.1}'),
        "made_with": np.full(rows, '{"graphrqi": "0", "libsumo": "0", "numpy": "0"}'),
    }  # fmt: skip
    for name in (*BEHAVIORS, *KINDS):
        columns[str(name)] = rng.integers(0, 10, size=rows, dtype=np.int32)
    arrays = [
        pa.array(columns[field.name]).cast(field.type)
        if field.name in columns
        else pa.nulls(rows, field.type)
        for field in CATALOGUE
    ]
    table = pa.Table.from_arrays(arrays, schema=CATALOGUE).take(pa.array(order))
    shards = {(SCENARIOS[s], str(p), str(n)) for s, p, n in zip(
        scenario[::1000], cycle[::1000], np.asarray(columns["shard"])[::1000], strict=True
    )}  # fmt: skip
    files = {
        f"{one}/scenario={s}/split={p}/{n}.parquet": FileEntry(sha256="0" * 64, size=2**28)
        for one in TABLES
        for s, p, n in shards
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_catalogue(Folder(folder), header_of({"synthetic": True}, {}, files), [table])


def asked(folder: Path) -> dict[str, float]:
    """Open a catalogue and ask it, in a process of its own.

    Returns:
        Seconds of each step, and the memory that the process took at most, MB: before anything was
        opened, and in all.
    """
    before = _memory_mb()
    times = [time.perf_counter()]
    dataset = open_dataset(folder)
    len(dataset)
    times.append(time.perf_counter())
    table = dataset.catalogue
    table.group_by(["scenario", "split"]).aggregate([("timid", "sum"), ("agent_steps", "sum")])
    times.append(time.perf_counter())
    dataset.episodes(split="test", scenario=SCENARIOS[0], behavior="timid", flow="dense")[:1]
    times.append(time.perf_counter())
    dataset.entry(table.column("id")[0].as_py())
    times.append(time.perf_counter())
    names = ("open_s", "label_query_s", "filtered_entries_s", "one_entry_s")
    found = dict(zip(names, np.diff(times).tolist(), strict=True))
    return {**found, "memory_before_mb": before, "memory_most_mb": _memory_mb()}


def _memory_mb() -> float:
    """The most memory that this process has had so far, MB (Linux); NaN elsewhere."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.is_file() else []
    return next((int(x.split()[1]) / 1e3 for x in lines if x.startswith("VmHWM")), float("nan"))


def _generated(config: GenerateConfig, jobs: int) -> tuple[float, float]:
    """Generate a dataset: CPU time of all processes, s, and most memory of this one, MB."""
    with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
        forget = Path("/proc/self/clear_refs")
        if forget.exists():
            forget.write_text("5")  # the most memory is what is taken from now on
        begin = _cpu_s()
        generate_shards(config, Path(scratch) / "data", jobs, quiet=True)
        return _cpu_s() - begin, _memory_mb()


def _cpu_s() -> float:
    """CPU time of this process and of all its ended children, s."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def measure(settings: Settings) -> Iterator[list[Row]]:
    """The catalogue's rows, then those of each generation, then how the cost grows."""
    with tempfile.TemporaryDirectory(prefix="graphrqi-bench-") as scratch:
        synthetic_catalogue(Path(scratch), settings.rows)
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, mp_context=spawn) as pool:
            found = pool.submit(asked, Path(scratch)).result()
        size = (Path(scratch) / "episodes.parquet").stat().st_size
    key: dict[str, Cell] = {"part": "catalogue", "episodes": settings.rows}
    measured = {**found, "catalogue_mb": size / 1e6}
    yield [tidy_row(key, metric, value, None, None, 1) for metric, value in measured.items()]
    config = GenerateConfig(
        scenarios=SCENARIOS[:1], episodes=1, seed=11, engine=settings.engine,
        duration_s=settings.duration_s,
    )  # fmt: skip
    warm = config.model_copy(update={"episodes": WARM_EPISODES})
    _generated(warm, settings.jobs)  # imports and compiled code count for none
    begin_s, _ = _generated(config, settings.jobs)
    costs: list[float] = []
    for count in settings.episodes:
        spent_s, most_mb = _generated(config.model_copy(update={"episodes": count}), settings.jobs)
        costs.append(max(spent_s - begin_s, 1e-6))
        key = {"part": "generation", "episodes": count}
        cost_ms = 1e3 * costs[-1] / max(count - 1, 1)
        yield [
            tidy_row(key, "cpu_ms_per_episode", cost_ms, None, None, count),
            tidy_row(key, "memory_most_mb", most_mb, None, None, 1),
        ]
    if len(costs) > 1:
        sizes = np.maximum(np.array(settings.episodes) - 1, 1)
        slope = np.polyfit(np.log(sizes), np.log(costs), 1)[0]
        key = {"part": "generation", "episodes": max(settings.episodes)}
        yield [tidy_row(key, "slope", float(slope), None, None, len(costs))]


BENCH: Final = Bench(
    name="store",
    summary="Opening and asking a large catalogue, and what each episode of a generation costs.",
    keys=KEYS,
    full=Settings(),
    quick=Settings(rows=20_000, episodes=(2, 4)),
    measure=measure,
)
