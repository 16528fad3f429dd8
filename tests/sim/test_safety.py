"""Safety measures beside a slow oracle: polygons that are moved on in small steps."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from behaviors.errors import InputError
from sim.frames import PEDESTRIAN, Signal, Tracks
from sim.road import Connection, Crossing, Lane, Road
from sim.safety import CONFLICT_KINDS, Bodies, conflicts, is_near_miss, pair_measures

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


def tracks_of(paths, kinds=None, sizes=None, times=None, **changes):
    """Tracks of (T, 4) x, y, heading, speed; nan where an agent is not there."""
    paths = np.asarray(paths, dtype=float)
    n, steps = paths.shape[:2]
    sizes = np.tile([4.5, 1.8], (n, 1)) if sizes is None else np.asarray(sizes)
    facts = {
        "ids": 10 * np.arange(1, n + 1),
        "names": tuple(map(str, range(n))),
        "kind": np.zeros(n) if kinds is None else kinds,
        "length": sizes[:, 0],
        "width": sizes[:, 1],
        "time_s": np.arange(steps) * 0.1 if times is None else times,
        "xy": paths[..., :2],
        "heading": paths[..., 2],
        "speed": paths[..., 3],
        "valid": np.isfinite(paths[..., 0]),
        "signals": np.zeros((0, steps)),
    }
    return Tracks.of_dense(**(facts | changes))


def line(times, x, y, degrees, speed, acceleration=0.0):
    """(T, 4) a straight drive that is at (x, y) at time 0; who comes to stand stays."""
    end = -speed / acceleration if acceleration < 0 else np.inf
    t = np.minimum(times, end)
    way, heading = speed * t + 0.5 * acceleration * t**2, np.radians(degrees)
    now = np.where(times < end, speed + acceleration * t, 0.0)
    at = [x + way * np.cos(heading), y + way * np.sin(heading)]
    return np.stack([*at, np.full(len(t), heading), now], axis=1)


def turn(times, x, y, degrees, speed, rate, begin_s):
    """(T, 4) a drive that turns with a rate, rad/s, for 1.5 s."""
    heading = np.radians(degrees) + rate * np.clip(times - begin_s, 0.0, 1.5)
    fine = np.linspace(times[0], times[-1], 20 * len(times))
    angle = np.radians(degrees) + rate * np.clip(fine - begin_s, 0.0, 1.5)
    step = np.diff(fine, prepend=fine[0])
    path = [np.cumsum(speed * step * f(angle)) for f in (np.cos, np.sin)]
    at = [c + np.interp(times, fine, p) for c, p in zip((x, y), path, strict=True)]
    return np.stack([*at, heading, np.full(len(times), speed)], axis=1)


TIMES = np.arange(0.0, 8.0, 0.1)
FINE = np.arange(0.0, 7.9, 0.01)


def covered(path, size, places):
    """(2, P) the first and the last time at which a body covers each place; nan if never."""
    near = np.linalg.norm(path[:, :2] - places.mean(axis=0), axis=1) < 14.0
    path, times = path[near], FINE[near]
    off = places[:, None] - path[None, :, :2]
    c, s = np.cos(path[:, 2]), np.sin(path[:, 2])
    along, aside = off[..., 0] * c + off[..., 1] * s, off[..., 1] * c - off[..., 0] * s
    inside = (np.abs(along) <= size[0] / 2) & (np.abs(aside) <= size[1] / 2)
    never = ~inside.any(axis=1)
    first, last = inside.argmax(axis=1), len(path) - 1 - inside[:, ::-1].argmax(axis=1)
    return np.where(never, np.nan, [times[first], times[last]])


def gap_at(places, makers, sizes):
    """(P,) time between the bodies at each place, negative where they meet; nan if unshared."""
    one, other = (covered(make(FINE), s, places) for make, s in zip(makers, sizes, strict=True))
    return np.maximum(other[0] - one[1], one[0] - other[1])


def square(half_m, step_m):
    """(P, 2) places about the origin."""
    side = np.arange(-half_m, half_m + 1e-9, step_m)
    return np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("n", [200])
def test_driven_crossings(n):
    """Post-encroachment time beside places of a fine grid that are looked up one by one."""
    rng = np.random.default_rng(5)
    drives, sizes, expected = [], [], []
    for _ in range(n):
        size = [SIZES["car"], SIZES["truck"], SIZES["bicycle"]][rng.integers(3)], SIZES["car"]
        v, v_2, late = rng.uniform(5, 12), rng.uniform(4, 12), rng.uniform(-2.5, 2.5)
        angle = np.radians(rng.uniform(35, 145) * rng.choice([-1, 1]))
        at = -(3.5 + late) * v_2 * np.array([np.cos(angle), np.sin(angle)])
        makers = [lambda t, v=v: line(t, -3.5 * v, 0, 0, v)]
        if rng.random() < 0.5:
            a = rng.uniform(-0.4, 0.4)
            makers.append(lambda t, p=at, h=angle, v=v_2, a=a: line(t, *p, np.degrees(h), v, a))
        else:
            r = rng.uniform(-0.3, 0.3)
            makers.append(
                lambda t, p=at, h=angle, v=v_2, r=r, b=2.8 + late: turn(
                    t, *p, np.degrees(h), v, r, b
                )
            )
        wide = square(8.0, 0.8)
        gaps = gap_at(wide, makers, size)
        if np.isfinite(gaps).any():
            fine = wide[np.nanargmin(gaps)] + square(0.9, 0.1)
            gaps = np.append(gaps, gap_at(fine, makers, size))
        expected.append(np.nanmin(gaps) if np.isfinite(gaps).any() else np.nan)
        drives += [make(TIMES) for make in makers]
        sizes += size
    drives = np.array(drives)
    drives[..., 0] += 300.0 * (np.arange(2 * n) // 2 % 40)[:, None]
    drives[..., 1] += 300.0 * (np.arange(2 * n) // 80)[:, None]
    found = conflicts(tracks_of(drives, sizes=sizes))
    assert (found.second == found.first + 10).all()
    pet = np.full(n, np.nan)
    for i, value in zip((found.first // 20).tolist(), found.pet_s, strict=True):
        pet[i] = np.fmin(pet[i], value)
    expected = np.array(expected)
    clear = np.isfinite(expected) & (expected < 4.5) & (expected > 0.1)
    assert clear.mean() > 0.5
    np.testing.assert_allclose(pet[clear], expected[clear], atol=0.1)
    meet = expected < -0.1
    assert meet.any()
    assert (pet[meet] == 0).all()


def only(found):
    """The single encounter, by column, kinds as words."""
    assert len(found) == 1
    return found.to_pandas().iloc[0]


def test_one_follows_and_brakes():
    """Both drive at 10 m/s, 9.5 m apart bumper to bumper: the headway is no near miss."""
    apart = tracks_of([line(TIMES, 0, 0, 0, 10), line(TIMES, 14, 0, 0, 10)])
    row = only(conflicts(apart))
    assert (row.kind, row.near_miss) == ("following", False)
    assert row.pet_s == pytest.approx(0.95)
    assert (row.passed_first, row.ttc_s, row.drac_mps2) == (20, np.inf, 0.0)
    stands = line(TIMES, 19.5, 0, 0, 0)
    row = only(conflicts(tracks_of([line(TIMES, 0, 0, 0, 10, -3.5), stands])))
    assert (row.kind, row.near_miss) == ("following", True)
    left_m = 15 - 100 / 7
    assert row.ttc_s == pytest.approx(2 * np.sqrt(left_m / 7), abs=0.01)
    assert row.gap_m == pytest.approx(left_m, abs=0.02)
    assert row.mttc_s == np.inf
    assert row.delta_v_mps == pytest.approx(np.sqrt(7 * left_m) / 2, abs=0.2)
    row = only(conflicts(tracks_of([line(TIMES, 0, 0, 0, 10), stands])))
    assert (row.near_miss, row.gap_m, row.ttc_s) == (False, 0.0, 0.0)


def test_a_body_follows_the_nearest_only():
    row = [line(TIMES, 14.0 * k, 0, 0, 10) for k in range(4)]
    found = conflicts(tracks_of(row))
    assert [*zip(found.first, found.second, strict=True)] == [(10, 20), (20, 30), (30, 40)]


def test_kinds():
    def kind(first, second, kinds=(0, 0), sizes=None):
        found = conflicts(tracks_of([first, second], kinds=kinds, sizes=sizes))
        return {CONFLICT_KINDS[code].value for code in found.kind}

    east = line(TIMES, -30, 0, 0, 10)
    assert kind(east, line(TIMES, 0, -50, 90, 10)) == {"crossing"}
    assert kind(east, line(TIMES, 30, 0.5, 180, 10, -4.0)) == {"oncoming"}
    assert kind(east, turn(TIMES, 0, -37, 90, 10, -np.pi / 3, 2.9)) == {"merging"}
    changes = turn(TIMES, -10, 3.3, 0, 10, -0.1, 1.0)
    changes[26:, :3] = line(TIMES[26:] - 2.6, changes[25, 0] + 1, 0.0, 0, 10)[:, :3]
    assert kind(east, changes) == {"merging"}
    drifts = line(TIMES, -29, 3.0, -3.0, 10)
    drifts[20:] = line(TIMES[20:] - 2.0, *drifts[20, :2], 3.0, 10)
    assert kind(east, drifts) == {"side"}
    person = line(TIMES, 0, -4, 90, 1.2)
    assert kind(east, person, (0, PEDESTRIAN), [(4.5, 1.8), (0.5, 0.5)]) == {"pedestrian"}
    assert kind(person, person + 0.3, (PEDESTRIAN, PEDESTRIAN)) == set()
    assert kind(east, line(TIMES, -30, 3.5, 0, 12)) == set()


def test_least_values_are_those_of_all_moments():
    """Beside every pair at every time; nobody turns."""
    rng = np.random.default_rng(2)
    paths = [
        line(TIMES, *rng.uniform(-50, 50, 2), rng.uniform(0, 360), rng.uniform(3, 14),
             rng.uniform(-2, 1))
        for _ in range(30)
    ]  # fmt: skip
    tracks = tracks_of(paths)
    table = conflicts(tracks).to_pandas().set_index(["first", "second"])
    heading, speed = np.array(paths)[..., 2], np.array(paths)[..., 3]
    faster = np.gradient(speed, 0.1, axis=1)
    size = np.full(TIMES.size, 4.5), np.full(TIMES.size, 1.8)
    near = 0
    for i in range(30):
        for j in range(i + 1, 30):
            one, other = (
                Bodies(tracks.xy[k], heading[k], speed[k], faster[k], *size) for k in (i, j)
            )
            ttc = pair_measures(one, other).ttc_s
            if ttc.min() > 5.0:
                continue
            near += 1
            rows = table.loc[[(10 * i + 10, 10 * j + 10)]]
            assert rows.ttc_s.min() == pytest.approx(ttc.min())
            gap = pair_measures(one, other).gap_m
            assert gap.min() - 1e-9 <= rows.gap_m.min() <= gap[ttc <= 5.0].min() + 1e-9
    assert near > 20


def test_a_turn_is_no_collision_course():
    """A car that turns passes in front of a standing one at which it heads for a moment."""
    turns = turn(TIMES, -20, 0, 0, 8, np.pi / 3, 1.6)
    stands = line(TIMES, 7, 0, 180, 0)
    found = conflicts(tracks_of([turns, stands]))
    straight = pair_measures(
        bodies([(turns[15, 0], 0, 0, 8, 0, 4.5, 1.8)]),
        bodies([(7, 0, 180, 0, 0, 4.5, 1.8)]),
    )
    assert straight.ttc_s < 1.5
    assert not found.near_miss.any()


def test_lost_from_sight_and_empty_tracks():
    gone = line(TIMES, 0, -50, 90, 10)
    gone[20:] = np.nan
    late = line(TIMES, -30, 0, 0, 10)
    late[:25] = np.nan
    found = conflicts(tracks_of([gone, late]))
    assert len(found) == 0
    nobody = conflicts(tracks_of(np.empty((0, 5, 4))))
    assert len(nobody.to_pandas()) == 0
    with pytest.raises(InputError, match="within_s"):
        conflicts(tracks_of([gone, late]), within_s=0.0)


def test_who_has_priority():
    """From the west and from the south through a junction; the south yields."""
    ways = {"west": ((-40, 0), (40, 0)), "south": ((0, -40), (0, 40))}
    lanes, links = [], []
    for name, ends in ways.items():
        begin, end = np.array(ends, dtype=float)
        parts = [begin, begin / 8, end / 8, end]
        for part, pair in zip("abc", pairwise(parts), strict=True):
            lanes.append(
                Lane(name + part, name, 0, np.array(pair), 3.2, 14.0, internal=part == "b")
            )
        links.append(Connection(name + "a", name + "c", (name + "b",), "straight"))
    crossing = Crossing("x", np.array([[20.0, -4.0], [20.0, 4.0]]), 3.0, ("west",))
    yielding = replace(links[1], must_yield=True, yields_to=(0,))
    road = Road("r", tuple(lanes), (links[0], yielding), (crossing,), (), Path("none"))
    west, south = line(TIMES, -30, 0, 0, 10), line(TIMES, 0, -50, 90, 10)
    assert only(conflicts(tracks_of([west, south]), road)).priority == 10
    assert conflicts(tracks_of([west, south])).priority == -1
    same = replace(road, connections=tuple(links))
    assert conflicts(tracks_of([west, south]), same).priority == -1
    lit = replace(
        road,
        connections=tuple(replace(link, signal=k) for k, link in enumerate(road.connections)),
        signal_groups=("w", "s"),
    )
    signals = np.tile([[Signal.RED.code], [Signal.GREEN.code]], TIMES.size)
    assert conflicts(tracks_of([west, south], signals=signals), lit).priority == 20
    facts = {"kinds": [0, PEDESTRIAN], "sizes": [(4.5, 1.8), (0.5, 0.5)]}
    for x, expected in ((20, 20), (30, -1)):
        person = line(TIMES, x, -5, 90, 1.2)
        assert conflicts(tracks_of([west, person], **facts), road).priority == expected
