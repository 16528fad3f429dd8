"""Commands that are killed or stopped at random moments, and then run again.

Each command works on a small input in a folder of its own. It gets SIGKILL, SIGTERM or SIGINT at a
random moment. What is visible afterwards must be whole; after SIGTERM and SIGINT nothing unfinished
may be left, also not in the folder for temporary files. The same command is then run again, and the
result must have the same bytes as one that nobody disturbed.

Generations with several workers are killed again and again until they come through, on a disk and
in an object store (`experiments.benches.kills.generations`).

Commands are run in forked processes that have everything imported: needs Linux.
"""

from __future__ import annotations

import importlib
import json
import logging
import random
import shutil
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from experiments.benches.contract import Bench, option
from experiments.benches.kills import generations
from experiments.benches.kills.forked import content, run
from experiments.benches.progress import read_progress
from experiments.score.rows import Row, tidy_row
from sim.store.atomic import write_whole

LOGGER = logging.getLogger(__name__)

SIGNALS: Final = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)

ENDED: Final[dict[int, tuple[int, ...]]] = {
    signal.SIGKILL: (-signal.SIGKILL, 0),
    signal.SIGTERM: (128 + signal.SIGTERM, -signal.SIGTERM, 0),
    signal.SIGINT: (128 + signal.SIGINT, -signal.SIGINT, 0),
}
"""Exit codes that each signal may lead to: stopped, ended before the command had begun, or done."""

LATEST: Final = 1.1
"""Signals come until this many times the time that the undisturbed command took."""

COMMANDS: Final[dict[str, tuple[str, ...]]] = {
    "generate": (
        "generate", "--scenario", "straight_road", "--episodes", "3", "--duration-s", "10",
        "--seed", "3", "--jobs", "1", "--quiet", "--out", "{out}/data",
    ),
    "import": ("import", "{given}/a.csv", "--format", "argoverse1", "--out", "{out}/data"),
    "export": ("export", "{given}/data", "--format", "sumo-fcd", "--out", "{out}/files"),
    "train": ("train", "{given}/data", "--method", "majority", "--out", "{out}/model"),
    "calibrate": ("calibrate", "{given}/data", "--out", "{out}/numbers", "--quiet"),
    "classify": ("classify", "{given}/data", "--model", "{given}/model", "--out",
                 "{out}/labels.parquet"),
    "predict": ("predict", "{given}/data", "--predictors", "constant-velocity", "--horizon-s", "1",
                "--model", "{given}/model", "--out", "{out}/p.parquet", "--json", "{out}/p.json"),
    "report": ("report", "{out}/rows.json"),
    "replay": ("replay", "{given}/data", "--predictor", "none", "--model", "{given}/model",
               "--out", "{out}/r.html"),
}  # fmt: skip
"""What is run; ``{given}`` has its inputs, ``{out}`` is empty, but for the rows of a report."""

MODULES: Final = (
    "experiments.calibration", "experiments.cli.commands", "experiments.data.exchange",
    "experiments.data.generate", "experiments.replay.write", "experiments.report",
    "experiments.score.labels", "experiments.score.predict",
    "experiments.training.classifier",
)  # fmt: skip
"""What commands import; it is there before they are forked, so that they begin at once."""

ROWS: Final = (
    '[{"bench": "loop", "stage": "all", "metric": "ms_median", "value": 1.0, "low": null, '
    '"high": null, "n": 3}]\n'
)

UNFINISHED: Final = (".partial-", ".lock")
"""How the names begin of what only a run in progress may have."""


FLAWS: Final = ("half_written", "left_behind", "other_bytes", "wrong_code")
"""What may be wrong with what a disturbed command leaves."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Which commands are disturbed, and how often."""

    commands: tuple[str, ...] = option(tuple(COMMANDS), "Commands; empty for none.")
    kills: int = option(1000, "Signals, over all commands.")
    seed: int = option(0, "Decides the moments.")
    places: tuple[str, ...] = option(
        generations.PLACES, "Where generations are killed; s3 needs the extra dev; empty for none."
    )
    place_kills: int = option(1000, "SIGKILLs of runs, workers and server in each place.")
    progress: str = option("", "Keep the counts here; the same command then goes on.", "FILE")


@dataclass(frozen=True)
class _Undisturbed:
    """A command that nobody disturbs: its words, how long it takes, and what it leaves."""

    name: str
    words: list[str]
    lasted_s: float
    wanted: dict[str, str]


def measure(settings: Settings) -> Iterator[list[Row]]:
    """How many runs were disturbed, and how many of them lost, left or changed something.

    The commands are disturbed in turn, so that a run which is stopped has told of all of them.

    Yields:
        The rows of all commands: disturbed (those that the signal reached before their end),
        half_written, left_behind, other_bytes and wrong_code. Then those of the generations in each
        place, after every dataset: killed_runs, killed_workers, killed_servers, datasets (that came
        through), and of these other_bytes and left_behind; wrong_code of the runs.

    Raises:
        InputError: if there is no such place, or the progress is another run's.
    """
    for place in settings.places:
        if place not in generations.PLACES:
            expected = " or ".join(generations.PLACES)
            raise InputError(f"places: found {place!r}, expected {expected}")
    for module in MODULES:
        importlib.import_module(module)
    share = -(-settings.kills // max(1, len(settings.commands)))
    kept = Path(settings.progress) if settings.progress else None
    work = f"{settings.seed}:{','.join(settings.commands)}"
    begun, counts, places = _begun(kept, work, settings.commands)

    def keep(signals: int) -> None:
        if kept is not None:
            told = {"work": work, "signals": signals, "counts": counts, "places": places}
            write_whole(kept, json.dumps(told, indent=1).encode())

    with tempfile.TemporaryDirectory(prefix="graphrqi-kills-") as scratch:
        root = Path(scratch)
        needed = {word for name in settings.commands for word in COMMANDS[name]}
        _prepare(root / "given", "{given}/data" in needed)
        commands = [_undisturbed(name, root) for name in settings.commands]
        for number in range(begun, share):
            for command in commands:
                counts[command.name] += _disturb(command, root, number, settings.seed)
            keep(number + 1)
        if settings.commands:
            yield [
                tidy_row({"command": name}, metric, float(counts[name][metric]), None, None,
                         max(begun, share))
                for name in settings.commands
                for metric in ("disturbed", *FLAWS)
            ]  # fmt: skip
        for place in settings.places:
            killed = places.setdefault(place, Counter())
            for _ in generations.disturb(
                place, root / place, settings.place_kills, settings.seed, killed
            ):
                LOGGER.info("%s: %s", place, dict(killed))
                keep(max(begun, share))
            kills = generations.kills(killed)
            key = {"command": f"generate on {place}"}
            yield [
                tidy_row(key, metric, float(killed[metric]), None, None, kills)
                for metric in generations.METRICS
            ]


def _begun(
    kept: Path | None, work: str, commands: Sequence[str]
) -> tuple[int, dict[str, Counter[str]], dict[str, Counter[str]]]:
    """How many signals each command has had in earlier runs, what came of them, and of places."""
    found = read_progress(
        kept,
        work,
        lambda told: (
            int(told["signals"]),
            {name: Counter[str](told["counts"][name]) for name in commands},
            {place: Counter[str](counts) for place, counts in told.get("places", {}).items()},
        ),
    )
    return (0, {name: Counter() for name in commands}, {}) if found is None else found


def _prepare(given: Path, dataset: bool) -> None:
    """The commands' inputs: a recording, and a dataset and a model where one needs them."""
    given.mkdir()
    lines = [f"{1 + k / 10:.1f},t{a},OTHERS,{3 * k}.5,{4 * a},PIT" for k in range(60)
             for a in range(4)]  # fmt: skip
    header = "TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME"
    (given / "a.csv").write_text("\n".join([header, *lines, ""]))
    for name, target in (("generate", "data"), ("train", "model")) if dataset else ():
        words = [w.format(out=given, given=given) for w in COMMANDS[name]]
        code, told = run(words, given / "scratch", None)
        if code != 0:
            raise RuntimeError(f"{name} ended with {code} and made no {target}: {told}")
    shutil.rmtree(given / "scratch", ignore_errors=True)


def _fresh(name: str, place: Path) -> None:
    """The folder that a command writes into, as it is before."""
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    if name == "report":
        (place / "rows.json").write_text(ROWS)


def _undisturbed(name: str, root: Path) -> _Undisturbed:
    place = root / "out"
    words = [word.format(out=place, given=root / "given") for word in COMMANDS[name]]
    for _ in range(2):  # the second time nothing is compiled any more
        _fresh(name, place)
        began = time.monotonic()
        code, told = run(words, root / "temporary", None)
        lasted_s = time.monotonic() - began
    if code != 0:
        raise RuntimeError(f"{name}: ended with {code} when nobody disturbed it: {told}")
    return _Undisturbed(name, words, lasted_s, content(place))


def _disturb(command: _Undisturbed, root: Path, number: int, seed: int) -> Counter[str]:
    """Send a command one signal, run it again, and count what is wrong."""
    name, place, counts = command.name, root / "out", Counter[str]()
    _fresh(name, place)
    shutil.rmtree(root / "temporary", ignore_errors=True)
    sent = SIGNALS[number % len(SIGNALS)]
    choose = random.Random(f"{name}:{seed}:{number}")
    after_s = choose.uniform(0.0, LATEST * command.lasted_s)
    code, told = run(command.words, root / "temporary", (sent, after_s))
    found = content(place)
    counts["disturbed"] += code != 0
    flaws = _flaws(sent, code, found, command.wanted, root / "temporary")
    if "wrong_code" in flaws:
        flaws["wrong_code"] += f": {told[-200:]}"
    if code != 0:
        code, told = run(command.words, root / "temporary", None)
    if code != 0 or content(place) != command.wanted:
        flaws["other_bytes"] = f"in the end: {code}, {sorted(content(place))}, {told}"
    for flaw, why in flaws.items():
        counts[flaw] += 1
        LOGGER.warning("%s: %s after %.3f s: %s: %.300s", name, sent.name, after_s, flaw, why)
    return counts


def _flaws(
    sent: signal.Signals,
    code: int,
    found: dict[str, str],
    wanted: dict[str, str],
    temporary: Path,
) -> dict[str, str]:
    """What is wrong with what a disturbed command left, by kind."""
    flaws: dict[str, str] = {}
    if code not in ENDED[sent]:
        flaws["wrong_code"] = str(code)
    whole = {path: digest for path, digest in found.items() if not _unfinished(path)}
    half = [p for p, digest in whole.items() if p in wanted and wanted[p] != digest]
    if half and not _grows(half):
        flaws["half_written"] = ", ".join(half)
    if sent != signal.SIGKILL and code > 0:
        left = [path for path in found if _unfinished(path)]
        left += [str(p.relative_to(temporary)) for p in temporary.rglob("*") if p.is_file()]
        if left:
            flaws["left_behind"] = ", ".join(left)
    return flaws


def _unfinished(path: str) -> bool:
    return any(part.startswith(UNFINISHED) for part in Path(path).parts)


def _grows(paths: list[str]) -> bool:
    """Whether these are a dataset's description, which grows with its episodes."""
    return all(Path(path).name in ("manifest.json", "README.md") for path in paths)


BENCH: Final = Bench(
    name="kills",
    summary="Commands killed or stopped at random moments: what is lost, left or different.",
    keys=("command",),
    full=Settings(),
    quick=Settings(("import", "export", "classify", "report"), kills=4, place_kills=4),
    measure=measure,
)
