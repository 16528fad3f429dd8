"""The commands that make pages and pictures: ``replay`` and ``report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import (
    FormatName,
    ModelName,
    Net,
    Quiet,
    Source,
    names_of,
    refuse_to_overwrite,
)


def replay(
    source: Source,
    out: Annotated[
        Path, typer.Option(dir_okay=False, metavar="FILE.html", help="The page.")
    ] = Path("replay.html"),
    episode: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="A name as classify shows it, an id or its beginning, or a scenario (default: "
            "the first).",
        ),
    ] = None,
    labels: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False, metavar="FILE.parquet", help="From classify (default: made here)."
        ),
    ] = None,
    predictions: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False, metavar="FILE.parquet", help="From predict (default: made here)."
        ),
    ] = None,
    format: FormatName = None,
    net: Net = None,
    model: ModelName = "graphrqi-plus",
    predictor: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="See graphrqi list; none for no predictions (default: graphrqi-predict).",
            autocompletion=names_of("predictor"),
        ),
    ] = None,
    color: Annotated[
        str | None,
        typer.Option(metavar="MODE", help="At first: true, predicted, confidence, speed or w."),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False,
            metavar="FILE",
            help="Draw one moment of it too (.png, .pdf or .svg), or a film (.mp4 or .gif).",
        ),
    ] = None,
    begin_s: Annotated[
        float | None, typer.Option("--begin-s", help="When page, film or picture begin, s.")
    ] = None,
    end_s: Annotated[float | None, typer.Option("--end-s", help="When the film ends, s.")] = None,
    quiet: Quiet = False,
) -> None:
    """Make a page that plays an episode in a browser."""
    from experiments.console.notices import say
    from experiments.replay.write import ReplayOptions, write_replay

    refuse_to_overwrite([source, labels, predictions, net], [out, picture])
    options = ReplayOptions(
        episode=episode, labels=labels, predictions=predictions, format=format, net=net,
        model=model, predictor=predictor, color=color, begin_s=begin_s, end_s=end_s,
        picture=picture,
    )  # fmt: skip
    for path in write_replay(source, out, options, quiet):
        say(str(path))


def report(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...", help="Files of rows, or folders of runs or models."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False,
            metavar="FILE",
            help="The page (default: beside the rows or in the folder; comparison.html of "
            "several).",
        ),
    ] = None,
    figures: Annotated[
        str | None,
        typer.Option(
            metavar="svg|pdf", help="Write the page's pictures beside it in this format, too."
        ),
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes.")] = None,
    quiet: Quiet = False,
) -> None:
    """Make a page of tables and pictures; of several runs, one that compares them."""
    from experiments.console.notices import say
    from experiments.report.page import write_report

    refuse_to_overwrite(runs, [out])
    say(str(write_report(runs, out, figures, jobs, quiet)))
