"""Options that several commands share: their names, types and help."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from typer.models import OptionInfo


def in_a_folder(path: Path | None) -> Path | None:
    """Refuse a file to write whose folder is missing, before any work is done.

    Raises:
        InputError: naming the folder.
    """
    from sim.store.places import is_remote

    if path is None or str(path) == "-" or is_remote(path):
        return path
    if not path.parent.is_dir():
        from behaviors.errors import InputError

        raise InputError(f"{path}: found no folder {path.parent}, expected one")
    return path


def table_to_write(path: Path | None) -> Path | None:
    """Refuse a table of another ending than those written, or whose folder is missing.

    Raises:
        InputError: naming the ending or the folder.
    """
    if path is not None:
        from experiments.scoring.table_file import check_ending

        check_ending(path)
    return in_a_folder(path)


def at_least_one(jobs: int | None) -> int | None:
    """Refuse no process, and fewer.

    Raises:
        InputError: naming the number.
    """
    if jobs is not None:
        from experiments.data.parallel import checked_jobs

        checked_jobs(jobs)
    return jobs


def metres_of(text: str | None) -> tuple[float, float] | None:
    """Two lengths in metres from ``X,Y``; None stays.

    Raises:
        InputError: if it is anything else.
    """
    if text is None:
        return None
    try:
        x, y = (float(word) for word in text.split(","))
    except ValueError:
        from behaviors.errors import InputError

        raise InputError(f"--shift: found {text!r:.60}, expected X,Y in metres") from None
    return x, y


def names_of(what: str) -> Callable[[str], list[str]]:
    """What the shell offers when a registered name is being typed."""

    def complete(incomplete: str) -> list[str]:
        from experiments.cli.doctor import names_of as registered

        return [name for name in registered(what) if name.startswith(incomplete)]

    return complete


def json_option(help: str) -> OptionInfo:
    """The option ``--json FILE``, with what it writes."""
    option: OptionInfo = typer.Option(
        "--json",
        dir_okay=False,
        callback=in_a_folder,
        allow_dash=True,
        metavar="FILE",
        help=help,
    )
    return option


Source = Annotated[Path, typer.Argument(help="A dataset, a recording, or a folder of them.")]
Jobs = Annotated[
    int | None, typer.Option(callback=at_least_one, help="Processes [default: one per core].")
]
Json = Annotated[Path | None, json_option("Write the table as JSON; - for standard output.")]
ModelName = Annotated[
    str, typer.Option("--model", help="A model that ships, or a folder written by train.")
]
FormatName = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="KEY",
        help="Told from the content if left out.",
        autocompletion=names_of("format"),
    ),
]
Net = Annotated[
    Path | None,
    typer.Option(
        "--net",
        dir_okay=False,
        metavar="FILE",
        help="SUMO net or map that a recording was made on.",
    ),
]
OwnNet = Annotated[
    str | None,
    typer.Option(
        "--net",
        metavar="FILE",
        help="Instead of a scenario, a map: SUMO net, OpenStreetMap, OpenDRIVE, Lanelet2, "
        "CommonRoad or Argoverse 2.",
    ),
]
Routes = Annotated[
    str | None,
    typer.Option(metavar="FILE", help="SUMO routes for the map [default: made from the map]."),
]
Seed = Annotated[int, typer.Option(min=0, help="Same seed, same result.")]
LabelsFile = Annotated[
    Path | None,
    typer.Option(
        dir_okay=False,
        callback=table_to_write,
        metavar="FILE",
        help="File for the answers, too: .parquet or .csv.",
    ),
]
GivenLabels = Annotated[
    Path | None,
    typer.Option(
        "--labels",
        dir_okay=False,
        metavar="FILE.csv",
        help="Known drivers: columns name and label (a behaviour or style), or also recording.",
    ),
]
Version = Annotated[
    bool, typer.Option("--version", help="Say the version, and those of the simulators.")
]
Verbose = Annotated[
    bool,
    typer.Option(
        "--verbose", "-v", help="Say on stderr what is read and how long it took; anywhere."
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")]
Engine = Annotated[
    str,
    typer.Option(help="Which simulator; see graphrqi list.", autocompletion=names_of("engine")),
]
Flow = Annotated[
    str | None,
    typer.Option(metavar="FLOW", help="light, medium, dense or vehicles per hour, at most 100000."),
]
Mix = Annotated[
    str | None,
    typer.Option(metavar="MIX", help="Shares of behaviours or styles: aggressive=.2,timid=.8."),
]
Spread = Annotated[
    float | None, typer.Option(help="How much drivers of one behaviour differ; 0 gives clones.")
]
PopulationName = Annotated[
    str | None,
    typer.Option(
        "--population",
        metavar="NAME or FILE",
        help="Of which drivers are drawn: a name (see graphrqi list) or a TOML file, such as "
        "calibrate writes.",
        autocompletion=names_of("population"),
    ),
]
WindowText = Annotated[
    str | None,
    typer.Option(
        "--window",
        metavar="AGENT[:M] or X0,Y0,X1,Y1",
        help="Classify and predict only an agent and those within 100 m (or M), or only an area.",
    ),
]
DurationS = Annotated[float | None, typer.Option("--duration-s", help="Length, s; at most 86400.")]
ScenarioOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Another option of the scenario, such as lanes=2; repeat for several.",
    ),
]
FLAGS = ("flow", "mix", "spread", "population", "duration_s")
"""Options of a scenario that commands have beside ``--set``."""
