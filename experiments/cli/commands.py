"""The ``graphrqi`` command.

Only typer is imported here; each command imports what it needs when it runs, so that help appears
at once. Whatever a user can do wrong ends in one line on stderr and exit code 2.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Final

import typer

from experiments.cli.bench import bench
from experiments.cli.files import export, import_, list_names, road, verify
from experiments.cli.generate import generate, run
from experiments.cli.models import calibrate, classify, evaluate, predict, train
from experiments.cli.options import Quiet
from experiments.cli.pages import replay, report, summary
from experiments.cli.what_if import drive, what_if
from experiments.console.exit_codes import STOPPED, Interrupted, exit_on_user_error
from experiments.console.notices import LOGGER, show_notices
from experiments.guard import guarding

app = typer.Typer(
    name="graphrqi",
    help="Label, classify and predict drivers in simulated and recorded traffic.",
    invoke_without_command=True,
    epilog="Exit codes: 0 done; 2 something asked for is wrong or missing, said in one line; "
    "130 stopped by Ctrl-C; 1 a defect of the program.",
    pretty_exceptions_enable=False,
)

SIMULATE, DATA, LEARN = "Simulate traffic", "Data", "Drivers: learn, classify, predict"
ASK, LOOK = "What if, and how safe", "Look and measure"

COMMANDS: Final[tuple[tuple[str, str, Callable[..., Any], str], ...]] = (
    (SIMULATE, "run", run, "run straight_road --flow dense --stream --predict"),
    (SIMULATE, "generate", generate,
     "generate --scenario straight_road --episodes 9 --out roads"),
    (SIMULATE, "road", road, "road town.osm --out town"),
    (DATA, "import", import_, "import recordings --format ngsim --out data"),
    (DATA, "export", export, "export data --format argoverse2 --out exported"),
    (DATA, "verify", verify, "verify data"),
    (LEARN, "train", train, "train data --method graphrqi-plus --out model"),
    (LEARN, "classify", classify, "classify data --out labels.parquet"),
    (LEARN, "evaluate", evaluate, "evaluate graphrqi-plus data --json scores.json"),
    (LEARN, "predict", predict, "predict data --predictors car-following --horizon-s 5"),
    (LEARN, "calibrate", calibrate, "calibrate recordings --out drivers"),
    (ASK, "what-if", what_if,
     "what-if straight_road --at-s 30 --agent 8 --behavior timid --out what-if"),
    (ASK, "drive", drive, "drive --policy planner --quick"),
    (LOOK, "summary", summary, "summary data --by behavior --out summary.csv"),
    (LOOK, "replay", replay, "replay data --episode straight_road --out replay.html"),
    (LOOK, "report", report, "report runs/demo"),
    (LOOK, "list", list_names, "list"),
)  # fmt: skip
"""The commands by their groups in the help, each with an example."""

for panel, name, command, example in COMMANDS:
    app.command(name, rich_help_panel=panel, epilog=f"example: graphrqi {example}")(command)

app.add_typer(bench, name="bench", rich_help_panel=LOOK)


@app.callback()
def about(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", help="Say the version, and those of the simulators.")
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option("--verbose", "-v", help="Say on stderr what is read and how long it took."),
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Label, classify and predict drivers in simulated and recorded traffic."""
    if version:
        from experiments.cli.names import version_line

        typer.echo(version_line())
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit
    if quiet:
        context.default_map = {context.invoked_subcommand: {"quiet": True}}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and end the process.

    Args:
        arguments: the command's arguments; by default those of the process.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    others = [word for word in given if word not in ("-v", "--verbose")]
    show_notices(quiet=bool({"-q", "--quiet"} & set(given)), verbose=len(others) < len(given))
    began_s = time.monotonic()
    with exit_on_user_error(), guarding():
        code = app(others, prog_name="graphrqi", standalone_mode=False)
        if code == STOPPED:
            raise Interrupted("stopped")  # typer swallows a Ctrl-C and returns its code
    LOGGER.debug("done in %.1f s", time.monotonic() - began_s)
    sys.exit(code if isinstance(code, int) else 0)


if __name__ == "__main__":
    main()
