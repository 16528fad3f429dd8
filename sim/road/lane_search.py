"""Searches along lanes, compiled: who is ahead or behind, which stop lines and crossings come.

`sim.episode.observables` says what they mean; here they are loops over plain arrays.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np


@numba.njit(cache=True, error_model="numpy")
def fit(
    xy: Any, heading: Any, start: Any, direction: Any, length: Any, turn_cost_m: Any
) -> tuple[Any, Any, Any]:
    """The straight piece of lane that fits each place and heading best.

    Args:
        xy: (n, 2) m.
        heading: (n,) rad.
        start: (G, 2) where each piece begins, m.
        direction: (G, 2) unit vectors.
        length: (G,) m.
        turn_cost_m: (G,) what facing across a piece costs, m; the other way costs twice as much.

    Returns:
        (n,) piece, distance along it, m, from 0 to its length, and signed distance to its left, m.
    """
    n = len(xy)
    best, at, left = np.zeros(n, np.int64), np.full(n, np.nan), np.full(n, np.nan)
    for i in range(n):
        east, north = np.cos(heading[i]), np.sin(heading[i])
        least, most = np.inf, np.inf
        for j in range(-1, length.size):
            if j < 0 and i == 0:
                continue
            g = best[i - 1] if j < 0 else j  # the one before is near by: its piece is a good guess
            dx, dy = xy[i, 0] - start[g, 0], xy[i, 1] - start[g, 1]
            ux, uy = direction[g, 0], direction[g, 1]
            along = dx * ux + dy * uy
            across = ux * dy - uy * dx
            clipped = min(max(along, 0.0), length[g])
            beyond = along - clipped
            if across * across + beyond * beyond > most:
                continue
            cost = np.hypot(across, beyond)
            cost += turn_cost_m[g] * (1.0 - (east * ux + north * uy))
            if cost < least:
                most = 1.001 * cost * cost  # farther away than this nothing is better
                if j >= 0:
                    least, best[i], at[i], left[i] = cost, g, clipped, across
    return best, at, left


@numba.njit(cache=True, error_model="numpy")
def place(
    lane: Any, s: Any, offset: Any, first: Any, last: Any, piece_at: Any, start: Any, direction: Any
) -> tuple[Any, Any]:
    """Places given in lane coordinates; beyond either end a lane goes on straight.

    Args:
        lane: (n,) lanes.
        s: (n,) distance along them, m.
        offset: (n,) distance to the left of the centre line, m.
        first: (L,) first piece of each lane.
        last: (L,) last piece.
        piece_at: (G,) distance along its lane at which each piece begins, m.
        start: (G, 2) where it begins, m.
        direction: (G, 2) unit vectors.

    Returns:
        (n, 2) positions, m, and (n,) the piece that each is on.
    """
    n = lane.size
    xy, piece = np.empty((n, 2)), np.empty(n, np.int64)
    for i in range(n):
        g = first[lane[i]]
        while g < last[lane[i]] and piece_at[g + 1] <= s[i]:
            g += 1
        along, ux, uy = s[i] - piece_at[g], direction[g, 0], direction[g, 1]
        xy[i, 0] = start[g, 0] + ux * along + offset[i] * -uy
        xy[i, 1] = start[g, 1] + uy * along + offset[i] * ux
        piece[i] = g
    return xy, piece


@numba.njit(cache=True, error_model="numpy")
def along_at(line: Any, x: Any, y: Any) -> tuple[Any, Any, Any]:
    """`along` of one place (x, y)."""
    begin, nearest, found, left = 0.0, np.inf, 0.0, 0.0
    pieces = len(line) - 1
    for k in range(pieces):
        east, north = line[k + 1, 0] - line[k, 0], line[k + 1, 1] - line[k, 1]
        size = np.hypot(east, north)
        east, north = east / size, north / size
        dx, dy = x - line[k, 0], y - line[k, 1]
        forward, aside = dx * east + dy * north, east * dy - north * dx
        clipped = forward
        if k > 0:
            clipped = max(clipped, 0.0)
        if k < pieces - 1:
            clipped = min(clipped, size)
        away = np.hypot(aside, forward - clipped)
        if away < nearest:
            nearest, found, left = away, begin + clipped, aside
        begin += size
    return found, left, begin


@numba.njit(cache=True, error_model="numpy")
def along(line: Any, xy: Any) -> tuple[Any, Any, Any]:
    """Places in the coordinates of a line that goes on straight at both ends.

    Args:
        line: (P, 2) points, m.
        xy: (n, 2) places, m.

    Returns:
        (n,) distance along it, m (negative before it, above its length after it), (n,) distance to
        its left, m, and its length, m.

    Examples:
        >>> u, left, total = along(np.array([[0.0, 0.0], [0.0, 8.0]]), np.array([[1.0, 9.0]]))
        >>> u.tolist(), left.tolist(), total
        ([9.0], [-1.0], 8.0)
    """
    n, total = len(xy), 0.0
    u, left = np.empty(n), np.empty(n)
    for i in range(n):
        u[i], left[i], total = along_at(line, xy[i, 0], xy[i, 1])
    if n == 0:
        _, _, total = along_at(line, 0.0, 0.0)
    return u, left, total


@numba.njit(cache=True, error_model="numpy")
def nearest(
    key: Any, at: Any, row: Any, lane_length: Any, onward: Any, instant: Any, lane: Any, s: Any,
    forward: bool, most_lanes: int, look_ahead: float,
) -> tuple[Any, Any]:  # fmt: skip
    """The first vehicle strictly ahead of (or behind) each place, along the lane and beyond.

    Args:
        key: (m,) instant times number of lanes plus lane, of vehicles sorted by it and by ``at``.
        at: (m,) their distance along the lane, m.
        row: (m,) their row.
        lane_length: (L,) m.
        onward: (L,) the lane after (or before) each, -1: none.
        instant: (q,) of each question.
        lane: (q,) asked about, -1: none.
        s: (q,) distance along it, m.
        forward: whether to look ahead.
        most_lanes: how many lanes are looked at.
        look_ahead: m.

    Returns:
        (q,) rows or -1, and (q,) distances between centres, m, or +inf.
    """
    lanes, m = lane_length.size, key.size
    found, distance = np.full(lane.size, -1, np.int64), np.full(lane.size, np.inf)
    for q in range(lane.size):
        now, travelled, place = lane[q], 0.0, s[q]
        for _ in range(most_lanes):
            if now < 0 or travelled > look_ahead:
                break
            wanted = instant[q] * lanes + now
            low, high = 0, m
            while low < high:
                middle = (low + high) // 2
                before = key[middle] < wanted or (
                    key[middle] == wanted
                    and (at[middle] < place or (forward and at[middle] == place))
                )
                if before:
                    low = middle + 1
                else:
                    high = middle
            j = low if forward else low - 1
            if 0 <= j < m and key[j] == wanted:
                far = travelled + abs(at[j] - max(place, 0.0))
                if far <= look_ahead:
                    found[q], distance[q] = row[j], far
                break
            if forward:
                travelled += lane_length[now] - max(place, 0.0)
                now, place = onward[now], -1e-9  # whoever stands at the very start counts
            else:
                travelled += place
                now = onward[now]
                place = lane_length[now] if now >= 0 else 0.0
    return found, distance


@numba.njit(cache=True, error_model="numpy")
def leaders(
    by_time: Any, begins: Any, lane: Any, forward: Any, s: Any, lane_length: Any, onward: Any,
    most_lanes: int, look_ahead: float,
) -> tuple[Any, Any]:  # fmt: skip
    """The vehicle ahead of each, instant by instant.

    Args:
        by_time: (m,) rows in order of time.
        begins: (T + 1,) where in them those of each time begin, and m.
        lane: (m,) lane of each row, -1: none.
        forward: (m,) the same where the vehicle drives along it, -1 elsewhere.
        s: (m,) distance along it, m.
        lane_length: as in `nearest`.
        onward: as in `nearest`.
        most_lanes: as in `nearest`.
        look_ahead: as in `nearest`.

    Returns:
        (m,) rows or -1, and (m,) distances between centres, m, or +inf.
    """
    m = by_time.size
    found, distance = np.full(m, -1, np.int64), np.full(m, np.inf)
    most = 0
    for t in range(begins.size - 1):
        most = max(most, begins[t + 1] - begins[t])
    row, key, at = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most)
    asked, place, now = np.empty(most, np.int64), np.empty(most), np.zeros(most, np.int64)
    ahead = m >= 0  # not the literal True, for which the search would be compiled once more
    for t in range(begins.size - 1):
        count, first = 0, begins[t]
        here = begins[t + 1] - first
        for j in range(here):
            i = by_time[first + j]
            asked[j], place[j] = forward[i], s[i]
            if lane[i] < 0:
                continue
            k = count  # sorted in as they come: they are few, and mostly in order
            while k > 0 and (key[k - 1] > lane[i] or (key[k - 1] == lane[i] and at[k - 1] > s[i])):
                row[k], key[k], at[k] = row[k - 1], key[k - 1], at[k - 1]
                k -= 1
            row[k], key[k], at[k] = i, lane[i], s[i]
            count += 1
        who, far = nearest(
            key[:count], at[:count], row[:count], lane_length, onward, now[:here], asked[:here],
            place[:here], ahead, most_lanes, look_ahead,
        )  # fmt: skip
        for j in range(here):
            found[by_time[first + j]], distance[by_time[first + j]] = who[j], far[j]
    return found, distance


@numba.njit(cache=True, error_model="numpy")
def followers(leader: Any, gap: Any) -> Any:
    """Who is nearest behind each.

    Args:
        leader: (m,) row of the vehicle ahead, -1: none.
        gap: (m,) to it, m.

    Returns:
        (m,) rows or -1; of several at the same distance the last.
    """
    follower = np.full(leader.size, -1, np.int64)
    for i in range(leader.size):
        ahead = leader[i]
        if ahead >= 0 and (follower[ahead] < 0 or gap[i] <= gap[follower[ahead]]):
            follower[ahead] = i
    return follower


@numba.njit(cache=True, error_model="numpy")
def stops_ahead(
    lane: Any, front: Any, lane_length: Any, ahead: Any, internal: Any, signal: Any,
    cross_lane: Any, cross_id: Any, cross_s: Any, cross_exit_s: Any, most_lanes: int,
    look_ahead: float,
) -> tuple[Any, Any, Any, Any]:  # fmt: skip
    """The next junction entry and the next crossing of each vehicle.

    Args:
        lane: (n,) -1: none.
        front: (n,) distance of the front bumper along it, m.
        lane_length: (L,) m.
        ahead: (L,) the lane after each, -1: none.
        internal: (L,) whether the lane crosses a junction.
        signal: (L,) group that guards entering it, -1: none.
        cross_lane: (Z,) lane of each place where a lane and a crossing meet.
        cross_id: (Z,) the crossing.
        cross_s: (Z,) distance along the lane of its near edge, m.
        cross_exit_s: (Z,) and of its far edge, m.
        most_lanes: how many lanes are looked at.
        look_ahead: m.

    Returns:
        (n,) each: distance to the junction entry, m, negative inside one, +inf if none; its signal
        group or -1; the crossing or -1; distance to its near edge, m, or +inf.
    """
    n = lane.size
    stop, group = np.full(n, np.inf), np.full(n, -1, np.int64)
    crossing, to_crossing = np.full(n, -1, np.int64), np.full(n, np.inf)
    for i in range(n):
        now, travelled = lane[i], -front[i]
        for hop in range(most_lanes):
            if now < 0 or travelled > look_ahead:
                break
            if internal[now] and stop[i] == np.inf:
                stop[i] = travelled
                if hop > 0:
                    group[i] = signal[now]
            for z in range(cross_lane.size):
                if cross_lane[z] != now or travelled + cross_exit_s[z] <= 0.0:
                    continue
                to = travelled + cross_s[z]
                if to < to_crossing[i]:
                    crossing[i], to_crossing[i] = cross_id[z], to
            travelled += lane_length[now]
            now = ahead[now]
    return stop, group, crossing, to_crossing
