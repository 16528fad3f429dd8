"""What a dataset is generated from: a TOML file, options of the command line, or both."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from behaviors.errors import InputError
from scenarios import get_scenario
from sim.engines import get_engine
from sim.invalid_fields import first_wrong_field
from sim.scenario import Scenario


class GenerateConfig(BaseModel):
    """What a dataset is generated from.

    Attributes:
        scenarios: registered names.
        episodes: episodes per scenario.
        seed: any non-negative integer.
        engine: registered name of the engine.
        flow: light, medium, dense or vehicles per hour; None for the scenario's own.
        mix: share of each behaviour, as text or mapping; None for the scenario's own.
        spread: how much drivers of one behaviour differ; None for the scenario's own.
        duration_s: length of an episode, s; None for the scenario's own.
        step_s: time between frames, s; None for the scenario's own.
        limits_mps: speed limits that a scenario's episodes take in turn, m/s; None for its own.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    scenarios: Annotated[tuple[str, ...], Field(min_length=1)]
    episodes: Annotated[int, Field(ge=1, le=10**6)]
    seed: Annotated[int, Field(ge=0)] = 0
    engine: str = "sumo"
    flow: str | float | None = None
    mix: str | dict[str, float] | None = None
    spread: float | None = None
    duration_s: float | None = None
    step_s: float | None = None
    limits_mps: Annotated[tuple[float, ...], Field(min_length=1)] | None = None

    def options(self, index: int) -> dict[str, Any]:
        """What a scenario of the episode with this index is called with."""
        given: dict[str, Any] = self.model_dump(
            include={"flow", "mix", "spread", "duration_s", "step_s"}, exclude_none=True
        )
        if self.limits_mps is not None:
            given["limit_mps"] = self.limits_mps[index % len(self.limits_mps)]
        return given

    def scenario(self, name: str, index: int = 0) -> Scenario:
        """The scenario of that name with this configuration's options, for one of its episodes.

        Raises:
            InputError: if there is no such scenario or an option is out of range.
        """
        return get_scenario(name)(**self.options(index))

    def check(self) -> None:
        """Refuse what no episode can be made from.

        Raises:
            InputError: if the engine or a scenario is not known or named twice, or an option is
                out of range.
        """
        get_engine(self.engine)
        for name in self.scenarios:
            for index in range(len(self.limits_mps or (None,))):
                self.scenario(name, index)
        if len(set(self.scenarios)) != len(self.scenarios):
            raise InputError(f"scenarios: found {', '.join(self.scenarios)}, expected each once")


def _read_toml(path: Path | None) -> dict[str, object]:
    if path is None:
        return {}
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {error}") from None


def read_cluster(path: Path | None, given: str | None = None) -> str | None:
    """The address of the cluster to generate on.

    Args:
        path: TOML file whose section ``[cluster]`` may have an ``address``; None for none.
        given: address given on the command line; it wins.

    Returns:
        The address; None to generate on this machine.

    Raises:
        InputError: if the section has anything else in it.
    """
    section = _read_toml(path).get("cluster", {})
    if not isinstance(section, dict) or set(section) - {"address"}:
        raise InputError(f"{path}: cluster: found {section!r}, expected an address and no more")
    address = given or section.get("address")
    if address is not None and not isinstance(address, str):
        raise InputError(f"{path}: cluster.address: found {address!r}, expected text")
    return address


def read_config(path: Path | None, **given: object) -> GenerateConfig:
    """A configuration from a TOML file, from options, or both; options win.

    Args:
        path: TOML file with the fields of `GenerateConfig`; None for none.
        **given: fields given on the command line; None where not given.

    Returns:
        The configuration.

    Raises:
        InputError: if the file is broken, a field unknown or a value wrong.
    """
    fields = _read_toml(path)
    fields.pop("cluster", None)
    fields.update({name: value for name, value in given.items() if value is not None})
    try:
        return GenerateConfig.model_validate(fields)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        if first["type"] == "missing":
            option = {"scenarios": "--scenario"}.get(where, f"--{where}")
            raise InputError(f"{option}: found none, expected one (or {where} in a file)") from None
        wrong = first_wrong_field(error, [*GenerateConfig.model_fields, "cluster"])
        raise InputError(f"{path or 'options'}: {wrong}") from None
