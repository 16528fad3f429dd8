"""The spectrum bench as a table and as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from experiments.benches.spectrum.rows import Row
from experiments.figure_files import write_figure

PAPER_SPEED_UP: Final = 2.0
"""What the paper's abstract claims over the best previous method."""


def spectrum_table(rows: Sequence[Row]) -> list[Row]:
    """Lay the bench out as a table for reading.

    Args:
        rows: of `run_spectrum_bench`.

    Returns:
        One row per solver and sequence: milliseconds of CPU per step for every d ("skipped" where
        it was not run), worst residual, missed pairs, the slopes of cost and memory; for plain
        Rayleigh-quotient iterations, in the rows of ``graphrqi``, the order of convergence and
        the residuals after each.
    """
    sizes = sorted({row["d"] for row in rows if row["d"] is not None})
    lines: dict[tuple[str, ...], Row] = {}
    for row in rows:
        names = ("graph", "kind", "end", "solver")
        key = tuple(str(row[name]) for name in names)
        line = lines.setdefault(
            key,
            dict(zip(names, key, strict=True))
            | {f"{d} (ms)": None for d in sizes}
            | dict.fromkeys(
                ("worst residual", "missed", "slope", "memory slope", "order", "residuals")
            ),
        )
        if row["metric"] == "cpu_ms":
            line[f"{row['d']} (ms)"] = "skipped" if row["value"] is None else row["value"]
        elif row["metric"] == "residual_max":
            line["worst residual"] = max(line["worst residual"] or 0.0, row["value"])
        elif row["metric"] == "missed_pairs":
            line["missed"] = (line["missed"] or 0) + int(row["value"])
        elif row["metric"] in ("slope", "memory_slope"):
            line[row["metric"].replace("_", " ")] = row["value"]
        elif row["metric"] == "order_of_convergence":
            line["order"] = row["value"]
        elif row["metric"].startswith("residual_after_"):
            line["residuals"] = f"{line['residuals'] or ''} {row['value']:.0e}".strip()
    return list(lines.values())


def plot_spectrum(rows: Sequence[Row], path: Path) -> None:
    """Draw CPU time against d, log-log, one panel per sequence.

    The dashed line is what the paper claims: half the time of the best previous method, here the
    quickest rival that missed no pair (of those printed in the paper's table). The runtimes
    printed in the paper were not at hand, and are not drawn.

    Args:
        rows: of `run_spectrum_bench`.
        path: picture to write, its ending says the format.
    """
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    costs = [row for row in rows if row["metric"] == "cpu_ms" and row["value"] is not None]
    panels = list(dict.fromkeys((r["graph"], r["kind"], r["end"]) for r in costs))
    solvers = list(dict.fromkeys(r["solver"] for r in costs))
    wrong = {
        (r["solver"], r["d"], r["graph"], r["kind"], r["end"])
        for r in rows
        if r["metric"] == "missed_pairs" and r["value"] > 0
    }
    columns = min(4, len(panels))
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(4.6 * columns, 4.2 * lines + 1.2), layout="constrained")
    axes = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True)
    styles = [colormaps["tab20"](i % 20) for i in range(len(solvers))]
    sizes = sorted({row["d"] for row in costs})
    ours = ("graphrqi", "positions-to-features")
    for axis, panel in zip(axes.flat, panels, strict=False):
        best: dict[int, float] = {}
        for color, solver in zip(styles, solvers, strict=True):
            points = sorted(
                (r["d"], r["value"])
                for r in costs
                if r["solver"] == solver and (r["graph"], r["kind"], r["end"]) == panel
            )
            if not points:
                continue
            d, value = zip(*points, strict=True)
            axis.plot(
                d,
                value,
                color=color,
                label=solver,
                linewidth=2.6 if solver in ours else 1.1,
                linestyle=":" if solver.startswith("positions") else "-",
                zorder=3 if solver in ours else 2,
            )
            right = [p for p in points if (solver, p[0], *panel) not in wrong]
            bad = [p for p in points if (solver, p[0], *panel) in wrong]
            axis.plot([p[0] for p in right], [p[1] for p in right], "o", color=color, markersize=4)
            axis.plot([p[0] for p in bad], [p[1] for p in bad], "x", color=color, markersize=6)
            if not solver.startswith(("graphrqi", "positions", "lapack")):
                for size, cost in right:
                    best[size] = min(best.get(size, np.inf), cost)
        if best:
            claim = sorted((size, cost / PAPER_SPEED_UP) for size, cost in best.items())
            axis.plot(*zip(*claim, strict=True), "k--", linewidth=1.2, label="claimed in the paper")
        axis.set(title=", ".join(panel) + " end", xscale="log", yscale="log")
        axis.set_xticks(sizes, [str(size) for size in sizes])
        axis.minorticks_off()
        axis.grid(True, which="major", alpha=0.3)
        axis.set_xlabel("vehicles d")
    for axis in axes[:, 0]:
        axis.set_ylabel("CPU per step, ms")
    handles: dict[str, Any] = {}
    for axis in axes.flat:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(
        list(handles.values()),
        list(handles),
        loc="outside lower center",
        ncols=columns + 1,
        fontsize=9,
    )
    figure.suptitle("Eigenvalue algorithms on traffic graphs (crosses: pairs were missed)")
    write_figure(figure, path)
