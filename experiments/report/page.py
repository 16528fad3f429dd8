"""Report pages: findings, tables, pictures and worst cases, from tidy rows."""

from __future__ import annotations

import base64
import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from behaviors.errors import InputError, lookup
from experiments.figure_files import figure_bytes
from experiments.report.findings import findings
from experiments.report.pictures import Picture, pictures_of
from experiments.report.tables import tables_of
from experiments.report.worst_cases import Excerpt, take_excerpts
from experiments.score.rows import MADE, Row, checked_rows, read_rows
from graphrqi.model_files import FILE, load_model
from sim.files import write_whole
from sim.store.catalogue import is_dataset

MARK: Final = b"GraphRQI"
"""Mark in the head of every page that is written here; another page is not overwritten."""

HEAD_BYTES: Final = 2000
"""Bytes of a page in which this mark is looked for."""

FORMATS: Final = {"svg": ".svg", "pdf": ".pdf"}
"""Formats of pictures in files of their own, and their endings."""


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """One thing to report on.

    Attributes:
        path: the file or folder.
        name: what it is called.
        rows: the figures, a row each; those without a value are left out.
    """

    path: Path
    name: str
    rows: pd.DataFrame

    @property
    def is_run(self) -> bool:
        """Whether the data and the model of the figures lie beside them, as ``make demo`` does."""
        return (self.path / "model" / FILE).is_file() and is_dataset(self.path / "data")


def read_source(path: Path) -> Source:
    """The rows of a file, of a folder with such files, or of a model's folder.

    Raises:
        InputError: if there is nothing to report on, or a file is broken.
    """
    if path.is_file():
        return Source(path, path.stem, _table_of(read_rows(path), path))
    if not path.is_dir():
        raise InputError(f"{path}: found nothing there, expected a file of rows or a folder")
    if (path / FILE).is_file():
        card = load_model(path).card
        rows = checked_rows(card.get("scores", []), f"{path / FILE}: card.scores")
    else:
        rows = [row for file in sorted(path.glob("*.json")) for row in read_rows(file)]
    return Source(path, path.resolve().name, _table_of(rows, path))


def _table_of(rows: Sequence[Row], path: Path) -> pd.DataFrame:
    """Rows with a value, of which there must be one, as a table."""
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

    Args:
        paths: files of rows, folders with such files, or folders of models.
        out: the page; None for ``report.html`` in the folder, beside a file by its name, or
            ``comparison.html`` for several.
        figures: ``svg`` or ``pdf`` to write the pictures beside the page, too; None for none.
        jobs: processes for looking at a run's episodes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        The page. It loads nothing; a run's worst cases link to the replays beside it.

    Raises:
        InputError: if there is nothing to report on, or a part is broken.
        OSError: if it cannot be written.
    """
    ending = None if figures is None else lookup(FORMATS, figures, "format of figures")
    sources = [read_source(path) for path in paths]
    out = _place(sources) if out is None else out
    if out.is_file() and MARK not in out.read_bytes()[:HEAD_BYTES]:
        raise InputError(f"{out}: found a page that is not a report, expected none; move it away")
    rows, across = _together(sources)
    shown: list[dict[str, Any]] = [
        {
            "title": name,
            "tables": list(tables_of(part, across)),
            "pictures": list(pictures_of(part)),
        }
        for name, part in rows.groupby("command", sort=False)
    ]
    excerpts = list[Excerpt]()
    if len(sources) == 1 and sources[0].is_run and out.parent.samefile(sources[0].path):
        excerpts = take_excerpts(sources[0].path, jobs, quiet)
    environment = Environment(
        loader=PackageLoader("experiments.report", "."), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["drawn"] = _drawn
    page = environment.get_template("page.html").render(
        title=" beside ".join(source.name for source in sources),
        findings=[] if len(sources) > 1 else findings(rows),
        sections=shown,
        excerpts=excerpts,
        made=rows[[key for key in MADE if key in rows]].drop_duplicates().fillna(""),
    )
    write_whole(out, page.encode())
    if ending is not None:
        parts = [*(section["pictures"] for section in shown), *(e.pictures for e in excerpts)]
        _write_pictures(out, ending, itertools.chain(*parts))
    return out


def _place(sources: Sequence[Source]) -> Path:
    if len(sources) > 1:
        return Path("comparison.html")
    path = sources[0].path
    return path / "report.html" if path.is_dir() else path.with_suffix(".html")


def _together(sources: Sequence[Source]) -> tuple[pd.DataFrame, list[str]]:
    """All rows, and the key that distinguishes several sources."""
    if len(sources) == 1:
        return sources[0].rows, []
    names = [source.name for source in sources]
    names = names if len(set(names)) == len(names) else [str(source.path) for source in sources]
    tables = [s.rows.assign(run=name) for s, name in zip(sources, names, strict=True)]
    return pd.concat(tables, ignore_index=True), ["run"]


def _drawn(picture: Picture) -> Markup:
    """A picture as an image that the page holds."""
    data = base64.b64encode(figure_bytes(picture.figure, ".svg")).decode()
    image = '<img alt="{}" src="data:image/svg+xml;base64,{}">'
    return Markup(image).format(picture.title, data)


def _write_pictures(page: Path, ending: str, pictures: Iterable[Picture]) -> None:
    """Write the pictures into a folder beside the page, numbered and named by their titles."""
    folder = page.with_name(f"{page.stem}-figures")
    folder.mkdir(exist_ok=True)
    for number, picture in enumerate(pictures, start=1):
        name = re.sub(r"[^a-z0-9]+", "-", picture.title.lower()).strip("-")[:80]
        write_whole(folder / f"{number:02d}-{name}{ending}", figure_bytes(picture.figure, ending))
