"""SUMO's route file of an episode: one vehicle type per driver.

All drivers of a run have the same car-following model and SUMO's LC2013 lane-change model with the
same imperfection (`SumoSettings`); they differ in what their `Profile` says.

References:
    Krauss (1998), Microscopic modeling of traffic flow, DLR-FB 98-08.
    Treiber, Hennecke, Helbing (2000), Phys. Rev. E 62, 1805: IDM.
    Erdmann (2015), SUMO's lane-changing model, Modeling Mobility with Open Data.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final
from xml.sax.saxutils import quoteattr

from behaviors.errors import InputError
from behaviors.profiles import CLOSING_ERROR_PER_S, ERROR_TIME_S, Profile
from sim.frames import AgentKind
from sim.scenario import KIND_LIMITS, WALK_START_M, AgentSpec
from sim.sumo.settings import DEFAULT_SETTINGS, SumoSettings, law_attributes

VEHICLE_CLASS: Final[dict[AgentKind, str]] = {
    AgentKind.CAR: "passenger",
    AgentKind.BUS: "bus",
    AgentKind.TRUCK: "truck",
    AgentKind.MOTORCYCLE: "motorcycle",
    AgentKind.BICYCLE: "bicycle",
    AgentKind.PEDESTRIAN: "pedestrian",
}
"""SUMO's class of each kind."""


def driver_attributes(profile: Profile) -> dict[str, float]:
    """The vType attributes that a driver's profile sets, by name."""
    return {
        "speedFactor": profile.speed_factor,
        "speedDev": 0.0,
        "tau": profile.time_headway_s,
        "minGap": profile.min_gap_m,
        "accel": profile.max_accel_mps2,
        "decel": profile.comfort_decel_mps2,
        "startupDelay": profile.startup_delay_s,
        "impatience": profile.insistence,
        "lcCooperative": min(profile.politeness, 1.0),
        "lcSpeedGain": profile.lane_change_gain,
        "lcSpeedGainRemainTime": profile.lane_change_patience_s,
        "lcAssertive": profile.lane_change_assertiveness,
        "jmTimegapMinor": profile.gap_acceptance_s,
        "jmCrossingGap": profile.crossing_gap_s,
        "jmDriveAfterYellowTime": profile.yellow_run_s,
    }


def perception_parameters(profile: Profile) -> dict[str, float]:
    """Parameters of SUMO's driver-state device for a driver's error of perception; none without.

    The device's error is an Ornstein-Uhlenbeck process. With half of its awareness and twice its
    usual coefficients, the process has standard deviation 1 and the correlation time
    `ERROR_TIME_S`.
    """
    noise = profile.perception_noise
    if not noise:
        return {}
    return {
        "initialAwareness": 0.5,
        "minAwareness": 0.1,
        "errorTimeScaleCoefficient": 2.0 * ERROR_TIME_S,
        "errorNoiseIntensityCoefficient": 2.0,
        "headwayErrorCoefficient": noise,
        "speedDifferenceErrorCoefficient": noise * CLOSING_ERROR_PER_S,
        "headwayChangePerceptionThreshold": 0.0,
        "speedDifferenceChangePerceptionThreshold": 0.0,
    }


def alternative_name(agent: AgentSpec) -> str:
    """Name of the vehicle type of a driver with another behaviour than it was drawn with."""
    return f"{agent.id}@{agent.behavior}"


def vehicle_type(
    agent: AgentSpec, settings: SumoSettings = DEFAULT_SETTINGS, name: str | None = None
) -> dict[str, str]:
    """All vType attributes of one agent, with the settings of the run.

    Raises:
        InputError: if a driver has no profile.
    """
    words = {"id": str(agent.id) if name is None else name, "vClass": VEHICLE_CLASS[agent.kind]}
    numbers = {"length": agent.length_m, "width": agent.width_m}
    profile = agent.profile
    if agent.kind is AgentKind.PEDESTRIAN:
        numbers |= {"maxSpeed": agent.speed_mps, "speedFactor": 1.0, "speedDev": 0.0}
        if agent.jaywalks:
            numbers["jmDriveAfterRedTime"] = 1000.0
    elif profile is None:
        raise InputError(f"agent {agent.id}: found no profile, expected one for a {agent.kind}")
    else:
        limits = KIND_LIMITS[agent.kind]
        words |= {"carFollowModel": settings.law, "laneChangeModel": "LC2013"}
        if math.isfinite(limits.cruise_mps):
            numbers["desiredMaxSpeed"] = limits.cruise_mps
        numbers |= {
            "maxSpeed": limits.max_speed_mps,
            "sigma": settings.imperfection,
            "emergencyDecel": max(limits.emergency_decel_mps2, profile.comfort_decel_mps2),
            "lcKeepRight": settings.keep_right,
            "lcOpposite": 0.0,
            "lcMaxSpeedLatStanding": 0.0,
            **driver_attributes(profile),
            **law_attributes(settings.law, profile),
        }
        if profile.reaction_time_s > 0:
            numbers["actionStepLength"] = max(profile.reaction_time_s, settings.longest_step_s)
    return words | {attribute: f"{value:.6g}" for attribute, value in numbers.items()}


def route_file(
    agents: Sequence[AgentSpec],
    jaywalking: Mapping[int, float] | None = None,
    settings: SumoSettings = DEFAULT_SETTINGS,
    alternatives: Sequence[AgentSpec] = (),
) -> Iterator[str]:
    """The lines of a SUMO route file, in order of departure.

    Args:
        agents: all agents of the episode, in any order.
        jaywalking: where along their first edge jaywalkers cross the road, m, by agent id.
        settings: what is the same for all drivers.
        alternatives: drivers with other behaviours, whose vehicle types are added.

    Yields:
        Lines of XML, without line ends.
    """
    yield "<routes>"
    ordered = sorted(agents, key=lambda a: (a.depart_s, a.id))
    for agent in ordered:
        yield _element(vehicle_type(agent, settings), agent)
    for agent in alternatives:
        yield _element(vehicle_type(agent, settings, alternative_name(agent)), agent)
    for agent in ordered:
        edges = quoteattr(" ".join(agent.route))
        depart = f"{agent.depart_s:.3f}"
        if agent.kind is AgentKind.PEDESTRIAN:
            at = (jaywalking or {}).get(agent.id)
            start = -WALK_START_M if at is None else max(at - WALK_START_M, 0.0)
            yield (
                f'<person id="{agent.id}" type="{agent.id}" depart="{depart}" '
                f'departPos="{start:g}">'
            )
            yield f"<walk edges={edges}/></person>"
        else:
            yield (
                f'<vehicle id="{agent.id}" type="{agent.id}" depart="{depart}" '
                f'departLane="best" departSpeed="max"><route edges={edges}/></vehicle>'
            )
    yield "</routes>"


def type_element(agent: AgentSpec, name: str, probability: float) -> str:
    """The vType of a driver as a member of a vTypeDistribution."""
    attributes = vehicle_type(agent, name=name) | {"probability": f"{probability:.6g}"}
    return _element(attributes, agent)


def _element(attributes: dict[str, str], agent: AgentSpec) -> str:
    """The vType of an agent, with the parameters of its driver's state if it errs."""
    named = {} if agent.profile is None else perception_parameters(agent.profile)
    if not named:
        return f"<vType{_attributes(attributes)}/>"
    parameters = {"has.driverstate.device": "true"}
    parameters |= {f"device.driverstate.{name}": f"{value:.6g}" for name, value in named.items()}
    inner = "".join(
        f"<param{_attributes({'key': key, 'value': value})}/>" for key, value in parameters.items()
    )
    return f"<vType{_attributes(attributes)}>{inner}</vType>"


def _attributes(values: dict[str, str]) -> str:
    return "".join(f" {name}={quoteattr(value)}" for name, value in values.items())
