"""``graphrqi road``: what a map holds, lacks and has wrong, and the files to drive on it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import Json, in_a_folder


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
            help="Write NAME.net.xml, the picture NAME.svg, and the scenario NAME.toml.",
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Say what a map holds, what it lacks and what is wrong with it; draw it; make it drivable."""
    from behaviors.errors import InputError
    from experiments.console.notices import say
    from experiments.console.tables import show_table
    from experiments.guard import guarded_call
    from scenarios.own.survey import survey
    from sim.road.net import MAX_NET_BYTES
    from sim.store.atomic import write_whole
    from sim.xml_tree import read_bytes

    in_a_folder(out)
    found = guarded_call(file, survey, file)
    if out is not None:
        files = {
            Path(f"{out}.net.xml"): read_bytes(found.net, MAX_NET_BYTES),
            Path(f"{out}.svg"): found.picture().encode(),
            Path(f"{out}.toml"): f'net = "{out.name}.net.xml"\nflow = "medium"\n'.encode(),
        }
        if any(path.resolve() == file.resolve() for path in files):
            raise InputError(f"--out: found {out}, which would overwrite {file}")
        for path, content in files.items():
            write_whole(path, content)
    show_table(found.rows(), json)
    if out is not None and str(json) != "-":
        say(f"{out}.net.xml, {out}.svg and {out}.toml: graphrqi run {out}.toml")
