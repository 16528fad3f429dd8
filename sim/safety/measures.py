"""How near two road users are to a collision: measures of a pair at one instant, and near misses.

Every body is a rectangle in the plane that keeps its heading. Positions, headings, speeds and sizes
are enough, so recordings have these measures as simulations do.

References:
    Hayward (1972), Near-miss determination through use of a scale of danger, Highway Research
    Record 384 (time to collision).
    Allen, Shin, Cooper (1978), Analysis of traffic conflicts and collisions, Transportation
    Research Record 667 (post-encroachment time).
    Hansson (1975), Studies in driver behaviour, Lund. Laureshyn, Svensson, Hydén (2010), Accident
    Analysis and Prevention 42(6) (time advantage; time to collision of rectangles). Mahmud,
    Ferreira, Hoque, Tavassoli (2017), Application of proximal surrogate indicators for safety
    evaluation, IATSS Research 41(4) (a review of all of them).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from behaviors.errors import InputError
from sim.frames import BoolArray, FloatArray
from sim.safety.rectangles import SLABS, measure

NEAR_MISS_TTC_S: Final = 1.5
"""A near miss has a time to collision below this, s (van der Horst 1990, A time-based analysis of
road user behaviour in normal and critical encounters, Delft)."""

NEAR_MISS_MPS: Final = 3.0
"""Such a time to collision is a near miss only above this closing speed, m/s: the norm of the
relative velocity. From slower approaches a driver stops within half a metre (Hydén 1987: how
serious a conflict is depends on the speed as well as on the time)."""

NEAR_MISS_PET_S: Final = 1.0
"""A near miss has a post-encroachment time below this, s (Allen, Shin, Cooper 1978)."""


class Bodies(NamedTuple):
    """Rectangles that move along their headings.

    Attributes:
        xy: (n, 2) centres, m.
        heading: (n,) rad, counter-clockwise from +x.
        speed: (n,) m/s, along the heading; negative when reversing.
        acceleration: (n,) m/s2, along the heading; negative when braking forwards.
        length: (n,) m.
        width: (n,) m.
    """

    xy: FloatArray
    heading: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    length: FloatArray
    width: FloatArray


class PairMeasures(NamedTuple):
    """How near two bodies are to a collision, for each of n pairs.

    Attributes:
        gap_m: (n,) least distance between the outlines, m; 0 where they touch or overlap.
        closing_mps: (n,) rate at which that distance shrinks now, m/s; negative when it grows, 0
            where they overlap.
        ttc_s: (n,) time until the outlines touch at constant velocities, s; 0 where they touch
            now, inf if they never do.
        mttc_s: (n,) modified time to collision, s: the same with today's accelerations. A body that
            comes to stand stays there; one that stands and has a negative acceleration stays, too.
        drac_mps2: (n,) deceleration rate to avoid the crash, m/s2: relative speed / (2 ttc_s). 0
            if they never meet, inf where they touch now.
        time_advantage_s: (n,) predicted post-encroachment time at constant velocities, s. 0 if
            they meet; nan where the areas ahead of them share no position.

    References:
        Almqvist, Hydén, Risser (1991), Use of speed limiters in cars for increased safety and a
        better environment, Transportation Research Record 1318 (deceleration rate).
        Ozbay, Yang, Bartin, Mudigonda (2008), Derivation and validation of new simulation-based
        surrogate safety measure, Transportation Research Record 2083 (modified time to collision).
    """

    gap_m: FloatArray
    closing_mps: FloatArray
    ttc_s: FloatArray
    mttc_s: FloatArray
    drac_mps2: FloatArray
    time_advantage_s: FloatArray


def pair_measures(first: Bodies, second: Bodies) -> PairMeasures:
    """Measures of n pairs: the first body of each row with the second one.

    Exact for bodies that do not turn: the separating axis theorem, solved for time. Where a number
    of either body is not finite, they are nan; a missing acceleration makes ``mttc_s`` nan only.

    Raises:
        InputError: if the shapes differ.

    Examples:
        A car at 10 m/s comes up to one that stands, and to a truck that crosses:

        >>> cars = Bodies(xy=np.zeros((2, 2)), heading=np.zeros(2), speed=np.full(2, 10.0),
        ...               acceleration=np.zeros(2), length=np.full(2, 4.0), width=np.full(2, 2.0))
        >>> others = Bodies(xy=np.array([[24.0, 0.0], [30.0, -40.0]]),
        ...                 heading=np.array([0.0, np.pi / 2]), speed=np.array([0.0, 10.0]),
        ...                 acceleration=np.zeros(2), length=np.array([4.0, 10.0]),
        ...                 width=np.array([2.0, 2.5]))
        >>> found = pair_measures(cars, others)
        >>> found.gap_m.round(2).tolist(), found.ttc_s.round(2).tolist()
        ([20.0, 43.26], [2.0, inf])
        >>> found.drac_mps2.round(2).tolist(), found.time_advantage_s.round(3).tolist()
        ([2.5, 0.0], [0.0, 0.075])
    """
    columns, columns_2 = _columns("first", first), _columns("second", second)
    n = columns.shape[1]
    if columns_2.shape[1] != n:
        raise InputError(f"second.xy: found {columns_2.shape[1]} bodies, expected {n}")
    found = np.empty((len(PairMeasures._fields), n))
    measure(columns, columns_2, found, np.empty((SLABS, 3)))
    return PairMeasures(*found)


def is_near_miss(ttc_s: ArrayLike, approach_mps: ArrayLike, pet_s: ArrayLike = np.nan) -> BoolArray:
    """Whether pairs nearly collide: the one definition of a near miss.

    A time to collision below `NEAR_MISS_TTC_S` while they approach faster than `NEAR_MISS_MPS`, or
    a post-encroachment time below `NEAR_MISS_PET_S`. A contact, a time of 0, is none.

    Args:
        ttc_s: times to collision, s; inf for none.
        approach_mps: sizes of the relative velocities at that time, m/s.
        pet_s: post-encroachment times of paths that cross, s; nan for none. Where one follows the
            other, the time between them is a headway and not meant here.

    Returns:
        One truth value for each, in the shape that the arguments share.

    Examples:
        >>> is_near_miss([1.2, 1.2, np.inf, 0.0], [8.0, 2.0, 9.0, 8.0], [np.nan, 3.0, 0.8, 0.0])
        array([ True, False,  True, False])
    """
    ttc, approach, pet = (np.asarray(each, np.float64) for each in (ttc_s, approach_mps, pet_s))
    soon = (ttc < NEAR_MISS_TTC_S) & (approach > NEAR_MISS_MPS)
    return np.asarray((soon | (pet < NEAR_MISS_PET_S)) & (ttc != 0.0) & (pet != 0.0))


def _columns(name: str, bodies: Bodies) -> FloatArray:
    """(7, n) the numbers of bodies, checked."""
    xy, *others = (np.asarray(values, np.float64) for values in bodies)
    if xy.ndim != 2 or xy.shape[1] != 2:
        raise InputError(f"{name}.xy: found shape {xy.shape}, expected (n, 2)")
    for field, values in zip(Bodies._fields[1:], others, strict=True):
        if values.shape != (len(xy),):
            raise InputError(f"{name}.{field}: found shape {values.shape}, expected {(len(xy),)}")
    return np.vstack([xy.T, *others])
