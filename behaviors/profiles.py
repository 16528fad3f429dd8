"""A driver's numbers, and drivers drawn around those of a behaviour.

A `Profile` gives what a driver wants, dares, obeys and perceives. Every driver of every behaviour
follows the same car-following and lane-change law with the same noise. Only these numbers differ
between behaviours.

References:
    Treiber, Kesting, Helbing (2006), Delays, inaccuracies and anticipation in microscopic traffic
        models, Physica A 360, 71: the human driver model.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.elementwise import exponential
from behaviors.errors import InputError
from behaviors.toml_files import read_toml

DEFAULT_SPREAD: Final = 0.15
"""Log-normal spread of every positive number between drivers of one behaviour (our choice)."""

FARTHEST_SPREADS: Final = 2.0
"""Largest distance of any number from its median, in spreads (our choice, as SUMO cuts off its
drivers' speeds)."""


@dataclass(frozen=True, slots=True)
class Profile:
    """One driver's parameters.

    Attributes:
        speed_factor: desired speed as a multiple of the limit.
        time_headway_s: time gap wanted to the leader, s.
        min_gap_m: bumper-to-bumper gap wanted at standstill, m.
        max_accel_mps2: largest acceleration used, m/s2.
        comfort_decel_mps2: largest braking used when nothing surprises, m/s2.
        politeness: weight of others' loss in a lane change (MOBIL's p), 0 to 1.
        lane_change_gain: eagerness to change lanes for speed; 1 is an average driver.
        lane_change_patience_s: how long a faster lane must promise to stay faster, s.
        lane_change_assertiveness: by what factor smaller gaps are accepted when changing; 1 is
            average.
        gap_acceptance_s: time gap demanded in traffic with priority, s.
        crossing_gap_s: time gap demanded to pedestrians on or near a crossing, s.
        yield_probability: chance to let pedestrians go first, drawn once per encounter, and to let
            vehicles that are still in a junction leave it, drawn once per junction.
        red_run_probability: chance to run a red light when first in line, drawn per encounter.
        stop_roll_probability: chance to roll over a stop line without stopping, drawn per
            encounter.
        yellow_run_s: for how long after the onset of yellow a driver still goes, s.
        insistence: how far others with priority are made to brake when merging into or crossing
            their way, 0 (not at all) to 1 (as hard as they can).
        startup_delay_s: time from being able to go to going, s.
        cut_in_rate_per_min: wish to cut in front of a chosen neighbour, per minute.
        stop_rate_per_min: unprovoked slowing or stopping, per minute.
        wrong_way_rate_per_min: wish to drive on the opposite side to get past, per minute.
        reaction_time_s: age of what the driver perceives of its leader, s.
        perception_noise: standard deviation of the relative error of the perceived gap, which
            drifts within `ERROR_TIME_S`; the error of the closing speed is `CLOSING_ERROR_PER_S`
            times as large per metre of gap.
        lapse_rate_per_min: lapses of attention, per minute.
        lapse_s: mean duration of a lapse, in which the driver goes on as it was, s.
        overlook_probability: chance not to see a vehicle with priority, a pedestrian or a light,
            drawn once per encounter.
    """

    speed_factor: float
    time_headway_s: float
    min_gap_m: float
    max_accel_mps2: float
    comfort_decel_mps2: float
    politeness: float
    lane_change_gain: float
    lane_change_patience_s: float
    lane_change_assertiveness: float
    gap_acceptance_s: float
    crossing_gap_s: float
    yield_probability: float
    red_run_probability: float
    stop_roll_probability: float
    yellow_run_s: float
    insistence: float
    startup_delay_s: float
    cut_in_rate_per_min: float
    stop_rate_per_min: float
    wrong_way_rate_per_min: float
    reaction_time_s: float = 0.0
    perception_noise: float = 0.0
    lapse_rate_per_min: float = 0.0
    lapse_s: float = 0.0
    overlook_probability: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what no driver can be."""
        for name in PROFILE_FIELDS:
            value, most = getattr(self, name), _MOST.get(name, np.inf)
            if not np.isfinite(value) or not 0 <= value <= most:
                expected = "a number >= 0" if most == np.inf else f"0 to {most:g}"
                raise InputError(f"Profile.{name}: found {value}, expected {expected}")
        for name in ("speed_factor", "time_headway_s", "max_accel_mps2", "comfort_decel_mps2"):
            if getattr(self, name) == 0:
                raise InputError(f"Profile.{name}: found 0, expected a number > 0")


PROFILE_FIELDS: Final[tuple[str, ...]] = tuple(f.name for f in dataclasses.fields(Profile))
"""The order of the profile numbers wherever they stand in a table."""

_PROBABILITIES: Final = (
    "politeness",
    "yield_probability",
    "red_run_probability",
    "stop_roll_probability",
    "insistence",
    "overlook_probability",
)

PERCEPTION_FIELDS: Final = PROFILE_FIELDS[-5:]
"""The numbers of perception and attention: all 0 for the six behaviours."""

_MOST: Final = {
    **dict.fromkeys(_PROBABILITIES, 1.0),
    "reaction_time_s": 5.0,
    "perception_noise": 1.0,
    "lapse_s": 60.0,
}
"""Largest values that are accepted (our choice: a vehicle beyond them is not driven)."""

SPREAD_FIELDS: Final = tuple(
    name for name in PROFILE_FIELDS if name not in (*_PROBABILITIES, *PERCEPTION_FIELDS)
)
"""The numbers in which drivers of one behaviour differ. Chance enters the others at each encounter.
Those of perception are the same for all drivers of a behaviour."""

ERROR_TIME_S: Final = 20.0
"""Correlation time of the error of perception, s (Treiber et al. 2006)."""

CLOSING_ERROR_PER_S: Final = 0.2
"""Error of the closing speed per metre of gap, relative to that of the gap, 1/s (Treiber et al.
2006: 0.01/s beside 5 %)."""

SOURCES: Final[dict[str, str]] = read_toml(Path(__file__).with_name("sources.toml"))
"""Where each number of ``behaviors.PROFILES`` comes from."""


def sample_profile(
    median: Profile, rng: np.random.Generator, spread: float = DEFAULT_SPREAD
) -> Profile:
    """Draw one driver of a behaviour.

    Every number of `SPREAD_FIELDS` is multiplied by exp(spread * z). z is standard normal,
    independent and cut off at ``FARTHEST_SPREADS``. Probabilities are not drawn: chance enters at
    each encounter.

    Args:
        median: the behaviour's profile.
        rng: source of randomness; the number of draws is fixed.
        spread: standard deviation of each logarithm; 0 gives clones.

    Returns:
        The driver's own profile.

    Raises:
        InputError: if ``spread`` is negative or not finite.

    Examples:
        >>> from behaviors import PROFILES, Behavior
        >>> rng = np.random.default_rng(0)
        >>> timid = PROFILES[Behavior.TIMID]
        >>> sample_profile(timid, rng, spread=0.0) == timid
        True
    """
    if not np.isfinite(spread) or spread < 0:
        raise InputError(f"spread: found {spread}, expected a number >= 0")
    drawn_z = rng.standard_normal(len(SPREAD_FIELDS)).clip(-FARTHEST_SPREADS, FARTHEST_SPREADS)
    factors = exponential(spread * drawn_z)
    drawn = {n: float(getattr(median, n) * f) for n, f in zip(SPREAD_FIELDS, factors, strict=True)}
    return dataclasses.replace(median, **drawn)
