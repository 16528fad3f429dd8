"""``graphrqi bench NAME``: a command for every registered bench, made from its settings."""

from __future__ import annotations

import dataclasses
import inspect
import typing
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from experiments.cli.options import json_option

if TYPE_CHECKING:
    from experiments.benches.contract import Bench

Json = Annotated[
    Path | None,
    json_option("Write the rows as JSON, after every part of the bench; - for standard output."),
]
Quick = Annotated[bool, typer.Option("--quick", help="Small sizes, in a minute or so.")]
Plot = Annotated[
    Path | None,
    typer.Option(
        "--plot", dir_okay=False, metavar="FILE", help="Draw the rows: .pdf, .png or .svg."
    ),
]


class BenchGroup(TyperGroup):
    """The benches of the registry as commands; each bench is imported when it is asked for."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names of all benches."""
        from experiments.benches.registry import BENCHES

        return list(BENCHES)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of one bench; None if there is no such bench."""
        from experiments.benches.registry import BENCHES

        return bench_command(BENCHES[cmd_name]) if cmd_name in BENCHES else None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The bench that the arguments name, and what follows.

        Raises:
            InputError: if there is no such bench; the message suggests the nearest name.
        """
        from behaviors.errors import lookup
        from experiments.benches.registry import BENCHES

        if not ctx.resilient_parsing:
            lookup(BENCHES, args[0], "bench")
        return super().resolve_command(ctx, args)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """What follows ``graphrqi bench``; where nothing does, the help is shown."""
        if not args and not ctx.resilient_parsing:  # as it is while the shell completes a name
            typer.echo(ctx.get_help())
            ctx.exit()
        return super().parse_args(ctx, args)


def bench_command(bench: Bench[Any]) -> Any:
    """A bench's command: an option for every field of its settings that is one.

    Args:
        bench: what to run; ``--quick`` takes its quick settings, and every other option replaces
            one of the settings.
    """
    types = typing.get_type_hints(type(bench.full))
    offered = [f for f in dataclasses.fields(bench.full) if "help" in f.metadata]
    annotations: dict[str, Any] = {}
    for entry in offered:
        kind = types[entry.name]
        listed = typing.get_origin(kind) is tuple
        annotations[entry.name] = Annotated[
            list[str] | None if listed else kind | None,
            typer.Option(
                "--" + entry.name.replace("_", "-"),
                help=f"{entry.metadata['help']}{_default(getattr(bench.full, entry.name))}",
                metavar=entry.metadata["metavar"] or ("A,B" if listed else None),
            ),
        ]
    annotations["quick"], annotations["json"] = Quick, Json
    if bench.plot is not None:
        annotations["plot"] = Plot

    def command(quick: bool, json: Path | None, **given: Any) -> None:
        if given.get("plot") is not None:
            from experiments.figure_files import check_figure_file

            check_figure_file(given["plot"], "--plot")
        plot = None if bench.plot is None else given.pop("plot")
        settings = bench.quick if quick else bench.full
        chosen = {
            name: _parsed(name, value, types[name]) if isinstance(value, list) else value
            for name, value in given.items()
            if value not in (None, [])
        }
        _measure(bench, dataclasses.replace(settings, **chosen), json, plot)

    command.__annotations__ = annotations
    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=False if name == "quick" else None,
                annotation=annotation,
            )
            for name, annotation in annotations.items()
        ]
    )
    app = typer.Typer(add_completion=False)
    app.command(
        bench.name,
        help=bench.summary,
        epilog=f"example: graphrqi bench {bench.name} --quick --json {bench.name}.json",
    )(command)
    return typer.main.get_command(app)


def _measure(bench: Bench[Any], settings: Any, json: Path | None, plot: Path | None) -> None:
    from experiments.console.tables import show_table, write_rows

    kept = None if json is None or str(json) == "-" else partial(write_rows, path=json)
    rows = bench.run(settings, kept)
    if plot is not None and bench.plot is not None:
        bench.plot(rows, plot)
    if json is not None:
        write_rows(rows, json)
    if json is None or str(json) != "-":
        show_table(rows if bench.table is None else bench.table(rows))


def _default(value: object) -> str:
    if value is None or value == ():
        return ""
    words = ",".join(map(str, value)) if isinstance(value, tuple) else value
    return f" (default: {words})"


def _parsed(name: str, texts: Sequence[str], kind: Any) -> tuple[object, ...]:
    """A tuple from words between commas, of an option that may be repeated."""
    from behaviors.errors import InputError

    words = [word.strip() for text in texts for word in text.split(",") if word.strip()]
    if typing.get_args(kind)[0] is not int:
        return tuple(words)
    try:
        return tuple(int(word) for word in words)
    except ValueError:
        option, found = name.replace("_", "-"), ",".join(texts)
        raise InputError(f"--{option}: found {found!r}, expected whole numbers: 25,100") from None
