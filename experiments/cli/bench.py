"""``graphrqi bench NAME``: measures what the product does, and prints one row per figure."""

from __future__ import annotations

from importlib import import_module
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from experiments.cli.options import Jobs, Json, as_command, shared

bench = typer.Typer(
    help="Measure, and print one row per figure; --json writes them after every part.",
    epilog="example: graphrqi bench spectrum --quick --json spectrum.json",
    rich_markup_mode=None,
    invoke_without_command=True,
)

OPTIONS: Final[dict[str, Any]] = {
    **{
        f"{name}s": Annotated[
            list[str] | None, shared("Only this; repeat for several (default: all).", f"--{name}")
        ]
        for name in ("scenario", "protocol", "method", "predictor", "graph", "solver", "engine")
    },
    "engine": Annotated[str, shared("Which simulator.")],
    "episodes": Annotated[int | None, shared("Episodes per scenario.")],
    "jobs": Jobs,
    "quick": Annotated[bool, shared("Small sizes, in a minute or so.", "--quick")],
    "json": Json,
    "behavior": Annotated[str, shared("Whose numbers the drivers have.")],
    "behaviors": Annotated[
        str | None, shared("Behaviours of your own, too: a TOML file, or distracted, novice.")
    ],
    "out": Annotated[
        Path | None, shared("Where datasets are made, and used again.", metavar="FOLDER")
    ],
    "data": Annotated[
        Path, shared("Folder of recordings.", file_okay=False, exists=True, metavar="FOLDER")
    ],
    "task": Annotated[
        str, shared("behavior, classification: beliefs without labels, or prediction.")
    ],
    "sizes": Annotated[
        list[int] | None,
        shared("Vehicles; repeat for several (default: 25 to 20000).", "--size"),
    ],
    "city": Annotated[bool, shared("In cities, all but the smallest need netgenerate.", "--city")],
}
"""Options of benchmarks by the name of the argument of ``measure`` that they are."""


BENCHES: Final[dict[str, tuple[str, dict[str, Any], dict[str, Any]]]] = {
    "behaviors": (
        "Measure which behaviour shows which trait, in every scenario.",
        {"scenarios": None, "engine": "sumo", "behaviors": None, "jobs": None},
        {"seeds": (0,), "duration_s": 60.0},
    ),
    "attention": (
        "Measure reactions, rear-end collisions, and what is overlooked.",
        {"behavior": "careful", "behaviors": None, "engine": "sumo-idm", "jobs": None},
        {"seeds": 1, "duration_s": 120.0},
    ),
    "classification": (
        "Score methods and the plain rival on unseen drivers, scenarios, engines, noise.",
        {"protocols": None, "methods": None, "out": None, "episodes": None, "jobs": None},
        {"protocols": ("inductive", "leak-probe"), "methods": ("graphrqi-plus", "majority"),
         "episodes": 5, "duration_s": 60.0},
    ),
    "real-data": (
        "Score methods or predictors on recordings, each left out of the training in turn.",
        {"data": Parameter.empty, "task": "behavior", "jobs": None},
        {"views": ("majority", "leak-probe", "nine-numbers"), "classes": (2,), "epochs": 1,
         "simulate": False},
    ),
    "prediction": (
        "Measure every predictor's errors on unseen episodes, and who is predicted to yield.",
        {"predictors": None, "episodes": None, "jobs": None},
        {"predictors": ("constant-velocity", "car-following", "lstm", "graphrqi-predict"),
         "episodes": 2, "duration_s": 30.0},
    ),
    "spectrum": (
        "Measure every eigenvalue algorithm on the same graphs, in one process.",
        {"graphs": None, "sizes": None, "solvers": None},
        {"sizes": (25,), "steps": 5},
    ),
    "loop": (
        "Time classifying and predicting while a simulation runs, stage by stage.",
        {"engines": None, "city": False},
        {"duration_s": 20.0, "repeats": 1, "blocks": (3,), "vehicles": (30, 90)},
    ),
    "generate": (
        "Measure the cost of generating data.",
        {},
        {"repeats": 1, "duration_s": 30.0, "episodes": 2},
    ),
    "conflicts": (
        "Compare our conflicts with those of SUMO's own device, in the same episodes.",
        {},
        {"seeds": (0,), "duration_s": 60.0},
    ),
}  # fmt: skip
"""What each benchmark does, its options with their defaults, and its quick arguments.

Each is a module with a function ``measure``, and maybe a ``table`` of rows."""


@bench.callback()
def show_help(context: typer.Context) -> None:
    """Measure, and print one row per figure."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def _add(name: str, about: str, options: dict[str, Any], quickly: dict[str, Any]) -> None:
    """Register a benchmark as a command; an option that is given counts more than ``--quick``."""

    def measure(quick: bool, json: Path | None, **given: Any) -> None:
        from experiments.score.rows import show_parts

        module = import_module(f"experiments.benchmarks.{name.replace('-', '_')}")
        chosen = {option: value for option, value in given.items() if value not in (None, [])}
        parts = module.measure(**{**(quickly if quick else {}), **chosen})
        show_parts(f"bench {name}", parts, json, getattr(module, "table", None))

    shown = [
        Parameter(option, Parameter.KEYWORD_ONLY, default=default, annotation=OPTIONS[option])
        for option, default in {**options, "quick": False, "json": None}.items()
    ]
    needed = " --data FOLDER" if "data" in options else ""
    example = f"example: graphrqi bench {name}{needed} --quick --json rows.json"
    bench.command(name, help=about, epilog=example)(as_command(measure, shown))


for _name, _bench in BENCHES.items():
    _add(_name, *_bench)
