"""The driver models: car following (IDM, Krauss), lane changes (MOBIL) and gap acceptance.

Each is a pure function of plain floats in SI units. The simulator and the predictor compile these
functions (`sim.compiled.shared`) and both drive by them; nothing here is compiled or needs numba.
No function calls another one, so that each compiles by itself.

References:
    Gipps (1981), A behavioural car-following model for computer simulation, Transportation
        Research B 15, 105.
    Kesting, Treiber, Helbing (2007), General lane-changing model MOBIL for car-following models,
        Transportation Research Record 1999, 86.
    Krauss (1998), Microscopic modeling of traffic flow, DLR-FB 98-08.
    Raff, Hart (1950), A volume warrant for urban stop signs, Eno Foundation.
    Treiber, Hennecke, Helbing (2000), Congested traffic states in empirical observations and
        microscopic simulations, Phys. Rev. E 62, 1805.
"""

from __future__ import annotations

import math
from typing import Final

IDM_EXPONENT: Final = 4.0
"""The exponent delta of IDM's free acceleration (Treiber et al. 2000, table I)."""

LEAST_SPEED_MPS: Final = 0.1
"""IDM divides by no smaller desired speed, m/s."""

LEAST_GAP_M: Final = 0.1
"""IDM divides by no smaller gap, m."""


def idm_free_acceleration(speed: float, desired_speed: float, max_accel: float) -> float:
    """IDM's acceleration on a free road, ``a (1 - (v / v0)^delta)``, m/s2.

    Treiber et al. (2000), eq. 2 without its interaction term.

    Args:
        speed: v, m/s.
        desired_speed: v0, m/s.
        max_accel: a, m/s2.

    Examples:
        >>> [idm_free_acceleration(v, 20.0, 1.6) for v in (0.0, 10.0, 20.0)]
        [1.6, 1.5, 0.0]
    """
    ratio = speed / max(desired_speed, LEAST_SPEED_MPS)
    return max_accel * (1.0 - math.pow(ratio, IDM_EXPONENT))


def idm_desired_gap(
    speed: float,
    leader_speed: float,
    min_gap: float,
    time_headway: float,
    max_accel: float,
    comfort_decel: float,
) -> float:
    """The gap that an IDM driver wants, ``s* = s0 + max(0, v T + v (v - u) / (2 sqrt(a b)))``, m.

    Treiber et al. (2000), eq. 3 with s1 = 0; the maximum as in Treiber, Kesting, Traffic Flow
    Dynamics, eq. 11.15.

    Args:
        speed: v, m/s.
        leader_speed: u, m/s.
        min_gap: s0, standstill gap, m.
        time_headway: T, s.
        max_accel: a, m/s2.
        comfort_decel: b, m/s2.

    Examples:
        >>> idm_desired_gap(10.0, 8.0, 2.0, 1.5, 1.0, 4.0)
        22.0
    """
    braking = speed * (speed - leader_speed) / (2.0 * math.sqrt(max_accel * comfort_decel))
    return min_gap + max(0.0, speed * time_headway + braking)


def idm_interaction(gap: float, desired_gap: float) -> float:
    """The share of its largest acceleration that a leader costs an IDM driver, ``(s* / s)^2``.

    The whole law is ``idm_free_acceleration(v, v0, a) - a * idm_interaction(s, s*)``
    (Treiber et al. 2000, eq. 2).

    Args:
        gap: s, bumper to bumper, m; infinite without a leader.
        desired_gap: s*, from `idm_desired_gap`, m.

    Examples:
        >>> idm_interaction(44.0, 22.0), idm_interaction(math.inf, 22.0)
        (0.25, 0.0)
    """
    return (desired_gap / max(gap, LEAST_GAP_M)) ** 2


def krauss_safe_speed(gap: float, leader_speed: float, reaction_time: float, decel: float) -> float:
    """The speed from which a driver can still stop behind its leader, m/s.

    ``-b T + sqrt((b T)^2 + u^2 + 2 b g)``: both brake with b, the follower a reaction time later
    (Krauss 1998, in SUMO's form; derived from Gipps 1981).

    Args:
        gap: g, beyond the gap at a standstill, m; may be negative.
        leader_speed: u, m/s.
        reaction_time: T, s.
        decel: b, m/s2.

    Examples:
        >>> krauss_safe_speed(4.0, 0.0, 1.5, 2.0)  # 3 m while reacting, 1 m while braking
        2.0
    """
    reach = decel * reaction_time
    squared = reach * reach + leader_speed * leader_speed + 2.0 * decel * gap
    return math.sqrt(max(squared, reach * reach)) - reach


def braking_speed(distance: float, end_speed: float, decel: float) -> float:
    """The speed from which braking over a distance ends at another, ``sqrt(u^2 + 2 b d)``, m/s.

    Args:
        distance: d, m; not negative.
        end_speed: u, m/s.
        decel: b, m/s2.

    Examples:
        >>> braking_speed(8.0, 3.0, 1.0)
        5.0
    """
    return math.sqrt(end_speed * end_speed + 2.0 * decel * distance)


def mobil_incentive(
    own_gain: float, new_follower_gain: float, old_follower_gain: float, politeness: float
) -> float:
    """MOBIL's incentive to change lanes, ``(a'_c - a_c) + p ((a'_n - a_n) + (a'_o - a_o))``, m/s2.

    A driver changes if the change is safe (`mobil_safe`) and the incentive is above its threshold
    (Kesting et al. 2007, eq. 3).

    Args:
        own_gain: the driver's gain in acceleration, m/s2.
        new_follower_gain: the new follower's, m/s2; 0 for none.
        old_follower_gain: the old follower's, m/s2; 0 for none.
        politeness: p, the weight of the others.

    Examples:
        >>> mobil_incentive(1.0, -1.5, 0.5, 0.25)
        0.75
    """
    return own_gain + politeness * (new_follower_gain + old_follower_gain)


def mobil_safe(follower_accel: float, safe_decel: float) -> bool:
    """MOBIL's safety criterion: the new follower need not brake harder than ``safe_decel``.

    Kesting et al. (2007), eq. 2.

    Args:
        follower_accel: acceleration of the follower on the new lane after the change, m/s2.
        safe_decel: positive, m/s2.

    Examples:
        >>> mobil_safe(-2.0, 2.0), mobil_safe(-2.1, 2.0)
        (True, False)
    """
    return follower_accel >= -safe_decel


def gap_accepted(
    enter_s: float,
    leave_s: float,
    other_enters_s: float,
    other_leaves_s: float,
    critical_gap_s: float,
    clearance_s: float,
) -> bool:
    """Whether a driver without priority crosses before or after another one.

    It goes after the other has left, or first if it leaves its critical gap before the other comes.
    A gap below the critical one is rejected (Raff, Hart 1950).

    Args:
        enter_s: when the driver would enter the conflict area, s from now.
        leave_s: when it would have left it, s.
        other_enters_s: when the other driver enters it, s.
        other_leaves_s: when that one has left it, s.
        critical_gap_s: time that the driver demands between leaving and the other's arrival, s.
        clearance_s: time that must have passed since the other has left, s.

    Examples:
        >>> gap_accepted(1.0, 3.0, 5.0, 6.0, 1.5, 0.25), gap_accepted(1.0, 4.0, 5.0, 6.0, 1.5, 0.25)
        (True, False)
    """
    return enter_s > other_leaves_s + clearance_s or leave_s + critical_gap_s < other_enters_s
