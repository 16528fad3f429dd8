"""The commands about files and names: ``import``, ``export``, ``verify``, ``road`` and ``list``."""

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
    NewDataset,
    Quiet,
    file_option,
    in_a_folder,
    option,
    refuse_to_overwrite,
)


def say_size(out: Path) -> None:
    """Say where a dataset is and how large it is: the last line of a command that makes one."""
    from experiments.console.notices import say
    from sim.files import place_of
    from sim.store.dataset import open_dataset

    dataset = open_dataset(out)
    steps = sum(dataset.totals.column("agent_steps").to_pylist())
    say(f"{place_of(out).url}: {len(dataset)} episodes, {steps} agent-steps")


def import_(
    source: Annotated[Path, typer.Argument(help="A recording, or a folder of recordings.")],
    out: NewDataset,
    format: FormatName = None,
    net: Net = None,
    types: Annotated[Path | None, file_option("vTypes of a SUMO recording, for sizes.")] = None,
    labels: GivenLabels = None,
    rate: Annotated[
        float | None,
        option("Frames per second, where the files are wrong.", metavar="HZ", min=1e-3),
    ] = None,
    shift: Annotated[
        str | None, option("Move the map so far onto the positions, m.", metavar="X,Y")
    ] = None,
    columns: Annotated[
        str | None,
        option("Columns of your own table; also heading, speed, vx, vy, length, width, kind.",
               metavar="id=NAME,t=NAME,x=NAME,y=NAME"),
    ] = None,
    units: Annotated[
        str | None, option("Units of these columns, where they are not SI.", metavar="t=ms,x=ft")
    ] = None,
    name: Annotated[
        str | None, option("What the scenario is called; the format's name if not.", metavar="NAME")
    ] = None,
    split: Annotated[
        Literal["train", "validation", "test"] | None,
        option("The part of the data that everything belongs to.", show_default="all"),
    ] = None,
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Make a dataset of recordings in other formats."""
    from experiments.data.exchange import import_recordings

    import_recordings(
        source, out, format, net, split, quiet, types, labels, rate, _metres(shift),
        _pairs("columns", columns), _pairs("units", units) or None, name,
    )  # fmt: skip
    say_size(out)


def _metres(text: str | None) -> tuple[float, float] | None:
    """Two lengths in metres from ``X,Y``."""
    if text is None:
        return None
    try:
        x, y = (float(word) for word in text.split(","))
    except ValueError:
        from behaviors.errors import InputError

        raise InputError(f"--shift: found {text!r:.60}, expected X,Y in metres") from None
    return x, y


def _pairs(what: str, text: str | None) -> dict[str, str] | None:
    """Values by name from ``NAME=VALUE,NAME=VALUE``."""
    if text is None:
        return None
    found = dict(word.split("=", 1) for word in text.split(",") if word.count("="))
    if len(found) != len(text.split(",")) or not all(found.values()):
        from behaviors.errors import InputError

        raise InputError(f"--{what}: found {text!r:.80}, expected NAME=VALUE,NAME=VALUE")
    return {key.strip(): value.strip() for key, value in found.items()}


def export(
    dataset: DatasetFolder,
    format: Annotated[
        str,
        option("See graphrqi list; vtypes: SUMO's vehicle types of the drivers, of a dataset or "
               "of behaviours (a TOML file, or distracted, novice).", "--format", metavar="KEY",
               names="format"),
    ],
    out: Annotated[Path, option("Folder to write into.")],
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Write a dataset, or its drivers alone, in another format."""
    from experiments.console.notices import say
    from experiments.data.exchange import export_dataset
    from experiments.data.vtypes import export_types

    if format == "vtypes":
        written = export_types(str(dataset), out)
    else:
        written = export_dataset(dataset, out, format, quiet)
    say(f"{out}: {len(written)} files written")


def verify(dataset: DatasetFolder, json: Json = None) -> None:
    """Compare every file with its checksum."""
    from experiments.console.notices import say
    from experiments.data.verify import verify_dataset
    from experiments.score.rows import show_table, stamped, tidy_row

    flaws = verify_dataset(dataset)
    if flaws or json is not None:
        lines = [{"file": str(f.path), "state": f.state} for f in flaws]
        rows = [tidy_row(line, "wrong_files", 1) for line in lines]
        show_table(stamped(rows, "verify"), json, lines=lines)
    if flaws:
        say(f"graphrqi: error: {dataset}: found {len(flaws)} wrong files", err=True)
        raise typer.Exit(2)
    if json is None:
        say(f"{dataset}: every file is as its catalogue says")


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
        option("Write NAME.net.xml, the picture NAME.svg, and the scenario NAME.toml.",
               metavar="NAME", callback=in_a_folder),
    ] = None,
    left_hand: Annotated[
        bool | None,
        typer.Option(
            "--left-hand/--right-hand",
            help="On which side traffic drives, of OpenStreetMap.",
            show_default="as the map says",
        ),
    ] = None,
    json: Json = None,
) -> None:  # fmt: skip
    """Say what a map holds, what it lacks and what is wrong with it; draw it; make it drivable."""
    from experiments.console.notices import say
    from experiments.guard import guarded_call
    from experiments.score.rows import show_table, stamped, tidy_row
    from scenarios.own.survey import survey
    from sim.files import write_whole
    from sim.input_files import read_bytes
    from sim.road.net import MAX_NET_BYTES

    found = guarded_call(file, survey, file, left_hand)
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
    rows = []
    for line in lines:
        value = line["value"]
        text, number = (value, None) if isinstance(value, str) else (None, value)
        rows.append(tidy_row({"text": text}, str(line["what"]), number))
    show_table(stamped(rows, "road"), json, lines=lines)
    if out is not None and str(json) != "-":
        say(f"{out}.net.xml, {out}.svg and {out}.toml: graphrqi run {out}.toml")


def list_names(json: Json = None) -> None:
    """Show every registered name, the distribution that it comes from, and what it is."""
    from experiments.cli.names import registered_names
    from experiments.score.rows import show_table, stamped

    show_table(stamped(registered_names(), "list"), json)
