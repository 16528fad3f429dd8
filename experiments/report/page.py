"""Report pages: findings, tables, pictures and worst cases, from tidy rows."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from behaviors.errors import InputError, lookup
from experiments.replay.pictures import figure_bytes
from experiments.report.findings import findings
from experiments.report.pictures import Picture, pictures_of
from experiments.report.tables import tables_of
from experiments.report.worst_cases import take_excerpts
from experiments.score.rows import MADE, checked_rows, read_rows
from graphrqi.model_files import FILE, load_model
from sim.files import write_whole
from sim.store.dataset import is_dataset

FORMATS: Final = {"svg": ".svg", "pdf": ".pdf"}
"""Formats of pictures in files of their own, and their endings."""


def read_source(path: Path) -> pd.DataFrame:
    """The rows with a value of a file, of a folder with such files, or of a model's folder."""
    if path.is_file():
        rows = read_rows(path)
    elif not path.is_dir():
        raise InputError(f"{path}: found nothing there, expected a file of rows or a folder")
    elif (path / FILE).is_file():
        card = load_model(path).card
        rows = checked_rows(card.get("scores", []), f"{path / FILE}: card.scores")
    else:
        rows = [row for file in sorted(path.glob("*.json")) for row in read_rows(file)]
    measured = [row for row in rows if row.get("value") is not None]
    if not measured:
        raise InputError(
            f"{path}: found no figure, expected rows as graphrqi COMMAND --json FILE writes them"
        )
    table = pd.DataFrame(measured)
    for column in ("low", "high", "n"):
        table[column] = pd.to_numeric(table[column]) if column in table else np.nan
    return table


def write_report(
    paths: Sequence[Path],
    out: Path | None = None,
    figures: str | None = None,
    jobs: int | None = None,
    quiet: bool = True,
) -> Path:
    """Write the page of some rows; of several files or folders, one that compares them.

    The page loads nothing. By default it is ``report.html`` in the folder, beside a file by its
    name, or ``comparison.html`` for several. Pictures are written beside it, too, as ``svg`` or
    ``pdf``. A run with its data and model, as ``make demo`` leaves it, gets worst cases, which
    link to replays beside the page.
    """
    ending = None if figures is None else lookup(FORMATS, figures, "format of figures")
    path, many = paths[0], len(paths) > 1
    names = [path.stem if path.is_file() else path.resolve().name for path in paths]
    tables = [read_source(path) for path in paths]
    if out is None:
        out = path / "report.html" if path.is_dir() else path.with_suffix(".html")
        out = Path("comparison.html") if many else out
    rows = tables[0]
    if many:
        runs = names if len(set(names)) == len(names) else [str(path) for path in paths]
        together = [table.assign(run=run) for table, run in zip(tables, runs, strict=True)]
        rows = pd.concat(together, ignore_index=True)
    shown: list[dict[str, Any]] = [
        {
            "title": name,
            "tables": list(tables_of(part, ["run"] if many else [])),
            "pictures": list(pictures_of(part)),
        }
        for name, part in rows.groupby("command", sort=False)
    ]
    is_run = (path / "model" / FILE).is_file() and is_dataset(path / "data")
    looked = is_run and not many and out.parent.samefile(path)
    excerpts = list(take_excerpts(path, jobs, quiet)) if looked else []
    environment = Environment(
        loader=PackageLoader("experiments.report", "."), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["drawn"] = _drawn
    page = environment.get_template("page.html").render(
        title=" beside ".join(names),
        findings=[] if many else findings(rows),
        sections=shown,
        excerpts=excerpts,
        made=rows[[key for key in MADE if key in rows]].drop_duplicates().fillna(""),
    )
    write_whole(out, page.encode())
    if ending is not None:
        folder = out.with_name(f"{out.stem}-figures")
        folder.mkdir(exist_ok=True)
        pictures = [picture for part in (*shown, *excerpts) for picture in part["pictures"]]
        for number, (title, figure) in enumerate(pictures, start=1):
            name = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")[:80]
            write_whole(folder / f"{number:02d}-{name}{ending}", figure_bytes(figure, ending))
    return out


def _drawn(picture: Picture) -> Markup:
    """A picture as an image that the page holds."""
    data = base64.b64encode(figure_bytes(picture.figure, ".svg")).decode()
    image = '<img alt="{}" src="data:image/svg+xml;base64,{}">'
    return Markup(image).format(picture.title, data)
