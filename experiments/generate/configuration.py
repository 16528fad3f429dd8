"""Configuration of a generated dataset: a TOML file, options of the command line, or both."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from behaviors.errors import InputError
from behaviors.labels import read_behaviors, tables_of
from behaviors.populations import read_population
from behaviors.toml_files import read_toml
from experiments.generate import RANDOM_WORLD
from experiments.guard import guarded_call
from scenarios import get_scenario
from scenarios.own.scenario_file import is_path
from sim.engines import get_engine
from sim.invalid_fields import first_wrong_field
from sim.scenario import Scenario

NOT_DRAWN: Final = frozenset({"scenarios", "episodes", "seed", "duration_s"})
"""Fields that may be chosen for random worlds, too."""


_Table = dict[str, Any]
_Population = Annotated[_Table, BeforeValidator(lambda given: read_population(given).table())]
_Behaviors = Annotated[_Table, BeforeValidator(lambda given: tables_of(read_behaviors(given)))]


class GenerateConfig(BaseModel):
    """Configuration of a generated dataset.

    Attributes:
        scenarios: registered names, paths of scenarios' files (``.toml``), or of maps; or
            ``random_world``, whose episodes draw everything but their number, length and seed.
        episodes: episodes per scenario.
        seed: any non-negative integer.
        engine: registered name of the engine.
        flow: light, medium, dense or vehicles per hour; None for the scenario's own.
        mix: share of each behaviour, as text or mapping; None for the scenario's own.
        spread: how much drivers of one behaviour differ; None for the scenario's own.
        population: what a population's file says, of which drivers are drawn; a name or a file
            stands for its content. None for the scenario's own.
        behaviors: behaviours of one's own, beside the six, as a file says them; names that ship
            or a file stand for their content.
        duration_s: length of an episode, s; None for the scenario's own.
        step_s: time between frames, s; None for the scenario's own.
        limits_mps: speed limits that a scenario's episodes take in turn, m/s; None for its own.
        routes: a SUMO route file, for a map; None for routes made from it.
        scenario_options: other options that every one of the scenarios takes, such as ``lanes`` or
            ``blocks``; None for their own.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    scenarios: Annotated[tuple[str, ...], Field(min_length=1, strict=False)]
    episodes: Annotated[int, Field(ge=1, le=10**6)]
    seed: Annotated[int, Field(ge=0)] = 0
    engine: str = "sumo"
    flow: str | float | None = None
    mix: str | dict[str, float] | None = None
    spread: float | None = None
    population: _Population | None = None
    behaviors: _Behaviors | None = None
    duration_s: float | None = None
    step_s: float | None = None
    limits_mps: Annotated[tuple[float, ...], Field(min_length=1, strict=False)] | None = None
    routes: str | None = None
    scenario_options: dict[str, bool | int | float | str] | None = None

    def options(self, name: str, index: int) -> dict[str, Any]:
        """Options of a scenario in the episode with this index."""
        given: dict[str, Any] = dict(self.scenario_options or {})
        given |= self.model_dump(
            include={
                "flow", "mix", "spread", "population", "behaviors", "duration_s", "step_s", "routes"
            },
            exclude_none=True,
        )  # fmt: skip
        limits = self.limits_mps or get_scenario(name).limits_mps
        if limits:
            given["limit_mps"] = limits[index % len(limits)]
        return given

    def scenario(self, name: str, index: int = 0) -> Scenario:
        """The scenario of that name with this configuration's options, for one of its episodes."""
        return get_scenario(name)(**self.options(name, index))

    def check(self) -> None:
        """Refuse what no episode can be made from."""
        get_engine(self.engine)
        named = [name for name in self.scenarios if name != RANDOM_WORLD]
        if len(named) < len(self.scenarios):
            self._check_worlds()
        for name in named:
            for index in range(len(self.limits_mps or get_scenario(name).limits_mps or (None,))):
                self.scenario(name, index)
        called = [scenario_name(name) for name in self.scenarios]
        if len(set(called)) != len(called):
            raise InputError(f"scenarios: found {', '.join(called)}, expected each once")

    def _check_worlds(self) -> None:
        """Refuse what random worlds draw themselves."""
        given = self.model_dump(exclude_defaults=True).keys() - NOT_DRAWN
        if given:
            name = {"scenario_options": "set"}.get(min(given), min(given))
            raise InputError(f"{name}: found one for {RANDOM_WORLD}, expected none: it is drawn")
        if not 1.0 <= (self.duration_s or 1.0) <= 3600.0:
            raise InputError(f"duration_s: found {self.duration_s}, expected 1 to 3600")


def scenario_name(given: str) -> str:
    """Name of a scenario that is given by its name, or the path of its file or map."""
    return given if given == RANDOM_WORLD else get_scenario(given).name


def _from_folder(name: str, value: object, folder: Path) -> object:
    """A field of a file, whose paths begin in the file's folder, as in a scenario's file."""
    if name == "scenarios" and isinstance(value, list):
        return [_from_folder("scenario", one, folder) for one in value]
    if not isinstance(value, str):
        return value
    named = name in ("scenario", "population", "behaviors") and is_path(value)
    return str(folder / value) if named or name in ("net", "routes") else value


def read_config(path: Path | None, **given: object) -> GenerateConfig:
    """A configuration from a TOML file, from options, or both; options win.

    The file has fields of `GenerateConfig`, and its paths begin in its folder. Options are None
    where not given. In both, ``net`` stands for a map as the only scenario.
    """
    fields: dict[str, object] = {} if path is None else read_toml(path)
    if path is not None:
        fields = {name: _from_folder(name, value, path.parent) for name, value in fields.items()}
    fields.update({name: value for name, value in given.items() if value is not None})
    net = fields.pop("net", None)
    if net is not None:
        if named := fields.get("scenarios"):
            first = named[0] if isinstance(named, list | tuple) else named
            raise InputError(
                f"--net: found {net} beside the scenario {str(first)[:80]}, expected one of the two"
            )
        fields["scenarios"] = (str(net),)
    try:
        config = GenerateConfig.model_validate(fields)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        if first["type"] == "missing":
            option = {"scenarios": "--scenario"}.get(where, f"--{where}")
            raise InputError(f"{option}: found none, expected one (or {where} in a file)") from None
        wrong = first_wrong_field(error, [*GenerateConfig.model_fields, "net"])
        raise InputError(f"{path or 'options'}: {wrong}") from None
    for name in filter(is_path, config.scenarios):  # in a child process, before an engine reads it
        guarded_call(Path(name), _try_scenario, config, name)
    return config


def _try_scenario(config: GenerateConfig, name: str) -> None:
    config.scenario(name)
