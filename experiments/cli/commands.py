"""The ``graphrqi`` command.

Only typer is imported here; each command imports what it needs when it runs, so that help appears
at once. Whatever a user can do wrong ends in one line on stderr and exit code 2.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.adapt import adapt
from experiments.cli.bench import BenchGroup
from experiments.cli.calibrate import calibrate, populations
from experiments.cli.classify import classify, evaluate
from experiments.cli.generate import generate, merge, size_of, upgrade
from experiments.cli.input_keeping import InputKeepingCommand
from experiments.cli.options import (
    FLAGS,
    DurationS,
    Engine,
    Flow,
    FormatName,
    GivenLabels,
    Jobs,
    Json,
    Mix,
    ModelName,
    Net,
    OwnNet,
    PopulationName,
    Quiet,
    Routes,
    ScenarioOptions,
    Seed,
    Source,
    Spread,
    Verbose,
    Version,
    WindowText,
    metres_of,
    names_of,
    table_to_write,
)
from experiments.cli.predictors import train_predictor
from experiments.cli.road import road
from experiments.cli.verify import verify
from experiments.cli.what_if import blame, what_if
from experiments.console.exit_codes import STOPPED, Interrupted, exit_on_user_error
from experiments.console.notices import LOGGER, say, show_notices
from experiments.guard import guarding

app = typer.Typer(
    name="graphrqi",
    help="Label, classify and predict drivers in simulated and recorded traffic.",
    invoke_without_command=True,
    epilog="example: graphrqi run straight_road --stream. Exit codes: 0 done; 2 something asked "
    "for is wrong or missing, said in one line; 130 stopped by Ctrl-C; 1 a defect of the program.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.callback()
def about(
    context: typer.Context,
    version: Version = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Label, classify and predict drivers in simulated and recorded traffic."""
    if version:
        from experiments.cli.doctor import version_line

        typer.echo(version_line())
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit
    if quiet:
        context.default_map = {context.invoked_subcommand: {"quiet": True}}


@app.command("list", epilog="example: graphrqi list")
def list_names(json: Json = None) -> None:
    """Show every registered name, the distribution that it comes from, and what it is."""
    from experiments.cli.doctor import registered_names
    from experiments.console.tables import show_table

    show_table(registered_names(), json)


@app.command(epilog="example: graphrqi run straight_road --flow dense --stream --predict")
def run(
    scenario: Annotated[
        str | None,
        typer.Argument(
            help="Name of a scenario (see graphrqi list), its TOML file, or a map.",
            autocompletion=names_of("scenario"),
        ),
    ] = None,
    engine: Engine = "sumo",
    stream: Annotated[bool, typer.Option("--stream", help="Classify drivers as they go.")] = False,
    predict: Annotated[bool, typer.Option("--predict", help="Predict, and score it.")] = False,
    model: ModelName = "graphrqi-plus",
    seed: Seed = 0,
    flow: Flow = None,
    mix: Mix = None,
    spread: Spread = None,
    population: PopulationName = None,
    duration_s: DurationS = None,
    net: OwnNet = None,
    routes: Routes = None,
    option: ScenarioOptions = None,
    window: WindowText = None,
    quiet: Quiet = False,
    json: Json = None,
) -> None:
    """Run a scenario headless and sum up what happened."""
    from experiments.console.tables import show_table
    from experiments.data.configuration import read_config
    from experiments.run import read_window, run_scenario
    from scenarios.command import read_options

    config = read_config(
        None, scenarios=[scenario] if scenario else None, net=net, routes=routes, episodes=1,
        seed=seed, engine=engine, flow=flow, mix=mix, spread=spread, population=population,
        duration_s=duration_s,
        scenario_options=read_options(option or [], FLAGS) or None,
    )  # fmt: skip
    used = model if stream or predict else None
    show_table(run_scenario(config, used, predict, quiet, read_window(window)), json)


app.command(epilog="example: graphrqi road town.osm --out town")(road)


@app.command(epilog="example: graphrqi train data --method graphrqi-plus --out model")
def train(
    dataset: Annotated[Path, typer.Argument(help="Folder written by generate or import.")],
    out: Annotated[Path, typer.Option(help="Folder of the model.")],
    method: Annotated[
        str, typer.Option(help="See graphrqi list.", autocompletion=names_of("method"))
    ] = "graphrqi-plus",
    seed: Seed = 0,
    jobs: Jobs = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Train a method on a dataset's training split, and score it on the test split."""
    from experiments.cli.classify import show_evaluation
    from experiments.rows import write_json
    from experiments.training.classifier import train_on

    rows = train_on([dataset], method, out, seed, quiet, jobs).card["evaluation"]
    if json is not None:
        write_json(rows, json)
    if str(json) == "-":
        return
    say(f"{out}: {method} trained on {dataset}")
    if rows:
        show_evaluation(rows)
    else:
        typer.echo("not scored: the dataset has no test episode with a driver seen for 1 s")


app.command(epilog="example: graphrqi generate --scenario straight_road --episodes 9 --out roads")(
    generate
)
app.command(epilog="example: graphrqi merge s3://bucket/data")(merge)
app.command(epilog="example: graphrqi upgrade old --out new")(upgrade)
app.command("train-predictor", epilog="example: graphrqi train-predictor recordings --out weights")(
    train_predictor
)


app.command(epilog="example: graphrqi classify data --out labels.parquet")(classify)
app.command(epilog="example: graphrqi evaluate graphrqi-plus data --json scores.json")(evaluate)
app.command(epilog="example: graphrqi calibrate recordings --out drivers")(calibrate)


app.command(epilog="example: graphrqi populations")(populations)
app.command(epilog="example: graphrqi adapt graphrqi-plus data --labels few.csv --out mine")(adapt)


@app.command(epilog="example: graphrqi predict data --predictors car-following --horizon-s 5")
def predict(
    source: Source,
    predictors: Annotated[
        str,
        typer.Option(
            metavar="A,B",
            help="Names (see graphrqi list) or module:function of your own, separated by commas.",
        ),
    ] = "constant-velocity,car-following-blind,graphrqi-predict",
    horizon_s: Annotated[float, typer.Option("--horizon-s", help="How far ahead, s.")] = 5.0,
    format: FormatName = None,
    net: Net = None,
    model: ModelName = "graphrqi-plus",
    out: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False,
            callback=table_to_write,
            metavar="FILE",
            help="File for the futures themselves: .parquet or .csv.",
        ),
    ] = None,
    submission: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Parquet file of the last predictor's futures as Argoverse 2's challenge takes "
            "them: of 6 s, 5 s after the beginning of each recording.",
        ),
    ] = None,
    weights: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="From train-predictor [default: those that ship]."),
    ] = None,
    jobs: Jobs = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Predict where everyone goes, and score it."""
    from experiments.console.tables import show_table
    from experiments.data.exchange import as_dataset
    from experiments.rows import write_json
    from experiments.scoring.prediction import NothingToScore, predict_dataset, short_table

    names = _words(predictors)
    with as_dataset(source, format, net) as dataset:
        try:
            rows = predict_dataset(
                dataset, names, horizon_s, model, out=out, weights=weights, jobs=jobs, quiet=quiet
            )
        except NothingToScore as reason:
            # The challenge's own test recordings end where the futures begin.
            if submission is None or out is not None or json is not None:
                raise
            say(f"graphrqi: not scored: {reason}", err=True)
        else:
            if json is not None:
                write_json(rows, json)
            if str(json) != "-":
                show_table(short_table(rows), title="prediction")
        if submission is not None:
            from experiments.scoring.submission import submit_dataset

            submit_dataset(dataset, names[-1], model, submission)


@app.command(epilog="example: graphrqi replay data --episode straight_road --out replay.html")
def replay(
    source: Source,
    out: Annotated[
        Path, typer.Option(dir_okay=False, metavar="FILE.html", help="The page.")
    ] = Path("replay.html"),
    episode: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="A name as classify shows it, an id or its beginning, or a scenario [default: "
            "the first].",
        ),
    ] = None,
    labels: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False, metavar="FILE.parquet", help="From classify [default: made here]."
        ),
    ] = None,
    predictions: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False, metavar="FILE.parquet", help="From predict [default: made here]."
        ),
    ] = None,
    format: FormatName = None,
    net: Net = None,
    model: ModelName = "graphrqi-plus",
    predictor: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="See graphrqi list; none for no predictions [default: graphrqi-predict, or the "
            "first in --predictions].",
            autocompletion=names_of("predictor"),
        ),
    ] = None,
    population: Annotated[
        str | None,
        typer.Option(
            metavar="NAME or FILE",
            help="Infer drivers' car-following numbers, too, as drivers of this population.",
            autocompletion=names_of("population"),
        ),
    ] = None,
    color: Annotated[
        str | None,
        typer.Option(metavar="MODE", help="At first: true, predicted, confidence, speed or w."),
    ] = None,
    video: Annotated[
        Path | None, typer.Option(dir_okay=False, metavar="FILE", help="Film it too: .mp4 or .gif.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False, metavar="FILE", help="Draw one moment of it too: .png, .pdf or .svg."
        ),
    ] = None,
    begin_s: Annotated[
        float | None, typer.Option("--begin-s", help="When page, film or picture begin, s.")
    ] = None,
    end_s: Annotated[float | None, typer.Option("--end-s", help="When the film ends, s.")] = None,
    quiet: Quiet = False,
) -> None:
    """Make a page that plays an episode in a browser."""
    from experiments.replay.write import ReplayOptions, write_replay

    options = ReplayOptions(
        episode=episode, labels=labels, predictions=predictions, format=format, net=net,
        model=model, predictor=predictor, population=population, color=color, begin_s=begin_s,
        end_s=end_s, video=video,
        picture=picture,
    )  # fmt: skip
    for path in write_replay(source, out, options, quiet):
        say(str(path))


app.command(
    "what-if",
    epilog="example: "
    "graphrqi what-if straight_road --at-s 30 --agent 8 --behavior timid --out what-if",
)(what_if)
app.command(epilog="example: graphrqi blame straight_road --flow dense --duration-s 60")(blame)


@app.command(epilog="example: graphrqi report runs/demo runs/other --out comparison.html")
def report(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="Folders of runs, or files of rows.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False,
            metavar="FILE",
            help="The page; of several runs, the one that compares them "
            "[default: beside the rows or in the run; comparison.html].",
        ),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            file_okay=False,
            metavar="FOLDER",
            help="Write the page's charts here, too, as PDF; of several runs, into a folder each.",
        ),
    ] = None,
    jobs: Jobs = None,
    quiet: Quiet = False,
) -> None:
    """Make the page of each run; of several, also one that compares them."""
    from experiments.report import write_comparison, write_report

    several = len(runs) > 1
    for run in runs:
        own = figures / run.stem if several and figures is not None else figures
        say(str(write_report(run, jobs, quiet, None if several else out, own)))
    if several:
        say(str(write_comparison(runs, out or Path("comparison.html"))))


@app.command("import", epilog="example: graphrqi import recordings --format ngsim --out data")
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
    quiet: Quiet = False,
) -> None:
    """Make a dataset of recordings in other formats."""
    from experiments.data.exchange import import_recordings

    import_recordings(
        source, out, format, net, quiet=quiet, types=types, labels=labels, rate_hz=rate,
        shift_m=metres_of(shift),
    )  # fmt: skip
    say(size_of(out))


@app.command(epilog="example: graphrqi export data --format argoverse2 --out exported")
def export(
    dataset: Annotated[Path, typer.Argument(help="Folder written by generate or import.")],
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
    from experiments.data.exchange import export_dataset

    written = export_dataset(dataset, out, format, quiet)
    say(f"{out}: {len(written)} files written")


app.command(epilog="example: graphrqi verify data --repair")(verify)

app.add_typer(
    typer.Typer(
        cls=BenchGroup,
        help="Measure, and print one row per figure.",
        epilog="example: graphrqi bench spectrum --quick --json spectrum.json",
        rich_markup_mode=None,
    ),
    name="bench",
)


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


@app.command(epilog="example: graphrqi doctor")
def doctor(json: Json = None) -> None:
    """Say what is installed, missing, and how to get it."""
    from experiments.cli.doctor import examine
    from experiments.console.tables import show_table

    findings = examine()
    show_table([finding.row for finding in findings], json)
    broken = [finding for finding in findings if finding.state == "broken"]
    if broken:
        say(f"graphrqi: error: {broken[0].what}: {broken[0].found}", err=True)
        raise typer.Exit(2)


for registered in app.registered_commands:
    registered.cls = InputKeepingCommand


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
