"""The configuration of the environments: its keys, their defaults and what each of them takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Final, Literal

from pydantic import (
    BaseModel,
    Field,
    PlainValidator,
    SkipValidation,
    ValidationError,
    model_validator,
)

from behaviors.errors import InputError
from behaviors.labels import read_behaviors, tables_of
from behaviors.populations import read_population
from behaviors.profiles import DEFAULT_SPREAD
from sim.highway.ego import check_action
from sim.invalid_fields import first_wrong_field

_POPULATION: Final = PlainValidator(
    lambda given: None if given is None else read_population(given).table()
)
_BEHAVIORS: Final = PlainValidator(
    lambda given: None if given is None else tables_of(read_behaviors(given))
)


class TrafficConfig(
    BaseModel, extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True
):
    """The keys that every environment has."""

    observation: Literal["kinematics", "behavior", "posterior", "graph"] = "kinematics"
    """Observation: positions and motion; with them every driver's true behaviour, the classifier's
    probabilities, or the traffic graph."""

    observed: int = Field(default=15, ge=1, le=10_000)
    """How many other agents are observed at most."""

    action: Annotated[Mapping[str, Any], PlainValidator(check_action)] = Field(
        default_factory=lambda: {
            "type": "DiscreteMetaAction",
            "target_speeds": [0.0, 3.0, 6.0, 9.0, 12.0, 15.0],
        }
    )
    """highway-env's "DiscreteMetaAction", "DiscreteAction" or "ContinuousAction" as ``type``, with
    its options; or "StockDriver": highway-env's IDM and MOBIL drive, whatever the action."""

    flow: Annotated[str | float, SkipValidation] = "medium"
    """Traffic: "light", "medium", "dense" or vehicles per hour."""

    mix: Annotated[str | Mapping[str, float] | None, SkipValidation] = None
    """Shares of behaviours or styles among the drivers: a mapping or "aggressive=.2,timid=.8"; None
    for equal shares."""

    spread: Annotated[float, SkipValidation] = DEFAULT_SPREAD
    """How much drivers of one behaviour differ."""

    population: Annotated[dict[str, Any] | None, _POPULATION] = None
    """A shipped population's name ("us101"), a TOML file, or its parsed content; None for drivers
    around the profiles."""

    behaviors: Annotated[dict[str, Any] | None, _BEHAVIORS] = None
    """Behaviours of one's own, beside the six, that the mix may name: names that ship, a TOML file,
    or its parsed content. In observations each counts for that of the six which it is like."""

    net: str | None = None
    """A map to drive on instead, of any kind that `graphrqi road` reads; the ego vehicle takes a
    route drawn for each episode."""

    routes: str | None = None
    """A SUMO route file for ``net``; None: routes made from the map."""

    scenario: str | None = None
    """Another scenario to drive in: a registered name, or a TOML file."""

    ego_route: Sequence[str] | None = Field(default=None, min_length=1)
    """The edges that the ego vehicle drives over; None: the environment's own, or a drawn one."""

    seed: int | None = Field(default=None, ge=0, lt=2**31)
    """Seed of every episode's traffic; None: each episode draws its own from ``reset(seed)``."""

    duration_s: float = Field(default=40.0, ge=1.0, le=1e6, allow_inf_nan=False)
    """Time after which an episode is truncated, s."""

    warmup_s: float = Field(default=20.0, ge=0.0, le=3600.0, allow_inf_nan=False)
    """How long the traffic drives before the ego vehicle enters, s."""

    simulation_frequency: int = Field(default=10, ge=10, le=1000)
    """Simulation steps per second, at least 10."""

    policy_frequency: int = Field(default=5, ge=1, le=1000)
    """Decisions per second; divides the simulation frequency."""

    classifier: Callable[..., Any] | None = None
    """For the observation "posterior": takes each `Frame` and returns beliefs with ``of(ids)``, as
    ``stream.update`` does. A function without arguments makes one for each episode, or an object
    with such a method ``update``: ``graphrqi.stream.load_stream``."""

    goal: Literal["straight", "left", "right"] | None = None
    """Goal of the ego vehicle at an intersection; None for straight on, and on other roads."""

    screen_width: int = Field(default=600, ge=1, le=16_384)
    """Width of images, pixels."""

    screen_height: int = Field(default=150, ge=1, le=16_384)
    """Height of images, pixels."""

    scaling: float = Field(default=5.5, gt=0.0, allow_inf_nan=False)
    """Pixels per metre."""

    centering_position: Sequence[float] = Field(default=(0.3, 0.5), min_length=2, max_length=2)
    """Where in the image the ego vehicle is, as shares of its width and height."""

    render_agent: bool = True
    """Whether images of a window are those of the screen or those of the scene alone."""

    offscreen_rendering: bool | None = None
    """Whether images are drawn without a window; None: unless the render mode is "human"."""

    manual_control: bool = False
    """Whether the keyboard steers the ego vehicle, in a window, and actions are ignored."""

    real_time_rendering: bool = False
    """Whether a window shows at most one simulated second per second."""

    @model_validator(mode="after")
    def _fits_together(self) -> TrafficConfig:
        if self.simulation_frequency % self.policy_frequency:
            raise InputError(
                f"policy_frequency: found {self.policy_frequency}, expected a divisor of "
                f"simulation_frequency {self.simulation_frequency}"
            )
        if self.net is not None and self.scenario is not None:
            raise InputError("scenario: found net beside it, expected one of them")
        if self.classifier is None and self.observation == "posterior":
            raise InputError(
                "classifier: found None, expected a callable for the observation 'posterior', "
                "such as graphrqi.stream.load_stream"
            )
        return self


def read_config(given: Mapping[str, Any]) -> TrafficConfig:
    """Check a configuration; missing keys have the defaults of `TrafficConfig`."""
    try:
        return TrafficConfig.model_validate(dict(given))
    except ValidationError as error:
        cause = error.errors(include_url=False)[0].get("ctx", {}).get("error")
        if isinstance(cause, InputError):
            raise cause from None
        raise InputError(first_wrong_field(error, TrafficConfig.model_fields)) from None
