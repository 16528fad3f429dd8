"""How vehicles enter the road: on the lane with most room, as fast as the one ahead allows."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from sim.compiled import in_place
from sim.highway.driving import idm, on_free_road, safe_speed
from sim.highway.junctions import BEND_BRAKING, BEND_FACTOR, braking_speed
from sim.highway.scene import path_to
from sim.highway.state import IntArray, Scene
from sim.highway.tables import Net, heading_at, project

ENTRY_BRAKING_MPS2: Final = 1.0
"""Agents enter at a speed at which keeping the headway to the vehicle ahead takes no more braking
than this."""


@in_place()
def begin(me: Any, lanes: IntArray, then: int, scene: Scene) -> bool:
    """Place a vehicle at the beginning of one of some lanes, from which it goes to a stretch or -1.

    Returns whether there is room on any.
    """
    most, found, found_speed = -np.inf, -1, 0.0
    for k in lanes:
        gap, ahead = _room(k, me.length, scene)
        wanted = on_free_road(me, scene.net.lanes[k].limit)
        speed = min(wanted, _speed_to_slow_down(me, k, then, scene.net))
        if gap < np.inf:
            room, headway_s = gap - me.min_gap_m, me.time_headway_s
            if idm(me, speed, wanted, gap, ahead) < -ENTRY_BRAKING_MPS2:
                safe = safe_speed(room, ahead, headway_s, ENTRY_BRAKING_MPS2)
                speed = min(speed, max(ahead, safe))
            if room < headway_s * speed:
                continue
        if gap > most:
            most, found, found_speed = gap, k, speed
    if found >= 0:
        put(me, found, me.length / 2, found_speed, scene.net)
    return found >= 0


@in_place()
def put(me: Any, k: int, s: float, speed: float, net: Net) -> None:
    """Place a vehicle in the middle of a lane, ``s`` m along it, at a speed in m/s."""
    g = net.lanes[k].piece
    while g + 1 < net.lanes[k].piece_end and net.pieces[g + 1].begin <= s:
        g += 1
    piece = net.pieces[g]
    me.x, me.y = piece.x + (s - piece.begin) * piece.dx, piece.y + (s - piece.begin) * piece.dy
    me.heading, me.speed, me.entry_speed = heading_at(s, k, net), speed, speed
    me.lane = me.target = me.wanted = k
    me.timer = (me.x + me.y) * math.pi % 1.0  # as in highway-env


@in_place(inner=True)
def _room(k: int, length: float, scene: Scene) -> tuple[float, float]:
    """Bumper gap to the first vehicle on a lane or changing to it, m, and its speed along it."""
    lane, gap, speed = scene.net.lanes[k], np.inf, 0.0
    for j in range(scene.vehicles.size):
        other = scene.vehicles[j]
        s, lateral, _ = project(other.x, other.y, k, scene.net)
        aside = abs(lateral) > lane.width / 2 + 1.0
        if (aside and other.target != k) or s > lane.length:
            continue
        if s - length - other.length / 2 < gap:
            gap = s - length - other.length / 2
            speed = max(other.speed * math.cos(other.heading - heading_at(s, k, scene.net)), 0.0)
    return gap, speed


@in_place(inner=True)
def _speed_to_slow_down(me: Any, k: int, then: int, net: Net) -> float:
    """The speed from which a driver can stop or take the bend at the end of its lane, m/s."""
    path = path_to(k, then, net) if then >= 0 else -1
    if path < 0:
        return np.inf
    bend = net.lanes[path]
    waits = bend.signal >= 0 or bend.must_yield or bend.must_stop
    allowed = 0.0 if waits else min(me.speed_factor, BEND_FACTOR) * bend.limit
    left = max(net.lanes[k].length - me.length, 0.0)
    return float(braking_speed(left, allowed, BEND_BRAKING * me.comfort_decel_mps2))
