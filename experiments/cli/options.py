"""Options that several commands share: their names, types and help."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from experiments.generate.configuration import GenerateConfig


def in_a_folder(path: Path | None) -> Path | None:
    """Refuse a file to write whose folder is missing, before any work is done."""
    from behaviors.errors import InputError
    from sim.files import is_remote

    if path is None or str(path) == "-" or is_remote(path) or path.parent.is_dir():
        return path
    raise InputError(f"{path}: found no folder {path.parent}, expected one")


def table_to_write(path: Path | None) -> Path | None:
    """Refuse a table of another ending than those written, or whose folder is missing."""
    if path is not None:
        from experiments.score.tables import check_ending

        check_ending(path)
    return in_a_folder(path)


def refuse_to_overwrite(read: Sequence[Path | None], written: Sequence[Path | None]) -> None:
    """Refuse files to write that are read, too, or that are named twice."""
    from behaviors.errors import InputError

    places = [path.resolve() for path in read if path is not None]
    for path in written:
        if path is None or str(path) == "-":
            continue
        if path.resolve() in places:
            raise InputError(f"{path}: found the same file twice, expected another one to write")
        places.append(path.resolve())


def names_of(what: str) -> Callable[[str], list[str]]:
    """Shell completion of a registered name."""

    def complete(incomplete: str) -> list[str]:
        from experiments.cli.names import names_of as registered

        return [name for name in registered(what) if name.startswith(incomplete)]

    return complete


def option(
    help: str, *flags: str, default: Any = None, metavar: str | None = None, **settings: Any
) -> Any:
    """An option as the default of a parameter; without one (``...``) it is needed.

    ``settings`` are those of typer, or ``names``: a registry that completes it.
    """
    registry = settings.pop("names", None)
    if registry is not None:
        settings["autocompletion"] = names_of(registry)
    return typer.Option(default, *flags, metavar=metavar, help=help, **settings)


def file_option(help: str, *flags: str, metavar: str = "FILE", **settings: Any) -> Any:
    """An option that names a file."""
    return option(help, *flags, metavar=metavar, dir_okay=False, **settings)


def shared(help: str, *flags: str, **settings: Any) -> Any:
    """An option in the annotation of a type that several commands take."""
    return option(help, *flags, default=..., **settings)


@contextmanager
def named_dataset(source: Path, format: str | None, net: Path | None) -> Iterator[tuple[Path, str]]:
    """A dataset, made of recordings where need be, with its id in rows."""
    from experiments.data.exchange import as_dataset
    from experiments.score.rows import dataset_id
    from sim.store.dataset import open_dataset

    with as_dataset(source, format, net) as folder:
        yield folder, dataset_id(open_dataset(folder))


Source = Annotated[Path, typer.Argument(help="A dataset, a recording, or a folder of them.")]
DatasetFolder = Annotated[Path, typer.Argument(help="Folder written by generate or import.")]
NewDataset = Annotated[Path, shared("Folder of the dataset.", "--out")]
Jobs = Annotated[int | None, shared("Processes (default: one per core).", min=1)]
Json = Annotated[
    Path | None,
    file_option("Write the figures as JSON rows; - for standard output.", "--json",
                default=..., callback=in_a_folder, allow_dash=True),
]  # fmt: skip
ModelName = Annotated[str, shared("A model that ships, or a folder written by train.", "--model")]
FormatName = Annotated[
    str | None,
    shared("Format of the recordings (default: recognised by their content).", "--format",
           metavar="KEY", names="format"),
]  # fmt: skip
Net = Annotated[
    Path | None, file_option("SUMO net or map of the recordings' place.", "--net", default=...)
]
Seed = Annotated[int, shared("Same seed, same result.", min=0)]
GivenLabels = Annotated[
    Path | None,
    file_option("Known drivers: columns name and label (a behaviour or style), or also recording.",
                "--labels", default=..., metavar="FILE.csv"),
]  # fmt: skip
TrafficKind = Annotated[
    str | None,
    shared("Where the positions come from: simulated (by run or generate), recorded or other "
           "(default: what the data say).", "--traffic", metavar="KIND"),
]  # fmt: skip
Quiet = Annotated[bool, shared("Show no progress.", "--quiet", "-q")]
ScenarioName = Annotated[
    str | None,
    typer.Argument(help="Name of a scenario (see graphrqi list), its TOML file, or a map.",
                   autocompletion=names_of("scenario")),
]  # fmt: skip
TableFile = Annotated[
    Path | None,
    file_option("File for the answers themselves: .parquet or .csv.", "--out",
                default=..., callback=table_to_write),
]  # fmt: skip


def _traffic(help: str, *flags: str, **settings: Any) -> Any:
    return option(help, *flags, rich_help_panel="Traffic", **settings)


Flow = Annotated[
    str | None, _traffic("light, medium, dense or vehicles per hour.", default=..., metavar="FLOW")
]


@dataclass(frozen=True, slots=True)
class Traffic:
    """The options that say which traffic drives; `with_traffic` gives them to a command."""

    engine: str | None = _traffic("Which simulator (default: sumo).", names="engine")
    flow: Flow = None
    mix: str | None = _traffic(
        "Shares of behaviours or styles: aggressive=.2,timid=.8.", metavar="MIX"
    )
    kinds: str | None = _traffic("Shares of kinds of agents: car=.9,truck=.1.", metavar="KINDS")
    spread: float | None = _traffic("How much drivers of one behaviour differ; 0 gives clones.")
    population: str | None = _traffic(
        "Population that drivers are drawn from: a name (see graphrqi list), or a TOML file as "
        "calibrate writes it.", metavar="NAME or FILE", names="population",
    )  # fmt: skip
    behaviors: str | None = _traffic(
        "Behaviours of your own, beside the six: a TOML file, or distracted, novice.",
        metavar="FILE or NAMES",
    )
    duration_s: float | None = _traffic("Length, s; at most 86400.", "--duration-s")
    net: str | None = _traffic(
        "A map instead of a scenario: SUMO net, OpenStreetMap, OpenDRIVE, Lanelet2, CommonRoad or "
        "Argoverse 2.", metavar="FILE",
    )  # fmt: skip
    routes: str | None = _traffic(
        "SUMO routes for the map (default: made from the map).", metavar="FILE"
    )
    option: list[str] | None = _traffic(
        "Another option of the scenario, such as lanes=2; repeat for several.", "--set",
        metavar="NAME=VALUE",
    )  # fmt: skip

    def config(
        self, scenarios: Sequence[str] | None, file: Path | None = None, **more: Any
    ) -> GenerateConfig:
        """The configuration of such traffic in scenarios, files or maps (None: ``--net`` says it).

        A TOML file with the same options is weaker than these; ``more`` are ``episodes`` and
        ``seed``.
        """
        from experiments.generate.configuration import read_config

        own = {one.name: getattr(self, one.name) for one in fields(self)}
        others, kinds = read_options(own.pop("option") or []), own.pop("kinds")
        if kinds is not None:
            others["kinds"] = kinds
        own["scenarios"], own["scenario_options"] = list(scenarios or ()) or None, others or None
        return read_config(file, **own, **more)


def as_command(
    called: Callable[..., None], parameters: Sequence[inspect.Parameter]
) -> Callable[..., None]:
    """A function as a command of typer with these parameters, which it takes by their names."""
    called.__annotations__ = {one.name: one.annotation for one in parameters}
    called.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return called


def with_traffic(command: Callable[..., None]) -> Callable[..., None]:
    """A command with an option for every field of its last parameter ``traffic``, a `Traffic`."""
    offered = inspect.signature(Traffic, eval_str=True).parameters
    own = dict(inspect.signature(command, eval_str=True).parameters)
    del own["traffic"]

    def called(**given: Any) -> None:
        chosen = {name: given.pop(name) for name in offered}
        command(**given, traffic=Traffic(**chosen))

    called.__name__, called.__doc__ = command.__name__, command.__doc__
    every = [*own.values(), *offered.values()]
    return as_command(called, [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in every])


def read_options(texts: Sequence[str]) -> dict[str, bool | int | float | str]:
    """Options given as ``NAME=VALUE``: true, false, a number, or a word."""
    from behaviors.errors import InputError

    found: dict[str, bool | int | float | str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise InputError(f"--set: found {text!r}, expected NAME=VALUE")
        if name in Traffic.__dataclass_fields__:
            raise InputError(f"--set: found {name}, expected --{name.replace('_', '-')} for it")
        found[name] = _value(value)
    return found


def _value(text: str) -> bool | int | float | str:
    if text in ("true", "false"):
        return text == "true"
    for number in (int, float):
        with suppress(ValueError):
            return number(text)
    return text
