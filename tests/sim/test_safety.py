"""Safety measures beside a slow oracle: polygons that are moved on in small steps."""

import numpy as np
import pytest

from behaviors.errors import InputError
from sim.safety import Bodies, is_near_miss, pair_measures

HORIZON_S = 8.0
STEP_S = 0.001
NUDGE_M = 0.0005


def bodies(rows):
    """Bodies from rows of x, y, heading in degrees, speed, acceleration, length, width."""
    x, y, degrees, speed, acceleration, length, width = np.array(rows, dtype=float).T
    heading = np.radians(degrees)
    return Bodies(np.stack([x, y], axis=1), heading, speed, acceleration, length, width)


def rows_of(them, which):
    return Bodies(*(np.asarray(values)[which] for values in them))


def grown(them, by_m):
    return them._replace(length=them.length + 2 * by_m, width=them.width + 2 * by_m)


def random_bodies(rng, n, box_m=30.0):
    return Bodies(
        rng.uniform(-box_m, box_m, (n, 2)),
        rng.uniform(-np.pi, np.pi, n),
        rng.uniform(-4.0, 20.0, n),
        rng.uniform(-6.0, 3.0, n),
        rng.uniform(0.4, 12.0, n),
        rng.uniform(0.4, 2.6, n),
    )


def polygons(them, way):
    """(n, 4, 2) corners of bodies that have gone a way, m, along their headings."""
    ahead = np.stack([np.cos(them.heading), np.sin(them.heading)], axis=1)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    centre = them.xy + way[:, None] * ahead
    along, aside = 0.5 * them.length[:, None] * ahead, 0.5 * them.width[:, None] * left
    corners = [along + aside, aside - along, -along - aside, along - aside]
    return np.stack([centre + corner for corner in corners], axis=1)


def distance(one, two):
    """(n,) least distance of polygons, m: of corners to sides; 0 where corner or sides cross."""
    least = np.full(len(one), np.inf)
    for a, b in ((one, two), (two, one)):
        inside = np.ones((len(a), 4), dtype=bool)
        for k in range(4):
            begin, side = b[:, None, k], (b[:, (k + 1) % 4] - b[:, k])[:, None]
            off = a - begin
            part = np.clip((off * side).sum(-1) / (side * side).sum(-1), 0.0, 1.0)
            away = np.linalg.norm(off - part[..., None] * side, axis=-1)
            least = np.minimum(least, away.min(axis=1))
            inside &= side[..., 0] * off[..., 1] - side[..., 1] * off[..., 0] >= 0
        least[inside.any(axis=1)] = 0.0
    for k in range(4):
        p, r = one[:, k], one[:, (k + 1) % 4] - one[:, k]
        for j in range(4):
            q, s = two[:, j], two[:, (j + 1) % 4] - two[:, j]
            turn = r[:, 0] * s[:, 1] - r[:, 1] * s[:, 0]
            off = q - p
            with np.errstate(all="ignore"):
                t = (off[:, 0] * s[:, 1] - off[:, 1] * s[:, 0]) / turn
                u = (off[:, 0] * r[:, 1] - off[:, 1] * r[:, 0]) / turn
            least[(t >= 0) & (t <= 1) & (u >= 0) & (u <= 1)] = 0.0
    return least


def way_of(them, time_s, accelerated):
    """(n,) way until a time and speed then; who comes to stand stays there."""
    if not accelerated:
        return them.speed * time_s, them.speed
    speed, acceleration = them.speed, them.acceleration
    forwards = speed >= 0
    brakes = np.where(forwards, acceleration < 0, acceleration > 0)
    with np.errstate(all="ignore"):
        stands = np.where(brakes, -speed / acceleration, np.inf)
    t = np.minimum(time_s, stands)
    return speed * t + 0.5 * acceleration * t**2, np.where(
        time_s < stands, speed + acceleration * t, 0.0
    )


def oracle_meeting(first, second, accelerated=False):
    """(n,) first time at which polygons touch, s; inf if not within the horizon.

    Each moves on by the time that their distance takes at the fastest that they may be, and by a
    millisecond at least.
    """
    n = len(first.speed)
    found, time_s, active = np.full(n, np.inf), np.zeros(n), np.arange(n)
    while active.size:
        a, b, t = rows_of(first, active), rows_of(second, active), time_s[active]
        way, speed = way_of(a, t, accelerated)
        way_2, speed_2 = way_of(b, t, accelerated)
        gap = distance(polygons(a, way), polygons(b, way_2))
        fastest = np.abs(speed) + np.abs(speed_2)
        if accelerated:
            fastest += (np.abs(a.acceleration) + np.abs(b.acceleration)) * 0.25
        else:
            facing = a.heading - b.heading
            squared = speed**2 + speed_2**2 - 2 * speed * speed_2 * np.cos(facing)
            fastest = np.sqrt(np.maximum(squared, 0.0))
        with np.errstate(all="ignore"):
            step = np.minimum(gap / fastest, 0.25)
        found[active[gap == 0.0]] = t[gap == 0.0]
        time_s[active] += np.maximum(np.nan_to_num(step, nan=0.25), STEP_S)
        active = active[(gap > 0.0) & (time_s[active] < HORIZON_S)]
    return found


def check(first, second):
    """Compare every measure of a pair with the oracle, grazes within millimetres aside."""
    found = pair_measures(first, second)
    still = np.zeros(len(first.speed))
    gap = distance(polygons(first, still), polygons(second, still))
    np.testing.assert_allclose(found.gap_m, gap, atol=0.01)
    small = pair_measures(grown(first, -NUDGE_M), grown(second, -NUDGE_M))
    large = pair_measures(grown(first, NUDGE_M), grown(second, NUDGE_M))
    compared = []
    for name, accelerated in (("ttc_s", False), ("mttc_s", True)):
        ours = getattr(found, name)
        with np.errstate(invalid="ignore"):
            graze = getattr(small, name) - getattr(large, name) > 0.1
        graze |= np.isinf(getattr(small, name)) != np.isinf(getattr(large, name))
        theirs = oracle_meeting(first, second, accelerated)
        soon = ~graze & (np.minimum(ours, theirs) < HORIZON_S - 0.1)
        np.testing.assert_allclose(ours[soon], theirs[soon], atol=0.01, err_msg=name)
        compared.append((graze, theirs))
    graze, theirs = compared[0]
    relative = velocity(first) - velocity(second)
    meets = ~graze & (theirs > 0.3) & (theirs < HORIZON_S - 0.1)
    drac = np.linalg.norm(relative, axis=1)[meets] / 2 / theirs[meets]
    np.testing.assert_allclose(found.drac_mps2[meets], drac, rtol=0.01)
    assert (found.drac_mps2[np.isinf(found.ttc_s)] == 0).all()
    moment = 1e-5 * np.ones(len(still))
    later = distance(polygons(first, first.speed * moment), polygons(second, second.speed * moment))
    apart = gap > 1e-3
    shrinks = (gap - later)[apart] / 1e-5
    np.testing.assert_allclose(found.closing_mps[apart], shrinks, atol=0.05)
    assert graze.mean() < 0.05
    return found


def velocity(them):
    ahead = np.stack([np.cos(them.heading), np.sin(them.heading)], axis=1)
    return them.speed[:, None] * ahead


def test_ten_thousand_random_pairs():
    rng = np.random.default_rng(7)
    found = check(random_bodies(rng, 10_000), random_bodies(rng, 10_000))
    assert 0.04 < np.isfinite(found.ttc_s).mean() < 0.4


SIZES = {
    "car": (4.5, 1.8), "truck": (10.0, 2.5), "pedestrian": (0.5, 0.5), "bicycle": (1.7, 0.6),
}  # fmt: skip


def family(name):
    """Hand-made pairs: the first body comes from the west."""
    first, second = [], []
    for size in SIZES.values():
        for size_2 in SIZES.values():
            if name == "crossing":
                cases = [
                    ((-20.0, 0, 0, v, a), place_on(degrees, late))
                    for degrees in (5, 10, 30, 45, 60, 90)
                    for late, v, a in ((0.0, 10.0, -2.0), (0.7, 10.0, 0.0), (-0.4, 10.0, 1.5))
                ]
            elif name == "oncoming":
                cases = [
                    ((-30.0, 0, 0, 12.0, -1.0), (30.0, y, 180, v, -3.0))
                    for y in (0.0, 0.6, 1.5, 4.0) for v in (10.0, 0.1, 0.0)
                ]  # fmt: skip
            elif name == "beside":
                cases = [
                    ((0.0, 0, 0, 10.0, 0.0), (x, 3.0, turn, v, a))
                    for x in (-2.0, 3.0) for turn in (0, -2, -8) for v, a in ((10, 1), (14, -5))
                ]  # fmt: skip
            elif name == "inside":
                cases = [((0.0, 0, 0, 5.0, 0.0), (x, 0.1, turn, 3.0, 1.0))
                         for x in (0.0, 0.3) for turn in (0, 45, 90)]  # fmt: skip
            elif name == "standing":
                cases = [((-25.0, 0, 0, v, a), (0.0, y, turn, 0.0, a_2))
                         for v, a in ((8.0, -1.2), (8.0, -1.4), (0.0, 2.0), (0.05, 0.0))
                         for y in (0.0, 1.0)
                         for turn, a_2 in ((0, 0), (40, 1), (90, -1))]  # fmt: skip
            else:
                cases = [((-12.0, 0, 0, v, a), (0.0, 0.3, turn, v_2, a_2))
                         for v, a in ((0.0, 0.0), (3.0, 0.0))
                         for v_2, a_2 in ((-4.0, 0.0), (-4.0, 1.0), (-2.0, -1.0))
                         for turn in (0, 20)]  # fmt: skip
            first += [(*one, *size) for one, _ in cases]
            second += [(*other, *size_2) for _, other in cases]
    return bodies(first), bodies(second)


def place_on(degrees, late):
    """A body at 10 m/s that comes to the origin two seconds from now, or later."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return (-(20 + 10 * late) * c, -(20 + 10 * late) * s, degrees, 10.0, 0.0)


@pytest.mark.parametrize(
    "name", ["crossing", "oncoming", "beside", "inside", "standing", "reversing"]
)
def test_hand_made_pairs(name):
    check(*family(name))


def test_time_advantage_beside_places_that_are_looked_up_one_by_one():
    """The least difference of two times, on a grid, at which the bodies cover a place."""
    rng = np.random.default_rng(3)
    first, second = random_bodies(rng, 3000, 25.0), random_bodies(rng, 3000, 25.0)
    found = pair_measures(first, second)
    chosen = np.flatnonzero(np.isinf(found.ttc_s) & (found.time_advantage_s < 6.0))[:60]
    chosen = np.concatenate([chosen, np.flatnonzero(np.isnan(found.time_advantage_s))[:20]])
    times = np.arange(0.0, 14.0, 0.04)
    compared = 0
    for i in chosen:
        a, b = rows_of(first, [i]), rows_of(second, [i])
        one = Bodies(*(np.repeat(values, times.size, axis=0) for values in a))
        two = Bodies(*(np.repeat(values, times.size, axis=0) for values in b))
        shape, shape_2 = polygons(one, one.speed * times), polygons(two, two.speed * times)
        centre, centre_2 = shape.mean(axis=1), shape_2.mean(axis=1)
        reach = np.hypot(a.length, a.width) / 2 + np.hypot(b.length, b.width) / 2
        away = np.linalg.norm(centre[:, None] - centre_2[None], axis=-1)
        at, at_2 = np.nonzero(away < reach)
        touch = distance(shape[at], shape_2[at_2]) == 0.0
        least = np.abs(times[at] - times[at_2])[touch].min(initial=np.inf)
        if np.isfinite(least):
            compared += 1
            assert found.time_advantage_s[i] == pytest.approx(least, abs=0.09)
    assert compared > 40  # the others share a place later than looked for, or none


def test_neither_order_nor_a_turn_of_the_plane_matters():
    rng = np.random.default_rng(11)
    first, second = random_bodies(rng, 2000), random_bodies(rng, 2000)
    turn = np.array([[np.cos(1.0), -np.sin(1.0)], [np.sin(1.0), np.cos(1.0)]])
    turned = [
        them._replace(xy=them.xy @ turn.T + 1e4, heading=them.heading + 1.0)
        for them in (second, first)
    ]
    found, again = pair_measures(first, second), pair_measures(*turned)
    for name in found._fields:
        one, other = getattr(found, name), getattr(again, name)
        near = np.isclose(one, other, rtol=1e-6, atol=1e-6, equal_nan=True)
        assert near.mean() > 0.999, name  # all but grazes


def test_contact_and_what_is_not_known():
    inside = bodies([(0, 0, 0, 10, 0, 5, 2)]), bodies([(1, 0, 90, 0, 0, 5, 2)])
    assert [value.item() for value in pair_measures(*inside)] == [0, 0, 0, 0, np.inf, 0]
    here, there = bodies([(0, 0, 0, 10, np.nan, 5, 2)]), bodies([(20, 0, 0, 0, 0, 5, 2)])
    found = pair_measures(here, there)
    assert found.ttc_s.item() == 1.5
    assert np.isnan(found.mttc_s).all()
    found = pair_measures(here._replace(heading=np.array([np.nan])), there)
    assert np.isnan(np.array(found)).all()
    none = Bodies(np.empty((0, 2)), *(np.empty(0) for _ in range(5)))
    assert [len(value) for value in pair_measures(none, none)] == [0] * 6


@pytest.mark.parametrize("field", ["xy", "speed"])
def test_arrays_of_other_shapes_are_named(field):
    one = bodies([(0, 0, 0, 10, 0, 5, 2)])
    with pytest.raises(InputError, match=field):
        pair_measures(one, one._replace(**{field: np.zeros(3)}))


def test_a_body_that_stops_short_is_never_met():
    """8 m/s, 20 m, braking at 1.6 m/s2: it stands after exactly 20 m."""
    ahead = bodies([(24.5, 0, 0, 0, 0, 4, 2)] * 2)
    braking = bodies([(0, 0, 0, 8, -1.5, 5, 2), (0, 0, 0, 8, -1.7, 5, 2)])
    found = pair_measures(braking, ahead)
    assert found.mttc_s[0] == pytest.approx((8 - np.sqrt(64 - 60)) / 1.5)
    assert found.mttc_s[1] == np.inf
    assert found.ttc_s.tolist() == [2.5, 2.5]


def test_one_near_miss():
    assert is_near_miss(1.49, 3.01)
    assert not is_near_miss(1.49, 2.99)
    assert not is_near_miss(1.51, 9.0)
    assert is_near_miss(np.inf, 0.0, 0.99)
    assert not is_near_miss(0.0, 9.0, 0.0)
