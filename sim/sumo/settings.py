"""How SUMO moves all vehicles of a run: the law, the lane discipline, the durations.

A `Profile` says in our words what a driver wants. `law_attributes` says it in the words of each
car-following law of SUMO, so that the same drivers can drive by any of them. Laws that have no
number for something ignore it.

References:
    Krauss (1998), Microscopic modeling of traffic flow, DLR-FB 98-08.
    Treiber, Hennecke, Helbing (2000), Phys. Rev. E 62, 1805: IDM.
    Treiber, Helbing (2003), Memory effects in microscopic traffic models, Phys. Rev. E 68: IDMM.
    Salles, Kaufmann, Reuss (2022), Extending the Intelligent Driver Model in SUMO: EIDM.
    Milanes, Shladover (2014), Transportation Research Part C 48: ACC and CACC.
    Wiedemann (1974), Simulation des Strassenverkehrsflusses; VISSIM's law of 1999: W99.
    Kerner, Klenov, Wolf (2002), J. Phys. A 35, 9971: BKerner.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from behaviors.errors import InputError, lookup
from behaviors.profiles import Profile
from sim.scenario import IMPERFECTION

LONGEST_STEP_S: Final = 0.1
"""SUMO's own step is at most this long by default; frames further apart are made of several."""

LANE_CHANGE_S: Final = 2.5
"""Default duration of a lane change, s (Toledo and Zohar 2007, Transportation Research Record
1999)."""

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
    """The vType attributes that differ from those of Krauss's law.

    Args:
        law: one of ``LAWS``.
        profile: the driver.

    Returns:
        Numbers by attribute.

    Raises:
        InputError: if no such law exists; the message names the nearest.

    Examples:
        >>> from behaviors import Behavior
        >>> from behaviors.labels import PROFILES
        >>> law_attributes("W99", PROFILES[Behavior.TIMID])["cc1"]
        2.9
    """
    check_law(law)
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


def check_law(law: str) -> None:
    """Refuse a law that is none of ``LAWS``; the message names the nearest."""
    lookup(dict.fromkeys(LAWS), law, "car-following law")


@dataclass(frozen=True, slots=True)
class SumoSettings:
    """Settings that all vehicles of a run share.

    Attributes:
        law: the car-following law, one of ``LAWS``.
        imperfection: sigma of Krauss's law and its relatives, 0 to 1.
        keep_right: SUMO's lcKeepRight: 0 never returns to the right lane for its own sake, 1 is
            SUMO's default.
        lane_change_s: how long a lane change takes, s; 0 is a jump.
        longest_step_s: SUMO's own step is at most this long, s.
        options: further options of SUMO, such as those of its outputs, after the product's own.
    """

    law: str = "Krauss"
    imperfection: float = IMPERFECTION
    keep_right: float = 0.0
    lane_change_s: float = LANE_CHANGE_S
    longest_step_s: float = LONGEST_STEP_S
    options: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what SUMO would silently take."""
        check_law(self.law)
        for name, most in (
            ("imperfection", 1.0),
            ("keep_right", 100.0),
            ("lane_change_s", 60.0),
            ("longest_step_s", 1.0),
        ):
            value = getattr(self, name)
            if not 0 <= value <= most:
                raise InputError(f"{name}: found {value}, expected 0 to {most:g}")
        if self.longest_step_s < 0.001:
            raise InputError(f"longest_step_s: found {self.longest_step_s}, expected 0.001 to 1")


DEFAULT_SETTINGS: Final = SumoSettings()
"""The settings of the engine ``sumo``."""
