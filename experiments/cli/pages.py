"""The commands that show data: ``summary``, ``replay`` and ``report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import (
    FormatName,
    Jobs,
    Json,
    ModelName,
    Net,
    Quiet,
    Source,
    file_option,
    named_dataset,
    option,
    refuse_to_overwrite,
)


def summary(
    source: Source,
    by: Annotated[
        str | None, option("Groups: behavior, kind or scenario (default: all together).")
    ] = None,
    format: FormatName = None,
    net: Net = None,
    json: Json = None,
    out: Annotated[
        Path | None, file_option("The same rows as CSV.", "--out", metavar="FILE.csv")
    ] = None,
) -> None:
    """Count conflicts, events and traits per kilometre and hour, with speeds and headways."""
    import pandas as pd

    from behaviors.errors import lookup
    from experiments.score.rows import show_table, stamped
    from experiments.summary import BY, summary, table
    from sim.files import write_whole
    from sim.store.dataset import open_dataset

    if by is not None:
        lookup(BY, by, "--by")
    with named_dataset(source, format, net) as (folder, known):
        found = summary(open_dataset(folder), by)
    rows = stamped(found, "summary", dataset=known)
    if out is not None:
        write_whole(out, pd.DataFrame(rows, dtype=object).to_csv(index=False).encode())
    show_table(rows, json, lines=table(found, by))


def replay(
    source: Source,
    out: Annotated[Path, file_option("The page.", metavar="FILE.html")] = Path("replay.html"),
    episode: Annotated[
        str | None,
        option("A name as classify shows it, an id or its beginning, or a scenario (default: the "
               "first).", metavar="NAME"),
    ] = None,
    labels: Annotated[
        Path | None, file_option("From classify (default: made here).", metavar="FILE.parquet")
    ] = None,
    format: FormatName = None,
    net: Net = None,
    model: ModelName = "graphrqi-plus",
    predictor: Annotated[
        str,
        option("See graphrqi list; none for no predictions.", metavar="NAME", names="predictor"),
    ] = "graphrqi-predict",
    color: Annotated[
        str | None,
        option("At first: true, predicted, confidence, speed or w.", metavar="MODE"),
    ] = None,
    picture: Annotated[
        Path | None,
        file_option("Draw one moment of it too (.png, .pdf or .svg), or a film (.mp4 or .gif)."),
    ] = None,
    begin_s: Annotated[
        float | None, option("When page, film or picture begin, s.", "--begin-s")
    ] = None,
    end_s: Annotated[float | None, option("When the film ends, s.", "--end-s")] = None,
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Make a page that plays an episode in a browser."""
    from experiments.console.notices import say
    from experiments.replay.write import write_replay

    refuse_to_overwrite([source, labels, net], [out, picture])
    written = write_replay(
        source, out, episode=episode, labels=labels, format=format, net=net, model=model,
        predictor=predictor, color=color, begin_s=begin_s, end_s=end_s, picture=picture,
        quiet=quiet,
    )  # fmt: skip
    for path in written:
        say(str(path))


def report(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...", help="Files of rows, or folders of runs or models."),
    ],
    out: Annotated[
        Path | None,
        file_option("The page (default: beside the rows or in the folder; comparison.html of "
                    "several)."),
    ] = None,
    figures: Annotated[
        str | None,
        option("Write the page's pictures beside it in this format, too.", metavar="svg|pdf"),
    ] = None,
    jobs: Jobs = None,
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Make a page of tables and pictures; of several runs, one that compares them."""
    from experiments.console.notices import say
    from experiments.report.page import write_report

    refuse_to_overwrite(runs, [out])
    say(str(write_report(runs, out, figures, jobs, quiet)))
