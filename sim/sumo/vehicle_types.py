"""How SUMO moves vehicles: settings of a run, and a route file with one vehicle type per driver.

All drivers of a run have the same car-following law and SUMO's LC2013 lane-change model with the
same imperfection (`SumoSettings`); they differ in what their `Profile` says. `law_attributes` says
it in the words of each law of SUMO. Laws that have no number for something ignore it.

References:
    Krauss (1998), Microscopic modeling of traffic flow, DLR-FB 98-08.
    Treiber, Hennecke, Helbing (2000), Phys. Rev. E 62, 1805: IDM.
    Treiber, Helbing (2003), Memory effects in microscopic traffic models, Phys. Rev. E 68: IDMM.
    Salles, Kaufmann, Reuss (2022), Extending the Intelligent Driver Model in SUMO: EIDM.
    Milanes, Shladover (2014), Transportation Research Part C 48: ACC and CACC.
    Wiedemann (1974), Simulation des Strassenverkehrsflusses; VISSIM's law of 1999: W99.
    Kerner, Klenov, Wolf (2002), J. Phys. A 35, 9971: BKerner.
    Erdmann (2015), SUMO's lane-changing model, Modeling Mobility with Open Data.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final
from xml.sax.saxutils import quoteattr

from behaviors.errors import InputError
from behaviors.profiles import CLOSING_ERROR_PER_S, ERROR_TIME_S, Profile
from sim.frames import AgentKind
from sim.scenario import IMPERFECTION, KIND_LIMITS, WALK_START_M, AgentSpec

VEHICLE_CLASS: Final = {kind: kind.value for kind in AgentKind} | {AgentKind.CAR: "passenger"}
"""SUMO's class of each kind."""

REFERENCE_MPS: Final = 13.89
"""Speed at which a law without a time headway gets the same gap as one with it: 50 km/h, the
limit that the profiles were made for."""

LAWS: Final = (
    "Krauss", "KraussOrig1", "KraussPS", "Daniel1", "IDM", "IDMM", "EIDM", "ACC", "CACC", "W99",
    "Wiedemann", "BKerner",
)  # fmt: skip
"""SUMO's car-following laws for road vehicles. SmartSK and PWagner2009 are left out, because their
drivers collide or stand on a free road."""


def law_attributes(law: str, profile: Profile) -> dict[str, float]:
    """The vType attributes of one of ``LAWS`` that differ from those of Krauss's law, by name."""
    headway_s, accel = profile.time_headway_s, profile.max_accel_mps2
    match law:
        case "Daniel1" | "BKerner":  # no safe braking of the own step: headways exceed a step
            return {"tau": 0.25 + 0.9 * headway_s}
        case "ACC" | "CACC":  # both collide at headways below a second (measured)
            return {"tau": 0.7 + 0.75 * headway_s, "minGap": max(profile.min_gap_m, 1.5)}
        case "Wiedemann":  # its gap is minGap + (1 + 7 security) sqrt(v)
            wanted = headway_s * REFERENCE_MPS**0.5
            return {"security": min(max((wanted - 1.0) / 7.0, 0.05), 1.2), "estimation": 0.5}
        case "W99":  # cc1 is the time headway, cc8 the acceleration from standstill
            return {"cc1": headway_s, "cc2": 4.0, "cc8": accel, "cc9": 0.6 * accel}
        case _:
            return {}


@dataclass(frozen=True, slots=True)
class SumoSettings:
    """Settings that all vehicles of a run share.

    Attributes:
        law: the car-following law, one of ``LAWS``.
        imperfection: sigma of Krauss's law and its relatives, 0 to 1.
        keep_right: SUMO's lcKeepRight: 0 never returns to the right lane for its own sake, 1 is
            SUMO's default.
        lane_change_s: how long a lane change takes, s; 0 is a jump (the default is that of Toledo
            and Zohar 2007, Transportation Research Record 1999).
        longest_step_s: SUMO's own step is at most this long, s; frames further apart are made of
            several.
        options: further options of SUMO, such as those of its outputs, after the product's own.
    """

    law: str = "Krauss"
    imperfection: float = IMPERFECTION
    keep_right: float = 0.0
    lane_change_s: float = 2.5
    longest_step_s: float = 0.1
    options: tuple[str, ...] = ()


DEFAULT_SETTINGS: Final = SumoSettings()
"""The settings of the engine ``sumo``."""


def alternative_name(agent: AgentSpec) -> str:
    """Name of the vehicle type of a driver with another behaviour than it was drawn with."""
    return f"{agent.id}@{agent.behavior}"


def vehicle_type(
    agent: AgentSpec, settings: SumoSettings = DEFAULT_SETTINGS, name: str = ""
) -> dict[str, str]:
    """All vType attributes of one agent, named by its id unless it has another name."""
    words = {"id": name or str(agent.id), "vClass": VEHICLE_CLASS[agent.kind]}
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
            **law_attributes(settings.law, profile),
        }
        if profile.reaction_time_s > 0:
            numbers["actionStepLength"] = max(profile.reaction_time_s, settings.longest_step_s)
    return words | {attribute: f"{value:.6g}" for attribute, value in numbers.items()}


def route_file(
    agents: Sequence[AgentSpec],
    jaywalking: Mapping[int, float],
    settings: SumoSettings,
    alternatives: Sequence[AgentSpec] = (),
) -> Iterator[str]:
    """The lines of a SUMO route file, in order of departure, without line ends.

    Jaywalkers cross the road so far along their first edge, m, by agent id. The vehicle types of
    the alternatives, drivers with other behaviours, are added.
    """
    yield "<routes>"
    ordered = sorted(agents, key=lambda a: (a.depart_s, a.id))
    for agent in ordered:
        yield type_element(agent, settings=settings)
    for agent in alternatives:
        yield type_element(agent, alternative_name(agent), settings=settings)
    for agent in ordered:
        edges = quoteattr(" ".join(agent.route))
        named = f' id="{agent.id}" type="{agent.id}" depart="{agent.depart_s:.3f}"'
        if agent.kind is AgentKind.PEDESTRIAN:
            at = jaywalking.get(agent.id)
            start = -WALK_START_M if at is None else max(at - WALK_START_M, 0.0)
            yield f'<person{named} departPos="{start:g}">'
            yield f"<walk edges={edges}/></person>"
        else:
            yield f'<vehicle{named} departLane="best" departSpeed="max">'
            yield f"<route edges={edges}/></vehicle>"
    yield "</routes>"


def type_element(
    agent: AgentSpec,
    name: str = "",
    probability: float | None = None,
    settings: SumoSettings = DEFAULT_SETTINGS,
) -> str:
    """The vType of a driver; with a probability it is a member of a vTypeDistribution.

    A driver that errs has SUMO's driver-state device. Half of the device's awareness and twice its
    usual coefficients make its Ornstein-Uhlenbeck process one of standard deviation 1 and
    correlation time `ERROR_TIME_S`.
    """
    attributes = vehicle_type(agent, settings, name)
    if probability is not None:
        attributes["probability"] = f"{probability:.6g}"
    noise = 0.0 if agent.profile is None else agent.profile.perception_noise
    if not noise:
        return f"<vType{_attributes(attributes)}/>"
    numbers = {
        "initialAwareness": 0.5,
        "minAwareness": 0.1,
        "errorTimeScaleCoefficient": 2.0 * ERROR_TIME_S,
        "errorNoiseIntensityCoefficient": 2.0,
        "headwayErrorCoefficient": noise,
        "speedDifferenceErrorCoefficient": noise * CLOSING_ERROR_PER_S,
        "headwayChangePerceptionThreshold": 0.0,
        "speedDifferenceChangePerceptionThreshold": 0.0,
    }
    parameters = {"has.driverstate.device": "true"}
    parameters |= {f"device.driverstate.{key}": f"{value:.6g}" for key, value in numbers.items()}
    inner = "".join(
        f"<param{_attributes({'key': key, 'value': value})}/>" for key, value in parameters.items()
    )
    return f"<vType{_attributes(attributes)}>{inner}</vType>"


def _attributes(values: dict[str, str]) -> str:
    return "".join(f" {name}={quoteattr(value)}" for name, value in values.items())
