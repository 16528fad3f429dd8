"""Scenarios from TOML files and of maps: what a path given as a scenario's name stands for.

The keys of a scenario's file are those of `ScenarioFile`. All but ``scenario``, ``net``,
``limits_mps`` and ``name`` are options of the scenario that the file is about, as its docstring
explains them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from behaviors.errors import InputError, in_file
from behaviors.toml_files import read_toml
from scenarios.entry import ScenarioEntry
from scenarios.networks.convert import name_of
from scenarios.own.own_road import own_road
from sim.invalid_fields import first_wrong_field
from sim.scenario import RouteFlow, Scenario

SCENARIO_SUFFIX: Final = ".toml"
"""How the names of scenario files end."""

_Positive = Annotated[float, Field(gt=0)]
_Rate = Annotated[float, Field(ge=0)]
_Shares = str | dict[str, float]
_STRICT = ConfigDict(
    extra="forbid", frozen=True, strict=True, allow_inf_nan=False, use_attribute_docstrings=True
)


class Flow(BaseModel):
    """The demand along one route: a table ``[[flows]]`` of a scenario's file."""

    model_config = _STRICT

    route: Annotated[tuple[str, ...], Field(min_length=1, strict=False)]
    """Edges from first to last, each joined to the next."""

    per_hour: _Rate
    """Agents per hour."""

    walking: bool = False
    """Whether they walk; the edges then have sidewalks."""


class ScenarioFile(BaseModel):
    """The keys of a scenario's file; ``scenario`` or ``net`` gives the road."""

    model_config = _STRICT

    scenario: str | None = None
    """A registered scenario that this one differs from."""

    net: str | None = None
    """A map instead: SUMO net, OpenStreetMap, OpenDRIVE, Lanelet2, CommonRoad or Argoverse 2; a
    path from the file's folder."""

    name: Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[\w.-]+$")] | None = None
    """Name of the scenario; by default the file's name."""

    routes: str | None = None
    """A SUMO route file, for a map; a path from the file's folder."""

    flow: str | float | None = None
    """"light", "medium", "dense" or vehicles per hour over all routes."""

    demand: dict[str, _Rate] | None = None
    """Vehicles per hour that enter at each edge, for a map."""

    flows: Annotated[tuple[Flow, ...], Field(min_length=1, strict=False)] | None = None
    """The demand along each route, for a map: tables with ``route``, ``per_hour``, ``walking``."""

    pedestrians_per_h: _Rate | None = None
    """Pedestrians per hour, for a registered scenario."""

    mix: _Shares | None = None
    """Share of each behaviour: a table or "impatient=.2,timid=.8"."""

    kinds: _Shares | None = None
    """Share of each kind of vehicle: a table or "car=.9,truck=.1"."""

    spread: float | None = None
    """How much drivers of one behaviour differ, 0 to 1."""

    population: str | dict[str, Any] | None = None
    """A shipped population's name, a TOML file (a path from the file's folder), or its content as a
    table."""

    behaviors: str | dict[str, Any] | None = None
    """Behaviours of one's own, beside the six: names that ship, a TOML file (a path from the file's
    folder), or its content as a table."""

    jaywalk_share: float | None = None
    """Share of pedestrians who cross on red and anywhere."""

    duration_s: float | None = None
    """Length of an episode, s."""

    step_s: float | None = None
    """Time between frames, s."""

    lanes: int | None = None
    """Lanes per direction, of a registered scenario."""

    limit_mps: _Positive | None = None
    """Speed limit, m/s; of a map, the greatest."""

    limits_mps: Annotated[tuple[_Positive, ...], Field(min_length=1, strict=False)] | None = None
    """Speed limits that the episodes of a dataset take in turn, m/s."""

    left_hand: bool | None = None
    """Whether traffic drives on the left, of an OpenStreetMap map."""

    signals: bool | None = None
    """Whether a map's traffic lights work; without them priority rules."""

    options: dict[str, Any] | None = None
    """Further options of a registered scenario, such as control, crossing, two_way, length_m."""

    @model_validator(mode="after")
    def _fits_together(self) -> ScenarioFile:
        if (self.scenario is None) == (self.net is None):
            raise InputError("scenario: expected either it or net")
        if self.limit_mps is not None and self.limits_mps is not None:
            raise InputError("limits_mps: found limit_mps beside it, expected one of them")
        return self

    def given(self, folder: Path) -> dict[str, Any]:
        """The options that the scenario is made with; paths begin in a folder."""
        left_out = {"scenario", "net", "name", "limits_mps", "options", "flows", "routes"}
        found = self.model_dump(exclude=left_out, exclude_none=True)
        for name, value in (self.options or {}).items():
            if name in type(self).model_fields:
                raise InputError(f"options: found {name!r}, expected it outside the table")
            found[name] = value
        if self.flows is not None:
            found["flows"] = [RouteFlow(one.route, one.per_hour, one.walking) for one in self.flows]
        if self.routes is not None:
            found["routes"] = folder / self.routes
        for name in ("population", "behaviors"):
            given = found.get(name)
            if isinstance(given, str) and is_path(given):
                found[name] = read_toml(folder / given)
        if self.limits_mps is not None:
            found["limit_mps"] = self.limits_mps[0]
        return found


def is_path(name: str) -> bool:
    """Whether a scenario's name is a path: registered names have no dot and no slash.

    Examples:
        >>> is_path("town.net.xml"), is_path("straight_road")
        (True, False)
    """
    return "." in name or "/" in name or "\\" in name


def scenario_at(path: Path, registered: Mapping[str, ScenarioEntry]) -> ScenarioEntry:
    """The scenario of a map, or of a TOML file, which may differ from a registered one."""
    if path.suffix != SCENARIO_SUFFIX:
        if not path.is_file():
            raise InputError(
                f"{path}: found no file, expected a map or a scenario ({SCENARIO_SUFFIX})"
            )
        return ScenarioEntry(name_of(path), functools.partial(own_road, net=path))
    table = read_toml(path)
    with in_file(path):
        try:
            read = ScenarioFile.model_validate(table)
        except ValidationError as error:
            raise InputError(first_wrong_field(error, ScenarioFile.model_fields)) from None
        given = read.given(path.parent)
        function: Callable[..., Scenario]
        if read.net is not None:
            function = functools.partial(own_road, net=path.parent / read.net)
        elif is_path(str(read.scenario)):
            raise InputError(f"scenario: found {read.scenario!r:.60}, expected a registered one")
        else:
            with in_file("scenario"):
                function = registered[str(read.scenario)].function
    return ScenarioEntry(read.name or name_of(path), function, given, read.limits_mps or ())
