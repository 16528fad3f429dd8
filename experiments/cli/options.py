"""Options that several commands share: their names, types and help."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from typer.models import OptionInfo

if TYPE_CHECKING:
    from experiments.generate.configuration import GenerateConfig


def in_a_folder(path: Path | None) -> Path | None:
    """Refuse a file to write whose folder is missing, before any work is done.

    Raises:
        InputError: naming the folder.
    """
    from sim.files import is_remote

    if path is None or str(path) == "-" or is_remote(path) or path.parent.is_dir():
        return path
    from behaviors.errors import InputError

    raise InputError(f"{path}: found no folder {path.parent}, expected one")


def table_to_write(path: Path | None) -> Path | None:
    """Refuse a table of another ending than those written, or whose folder is missing.

    Raises:
        InputError: naming the ending or the folder.
    """
    if path is not None:
        from experiments.score.tables import check_ending

        check_ending(path)
    return in_a_folder(path)


def refuse_to_overwrite(read: Sequence[Path | None], written: Sequence[Path | None]) -> None:
    """Refuse files to write that are read, too, or that are named twice.

    Args:
        read: what a command reads.
        written: what it writes.

    Raises:
        InputError: naming the file.
    """
    from behaviors.errors import InputError

    places = [path.resolve() for path in read if path is not None]
    for path in written:
        if path is None or str(path) == "-":
            continue
        if path.resolve() in places:
            raise InputError(f"{path}: found the same file twice, expected another one to write")
        places.append(path.resolve())


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


def pairs_of(what: str, text: str | None) -> dict[str, str] | None:
    """Values by name from ``NAME=VALUE,NAME=VALUE``; None stays.

    Args:
        what: the option, for the message.
        text: as it was given.

    Raises:
        InputError: if it is anything else.

    Examples:
        >>> pairs_of("columns", "id=track,t=time")
        {'id': 'track', 't': 'time'}
    """
    if text is None:
        return None
    found = dict(word.split("=", 1) for word in text.split(",") if word.count("="))
    if len(found) != len(text.split(",")) or not all(found.values()):
        from behaviors.errors import InputError

        raise InputError(f"--{what}: found {text!r:.80}, expected NAME=VALUE,NAME=VALUE")
    return {key.strip(): value.strip() for key, value in found.items()}


def names_of(what: str) -> Callable[[str], list[str]]:
    """What the shell offers when a registered name is being typed."""

    def complete(incomplete: str) -> list[str]:
        from experiments.cli.names import names_of as registered

        return [name for name in registered(what) if name.startswith(incomplete)]

    return complete


def json_option(help: str) -> OptionInfo:
    """The option ``--json FILE``, with what it writes."""
    option: OptionInfo = typer.Option(
        "--json", dir_okay=False, callback=in_a_folder, allow_dash=True, metavar="FILE", help=help
    )
    return option


Source = Annotated[Path, typer.Argument(help="A dataset, a recording, or a folder of them.")]
DatasetFolder = Annotated[Path, typer.Argument(help="Folder written by generate or import.")]
Jobs = Annotated[int | None, typer.Option(min=1, help="Processes (default: one per core).")]
Json = Annotated[Path | None, json_option("Write the figures as JSON rows; - for standard output.")]
ModelName = Annotated[
    str, typer.Option("--model", help="A model that ships, or a folder written by train.")
]
FormatName = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="KEY",
        help="Format of the recordings (default: recognised by their content).",
        autocompletion=names_of("format"),
    ),
]
Net = Annotated[
    Path | None,
    typer.Option(
        "--net", dir_okay=False, metavar="FILE", help="SUMO net or map of the recordings' place."
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Same seed, same result.")]
GivenLabels = Annotated[
    Path | None,
    typer.Option(
        "--labels",
        dir_okay=False,
        metavar="FILE.csv",
        help="Known drivers: columns name and label (a behaviour or style), or also recording.",
    ),
]
TrafficKind = Annotated[
    str | None,
    typer.Option(
        "--traffic",
        metavar="KIND",
        help="Where the positions come from: simulated (by run or generate), recorded or other "
        "(default: what the data say).",
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")]
ScenarioName = Annotated[
    str | None,
    typer.Argument(
        help="Name of a scenario (see graphrqi list), its TOML file, or a map.",
        autocompletion=names_of("scenario"),
    ),
]

TRAFFIC_PANEL: Final = "Traffic"


def _traffic(*flags: str, **settings: Any) -> OptionInfo:
    option: OptionInfo = typer.Option(*flags, rich_help_panel=TRAFFIC_PANEL, **settings)
    return option


@dataclass(frozen=True, slots=True)
class Traffic:
    """The options that say which traffic drives; `with_traffic` gives them to a command."""

    engine: Annotated[
        str | None,
        _traffic(help="Which simulator (default: sumo).", autocompletion=names_of("engine")),
    ] = None
    flow: Annotated[
        str | None, _traffic(metavar="FLOW", help="light, medium, dense or vehicles per hour.")
    ] = None
    mix: Annotated[
        str | None,
        _traffic(metavar="MIX", help="Shares of behaviours or styles: aggressive=.2,timid=.8."),
    ] = None
    kinds: Annotated[
        str | None, _traffic(metavar="KINDS", help="Shares of kinds of agents: car=.9,truck=.1.")
    ] = None
    spread: Annotated[
        float | None, _traffic(help="How much drivers of one behaviour differ; 0 gives clones.")
    ] = None
    population: Annotated[
        str | None,
        _traffic(
            metavar="NAME or FILE",
            help="Population that drivers are drawn from: a name (see graphrqi list), or a TOML "
            "file as calibrate writes it.",
            autocompletion=names_of("population"),
        ),
    ] = None
    duration_s: Annotated[
        float | None, _traffic("--duration-s", help="Length, s; at most 86400.")
    ] = None
    net: Annotated[
        str | None,
        _traffic(
            metavar="FILE",
            help="A map instead of a scenario: SUMO net, OpenStreetMap, OpenDRIVE, Lanelet2, "
            "CommonRoad or Argoverse 2.",
        ),
    ] = None
    routes: Annotated[
        str | None,
        _traffic(metavar="FILE", help="SUMO routes for the map (default: made from the map)."),
    ] = None
    option: Annotated[
        list[str] | None,
        _traffic(
            "--set",
            metavar="NAME=VALUE",
            help="Another option of the scenario, such as lanes=2; repeat for several.",
        ),
    ] = None

    def config(
        self, scenarios: Sequence[str] | None, file: Path | None = None, **more: Any
    ) -> GenerateConfig:
        """The configuration of such traffic.

        Args:
            scenarios: names, files or maps; None where a file or ``--net`` says it.
            file: a TOML file with the same options, which are weaker than these.
            **more: ``episodes`` and ``seed``.

        Returns:
            The configuration.

        Raises:
            InputError: if an option is wrong.
        """
        from experiments.generate.configuration import read_config

        others = read_options(self.option or [])
        if self.kinds is not None:
            others["kinds"] = self.kinds
        return read_config(
            file, scenarios=list(scenarios) if scenarios else None, engine=self.engine,
            flow=self.flow, mix=self.mix, spread=self.spread, population=self.population,
            duration_s=self.duration_s, net=self.net, routes=self.routes,
            scenario_options=others or None, **more,
        )  # fmt: skip


def with_traffic(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of `Traffic`.

    Args:
        command: takes ``traffic``, a `Traffic`, as its last parameter.

    Returns:
        The command with an option for every field instead.
    """
    offered = inspect.signature(Traffic, eval_str=True).parameters
    own = dict(inspect.signature(command, eval_str=True).parameters)
    del own["traffic"]

    def called(**given: Any) -> None:
        chosen = {name: given.pop(name) for name in offered}
        command(**given, traffic=Traffic(**chosen))

    shown = {
        name: one.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for name, one in {**own, **offered}.items()
    }
    called.__name__, called.__doc__ = command.__name__, command.__doc__
    called.__annotations__ = {name: one.annotation for name, one in shown.items()}
    called.__signature__ = inspect.Signature(list(shown.values()))  # type: ignore[attr-defined]
    return called


def read_options(texts: Sequence[str]) -> dict[str, bool | int | float | str]:
    """Options given as ``NAME=VALUE``: true, false, a number, or a word.

    Args:
        texts: as given on the command line, after ``--set``.

    Returns:
        The values by name.

    Raises:
        InputError: if one is written otherwise, or is an option of its own.

    Examples:
        >>> read_options(["blocks=8", "crossing=true"])
        {'blocks': 8, 'crossing': True}
    """
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
        try:
            return number(text)
        except ValueError:
            continue
    return text
