"""What kernels read and write: a road's arrays, and everybody on it as rows of arrays.

The rows are the truth. A rule that needs a memory of its own adds a field to `VEHICLE`; what the
driver is like comes from the fields of its profile that have the same names.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.frames import EventKind
from sim.highway.tables import Net, Records, record_type

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

EVENT_KINDS: Final = tuple(EventKind)
"""Events by their codes."""

LATE_S: Final = 0.1
"""A driver's decisions are kept this often, s."""

MOST_LATE: Final = 51
"""How many of them are kept: those of the longest reaction time."""

VEHICLE: Final = record_type(
    agent="i8", kind="i1", profiled="?", length="f8", width="f8", route="i8", leg="i8", key="u8",
    # its driver: fields of the profile, and what follows from them
    krauss="?", speed_factor="f8", time_headway_s="f8", min_gap_m="f8", max_accel_mps2="f8",
    comfort_decel_mps2="f8", politeness="f8", lane_change_patience_s="f8", startup_delay_s="f8",
    yellow_run_s="f8", gap_acceptance_s="f8", insistence="f8", crossing_gap_s="f8",
    red_run_probability="f8", stop_roll_probability="f8", yield_probability="f8",
    cut_in_rate_per_min="f8", stop_rate_per_min="f8", wrong_way_rate_per_min="f8",
    reaction_time_s="f8", perception_noise="f8", lapse_rate_per_min="f8", lapse_s="f8",
    overlook_probability="f8",
    change_threshold="f8", imposed_braking="f8", change_gap="f8", emergency_decel="f8",
    top_speed="f8",
    # motion
    x="f8", y="f8", heading="f8", speed="f8", steering="f8", accel="f8", entry_speed="f8",
    lane="i8", target="i8", wanted="i8",
    # memory
    clock="f8", timer="f8", go_at="f8", standing_since="f8",
    crashed="?", crashed_at="f8", wrong_way="?", ran_red="?",
    cut_in_at="f8", stop_at="f8", stop_until="f8", wrong_way_at="f8",
    cut_ins="i8", stops="i8", wrong_ways="i8", dawdled="i8",
    lapse_at="f8", lapse_until="f8", lapses="i8", error="f8", erred="i8", seen_at="f8",
    late=f"{MOST_LATE}f8", late_since="i8",
    last_path="i8", path_before="i8", line_before="f8", stood_at="i8", stopped_s="f8",
    # where it is on its way, in this step
    s="f8", then="i8", path="i8", to_line="f8", stood_s="f8",
    # what the rules demand in this step
    stop_gap="f8", speed_cap="f8", held="?", was_held="?", changes="?", forced="i8", astray="?",
    arrives="?", leaves="i8",
)  # fmt: skip
"""A vehicle; lengths in m, times in s, angles in rad, highway-env's axes, -1 for none.

``entry_speed``: at which it came, m/s; ``profiled``: whether a `Profile` drives it; ``key``: of its
draws; ``leg``: the last stretch of its route that it came to; ``krauss``: whether its driver
follows by Krauss's law; ``change_threshold`` to ``top_speed``: see `sim.highway.driving`;
``target``: the lane that it changes to, or the present one; ``wanted``: the same from the next step
on; ``go_at``: when it may start, after standing; ``standing_since``: infinite while it moves;
``cut_ins``, ``stops``, ``wrong_ways``, ``dawdled``: how many times each was drawn; ``lapse_at``,
``lapse_until``, ``lapses``: the same of lapses of attention; ``error``: of perception, with
standard deviation 1, drawn ``erred`` times, last at ``seen_at``; ``late``: the last accelerations
wanted, every `LATE_S`, the first at ``late_since``; ``last_path``: the junction path that it was on
last, until it has left it; ``path_before``, ``line_before``: the path ahead a step ago and how far
away it was; ``stood_at``: the path before whose stop sign it has stood, since ``stopped_s``;
``then``: the stretch after its lane's; ``path``: the junction path that it is on or comes to next;
``to_line``: front bumper to the beginning of that path, or to the end of a lane without one,
negative beyond it; ``stood_s``: for how long it has stood; ``stop_gap``: front bumper to the line
at which to stop; ``speed_cap``: speed not to exceed; ``held``: whether a light or a sign makes it
stop at the line, and ``was_held`` a step ago; ``changes``: whether lane changes are allowed;
``forced``: the lane that it has to head for; ``astray``: whether it needs another route;
``arrives``: whether it is at the end of its way; ``leaves``: why it goes.
"""

WALKER: Final = record_type(
    agent="i8", kind="i1", length="f8", width="f8", x="f8", y="f8", heading="f8", speed="f8",
    way="i8", s="f8", aside="f8", free_speed="f8", crossed="i8", stood_s="f8",
    crashed="?", crashed_at="f8", leaves="i8", link="i8",
)  # fmt: skip
"""A pedestrian; lengths in m, times in s, highway-env's axes.

``way``: number of its footway; ``s`` and ``aside``: its place on it; ``crossed``: how many of its
crossings it has passed; ``stood_s``: for how long it has stood; ``leaves``: why it goes; ``link``:
the next one at the same crossing.
"""

FOOTWAY: Final = record_type(
    length="f8", step="i8", step_end="i8", crossover="i8", crossover_end="i8"
)
"""A way on foot, with its straight pieces, `STEP`, and its crossings, `CROSSOVER`."""

STEP: Final = record_type(x="f8", y="f8", dx="f8", dy="f8", heading="f8", begin="f8")
CROSSOVER: Final = record_type(crossing="i8", begin_s="f8", end_s="f8", forward="?")
"""A crossing on a way: where along it a pedestrian waits and has left it, m, and whether it is
walked along its centre line, not against it."""

NOW: Final = record_type(
    time_s="f8", events="i8", arrivals="i8", pairs="i8", astray="i8", entries="i8"
)
"""The time, and how many rows of each list are in use; ``astray``: how many drivers need another
route; ``entries``: vehicles on lanes."""

EVENT: Final = record_type(kind="i8", agent="i8", time_s="f8")
"""Something that a rule recorded, by the code of its `EventKind`."""

ON: Final = record_type(row="i8", lane="i8", s="f8", along="f8")
"""A vehicle on a lane: its distance along it, m, and its speed along it, m/s."""

ARRIVAL: Final = record_type(
    vehicle="i8", crossing="i8", near="f8", far="f8", yields="?", stood_s="f8", link="i8"
)
"""A vehicle that comes to a spot of a crossing: front bumper to its near and far edge, m; whether
it lets the pedestrians go first; for how long it has stood, s; the next arrival at that spot."""

PAIR: Final = record_type(one="i8", other="i8")
"""Two who touch; pedestrians are counted after the vehicles."""


class Footways(NamedTuple):
    """The ways on foot that pedestrians of a road take, as arrays named after their types."""

    ways: Records
    steps: Records
    crossovers: Records


class Scene(NamedTuple):
    """A road at one time.

    Lists without a maximum length are linked: a ``head`` has the first row of each, or -1, and the
    rows have the next. Heads are -1 between two kernels.

    Attributes:
        net: the road.
        routes: (r, m) numbers of the stretches on each route, -1 after the last.
        footways: ways on foot.
        signals: (g,) what each signal group shows.
        signal_since: (g,) since when, s.
        vehicles: (n,) rows of `VEHICLE`.
        walkers: (m,) rows of `WALKER`.
        now: (1,) of `NOW`.
        on_first: (K + 1,) where each lane's entries of ``on`` begin.
        on: of `ON`, by lane, then by distance along it.
        unsorted: as ``on``, in the order in which they are found.
        lane_head: (K,) first vehicle on its way over each junction path, or changing to a lane.
        lane_link: (2n,) the next; those who have not quite left a path are counted from n.
        spot_head: first arrival at each spot of a crossing.
        crossing_head: first pedestrian on or near each crossing.
        cell_head: first of everybody in each cell.
        cell_link: (n + m,) the next one.
        arrivals: of `ARRIVAL`.
        pairs: of `PAIR`.
        events: of `EVENT`.
    """

    net: Net
    routes: IntArray
    footways: Footways
    signals: NDArray[np.int8]
    signal_since: FloatArray
    vehicles: Records
    walkers: Records
    now: Records
    on_first: IntArray
    on: Records
    unsorted: Records
    lane_head: IntArray
    lane_link: IntArray
    spot_head: IntArray
    crossing_head: IntArray
    cell_head: IntArray
    cell_link: IntArray
    arrivals: Records
    pairs: Records
    events: Records


def blank_vehicles(n: int) -> Records:
    """(n,) rows of vehicles that stand nowhere and have no driver."""
    rows = np.zeros(n, VEHICLE)
    for name in (
        "go_at", "standing_since", "crashed_at", "cut_in_at", "stop_at", "wrong_way_at", "lapse_at",
        "stop_gap", "speed_cap",
    ):  # fmt: skip
        rows[name] = np.inf
    for name in (
        "agent", "late_since", "route", "last_path", "path_before", "stood_at", "then", "path",
        "forced",
    ):  # fmt: skip
        rows[name] = -1
    rows["stop_until"], rows["changes"] = -np.inf, True
    return rows
