"""The commands about files and names: ``import``, ``export``, ``road`` and ``list``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from experiments.cli.options import (
    DatasetFolder,
    FormatName,
    GivenLabels,
    Json,
    Net,
    Quiet,
    in_a_folder,
    metres_of,
    names_of,
    pairs_of,
    refuse_to_overwrite,
)


def import_(
    source: Annotated[Path, typer.Argument(help="A recording, or a folder of recordings.")],
    out: Annotated[Path, typer.Option(help="Folder of the dataset.")],
    format: FormatName = None,
    net: Net = None,
    types: Annotated[
        Path | None,
        typer.Option(dir_okay=False, metavar="FILE", help="vTypes of a SUMO recording, for sizes."),
    ] = None,
    labels: GivenLabels = None,
    rate: Annotated[
        float | None,
        typer.Option(metavar="HZ", min=1e-3, help="Frames per second, where the files are wrong."),
    ] = None,
    shift: Annotated[
        str | None,
        typer.Option(metavar="X,Y", help="Move the map so far onto the positions, m."),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            metavar="id=NAME,t=NAME,x=NAME,y=NAME",
            help="Columns of your own table; also heading, speed, vx, vy, length, width, kind.",
        ),
    ] = None,
    units: Annotated[
        str | None,
        typer.Option(metavar="t=ms,x=ft", help="Units of these columns, where they are not SI."),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="What the scenario is called; the format's name if not."),
    ] = None,
    split: Annotated[
        Literal["train", "validation", "test"] | None,
        typer.Option(help="The part of the data that everything belongs to.", show_default="all"),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Make a dataset of recordings in other formats."""
    from experiments.cli.generate import size_of
    from experiments.console.notices import say
    from experiments.data.exchange import import_recordings

    import_recordings(
        source, out, format, net, split, quiet, types, labels, rate, metres_of(shift),
        pairs_of("columns", columns), pairs_of("units", units) or None, name,
    )  # fmt: skip
    say(size_of(out))


def export(
    dataset: DatasetFolder,
    format: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="KEY",
            help="See graphrqi list.",
            autocompletion=names_of("format"),
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder to write into.")],
    quiet: Quiet = False,
) -> None:
    """Write a dataset in another format."""
    from experiments.console.notices import say
    from experiments.data.exchange import export_dataset

    written = export_dataset(dataset, out, format, quiet)
    say(f"{out}: {len(written)} files written")


def road(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="SUMO net, OpenStreetMap, OpenDRIVE, Lanelet2, CommonRoad or Argoverse 2 map.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="NAME",
            callback=in_a_folder,
            help="Write NAME.net.xml, the picture NAME.svg, and the scenario NAME.toml.",
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Say what a map holds, what it lacks and what is wrong with it; draw it; make it drivable."""
    from experiments.console.notices import say
    from experiments.console.tables import show_table
    from experiments.guard import guarded_call
    from experiments.score.rows import stamped, tidy_row
    from scenarios.own.survey import survey
    from sim.files import write_whole
    from sim.input_files import read_bytes
    from sim.road.net import MAX_NET_BYTES

    found = guarded_call(file, survey, file)
    if out is not None:
        files = {
            Path(f"{out}.net.xml"): read_bytes(found.net, MAX_NET_BYTES),
            Path(f"{out}.svg"): found.picture().encode(),
            Path(f"{out}.toml"): f'net = "{out.name}.net.xml"\nflow = "medium"\n'.encode(),
        }
        refuse_to_overwrite([file], list(files))
        for path, content in files.items():
            write_whole(path, content)
    lines = found.rows()
    rows = [
        tidy_row({"text": value}, str(what), None)
        if isinstance(value := line["value"], str)
        else tidy_row({"text": None}, str(what), value)
        for line in lines
        for what in [line["what"]]
    ]
    show_table(stamped(rows, "road"), json, lines=lines)
    if out is not None and str(json) != "-":
        say(f"{out}.net.xml, {out}.svg and {out}.toml: graphrqi run {out}.toml")


def list_names(json: Json = None) -> None:
    """Show every registered name, the distribution that it comes from, and what it is."""
    from experiments.cli.names import registered_names
    from experiments.console.tables import show_table
    from experiments.score.rows import stamped

    show_table(stamped(registered_names(), "list"), json)
