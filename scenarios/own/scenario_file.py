"""Scenarios on one's own road and from TOML files: what a path given as a scenario's name means.

The keys of a scenario's file are those of `ScenarioFile`. All but ``scenario``, ``net``,
``limits_mps`` and ``name`` are options of the scenario that the file is about, as its docstring
explains them.
"""

from __future__ import annotations

import dataclasses
import functools
import logging
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Unpack

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from behaviors.errors import InputError, in_file
from behaviors.toml_files import read_toml
from scenarios.demand import PopulationOptions, ScenarioEntry, parse_flow, parse_population
from scenarios.networks.convert import edited_net, name_of, open_map
from scenarios.own.flows import flows_of, read_routes
from sim.invalid_fields import first_wrong_field
from sim.road.net import read_road
from sim.scenario import RouteFlow, Scenario

LOGGER: Final = logging.getLogger("graphrqi")

SCENARIO_SUFFIX: Final = ".toml"
"""How the names of scenario files end."""


def own_road(
    *,
    net: str | Path,
    routes: str | Path | None = None,
    flow: str | float | None = None,
    demand: Mapping[str, float] | None = None,
    flows: Sequence[RouteFlow] | None = None,
    signals: bool = True,
    limit_mps: float | None = None,
    left_hand: bool | None = None,
    **population: Unpack[PopulationOptions],
) -> Scenario:
    """Any road: a SUMO net, or a map that netconvert turns into one.

    Args:
        net: the map: a SUMO net, OpenStreetMap, OpenDRIVE, Lanelet2, CommonRoad or Argoverse 2.
        routes: a SUMO route file; None for routes made from the map, as
            `scenarios.own.flows.flows_of` does.
        flow: ``light``, ``medium``, ``dense`` or vehicles per hour over all routes; None for what
            the route file says, or else ``medium``. Levels need routes made from the map.
        demand: vehicles per hour that enter at each edge, by edge; instead of ``flow``.
        flows: the routes themselves with their flows; instead of ``routes``, ``flow`` and
            ``demand``.
        signals: whether traffic lights work; else priority rules at their junctions.
        limit_mps: greatest speed limit, m/s; None for the map's own.
        left_hand: whether traffic drives on the left, of OpenStreetMap; None for what it says.
        population: see `scenarios.demand.PopulationOptions`.

    Returns:
        The scenario, named after the map.

    Raises:
        InputError: if a file is broken, an option is out of range, or no route exists; one line
            that names it.
    """
    kinds = {"routes": routes, "demand": demand, "flows": flows}
    given = [name for name, value in kinds.items() if value is not None]
    if flow is not None and given != ["routes"]:
        given.append("flow")
    if len(given) > 1:
        raise InputError(f"{given[0]}: found {given[1]} beside it, expected one of them")
    found, name = open_map(Path(net), left_hand), name_of(Path(net))
    road = read_road(edited_net(found.net, signals, limit_mps), name)
    for text in found.source.warnings:
        LOGGER.warning("%s: %s", net, text)
    if routes is not None:
        flows = read_routes(Path(routes), road)
        if flow is not None:
            vehicles, total = parse_flow(flow, {}), sum(one.per_hour for one in flows)
            if not total > 0:
                raise InputError("flow: found routes without vehicles, expected some to share it")
            flows = [
                dataclasses.replace(one, per_hour=one.per_hour * vehicles / total) for one in flows
            ]
    elif flows is None:
        flows = flows_of(road, "medium" if flow is None else flow, demand)
    return Scenario(name, road, tuple(flows), **parse_population(population))


_Positive = Annotated[float, Field(gt=0)]
_Rate = Annotated[float, Field(ge=0)]
_Shares = str | dict[str, float]
_STRICT = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Flow(BaseModel):
    """The demand along one route: edges, agents per hour, and whether they walk."""

    model_config = _STRICT
    route: Annotated[tuple[str, ...], Field(min_length=1, strict=False)]
    per_hour: _Rate
    walking: bool = False


class ScenarioFile(BaseModel):
    """The keys of a scenario's file; ``docs/roads.md`` explains them.

    Paths in ``net``, ``routes``, ``population`` and ``behaviors`` begin in the file's folder.
    """

    model_config = _STRICT
    scenario: str | None = None
    net: str | None = None
    name: Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[\w.-]+$")] | None = None
    routes: str | None = None
    flow: str | float | None = None
    demand: dict[str, _Rate] | None = None
    flows: Annotated[tuple[Flow, ...], Field(min_length=1, strict=False)] | None = None
    pedestrians_per_h: _Rate | None = None
    mix: _Shares | None = None
    kinds: _Shares | None = None
    spread: float | None = None
    population: str | dict[str, Any] | None = None
    behaviors: str | dict[str, Any] | None = None
    jaywalk_share: float | None = None
    duration_s: float | None = None
    step_s: float | None = None
    lanes: int | None = None
    limit_mps: _Positive | None = None
    limits_mps: Annotated[tuple[_Positive, ...], Field(min_length=1, strict=False)] | None = None
    left_hand: bool | None = None
    signals: bool | None = None
    options: dict[str, Any] | None = None

    @model_validator(mode="after")
    def _fits_together(self) -> ScenarioFile:
        if (self.scenario is None) == (self.net is None):
            raise InputError("scenario: expected either it or net")
        if self.limit_mps is not None and self.limits_mps is not None:
            raise InputError("limits_mps: found limit_mps beside it, expected one of them")
        for name in self.options or ():
            if name in type(self).model_fields:
                raise InputError(f"options: found {name!r}, expected it outside the table")
        return self

    def given(self, folder: Path) -> dict[str, Any]:
        """The options that the scenario is made with; paths begin in a folder."""
        left_out = {"scenario", "net", "name", "limits_mps", "options"}
        found = {**self.model_dump(exclude=left_out, exclude_none=True), **(self.options or {})}
        if "flows" in found:
            found["flows"] = [RouteFlow(**one) for one in found["flows"]]
        if "routes" in found:
            found["routes"] = folder / found["routes"]
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
