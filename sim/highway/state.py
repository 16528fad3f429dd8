"""What kernels read and write: a road's arrays, and everybody on it as rows of arrays.

Every lane has a number, its position in `HighwayNetwork.lanes`; -1 stands for none. Lists that
belong to a lane, such as its `CONFLICT` rows, run from ``lane.conflict`` to ``lane.conflict_end``.

The rows of agents are the truth. A rule that needs a memory of its own adds a field to `VEHICLE`;
what the driver is like comes from the fields of its profile that have the same names.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.frames import EventKind, FloatArray, IntArray
from sim.road.cells import Cells

Records = NDArray[Any]

STRETCH_MARGIN_M, PATH_MARGIN_M = 1.0, 0.5
"""A vehicle this far beyond a stretch's edge is still on it (highway-env's), and beyond a junction
path's, which lie close together."""

BEHIND_M, LONGEST_M = 40.0, 40.0
"""A vehicle this far before the beginning of a lane, and in line with it, is on it already. A
vehicle up to this length is still on a lane with its rear alone (twice a lorry's)."""


def record_type(**names: str) -> np.dtype[Any]:
    """The type of rows that kernels read and write: the names of its fields, by their types."""
    fields = [(name, kind) for kind, those in names.items() for name in those.split()]
    return np.dtype((np.record, np.dtype(fields, align=True)))


LANE: Final = record_type(
    f8="length limit width margin behind",
    bool="connector wrong must_yield must_stop tight",
    i8="signal entry exit left right stretch opposite own piece piece_end turn turn_end "
    "way way_end conflict conflict_end strip strip_end",
)
"""A lane.

``margin``: how far aside a vehicle is still on it, m; ``behind``: how far before it, m;
``connector``: whether it crosses a junction; ``wrong``: whether it runs over a lane of the opposite
direction; ``tight``: whether it turns too sharply for the middle of a car to keep to it;
``signal``: the group that guards its entry; ``entry`` and ``exit``: the lanes on which
a junction path begins and ends; ``left`` and ``right``: lanes that drivers may change to;
``opposite``: the lane over the one of the opposite direction beside it; ``own``: the lane beside
such a lane.
"""

PIECE: Final = record_type(f8="x y dx dy size begin outside outside_end")
"""A straight piece of a lane: beginning and direction, m; how long it is and where it begins along
the lane, m; the side of a sharp corner at its beginning and at its end that is outside, or 0."""

TURN: Final = record_type(f8="begin heading")
"""A lane's heading, rad, at a distance along it, m; between two of them it is interpolated."""

WAY: Final = record_type(i8="stretch path")
"""A stretch to which a lane leads, and the junction path that leads there."""

CONFLICT: Final = record_type(i8="other yields", f8="begin end other_begin other_end")
"""Where a junction path runs too close to another one: from where to where on either, m.

``yields`` is 1 if its traffic gives way to the other's, -1 if the other's does, else 0.
"""

STRIP: Final = record_type(i8="crossing spot", f8="near far u")
"""Where a lane runs over a crossing, and which spot of the crossing that is."""

CROSSING: Final = record_type(i8="signal spot spot_end", bool="priority")
"""A crossing: its signal group, and whether drivers have to let pedestrians cross."""

SPOT: Final = record_type(f8="u half")
"""Where lanes run over a crossing: middle and half width, m along the crossing."""


class Net(NamedTuple):
    """The arrays of a road, named after their types; ``cells`` holds the lanes by place."""

    lanes: Records
    pieces: Records
    turns: Records
    ways: Records
    conflicts: Records
    strips: Records
    crossings: Records
    spots: Records
    cells: Cells
    has_paths: bool  # whether any lane is a junction path
    has_wrong: bool  # whether any lane runs over one of the opposite direction


def listed(of: Records, name: str, lists: Sequence[Any], kind: np.dtype[Any]) -> Records:
    """All lists behind one another, and in each row of ``of`` where its own begins and ends."""
    ends = np.cumsum([len(each) for each in lists], dtype=np.int64)
    of[name + "_end"] = ends
    of[name][1:] = ends[:-1]
    return np.concatenate([np.zeros(0, kind), *(np.asarray(each, kind) for each in lists)])


RED_RUN, STOP_ROLLED, WRONG_WAY, YIELDED, NOT_YIELDED = range(5)
RECORDED: Final = (
    EventKind.RED_RUN, EventKind.STOP_ROLLED, EventKind.WRONG_WAY, EventKind.YIELDED,
    EventKind.NOT_YIELDED,
)  # fmt: skip
"""Events that rules record, by their codes."""

LATE_S, MOST_LATE = 0.1, 51
"""A driver's decisions are kept this often, s, and so many of them: those of the longest reaction
time."""

KINDS_DRAWN: Final = 13
"""How many kinds of draws `sim.highway.driving` names."""

MOST_MET: Final = 4
"""Crossings at which a driver can have met pedestrians that it has not passed yet."""

VEHICLE: Final = record_type(
    i1="kind",
    u8="key",
    bool="profiled krauss crashed wrong_way ran_red held was_held changes astray arrives",
    i8="agent row route leg lane target wanted late_since last_path path_before stood_at then path "
    "forced leaves",
    f8="length width speed_factor time_headway_s min_gap_m max_accel_mps2 comfort_decel_mps2 "
    "politeness lane_change_patience_s startup_delay_s yellow_run_s gap_acceptance_s insistence "
    "crossing_gap_s red_run_probability stop_roll_probability yield_probability reaction_time_s "
    "perception_noise lapse_s overlook_probability change_threshold imposed_braking change_gap "
    "emergency_decel top_speed x y heading speed steering accel entry_speed clock timer go_at "
    "standing_since crashed_at stop_until lapse_until error seen_at line_before stopped_s s "
    "to_line stood_s stop_gap speed_cap",
    **{f"{KINDS_DRAWN}f8": "rate_per_min due", f"{KINDS_DRAWN}i8": "drawn"},
    **{f"{MOST_LATE}f8": "late", f"{MOST_MET}i8": "met", f"{MOST_MET}i1": "met_near yielded"},
)
"""A vehicle; lengths in m, times in s, angles in rad, highway-env's axes, -1 for none.

``row``: its number among the vehicles; ``entry_speed``: at which it came, m/s; ``profiled``:
whether a `Profile` drives it; ``leg``: the last stretch of its route that it came to; ``krauss``:
whether its driver follows by Krauss's law; ``change_threshold`` to ``top_speed``: see
`sim.highway.driving`; ``target``: the lane that it changes to, or the present one; ``wanted``: the
same from the next step on; ``go_at``: when it may start, after standing; ``standing_since``:
infinite while it moves; ``key``: of its draws; ``drawn``: how many draws of each kind it has made;
``due``: when what happens at a ``rate_per_min`` happens next; ``error``: of perception, with
standard deviation 1, last drawn at ``seen_at``; ``late``: the last accelerations wanted, every
`LATE_S`, the first at ``late_since``; ``last_path``: the junction path that it was on last, until
it has left it; ``path_before``, ``line_before``: the path ahead a step ago and how far away it was;
``stood_at``: the path before whose stop sign it has stood, since ``stopped_s``; ``then``: the
stretch after its lane's; ``path``: the junction path that it is on or comes to next; ``to_line``:
front bumper to the beginning of that path, or to the end of a lane without one, negative beyond it;
``stood_s``: for how long it has stood; ``stop_gap``: front bumper to the line at which to stop;
``speed_cap``: speed not to exceed; ``held``: whether a light or a sign makes it stop at the line,
and ``was_held`` a step ago; ``changes``: whether lane changes are allowed; ``forced``: the lane
that it has to head for; ``astray``: whether it needs another route; ``arrives``: whether it is at
the end of its way; ``leaves``: why it goes; ``met``: crossings at which the driver met pedestrians
closely (``met_near``) or ``yielded``.
"""

WALKER: Final = record_type(
    i1="kind",
    bool="crashed",
    i8="agent way crossed leaves link",
    f8="length width x y heading speed s aside free_speed stood_s crashed_at",
)
"""A pedestrian; lengths in m, times in s, highway-env's axes.

``way``: number of its footway; ``s`` and ``aside``: its place on it; ``crossed``: how many of its
crossings it has passed; ``stood_s``: for how long it has stood; ``leaves``: why it goes; ``link``:
the next one at the same crossing.
"""

FOOTWAY: Final = record_type(f8="length", i8="piece piece_end crossover crossover_end")
"""A way on foot, with its straight pieces, `PIECE`, and its crossings, `CROSSOVER`."""

CROSSOVER: Final = record_type(i8="crossing", f8="begin_s end_s", bool="forward")
"""A crossing on a way: where along it a pedestrian waits and has left it, m, and whether it is
walked along its centre line, not against it."""

NOW: Final = record_type(f8="time_s", i8="events arrivals pairs astray leaving")
"""The time, and how many rows of each list are in use; ``astray``: how many drivers need another
route; ``leaving``: how many agents go."""

EVENT: Final = record_type(i8="kind agent", f8="time_s")
"""Something of `RECORDED`."""

ON: Final = record_type(i8="row then", f8="s along")
"""A vehicle on a lane: its distance along it, m, its speed along it, m/s, and the next entry of
``on``, further along that lane."""

ARRIVAL: Final = record_type(i8="vehicle crossing link", f8="near far stood_s", bool="yields")
"""A vehicle that comes to a spot of a crossing: front bumper to its near and far edge, m; whether
it lets the pedestrians go first; for how long it has stood, s; the next arrival at that spot."""

PAIR: Final = record_type(i8="one other")
"""Two who touch, as of ``by_x``, the smaller number first."""


class Footways(NamedTuple):
    """The ways on foot that pedestrians of a road take, as arrays named after their types."""

    ways: Records
    pieces: Records
    crossovers: Records


class Scene(NamedTuple):
    """A road at one time.

    Lists without a maximum length are linked: a ``head`` has the first row of each, or -1, and the
    rows have the next. ``lane_head`` is -1 between two kernels; the others last until they are
    found again.
    """

    net: Net
    routes: IntArray  # (r, m) numbers of the stretches on each route, -1 after the last
    footways: Footways
    signals: NDArray[np.int8]  # (g,) what each signal group shows
    signal_since: FloatArray  # (g,) since when, s
    vehicles: Records  # (n,) of `VEHICLE`
    walkers: Records  # (m,) of `WALKER`
    now: Records  # (1,) of `NOW`
    on: Records  # of `ON`
    on_head: IntArray  # (K,) first vehicle on each lane
    lane_head: IntArray  # (K,) first vehicle on its way over a junction path, or changing to a lane
    lane_link: IntArray  # (2n,) the next; those who have not quite left a path are counted from n
    spot_head: IntArray  # first arrival at each spot of a crossing
    crossing_head: IntArray  # first pedestrian on or near each crossing
    by_x: IntArray  # (n + m,) everybody in order of x; pedestrians are counted after the vehicles
    arrivals: Records  # of `ARRIVAL`
    pairs: Records  # of `PAIR`
    events: Records  # of `EVENT`


def blank_vehicles(n: int) -> Records:
    """(n,) rows of vehicles that stand nowhere and have no driver."""
    rows = np.zeros(n, VEHICLE)
    for name in ("go_at", "standing_since", "crashed_at", "due", "speed_cap"):
        rows[name] = np.inf
    for name in ("met", "late_since", "last_path", "path_before", "stood_at"):
        rows[name] = -1
    return rows
