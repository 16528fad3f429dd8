"""Makes the sections of a report from rows: tables and charts for each bench."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from behaviors.labels import BEHAVIORS
from experiments.report.charts import Axis, Chart, Line, Point
from experiments.report.evaluation import DRAWN, reliability_charts
from experiments.report.tables import Table, grouped, name_of, number_or_none, pivot, words
from experiments.rows import Row

OURS: Final = "graphrqi-predict"

REAL_TIME_MS: Final = 100.0
"""Time from one frame to the next, ms."""


@dataclass(frozen=True, slots=True)
class Layout:
    """How the rows of one bench are arranged as tables.

    Attributes:
        title: the heading of the section.
        group: keys; there is a table for each combination of their values.
        down: keys whose values distinguish the lines of a table.
        across: keys whose values distinguish its columns.
        main: metrics whose tables are visible at first; empty for all. A click shows the others.
        made_by: the command that measures these figures.
        introduction: the text under the heading: what words mean, and how figures were measured.
    """

    title: str
    group: tuple[str, ...]
    down: tuple[str, ...]
    across: tuple[str, ...]
    main: tuple[str, ...]
    made_by: str
    introduction: str


OTHER: Final = Layout("Other figures", (), (), ("metric",), (), "", "")
"""The layout for rows whose bench has none of its own."""

LAYOUTS: Final[dict[str, Layout]] = {
    "classification": Layout(
        "Who drives how", ("protocol", "scenario"), ("method", "window_s", "variation"),
        ("metric",),
        ("weighted_accuracy", "majority_weighted_accuracy", "balanced_accuracy", "macro_f1",
         "style_balanced_accuracy", "ece", "auc", "ms_per_frame"),
        "graphrqi bench classification",
        "Majority class: the accuracy of always naming the most frequent behaviour. n counts "
        "windows: the last 10 s of one driver, one a second. Style: aggressive or conservative. "
        "Inductive: unseen episodes; transductive: windows of seen episodes too. Intervals, where "
        "there are some, are over episodes.",
    ),
    "evaluation": Layout(
        "How good the answers are", ("model",), ("scenario", "split"), ("metric",),
        ("drivers", "weighted_accuracy", "majority_weighted_accuracy", "told_accuracy",
         "balanced_accuracy", "macro_f1", "ece", "style_balanced_accuracy", "style_auc",
         "unknown_share"),
        "graphrqi evaluate",
        "Every driver once, by the last answer about it. Majority class: the accuracy of always "
        "naming the most frequent behaviour of the drivers that are scored. Where told: only "
        "drivers whose behaviour or style is likely enough to be told; the others are unknown. "
        "Style: aggressive or conservative. Intervals, where there are some, are over episodes.",
    ),
    "real-data": Layout(
        "Real drivers", ("dataset", "protocol", "classes"), ("method", "fold"), ("metric",),
        ("weighted_accuracy", "majority_weighted_accuracy", "balanced_accuracy", "macro_f1",
         "style_balanced_accuracy", "auc", "published_weighted_accuracy"),
        "graphrqi bench real-data",
        "Labelled recordings, one video left out at a time; fold all pools the videos.",
    ),
    "prediction": Layout(
        "Where everyone goes next", ("scenario", "behavior"), ("predictor",),
        ("metric", "horizon_s"), ("ade_m", "fde_m", "miss_rate"), "graphrqi predict",
        "Drivers of unseen episodes, behaviours as classified, never the truth. ADE: mean distance "
        "from what happened up to a horizon; FDE: at it. Intervals, where there are some, are over "
        "episodes.",
    ),
    "behaviors": Layout(
        "Traits shown", ("engine", "scenario"), ("metric",), ("behavior",), (),
        "graphrqi bench behaviors", "What drivers of each behaviour were seen to do.",
    ),
    "spectrum": Layout(
        "What the eigenvalues cost", ("end", "graph", "kind"), ("solver",), ("metric", "d"),
        ("cpu_ms",), "graphrqi bench spectrum",
        "CPU time per step for the same graphs in one process, d vehicles.",
    ),
    "loop": Layout(
        "While it drives", ("engine", "lanes"), ("stage", "agents", "vehicles"), ("metric",), (),
        "graphrqi bench loop", "Time of each stage per frame of a running simulation.",
    ),
    "generate": Layout(
        "Making data", (), ("scenario", "jobs"), ("metric",), (), "graphrqi bench generate",
        "The cost of generating a dataset.",
    ),
    "navigation": Layout(
        "Driving among others", ("environment",), ("arm",), ("metric",), (),
        "graphrqi bench navigation",
        "Means per episode of an ego vehicle that knows nothing, beliefs or the truth of others; "
        "differences are paired by seed.",
    ),
    "drive": Layout(
        "Licence test", ("scenario", "crowd"), ("policy",), ("metric",),
        ("rank", "score", "score_minus_diverse", "collisions", "collisions_caused", "near_misses",
         "rules_broken", "progress", "uncomfortable_share", "swapped_pairs", "best_differs"),
        "graphrqi bench drive",
        "Means per episode; everybody departs alike in every crowd, and differences are paired by "
        "seed. Score: 0 after a collision that the policy caused or off the road, otherwise "
        "progress, no near miss, no rule broken and comfort. Among clones (homogeneous), "
        "score_minus_diverse says by how much they flatter a policy, swapped_pairs how many pairs "
        "of policies they rank the other way than drivers of every kind do (mixed), and "
        "best_differs how often the best one is another when episodes are drawn again.",
    ),
    "branches": Layout(
        "Exact branches", (), ("scenario",), ("metric",), (), "graphrqi bench branches",
        "Branches of a running episode beside the episode itself.",
    ),
    "highway": Layout(
        "The highway-env engine", (), ("cars", "road"), ("metric",), (),
        "graphrqi bench highway", "Its speed beside that of the stock road.",
    ),
}  # fmt: skip
"""The layout of each bench, in the order in which a page shows them."""


@dataclass(frozen=True, slots=True)
class Section:
    """A section of a page.

    Attributes:
        bench: name of the bench that measured the figures.
        title: the heading.
        introduction: the text under the heading.
        made_by: the command that measures these figures.
        tables: tables that are visible at first.
        more: tables that a click shows.
        charts: the charts.
    """

    bench: str
    title: str
    introduction: str
    made_by: str
    tables: tuple[Table, ...]
    more: tuple[Table, ...]
    charts: tuple[Chart, ...]


def _has_splits(rows: Sequence[Row]) -> bool:
    return len({row.get("split") for row in rows}) > 1


def sections(rows: Mapping[str, Sequence[Row]]) -> list[Section]:
    """Make the sections of a page.

    Args:
        rows: the rows of each bench, by its name.

    Returns:
        A section for each bench.
    """
    found = []
    for bench, layout in layouts(rows).items():
        if bench == "prediction" and _has_splits(rows[bench]):
            layout = replace(layout, group=("scenario", "split", "behavior"))
        tables, more = _tables([r for r in rows[bench] if r["metric"] not in DRAWN], layout)
        charts = tuple(chart for chart in _charts(bench, rows[bench]) if chart)
        found.append(
            Section(bench, layout.title, layout.introduction, layout.made_by, tables, more, charts)
        )
    return found


_SHOWN_APART: Final = frozenset({"bench", "metric", "value", "low", "high", "n", "split"})
"""Keys that neither lines nor columns are made of, since cells, captions and titles show them."""


def layouts(benches: Iterable[str]) -> dict[str, Layout]:
    """The layouts of some benches, in the order of a page; benches without one come last."""
    present = set(benches)
    known = {bench: layout for bench, layout in LAYOUTS.items() if bench in present}
    return known | dict.fromkeys(sorted(present - set(LAYOUTS)), OTHER)


def _tables(rows: Sequence[Row], layout: Layout) -> tuple[tuple[Table, ...], tuple[Table, ...]]:
    """The tables that are visible at first, and the others."""
    down = (
        layout.down
        or tuple(dict.fromkeys(k for r in rows for k in r if k not in _SHOWN_APART))
        or ("metric",)
    )
    known = {*layout.group, *down, *layout.across, *_SHOWN_APART}
    rest = tuple(dict.fromkeys(k for r in rows for k in r if k not in known))
    main: list[Table] = []
    more: list[Table] = []
    for values, group in grouped(rows, layout.group).items():
        title = ", ".join(value for value in values if value != "none") or layout.title
        first = [r for r in group if _is_main(r, layout)]
        others = [r for r in group if not _is_main(r, layout)]
        if first:
            target = main if is_first(first[0]) else more
            target.append(pivot(first, title, (*down, *rest), layout.across))
        if others:
            more.append(pivot(others, f"{title}: other figures", (*down, *rest), layout.across))
    return tuple(main), tuple(more)


def _is_main(row: Row, layout: Layout) -> bool:
    plain = not row.get("variation") or row.get("variation") == "none"
    return plain and (not layout.main or row["metric"] in layout.main)


def is_first(row: Row) -> bool:
    """Whether a table is visible at first: one of all drivers, not of those of one behaviour."""
    behavior = row.get("behavior", "all")
    return behavior in ("all", *map(str, BEHAVIORS)) and (
        "predictor" not in row or behavior == "all"
    )


def _charts(bench: str, rows: Sequence[Row]) -> list[Chart]:
    if bench == "prediction":
        return _prediction_charts(rows)
    if bench == "classification":
        return _early_charts(rows)
    if bench == "evaluation":
        return reliability_charts(rows)
    if bench == "loop":
        return _loop_charts(rows)
    return _runtime_charts(rows) if bench == "spectrum" else []


def line_of(name: str, rows: Sequence[Row], key: str) -> Line:
    """A line of a chart: the values of rows over one of their keys."""
    points = [
        Point(
            _number(r[key]),
            _number(r["value"]),
            number_or_none(r.get("low")),
            number_or_none(r.get("high")),
        )
        for r in rows
    ]
    return Line(name, tuple(sorted(points, key=lambda p: p.x)))


def _number(value: object) -> float:
    assert isinstance(value, int | float)
    return float(value)


def _prediction_charts(rows: Sequence[Row]) -> list[Chart]:
    """Charts of error against horizon: of each predictor, and of one for each behaviour."""
    charts = []
    errors = [r for r in rows if r["metric"] == "ade_m"]
    farthest = max((_number(r["horizon_s"]) for r in errors), default=5.0)
    x, y = Axis("horizon, s", high=farthest), Axis("ADE, m")
    keys = ["scenario", "split"] if _has_splits(errors) else ["scenario"]
    for values, here in grouped(errors, keys).items():
        scenario = ", ".join(values)
        everyone = grouped([r for r in here if r["behavior"] == "all"], ["predictor"])
        lines = [line_of(name, part, "horizon_s") for (name,), part in everyone.items()]
        charts.append(Chart(f"{scenario}: error against horizon", x, y, tuple(lines)))
        shown = shown_predictor(here)
        each = grouped([r for r in here if r["predictor"] == shown], ["behavior"])
        lines = [
            line_of(str(b), each[(str(b),)], "horizon_s") for b in BEHAVIORS if (str(b),) in each
        ]
        title = f"{scenario}: error of {shown} against horizon, by true behaviour"
        charts.append(Chart(title, x, y, tuple(lines)))
    return charts


def shown_predictor(rows: Sequence[Row]) -> str:
    """The predictor whose errors are shown by behaviour: our own, or else the last one."""
    names = [words(r["predictor"]) for r in rows]
    return OURS if OURS in names else names[-1]


def _early_charts(rows: Sequence[Row]) -> list[Chart]:
    """Charts of balanced accuracy against the time for which a driver was observed."""
    charts = []
    wanted = [
        r for r in rows
        if r["metric"] == "balanced_accuracy" and r.get("window_s") is not None
        and r["protocol"] == "inductive" and not r.get("variation")
    ]  # fmt: skip
    for (scenario,), here in grouped(wanted, ["scenario"]).items():
        lines = [
            line_of(name, part, "window_s")
            for (name,), part in grouped(here, ["method"]).items()
            if len(part) > 1
        ]
        title = f"{scenario}: {name_of('balanced_accuracy')} against seconds observed"
        charts.append(
            Chart(title, Axis("observed, s"), Axis("balanced accuracy", low=0.0), tuple(lines))
        )
    return charts


def _loop_charts(rows: Sequence[Row]) -> list[Chart]:
    """Charts of the cost of a frame against the numbers of vehicles and lanes, and real time."""
    wanted = [
        r for r in rows
        if r["metric"] == "ms_median" and r.get("vehicles")
    ]  # fmt: skip
    charts = []
    for key, label, kept in (("agents", "vehicles", "lanes"), ("lanes", "lanes", "vehicles")):
        for (fixed,), here in grouped(wanted, [kept]).items():
            sizes = sorted({_number(r[key]) for r in here})
            if len(sizes) < 2:
                continue
            lines = [line_of(name, part, key) for (name,), part in grouped(here, ["stage"]).items()]
            real = (Point(sizes[0], REAL_TIME_MS), Point(sizes[-1], REAL_TIME_MS))
            lines.append(Line("real time", real, thin=True))
            other = "lanes" if kept == "lanes" else "vehicles"
            title = f"Cost of a frame against {label}: {fixed} {other}"
            x, y = Axis(label, log=True), Axis("CPU per frame, ms", log=True)
            charts.append(Chart(title, x, y, tuple(lines)))
    return charts


def _runtime_charts(rows: Sequence[Row]) -> list[Chart]:
    """Charts of CPU time against the number of vehicles, on logarithmic axes."""
    charts = []
    wanted = [r for r in rows if r["metric"] == "cpu_ms" and r.get("d") is not None]
    for (end, graph, kind), here in grouped(wanted, ["end", "graph", "kind"]).items():
        lines = [line_of(name, part, "d") for (name,), part in grouped(here, ["solver"]).items()]
        title = f"CPU time per step against vehicles: {end} eigenpairs, {graph}, {kind} graph"
        charts.append(
            Chart(title, Axis("vehicles d", log=True), Axis("CPU, ms", log=True), tuple(lines))
        )
    return charts
