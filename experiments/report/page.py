"""Report pages: one for each run or file of rows, and one that compares several."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Final

from behaviors.colors import COLORS, UNKNOWN_COLOR
from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from experiments.replay.ramp import ramp_color
from experiments.report.charts import Chart
from experiments.report.evaluation import confusion_of, confusions
from experiments.report.excerpts import take_excerpts
from experiments.report.run_file import Metrics
from experiments.report.sections import (
    LAYOUTS,
    Section,
    is_first,
    layouts,
    sections,
    shown_predictor,
)
from experiments.report.source import Source, by_bench, read_source, rows_of
from experiments.report.tables import Table, name_of, pivot, words
from experiments.report.templates import rendered
from experiments.rows import Row
from sim.files import write_whole

OURS: Final = b"GraphRQI"
"""Mark in the head of every page that is written here; a page without it is not overwritten."""

HEAD_BYTES: Final = 2000
"""Bytes of a page in which this mark is looked for."""

MOST_LETTERS: Final = 100
"""Longest name of a chart's file, without its number and ending, in letters."""


def write_report(
    path: Path,
    jobs: int | None = None,
    quiet: bool = True,
    out: Path | None = None,
    figures: Path | None = None,
) -> Path:
    """Write the page of a run, or of a file of rows.

    Args:
        path: a run's folder, a folder with files of rows, or one such file.
        jobs: processes for looking at a run's episodes; None for one per core.
        quiet: whether to show no progress.
        out: the page; None for ``report.html`` in the folder, or beside the file by its name.
        figures: a folder for the page's charts, each a PDF by its title, too; None for none.

    Returns:
        The page. It loads nothing; a run's worst cases link to the replays beside it.

    Raises:
        InputError: if a part is missing or broken, or the page of a run is to stand elsewhere.
        OSError: if it cannot be written.
    """
    source = read_source(path)
    run = source.run
    beside = path / "report.html" if path.is_dir() else path.with_suffix(".html")
    if run is not None and out is not None and out.resolve() != beside.resolve():
        raise InputError(
            f"--out: found {out}, expected {beside}: a run's page links to the replays beside it"
        )
    out = beside if out is None else out
    excerpts = []
    if run is not None and (path / run.dataset).is_dir() and (path / run.model).is_dir():
        predicted = source.rows.get("prediction", ())
        scenarios = list(dict.fromkeys(words(r["scenario"]) for r in source.rows["classification"]))
        name = shown_predictor(predicted) if predicted else "none"
        excerpts = take_excerpts(path, run.dataset, run.model, scenarios, name, jobs, quiet)
    matrices = {
        "classification": [
            confusion_of(matrix, f"{method}, {scenario}")
            for scenario, methods in (run.confusion if run else {}).items()
            for method, matrix in methods.items()
        ],
        "evaluation": confusions(source.rows.get("evaluation", ())),
    }
    shown = sections(source.rows)
    _write(
        out, "page.html", source=source, run=run, sections=shown,
        behavior_colors=[*((COLORS[b], b.value) for b in BEHAVIORS), (UNKNOWN_COLOR, "not known")],
        ramp_colors=[
            (ramp_color(0.0), "none"), (ramp_color(0.5), "a quarter"),
            (ramp_color(1.0), "the largest"),
        ],
        confusions=matrices, behaviors=[str(b) for b in BEHAVIORS], excerpts=excerpts,
        missing=[
            (layout.title, layout.made_by)
            for bench, layout in LAYOUTS.items()
            if bench not in source.rows
        ],
    )  # fmt: skip
    if figures is not None:
        _write_figures(
            figures, [*chain(*(part.charts for part in shown), *(one.charts for one in excerpts))]
        )
    return out


def _write_figures(folder: Path, charts: Sequence[Chart]) -> None:
    """Write charts by their titles; where two have the same, the later ones are numbered."""
    folder.mkdir(parents=True, exist_ok=True)
    many: Counter[str] = Counter()
    for chart in charts:
        name = re.sub(r"[^a-z0-9]+", "-", chart.title.lower()).strip("-")[:MOST_LETTERS]
        many[name] += 1
        number = "" if many[name] == 1 else f"-{many[name]}"
        write_whole(folder / f"{name}{number}.pdf", chart.pdf())


def write_comparison(paths: Sequence[Path], out: Path) -> Path:
    """Write one page that puts runs beside each other.

    Args:
        paths: at least two runs or files of rows.
        out: the HTML file.

    Returns:
        The page.

    Raises:
        InputError: if there are fewer than two, a part is broken, or they have no figure in common.
        OSError: if it cannot be written.
    """
    if len(paths) < 2:
        raise InputError(f"runs: found {len(paths)}, expected at least 2 to compare")
    sources = [read_source(path) for path in paths]
    names = _distinct_names(sources)
    compared = compare(dict(zip(names, (s.rows for s in sources), strict=True)))
    if not compared:
        raise InputError(
            f"{out}: found no kind of figure that {' and '.join(names)} have in common, expected "
            "one to compare; each has a page of its own"
        )
    _write(out, "comparison.html", names=names, sources=sources, sections=compared)
    return out


def _distinct_names(sources: Sequence[Source]) -> list[str]:
    names = [source.name for source in sources]
    return [
        name if names.count(name) == 1 else str(source.path)
        for name, source in zip(names, sources, strict=True)
    ]


def compare(runs: Mapping[str, Mapping[str, Sequence[Row]]]) -> list[Section]:
    """Sections whose tables have a column for each run.

    Args:
        runs: the rows of each run by bench, by the run's name.

    Returns:
        A section for each bench that at least two runs have.
    """
    found = []
    for bench, layout in layouts(bench for rows in runs.values() for bench in rows).items():
        having = [name for name, rows in runs.items() if bench in rows]
        if len(having) < 2:
            continue
        tables: dict[tuple[str, str], list[Row]] = {}
        for name in having:
            for row in runs[name][bench]:
                values = [words(row.get(k)) for k in layout.group]
                title = ", ".join(v for v in values if v != "none") or layout.title
                tables.setdefault((title, str(row["metric"])), []).append({**row, "run": name})
        across = (*(k for k in layout.across if k != "metric"), "run")
        hidden = {"bench", "metric", "value", "low", "high", "n", "split", *layout.group, *across}
        main: list[Table] = []
        more: list[Table] = []
        for (title, metric), part in tables.items():
            if len({words(r["run"]) for r in part}) < 2:
                continue
            down = [k for k in dict.fromkeys(k for r in part for k in r) if k not in hidden]
            first = is_first(part[0]) and (not layout.main or metric in layout.main)
            table = pivot(part, f"{title}: {name_of(metric)}", down or ["metric"], across)
            (main if first else more).append(table)
        if main or more:
            found.append(
                Section(bench, layout.title, layout.introduction, "", tuple(main), tuple(more), ())
            )
    return found


def _write(out: Path, template: str, **values: Any) -> None:
    if out.is_file() and OURS not in out.read_bytes()[:HEAD_BYTES]:
        raise InputError(f"{out}: found a page that is not a report, expected none; move it away")
    write_whole(out, rendered(template, **values).encode())


def printed_tables(metrics: Metrics) -> list[tuple[str, Table]]:
    """The main tables of a run, for the terminal, each with its section's title."""
    return [(s.title, table) for s in sections(by_bench(rows_of(metrics))) for table in s.tables]
