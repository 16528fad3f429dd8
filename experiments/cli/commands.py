"""The ``graphrqi`` command.

Only typer is imported here; each command imports what it needs when it runs, so that help appears
at once. Whatever a user can do wrong ends in one line on stderr and exit code 2.
``python -m scenarios.NAME`` calls ``run``, too.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from experiments.cli.bench import bench
from experiments.cli.options import (
    DatasetFolder,
    Flow,
    FormatName,
    GivenLabels,
    Jobs,
    Json,
    ModelName,
    Net,
    NewDataset,
    Quiet,
    ScenarioName,
    Seed,
    Source,
    TableFile,
    Traffic,
    TrafficKind,
    file_option,
    in_a_folder,
    named_dataset,
    option,
    refuse_to_overwrite,
    table_to_write,
    with_traffic,
)
from experiments.console.notices import (
    LOGGER,
    STOPPED,
    Interrupted,
    exit_on_user_error,
    show_notices,
)
from experiments.guard import guarding

if TYPE_CHECKING:
    from experiments.generate.configuration import GenerateConfig
    from experiments.score.rows import Row

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


def _command(panel: str, name: str, example: str) -> Callable[[Any], Any]:
    """Register a function as a command, in a group of the help and with an example."""
    return app.command(name, rich_help_panel=panel, epilog=f"example: graphrqi {example}")


def _show(
    command: str, rows: Sequence[Row], json: Path | None, *, seed: int | None = None,
    dataset: str | None = None, **shown: Any,
) -> None:  # fmt: skip
    """Print the table of a command's rows, or write them; ``shown`` is as `show_table` takes it."""
    from experiments.score.rows import show_table, stamped

    show_table(stamped(rows, command, seed, dataset), json, **shown)


@_command(SIMULATE, "run", "run straight_road --flow dense --stream --predict")
@with_traffic
def run(
    scenario: ScenarioName = None,
    stream: bool = option("Classify drivers as they go.", "--stream", default=False),
    predict: bool = option("Predict, and score it.", "--predict", default=False),
    model: ModelName = "graphrqi-plus",
    seed: Seed = 0, json: Json = None, quiet: Quiet = False, *, traffic: Traffic,
) -> None:  # fmt: skip
    """Run a scenario headless and sum up what happened."""
    from experiments.run import run_scenario, shown

    config = traffic.config([scenario] if scenario else None, episodes=1, seed=seed)
    used = model if stream or predict else None
    found = run_scenario(config, used, predict, quiet)
    _show("run", found, json, seed=seed, lines=shown(found))


@_command(SIMULATE, "generate", "generate --scenario straight_road --episodes 9 --out roads")
@with_traffic
def generate(
    out: NewDataset,
    scenario: list[str] | None = option(
        "A scenario's name, its TOML file, or a map; random_world draws one for each episode; "
        "repeat for several. Needed, here or in the file.", names="scenario"),
    episodes: int | None = option("Episodes per scenario. Needed, here or in the file."),
    config: Path | None = file_option("The same options in a file.", metavar="FILE.toml"),
    seed: int | None = option("Same seed, same bytes (default: 0)."),
    jobs: Jobs = None,
    cluster: str | None = option("Dask scheduler, instead of processes.", metavar="ADDRESS"),
    quiet: Quiet = False, *, traffic: Traffic,
) -> None:  # fmt: skip
    """Make a dataset, or what is missing of it."""
    from experiments.generate.dataset import generate as make

    chosen = traffic.config(scenario, config, episodes=episodes, seed=seed)
    make(chosen, out, jobs, quiet, cluster)
    _say_size(out)


def _say_size(out: Path) -> None:
    """Say where a dataset is and how large it is: the last line of a command that makes one."""
    from experiments.console.notices import say
    from sim.files import place_of
    from sim.store.dataset import open_dataset

    dataset = open_dataset(out)
    steps = sum(dataset.catalogue.column("agent_steps").to_pylist())
    say(f"{place_of(out).url}: {len(dataset)} episodes, {steps} agent-steps")


@_command(SIMULATE, "road", "road town.osm --out town")
def road(
    file: Annotated[Path, typer.Argument(
        metavar="FILE",
        help="SUMO net, OpenStreetMap, OpenDRIVE, Lanelet2, CommonRoad or Argoverse 2 map.")],
    out: Path | None = option(
        "Write NAME.net.xml, the picture NAME.svg, and the scenario NAME.toml.",
        metavar="NAME", callback=in_a_folder),
    left_hand: bool | None = option(
        "On which side traffic drives, of OpenStreetMap.", "--left-hand/--right-hand",
        show_default="as the map says"),
    json: Json = None,
) -> None:  # fmt: skip
    """Say what a map holds, what it lacks and what is wrong with it; draw it; make it drivable."""
    from behaviors.errors import InputError
    from experiments.console.notices import say
    from experiments.guard import guarded_call
    from experiments.score.rows import tidy_row
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
        net, _, written = files
        if net.exists() and not written.exists():
            raise InputError(f"{net}: found a map of your own, expected another --out NAME")
        for path, content in files.items():
            write_whole(path, content)
    lines, rows = found.rows(), []
    for line in lines:
        value = line["value"]
        text, number = (value, None) if isinstance(value, str) else (None, value)
        rows.append(tidy_row({"text": text}, str(line["what"]), number))
    _show("road", rows, json, lines=lines)
    if out is not None and str(json) != "-":
        say(f"{out}.net.xml, {out}.svg and {out}.toml: graphrqi run {out}.toml")


@_command(DATA, "import", "import recordings --format ngsim --out data")
def import_(
    source: Annotated[Path, typer.Argument(help="A recording, or a folder of recordings.")],
    out: NewDataset, format: FormatName = None, net: Net = None,
    types: Path | None = file_option("vTypes of a SUMO recording, for sizes."),
    labels: GivenLabels = None,
    rate: float | None = option(
        "Frames per second, where the files are wrong.", metavar="HZ", min=1e-3),
    shift: str | None = option("Move the map so far onto the positions, m.", metavar="X,Y"),
    columns: str | None = option(
        "Columns of your own table; also heading, speed, vx, vy, length, width, kind.",
        metavar="id=NAME,t=NAME,x=NAME,y=NAME"),
    units: str | None = option(
        "Units of these columns, where they are not SI.", metavar="t=ms,x=ft"),
    name: str | None = option(
        "What the scenario is called; the format's name if not.", metavar="NAME"),
    split: Literal["train", "validation", "test"] | None = option(
        "The part of the data that everything belongs to.", show_default="all"),
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Make a dataset of recordings in other formats."""
    from experiments.data.exchange import import_recordings

    import_recordings(
        source, out, format, net, split, quiet, types, labels, rate, _metres(shift),
        _pairs("columns", columns), _pairs("units", units) or None, name,
    )  # fmt: skip
    _say_size(out)


def _metres(text: str | None) -> tuple[float, float] | None:
    """Two lengths in metres from ``X,Y``."""
    if text is None:
        return None
    try:
        x, y = map(float, text.split(","))
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


@_command(DATA, "export", "export data --format argoverse2 --out exported")
def export(
    dataset: DatasetFolder,
    format: str = option(
        "See graphrqi list; vtypes: SUMO's vehicle types of the drivers, of a dataset or of "
        "behaviours (a TOML file, or distracted, novice).",
        "--format", metavar="KEY", names="format", default=...),
    out: Path = option("New or empty folder.", default=...),
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


@_command(DATA, "verify", "verify data")
def verify(dataset: DatasetFolder, json: Json = None) -> None:
    """Compare every file with its checksum."""
    from experiments.console.notices import say
    from experiments.data.verify import verify_dataset
    from experiments.score.rows import tidy_row

    flaws = verify_dataset(dataset)
    if flaws or json is not None:
        lines = [{"file": str(f.path), "state": f.state} for f in flaws]
        rows = [tidy_row(line, "wrong_files", 1) for line in lines]
        _show("verify", rows, json, lines=lines)
    if flaws:
        say(f"graphrqi: error: {dataset}: found {len(flaws)} wrong files", err=True)
        raise typer.Exit(2)
    if json is None:
        say(f"{dataset}: every file is as its catalogue says")


@_command(LEARN, "train", "train data --method graphrqi-plus --out model")
def train(
    data: Annotated[
        list[Path], typer.Argument(help="Datasets; recordings for --from and --predictor.")
    ],
    out: Path = option("Folder of the model.", default=...),
    method: str = option("See graphrqi list.", names="method", default="graphrqi-plus"),
    start: str | None = option(
        "Adapt this model to the place of recordings instead.", "--from", metavar="MODEL"),
    labels: GivenLabels = None,
    predictor: bool = option(
        "Train the predictor for recordings instead.", "--predictor", default=False),
    epochs: int = option("Passes over the data (--predictor).", min=1, default=4),
    format: FormatName = None, net: Net = None, seed: Seed = 0, jobs: Jobs = None,
    json: Json = None, quiet: Quiet = False,
) -> None:  # fmt: skip
    """Train a classifier on datasets, adapt one to recordings, or train the predictor."""
    from behaviors.errors import InputError
    from experiments.score.rows import melted

    for name, given in (("--labels", labels), ("--format", format), ("--net", net)):
        if given is not None and start is None:
            raise InputError(f"{name}: found no --from, expected the model to adapt")
    if predictor and start is not None:
        raise InputError("--predictor: found --from, too, expected one of them")
    if predictor:
        from experiments.training.recorded import train_on_recordings

        scores = train_on_recordings(data, out, epochs=epochs, seed=seed, quiet=quiet)
        lines: list[Row] = [
            {"recordings": name, "ade_over_constant_velocity": round(value, 3)}
            for name, value in scores.items()
        ]
        rows = melted(lines, ["recordings"])
        _show("train --predictor", rows, json, seed=seed, title=f"{out}: trained", lines=lines)
        return
    if start is not None:
        from experiments.data.exchange import as_dataset
        from experiments.training.adapt import adapt

        if labels is None:
            raise InputError("--from: found no --labels, expected labels of some drivers")
        if len(data) != 1:
            raise InputError(f"--from: found {len(data)} recordings, expected one or a folder")
        with as_dataset(data[0], format, net) as dataset:
            rows = adapt(start, dataset, out, labels, quiet)
        _show("train --from", rows, json, title=f"{out}: {start} adapted")
        return
    from experiments.score.rows import dataset_id
    from experiments.training.classifier import train_on
    from sim.store.dataset import open_dataset

    rows = train_on(data, method, out, seed, quiet, jobs).card["scores"]
    known = ", ".join(dataset_id(open_dataset(path)) for path in data)
    _show_scores("train", rows, json, seed=seed, dataset=known)
    if not rows:
        typer.echo("not scored: the data have no test episode with a driver seen for 1 s", err=True)


@_command(LEARN, "classify", "classify data --out labels.parquet")
def classify(
    source: Source, out: TableFile = None, format: FormatName = None, net: Net = None,
    model: ModelName = "graphrqi-plus", labels: GivenLabels = None,
    conflicts: Path | None = file_option(
        "File for the conflicts of any two road users: .parquet or .csv.",
        "--conflicts", callback=table_to_write),
    traffic: TrafficKind = None, jobs: Jobs = None, json: Json = None, quiet: Quiet = False,
) -> None:  # fmt: skip
    """Name each driver's behaviour as it drives."""
    from experiments.score.labels import classify_dataset, domain_notice, named_table
    from experiments.score.rows import show_table
    from experiments.score.tables import write_conflicts

    refuse_to_overwrite([source, net, labels], [out, conflicts, json])
    with named_dataset(source, format, net) as (dataset, known):
        if conflicts is not None:
            write_conflicts(dataset, conflicts)
        rows = classify_dataset(
            dataset, model, out, labels, traffic=traffic, jobs=jobs, quiet=quiet
        )
    if str(json) != "-":
        show_table(named_table(rows), title="drivers by their last answer")
    _show_scores("classify", rows, json, dataset=known)
    if notice := domain_notice(rows):
        typer.echo(notice, err=True)


def _show_scores(command: str, rows: Sequence[Row], json: Path | None, **made: Any) -> None:
    """Write all rows, and print the scores and confusions of those over many episodes."""
    from experiments.score.answers import LEGEND, confusion_table, is_scored, scores_table
    from experiments.score.rows import show_table

    totals = [row for row in rows if row.get("name") is None]
    if not is_scored(totals) and json is None:
        return
    paired = [row for row in totals if row.get("against")]
    down = ["model", "scenario", "split"] if paired else ["scenario", "split"]
    title = "every driver once, by its last answer; 95 % intervals over episodes"
    lines = scores_table([row for row in totals if row not in paired], down)
    _show(command, rows, json, title=title, lines=lines, legend=LEGEND, **made)
    if str(json) == "-":
        return
    if paired:
        keys = ("model", "against", "metric", "value", "low", "high")
        lines = [{key: row[key] for key in keys} for row in paired]
        show_table(lines, title="differences on the same drivers")
    if confusions := confusion_table(totals):
        show_table(confusions, title="how often each behaviour gets each answer")


@_command(LEARN, "evaluate", "evaluate graphrqi-plus data --json scores.json")
def evaluate(
    model: Annotated[str, typer.Argument(help="A model that ships, or a folder.")],
    source: Source, format: FormatName = None, net: Net = None, labels: GivenLabels = None,
    answers: Path | None = file_option(
        "Answers of your own model about the test split, to compare: columns episode, agent, "
        "label, and time_s or p_impatient ... if known.", "--answers"),
    traffic: TrafficKind = None, jobs: Jobs = None, json: Json = None, quiet: Quiet = False,
) -> None:  # fmt: skip
    """Score a model where drivers are known; report makes a page of the JSON."""
    from experiments.score.labels import evaluate

    refuse_to_overwrite([source, net, labels, answers], [json])
    with named_dataset(source, format, net) as (dataset, known):
        rows = evaluate(model, dataset, labels, answers, traffic=traffic, jobs=jobs, quiet=quiet)
    _show_scores("evaluate", rows, json, dataset=known)


@_command(LEARN, "predict", "predict data --predictors car-following --horizon-s 5")
def predict(
    source: Source,
    predictors: str = option(
        "Names (see graphrqi list) or module:function of your own, separated by commas.",
        metavar="A,B", default="constant-velocity,graphrqi-predict"),
    horizon_s: float = option("How far ahead, s.", "--horizon-s", default=5.0),
    format: FormatName = None, net: Net = None, model: ModelName = "graphrqi-plus",
    out: TableFile = None,
    weights: Path | None = option(
        "From train --predictor (default: the weights that ship).", metavar="FOLDER"),
    traffic: TrafficKind = None,
    split: str | None = option(
        "test, validation, train or all (default: test; of recordings, all)."),
    jobs: Jobs = None, json: Json = None, quiet: Quiet = False,
) -> None:  # fmt: skip
    """Predict the motion of every agent, and score it."""
    from experiments.score.predictions import errors_table, predict_dataset

    refuse_to_overwrite([source, net], [out, json])
    names = [word.strip() for word in predictors.split(",") if word.strip()]
    with named_dataset(source, format, net) as (dataset, known):
        rows = predict_dataset(
            dataset, names, horizon_s, model, out=out, weights=weights, traffic=traffic,
            split=split, jobs=jobs, quiet=quiet,
        )  # fmt: skip
    _show("predict", rows, json, dataset=known, title="prediction", lines=errors_table(rows))


@_command(LEARN, "calibrate", "calibrate recordings --out drivers")
def calibrate(
    source: Source,
    out: Path = option(
        "New folder for the results.", metavar="FOLDER", file_okay=False, default=...),
    format: FormatName = None, net: Net = None, json: Json = None, quiet: Quiet = False,
) -> None:  # fmt: skip
    """Infer every driver's car-following numbers, and the population they come from."""
    from experiments.calibration import population_rows, write_calibration
    from experiments.score.rows import melted

    calibrated = write_calibration(source, out, format, net, quiet)
    lines = population_rows(calibrated)
    title = f"{out}: {len(calibrated.drivers)} drivers"
    _show("calibrate", melted(lines, ["number"]), json, title=title, lines=lines)


@_command(
    ASK, "what-if", "what-if straight_road --at-s 30 --agent 8 --behavior timid --out what-if"
)  # fmt: skip
@with_traffic
def what_if(
    scenario: ScenarioName = None,
    at_s: float | None = option("From when on the driver differs, s.", "--at-s"),
    agent: int | None = option("The driver.", metavar="ID"),
    out: Path | None = option("Folder of the dataset."),
    behavior: list[str] | None = option(
        "A behaviour to go on with; repeat for several.", metavar="B"),
    action: list[str] | None = option(
        "brake, keep, accelerate, change-left or change-right at that instant; repeat for several.",
        metavar="A"),
    episode: int = option(
        "Which of the scenario's episodes, as by generate.", min=0, metavar="N", default=0),
    seed: Seed = 0,
    blame: bool = option(
        "Instead, say whose careful driving would have prevented each collision and near miss.",
        "--blame", default=False),
    picture: Path | None = file_option(
        "Draw the paths over the factual ones too: .png, .pdf or .svg."),
    json: Json = None, quiet: Quiet = False, *, traffic: Traffic,
) -> None:  # fmt: skip
    """Drive one episode on from one instant with one driver different (Linux only)."""
    from behaviors.errors import InputError, lookup
    from behaviors.labels import BEHAVIORS, Behavior, read_behaviors
    from experiments.replay.pictures import check_picture, write_paths
    from experiments.score.rows import dataset_id, melted
    from experiments.what_if.branches import make_what_if
    from experiments.what_if.outcomes import outcomes
    from sim.store.dataset import open_dataset
    from sim.sumo.control import Action

    drawn = traffic.config([scenario] if scenario else None, episodes=episode + 1, seed=seed)
    if blame:
        for name, given in (("--at-s", at_s), ("--agent", agent), ("--out", out),
                            ("--behavior", behavior), ("--action", action),
                            ("--picture", picture)):  # fmt: skip
            if given is not None:
                raise InputError(f"{name}: found it beside --blame, expected one of the two")
        _show_blame(drawn, episode, seed, json)
        return
    if at_s is None or agent is None or out is None:
        missing = "--at-s" if at_s is None else "--agent" if agent is None else "--out"
        raise InputError(f"{missing}: found none, expected it, or --blame")
    known = (*BEHAVIORS, *read_behaviors(drawn.behaviors))
    behaviors, actions = {str(b): b for b in known}, {a.value: a for a in Action}
    changes: list[Behavior | Action] = [
        *(lookup(behaviors, word, "behavior") for word in behavior or ()),
        *(lookup(actions, word, "action") for word in action or ()),
    ]
    if picture is not None:
        check_picture(picture)
    make_what_if(drawn, out, at_s=at_s, agent=agent, changes=changes, index=episode, quiet=quiet)
    dataset = open_dataset(out)
    lines = outcomes(dataset)
    rows = melted(lines, ["change"])
    _show("what-if", rows, json, seed=seed, dataset=dataset_id(dataset), lines=lines)
    if picture is not None:
        write_paths(dataset, picture)


def _show_blame(config: GenerateConfig, episode: int, seed: int, json: Path | None) -> None:
    """Print a line for each incident of an episode and driver who was tried."""
    from experiments.generate.episode import Task
    from experiments.score.rows import melted
    from experiments.what_if.blame import judge
    from sim.scenario import sample_agents

    task = Task(config, config.scenarios[0], episode)
    made = config.scenario(task.scenario, episode)
    lines = list(judge(made, sample_agents(made, task.seed), task.seed, config.engine))
    if lines or json is not None:
        keys = ["time_s", "incident", "agent", "other", "rule", "driver", "role", "behavior"]
        _show("what-if --blame", melted(lines, keys), json, seed=seed, lines=lines)
    if not lines:
        typer.echo(f"{made.name}: no collision and no near miss in {made.duration_s:g} s", err=True)


@_command(ASK, "drive", "drive --policy planner-classified --quick")
def drive(
    policy: list[str] | None = option(
        "A policy of ours, such as planner-blind, or module:function; repeat for several "
        "(default: ours).", metavar="NAME"),
    scenario: list[str] | None = option(
        "Where; repeat for several (default: all but roundabout and city)."),
    crowd: list[str] | None = option(
        "Among whom: a behaviour, mixed, recorded, homogeneous, or a mix such as "
        "timid=.9,novice=.1; repeat for several (default: all).", metavar="NAME or MIX"),
    behaviors: str | None = option(
        "Behaviours of your own: a TOML file, or distracted, novice.", metavar="FILE or NAMES"),
    episodes: int | None = option("Of each policy in each scenario and crowd (default: 20)."),
    seed: int | None = option("Of the first episode.", min=0),
    flow: Flow = None,
    duration_s: float | None = option("Longest episode, s (default: 60).", "--duration-s"),
    warmup_s: float | None = option(
        "How long the traffic drives before, s (default: 20).", "--warmup-s"),
    quick: bool = option(
        "Two scenarios, two crowds, two short episodes.", "--quick", default=False),
    jobs: Jobs = None, json: Json = None, quiet: Quiet = False,
) -> None:  # fmt: skip
    """Test how driving policies do in every scenario among drivers of every kind."""
    from experiments.drive.run import QUICK, run_test, short_table
    from experiments.score.rows import show_parts

    given: dict[str, Any] = {
        "policies": tuple(policy or ()), "scenarios": tuple(scenario or ()),
        "crowds": tuple(crowd or ()), "episodes": episodes, "seed": seed, "flow": flow,
        "duration_s": duration_s, "warmup_s": warmup_s, "behaviors": behaviors,
    }  # fmt: skip
    chosen = {name: value for name, value in given.items() if value not in (None, ())}
    given = {**(QUICK if quick else {}), **chosen}
    show_parts("drive", run_test(**given, jobs=jobs, quiet=quiet), json, short_table)


@_command(LOOK, "summary", "summary data --by behavior --out summary.csv")
def summary(
    source: Source,
    by: str | None = option("Groups: behavior, kind or scenario (default: all together)."),
    format: FormatName = None, net: Net = None, json: Json = None,
    out: Path | None = file_option("The same rows as CSV.", "--out", metavar="FILE.csv"),
) -> None:  # fmt: skip
    """Count conflicts, events and traits per kilometre and hour, with speeds and headways."""
    import pandas as pd

    from behaviors.errors import lookup
    from experiments.score.rows import stamped
    from experiments.summary import BY, LEGEND, summary, table
    from sim.files import write_whole
    from sim.store.dataset import open_dataset

    if by is not None:
        lookup(BY, by, "--by")
    with named_dataset(source, format, net) as (folder, known):
        found = summary(open_dataset(folder), by)
    if out is not None:
        rows = stamped(found, "summary", dataset=known)
        write_whole(out, pd.DataFrame(rows, dtype=object).to_csv(index=False).encode())
    _show("summary", found, json, dataset=known, lines=table(found, by), legend=LEGEND)


@_command(LOOK, "replay", "replay data --episode straight_road --out replay.html")
def replay(
    source: Source,
    out: Path = file_option(
        "The page.", metavar="FILE.html", default=Path("replay.html"), callback=in_a_folder),
    episode: str | None = option(
        "A name as classify shows it, an id or its beginning, or a scenario (default: the first).",
        metavar="NAME"),
    labels: Path | None = file_option(
        "From classify (default: made here).", metavar="FILE.parquet"),
    format: FormatName = None, net: Net = None, model: ModelName = "graphrqi-plus",
    predictor: str = option(
        "See graphrqi list; none for no predictions.",
        metavar="NAME", names="predictor", default="graphrqi-predict"),
    color: str | None = option(
        "At first: true, predicted, confidence, speed or w.", metavar="MODE"),
    picture: Path | None = file_option(
        "Draw one moment of it too (.png, .pdf or .svg), or a film (.mp4 or .gif)."),
    begin_s: float | None = option("When page, film or picture begin, s.", "--begin-s"),
    end_s: float | None = option("When the film ends, s.", "--end-s"),
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Make a page that plays an episode in a browser."""
    from experiments.console.notices import say
    from experiments.replay.page import write_replay

    refuse_to_overwrite([source, labels, net], [out, picture])
    written = write_replay(
        source, out, episode=episode, labels=labels, format=format, net=net, model=model,
        predictor=predictor, color=color, begin_s=begin_s, end_s=end_s, picture=picture,
        quiet=quiet,
    )  # fmt: skip
    for path in written:
        say(str(path))


@_command(LOOK, "report", "report runs/demo")
def report(
    runs: Annotated[list[Path], typer.Argument(
        metavar="RUN...", help="Files of rows, or folders of runs or models.")],
    out: Path | None = file_option(
        "The page (default: beside the rows or in the folder; comparison.html of several)."),
    figures: str | None = option(
        "Write the page's pictures beside it in this format, too.", metavar="svg|pdf"),
    jobs: Jobs = None, quiet: Quiet = False,
) -> None:  # fmt: skip
    """Make a page of tables and pictures; of several runs, one that compares them."""
    from experiments.console.notices import say
    from experiments.report.page import write_report

    refuse_to_overwrite(runs, [out])
    say(str(write_report(runs, out, figures, jobs, quiet)))


@_command(LOOK, "list", "list")
def list_names(json: Json = None) -> None:
    """Show every registered name, the distribution that it comes from, and what it is."""
    from experiments.cli.names import registered_names

    _show("list", registered_names(), json)


app.add_typer(bench, name="bench", rich_help_panel=LOOK)


@app.callback()
def about(
    context: typer.Context,
    version: bool = option(
        "Say the version, and those of the simulators.", "--version", default=False),
    verbose: bool = option(
        "Say on stderr what is read and how long it took.", "--verbose", "-v", default=False),
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Label, classify and predict drivers in simulated and recorded traffic."""
    if version:
        from experiments.cli.names import version_line

        typer.echo(version_line())
    elif context.invoked_subcommand is None:
        typer.echo(context.get_help())
    if version or context.invoked_subcommand is None:
        raise typer.Exit
    if quiet:
        context.default_map = {context.invoked_subcommand: {"quiet": True}}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line with arguments, or those of the process, and end the process."""
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
