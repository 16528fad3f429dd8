"""Pedestrians of the highway engine: their ways on foot, and crossings.

They keep to the sidewalks of their route and cross where the road has crossings. At a signal they
wait for green. At a zebra they step out when every vehicle that comes near is far enough away,
stands, or is going to let them cross. On the way they stop before a lane on which a vehicle comes
that does not. Whether a driver yields is drawn once per encounter.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from behaviors.errors import InputError
from sim.compiled import in_place
from sim.frames import FloatArray, Signal
from sim.geometry import distances_along
from sim.highway import state
from sim.highway.driving import OVERLOOKS, YIELDS, attention_m, can_stop, chance
from sim.highway.junctions import ENTERED_M
from sim.highway.lanes import straight_pieces
from sim.highway.places import last_begun, record
from sim.highway.state import CROSSOVER, FOOTWAY, MOST_MET, PIECE, WALKER, Footways, Scene, listed
from sim.road import Road
from sim.road.cells import boxes_of, near_pairs
from sim.scenario import WALK_START_M, AgentSpec

LINK_M, DETOUR_M = 12.0, 5.0
"""Sidewalk ends and crossing ends this near to each other are joined on foot (the widest corner).
Pedestrians cross a road only if that saves more than the detour."""

SETBACK_M, OFFSET_M = 1.6, 0.6
"""Pedestrians wait this far back from the kerb (out of the way of turning vehicles); a crossover
begins and ends there. They keep up to this far to either side of the path's middle."""

GREEN, OFF = Signal.GREEN.code, Signal.OFF.code

KERB_SOON_S, KERB_M = 4.0, 0.4
"""Drivers that demand at least this gap see that a pedestrian this near the kerb wants to cross, s.
Pedestrians decide this near the kerb whether to step out, m (half a stride)."""

MET_S, MET_KERB_S = 3.0, 2.0
"""A driver that would pass less than this before a pedestrian has met that pedestrian, s. It counts
only where the pedestrian is on the crossing or this near its kerb, s."""

STALLED_S, STOOD_S = 4.0, 0.8
"""A pedestrian who has stood this long on the crossing, out of a vehicle's way, waits for the
vehicles, s (else each would wait for the other in a full junction). Pedestrians assume that a
vehicle that has stood this long before a crossing waits, s."""

DANGER_S, SPARE_S = 1.0, 0.7
"""All drivers brake for a pedestrian who steps onto their lane within this time, s. Pedestrians
want this time to spare before a vehicle comes, s."""

STRIP_M, WALKED_M = 0.1, 1.1
"""The strip of a lane that vehicles and pedestrians keep clear of each other ends this far inside
the lane's edges, m: a pedestrian can stand between two lanes. Pedestrians walk this far to either
side of a crossing's middle line, m (`OFFSET_M`, half a pedestrian and a little)."""


class Footway(NamedTuple):
    """A pedestrian's whole way."""

    points: FloatArray  # (P, 2) m, in highway-env's axes
    at: FloatArray  # (P,) how far along each is, m
    crossed: list[tuple[int, int, int, bool]]  # crossing, its first and last point, forward or not


@functools.lru_cache(maxsize=256)
def find_footway(road: Road, route: tuple[str, ...]) -> Footway:
    """The way on foot along a route of edges: its sidewalks and the shortest way between them.

    Raises:
        InputError: if an edge has no sidewalk or two cannot be joined by crossings.
    """
    sidewalks = {lane.edge: lane for lane in road.lanes if lane.walking and not lane.internal}
    for edge in route:
        if edge not in sidewalks:
            raise InputError(f"route: found edge {edge!r} without sidewalk, expected one with")
    ends = _orient([sidewalks[edge].centerline for edge in route])
    begin, leave = ends[0]
    share = min(1.0, WALK_START_M / max(float(np.hypot(*(begin - leave))), 1e-9))
    points, way, crossed = [leave + share * (begin - leave)], [(leave, -1, True)], []
    for (_, leave), (enter, onward) in itertools.pairwise(ends):
        way += [*_walk(road, leave, enter), (onward, -1, True)]
    for xy, crossing, forward in way:
        before = len(points) - 1
        if np.hypot(*(xy - points[-1])) > 1e-6:
            points.append(xy)
        if crossing >= 0:
            crossed.append((crossing, before, len(points) - 1, forward))
    line = np.array(points) * np.array([1.0, -1.0])
    return Footway(line, distances_along(line), crossed)


def _orient(lines: list[FloatArray]) -> list[tuple[FloatArray, FloatArray]]:
    """Beginning and end of each sidewalk, in the order that connects the route."""
    found: list[tuple[FloatArray, FloatArray]] = []
    for line, after in itertools.zip_longest(lines, lines[1:]):
        a, b = line[0], line[-1]
        if after is not None:
            far = [min(math.dist(p, a), math.dist(p, b)) for p in (after[0], after[-1])]
            to = after[0] if far[0] <= far[1] else after[-1]
            turned = math.dist(b, to) > math.dist(a, to)
        else:
            turned = bool(found) and math.dist(a, found[-1][1]) > math.dist(b, found[-1][1])
        found.append((b, a) if turned else (a, b))
    return found


def _walk(road: Road, begin: FloatArray, end: FloatArray) -> list[tuple[FloatArray, int, bool]]:
    """Points from one place to another: (point, crossing walked to reach it or -1, forward)."""
    ends = [begin, end]
    for each in road.crossings:
        line = each.centerline
        for kerb, inside in ((line[0], line[1]), (line[-1], line[-2])):
            ends.append(kerb + SETBACK_M * (kerb - inside) / np.hypot(*(kerb - inside)))
    places = np.array(ends)
    near = KDTree(places).query_pairs(LINK_M, output_type="ndarray")
    near = near[~_runs_over_a_lane(road, places[near])]
    near = near[(near[:, 0] < 2) | (near[:, 0] // 2 != near[:, 1] // 2)]
    first = np.arange(2, len(places), 2)
    pairs = np.concatenate([near, np.column_stack([first, first + 1])])
    cost = np.hypot(*(places[pairs[:, 0]] - places[pairs[:, 1]]).T)
    cost[len(near) :] += DETOUR_M
    shape = (len(places), len(places))
    graph = coo_array((np.maximum(cost, 1e-9), (pairs[:, 0], pairs[:, 1])), shape=shape)
    away, before = dijkstra(graph.tocsr(), directed=False, indices=[0], return_predecessors=True)
    if not np.isfinite(away[0, 1]):
        raise InputError(
            f"route: found no way on foot from {np.round(begin, 1)} to {np.round(end, 1)}, "
            f"expected crossings of road {road.name!r} to join them"
        )
    way: list[tuple[FloatArray, int, bool]] = []
    j = 1
    while j != 0:
        i = int(before[0, j])
        crosses = i >= 2 and j >= 2 and i // 2 == j // 2
        way.append((places[j], (i - 2) // 2 if crosses else -1, i < j))
        j = i
    return way[::-1]


def _runs_over_a_lane(road: Road, links: FloatArray) -> NDArray[np.bool_]:
    """Whether each straight way, of (n, 2, 2) beginnings and ends, meets a lane's centre line."""
    lines = [lane.centerline for lane in road.lanes if not lane.walking]
    pieces = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    pairs = near_pairs(boxes_of(list(links), 0.0), boxes_of(list(pieces), 0.0), LINK_M)
    (a, b), (p, q) = (ends[pairs[:, i]].swapaxes(0, 1) for i, ends in enumerate((links, pieces)))
    step, other, gap = b - a, q - p, p - a
    det = step[:, 0] * other[:, 1] - step[:, 1] * other[:, 0]
    det = np.where(np.abs(det) > 1e-12, det, np.nan)  # NaN where they are parallel
    t = (gap[:, 0] * other[:, 1] - gap[:, 1] * other[:, 0]) / det
    u = (gap[:, 0] * step[:, 1] - gap[:, 1] * step[:, 0]) / det
    meets = np.zeros(len(links), bool)
    meets[pairs[(t > 0) & (t < 1) & (u >= 0) & (u <= 1), 0]] = True
    return meets


def footways_of(footways: Sequence[Footway]) -> Footways:
    """Ways on foot as arrays."""
    ways, steps, crossovers = np.zeros(len(footways), FOOTWAY), [], []
    for i, (points, at, crossed) in enumerate(footways):
        steps.append(straight_pieces(points))
        steps[-1]["begin"], ways["length"][i] = at[:-1], at[-1]
        crossovers.append([(one, at[j], at[k], forward) for one, j, k, forward in crossed])
    pieces = listed(ways, "piece", steps, PIECE)
    return Footways(ways, pieces, listed(ways, "crossover", crossovers, CROSSOVER))


def walker_row(spec: AgentSpec, footway: Footway, number: int, seed: int) -> Any:
    """The row of `WALKER` of a pedestrian at the beginning of a way of this number."""
    row = np.zeros(1, WALKER)[0]
    aside = float(np.random.default_rng((seed, spec.seed)).uniform(-OFFSET_M, OFFSET_M))
    piece = straight_pieces(footway.points[:2])[0]
    row["x"], row["y"] = piece.x + aside * -piece.dy, piece.y + aside * piece.dx
    row["heading"], row["way"], row["aside"] = math.atan2(piece.dy, piece.dx), number, aside
    row["agent"], row["kind"], row["crashed_at"] = spec.id, spec.kind.code, math.inf
    row["length"], row["width"], row["free_speed"] = spec.length_m, spec.width_m, spec.speed_mps
    return row


@in_place(inner=True)
def note_walkers(scene: Scene) -> None:
    """List the pedestrians on each crossing and those who reach its kerb soon."""
    scene.spot_head[:] = -1
    scene.crossing_head[:] = -1
    for w in range(scene.walkers.size):
        person = scene.walkers[w]
        at = _crossover(person, scene)
        if at < 0 or person.crashed:
            continue
        way = scene.footways.crossovers[at]
        beyond = person.s - way.begin_s
        if beyond > 0.0 or -beyond <= KERB_SOON_S * person.free_speed:
            head = scene.crossing_head
            person.link, head[way.crossing] = head[way.crossing], w


@in_place(inner=True)
def _crossover(person: Any, scene: Scene) -> int:
    """The crossing of its way that a pedestrian is on or comes to next; -1 for none."""
    way = scene.footways.ways[person.way]
    at = way.crossover + person.crossed
    return int(at) if at < way.crossover_end else -1


@in_place(inner=True)
def _along(u: float, at: int, scene: Scene) -> float:
    """How far from its beginning a place is that is given along a crossing's line, m."""
    way = scene.footways.crossovers[at]
    u = u + SETBACK_M
    return float(u if way.forward else (way.end_s - way.begin_s) - u)


@in_place(inner=True)
def obey_crossings(scene: Scene) -> None:
    """Note who stops before which crossing and who comes to it; record who let pedestrians go."""
    now, arrivals = scene.now[0], scene.arrivals
    now.arrivals = 0
    for i in range(scene.vehicles.size):
        me, first = scene.vehicles[i], now.arrivals
        _look_at_strips(me, me.lane, -(me.s + me.length / 2), scene)
        if me.path >= 0 and me.path != me.lane:
            _look_at_strips(me, me.path, me.to_line, scene)
        for a in range(first, now.arrivals):
            for b in range(first, now.arrivals):
                if arrivals[b].yields and arrivals[b].crossing == arrivals[a].crossing:
                    arrivals[a].yields = True


@in_place(inner=True)
def _look_at_strips(me: Any, lane: int, begin: float, scene: Scene) -> None:
    """Look at the crossings of a lane that begins so far ahead of a vehicle's front bumper."""
    net, number, heads = scene.net, scene.now[0].arrivals, scene.spot_head
    obeys = me.profiled and not net.lanes[me.lane].wrong
    for z in range(net.lanes[lane].strip, net.lanes[lane].strip_end):
        strip = net.strips[z]
        near, far, w = strip.near + begin, strip.far + begin, scene.crossing_head[strip.crossing]
        if far + me.length < 0.0:
            if obeys:
                _record_encounter(me, strip.crossing, scene)
            continue
        if w < 0 or near > attention_m(me):
            continue
        arrival = scene.arrivals[number]
        arrival.vehicle, arrival.crossing, arrival.near, arrival.far = (
            me.row, strip.crossing, near, far
        )  # fmt: skip
        arrival.yields, arrival.stood_s, arrival.link = False, me.stood_s, heads[strip.spot]
        heads[strip.spot] = number
        number += 1
        while w >= 0 and obeys and near >= -ENTERED_M:
            if _yields_to(me, scene.walkers[w], strip, near, far, scene):
                me.stop_gap = min(me.stop_gap, near)
                arrival.yields = True
            w = scene.walkers[w].link
    scene.now[0].arrivals = number


@in_place(inner=True)
def _record_encounter(me: Any, crossing: int, scene: Scene) -> None:
    """Record whether a driver that has passed a crossing yielded to those it met there."""
    for slot in range(MOST_MET):
        if me.met[slot] == crossing:
            if me.met_near[slot]:
                kind = state.YIELDED if me.yielded[slot] else state.NOT_YIELDED
                record(kind, me.agent, scene)
            me.met[slot], me.met_near[slot], me.yielded[slot] = -1, 0, 0


@in_place(inner=True)
def _note_met(me: Any, crossing: int, near: bool, yields: bool) -> None:
    """Remember that a driver yields to pedestrians at a crossing, or meets them there."""
    at = -1
    for slot in range(MOST_MET):
        if me.met[slot] == crossing or (me.met[slot] < 0 and at < 0):
            at = slot
    if at >= 0:
        me.met[at] = crossing
        me.met_near[at] |= near
        me.yielded[at] |= yields


@in_place(inner=True)
def _yields_to(me: Any, person: Any, strip: Any, near: float, far: float, scene: Scene) -> bool:
    """Whether a driver stops for a pedestrian at a crossing that is ``near`` to ``far`` m ahead."""
    crossing, at, speed = scene.net.crossings[strip.crossing], _crossover(person, scene), me.speed
    overlooks, pace = me.overlook_probability, person.free_speed
    sees = overlooks <= 0.0 or chance(me.key, OVERLOOKS, person.agent) >= overlooks
    lit, walk = _light(crossing, scene)
    beyond = person.s - scene.footways.crossovers[at].begin_s
    on = beyond > 0.0
    comes_s, clears_s = near / max(speed, 2.0), (far + me.length) / max(speed, 2.0)
    along, half = _along(strip.u, at, scene), scene.net.lanes[me.lane].width / 2 - STRIP_M
    enters_s, leaves_s = (along - half - beyond) / pace, (along + half - beyond) / pace
    if leaves_s < 0.0:
        return False
    if on and (enters_s <= 0.0 or (person.speed > 0.0 and enters_s < DANGER_S)):
        hard = me.emergency_decel
        return sees and can_stop(speed, near, hard) and leaves_s > comes_s - DANGER_S
    if (on and person.stood_s > STALLED_S) or not ((crossing.priority or lit) and (on or walk)):
        return False
    gentle = max(1.2 * me.comfort_decel_mps2, 3.0)
    if leaves_s < comes_s - DANGER_S or not can_stop(speed, near, gentle):
        return False
    heeds = -beyond <= me.crossing_gap_s * pace and enters_s < clears_s + me.crossing_gap_s
    met = enters_s < clears_s + MET_S and -beyond < MET_KERB_S * pace
    yields = sees and heeds and chance(me.key, YIELDS, strip.crossing) < me.yield_probability
    if met or yields:
        _note_met(me, strip.crossing, met, yields)
    return bool(yields)


@in_place(inner=True)
def _light(crossing: Any, scene: Scene) -> tuple[bool, bool]:
    """Whether a crossing has a light that works, and whether pedestrians may go by it."""
    shown = scene.signals[crossing.signal] if crossing.signal >= 0 else OFF
    return shown != OFF, shown in (GREEN, OFF)


@in_place(inner=True)
def walk(dt: float, scene: Scene) -> None:
    """Let every pedestrian walk on or wait for ``dt`` seconds, as `_may_walk` says."""
    for w in range(scene.walkers.size):
        person = scene.walkers[w]
        at = _crossover(person, scene)
        person.speed = person.free_speed if _may_walk(person, at, dt, scene) else 0.0
        person.stood_s = 0.0 if person.speed > 0.0 else person.stood_s + dt
        way = scene.footways.ways[person.way]
        person.s = min(person.s + person.speed * dt, way.length)
        if at >= 0 and person.s >= scene.footways.crossovers[at].end_s:
            person.crossed += 1
        pieces = scene.footways.pieces
        piece = pieces[last_begun(person.s, way.piece, way.piece_end, pieces)]
        along = person.s - piece.begin
        person.x = piece.x + piece.dx * along + person.aside * -piece.dy
        person.y = piece.y + piece.dy * along + person.aside * piece.dx
        person.heading = math.atan2(piece.dy, piece.dx)


@in_place(inner=True)
def _may_walk(person: Any, at: int, dt: float, scene: Scene) -> bool:
    """Whether a pedestrian walks on in a step of ``dt`` s, or waits."""
    if person.crashed or at < 0:
        return not person.crashed
    way, stride = scene.footways.crossovers[at], person.free_speed * dt
    crossing = scene.net.crossings[way.crossing]
    begins = person.s < way.begin_s
    if begins and way.begin_s - person.s > max(KERB_M, stride):
        return True
    lit, goes = _light(crossing, scene)
    if begins and not goes:
        return False
    nearest = np.inf
    if begins and lit:  # the first lane only
        for spot in range(crossing.spot, crossing.spot_end):
            nearest = min(nearest, _strip_of(spot, at, scene)[0])
    for spot in range(crossing.spot, crossing.spot_end):
        begin, end = _strip_of(spot, at, scene)
        if not begins and not person.s <= begin < person.s + stride:
            continue
        if begin <= nearest and not _is_safe(person, spot, begin, end, scene):
            return False
    return True


@in_place(inner=True)
def _strip_of(spot: int, at: int, scene: Scene) -> tuple[float, float]:
    """Where a lane's strip of a crossing begins and ends along a way over it, m."""
    middle = scene.footways.crossovers[at].begin_s + _along(scene.net.spots[spot].u, at, scene)
    half = scene.net.spots[spot].half - STRIP_M
    return middle - half, middle + half


@in_place(inner=True)
def _is_safe(person: Any, spot: int, begin: float, end: float, scene: Scene) -> bool:
    """Whether a pedestrian can cross a lane's strip before any vehicle reaches it.

    A vehicle that waits before the crossing holds those behind it back.
    """
    enter_s = max(begin - person.s, 0.0) / person.free_speed
    leave_s = (end - person.s) / person.free_speed
    safe, nearest, a = True, np.inf, scene.spot_head[spot]
    while a >= 0:
        arrival = scene.arrivals[a]
        a = arrival.link
        vehicle = scene.vehicles[arrival.vehicle]
        speed, middle_m = vehicle.speed, (arrival.far - arrival.near) / 2
        near, far = arrival.near + middle_m - WALKED_M, arrival.far - middle_m + WALKED_M
        clear_s = (far + vehicle.length) / max(speed, 0.5)
        if arrival.near > nearest or clear_s < 0.0 or (speed > 0.5 and clear_s < enter_s - 0.2):
            continue  # behind another one, or past it before the pedestrian comes
        yields = arrival.yields or vehicle.held
        waits = (yields and speed * speed <= 2.0 * 5.0 * near) or arrival.stood_s > STOOD_S
        comes_s = near / speed if speed >= 2.0 else -speed + math.sqrt(speed * speed + 2.0 * near)
        if near <= 0.1 or waits or comes_s <= leave_s + SPARE_S:
            nearest, safe = arrival.near, near > 0.1 and waits
    return safe
