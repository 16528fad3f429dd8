"""Replaces the vehicles' own ``act`` and ``step``, and the rules' commands, by kernels."""

from __future__ import annotations

import math
import operator
from collections import Counter
from typing import Any, Final, TypeAlias

import numpy as np
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from sim.highway.driving import COMFORT_DECEL, STANDING_MPS, dawdling
from sim.highway.kernels.ahead import (
    Ahead,
    Demands,
    Travellers,
    demand,
    empty_ahead,
    look_ahead,
)
from sim.highway.kernels.decide import Drivers, accelerate, choose_lanes, steer_all
from sim.highway.kernels.lane_tables import LaneTables, places_on_lanes
from sim.highway.kernels.leaders import Places
from sim.highway.lanes import LaneIndex
from sim.highway.rules.commands import record_violation
from sim.highway.rules.crossings import (
    Walkers,
    find_arrivals,
    record_encounter,
    walkers_at_crossings,
    yield_at_crossings,
)
from sim.highway.rules.junctions import runs_red, stops_at_sign
from sim.highway.rules.way_ahead import ENTERED_M, RANGE_M, WayAhead, way_ahead
from sim.highway.rules.wrong_lane import lane_to_get_over_to
from sim.highway.rules.wrong_way import wrong_way_lane
from sim.highway.state import Arrival, RoadState, agent_of
from sim.highway.vehicle import (
    CHANGE_LEAST_SPEED_MPS,
    DEFAULT_PARAMETERS,
    DriverCommands,
    ProfileVehicle,
    parameters_of,
)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NOBODY: Final[frozenset[int]] = frozenset()

Meetings: TypeAlias = dict[int, tuple[WayAhead, frozenset[int]]]
"""The rows of those who come to a crossing with pedestrians: their way, and the crossings whose
pedestrians they let go first."""


def rows_of(mask: BoolArray) -> list[int]:
    """The rows at which a mask is true."""
    rows: list[int] = mask.nonzero()[0].tolist()
    return rows


class Fleet:
    """Facts about the vehicles that do not change from step to step, one row each.

    They are gathered again when a vehicle enters, leaves, or gets another profile or route.

    Args:
        tables: the road's lanes.
        vehicles: everybody.
    """

    def __init__(self, tables: LaneTables, vehicles: list[Vehicle]) -> None:
        n = len(vehicles)
        self.vehicles = list(vehicles)
        self.facts = _facts(vehicles)
        profiled = [isinstance(v, ProfileVehicle) for v in vehicles]
        self.known = np.array(profiled, dtype=np.bool_)
        self.drivers: list[tuple[int, ProfileVehicle]] = [
            (i, v) for i, v in enumerate(vehicles) if profiled[i]
        ]
        self.others: list[tuple[int, Vehicle]] = [
            (i, v) for i, v in enumerate(vehicles) if not profiled[i]
        ]
        self.agent = np.array([agent_of(v) for v in vehicles], dtype=np.int64)
        self.length = np.array([v.LENGTH for v in vehicles], dtype=np.float64)
        self.parameters = np.array([parameters_of(v) for v in vehicles], dtype=np.float64)
        self.parameters = self.parameters.reshape(n, DEFAULT_PARAMETERS.size)
        self.manners = np.zeros((n, 3))
        for i, v in self.drivers:
            p = v.profile
            self.manners[i] = p.yellow_run_s, p.gap_acceptance_s, p.insistence
        self.dawdlers = [(i, v) for i, v in self.drivers if v.driver.law == "Krauss"]
        numbers: dict[tuple[tuple[str, str], ...], int] = {}
        self.way = np.array(
            [numbers.setdefault(getattr(v, "stretches", ()), len(numbers)) for v in vehicles],
            dtype=np.int64,
        )
        longest = max((len(way) for way in numbers), default=0)
        self.ways = np.full((len(numbers), longest + 1), -1, dtype=np.int64)
        for way, row in numbers.items():
            self.ways[row, : len(way)] = tables.way(way)

    def holds(self, vehicles: list[Vehicle]) -> bool:
        """Whether the vehicles, their profiles and their routes are still the same."""
        same = len(self.vehicles) == len(vehicles) and all(
            map(operator.is_, self.vehicles, vehicles)
        )
        return same and all(map(operator.is_, self.facts, _facts(vehicles)))


def _facts(vehicles: list[Vehicle]) -> list[Any]:
    """The objects whose replacement changes what a `Fleet` holds."""
    facts: list[Any] = [getattr(v, "stretches", None) for v in vehicles]
    return facts + [getattr(v, "parameters", None) for v in vehicles]


class CompiledTraffic:
    """Decides and moves everybody on a road.

    Args:
        road: whose vehicles to drive.
    """

    def __init__(self, road: RoadState) -> None:
        self.road = road
        self.tables = LaneTables(road.network_info)
        self._fleet = Fleet(self.tables, [])
        self.at_end: set[int] = set()  # ids of objects that may have come to the end of their lane
        self._met = [
            tuple(("met", strip.crossing) for strip in road.network_info.info[key].strips)
            for key in self.tables.keys
        ]

    # Deciding --------------------------------------------------------------------------------

    def act(self) -> None:
        """Give everybody its commands and decide for everybody, after the road's `locate`."""
        self._refresh()
        if not self._fleet.vehicles:
            self.road.arrivals = {}
            return
        places, who = self._places(), self._travellers()
        self._command(places, who)
        if self._refresh():  # somebody goes another way
            places = places._replace(way=self._fleet.way, ways=self._fleet.ways)
        for _, vehicle in self._fleet.others:
            vehicle.act()
        self._decide(places, who.lane)

    def _refresh(self) -> bool:
        """Gather the facts again if vehicles, profiles or routes changed; whether they did."""
        if self._fleet.holds(self.road.vehicles):
            return False
        self._fleet = Fleet(self.tables, self.road.vehicles)
        return True

    def _places(self) -> Places:
        located, fleet = self.road.located, self._fleet
        return Places(
            xy=located.xy,
            lines=self.road.network_info.lines,
            on=located.on,
            length=fleet.length,
            speed=located.speed,
            way=fleet.way,
            ways=fleet.ways,
        )

    def _numbers(self, keys: list[LaneIndex | None]) -> IntArray:
        number = self.tables.number
        return np.array([-1 if key is None else number[key] for key in keys], dtype=np.int64)

    def _travellers(self) -> Travellers:
        """The vehicles as the rules need them."""
        fleet, now = self._fleet, self.road.time_s
        vehicles, n = fleet.vehicles, len(fleet.vehicles)
        lane = self._numbers([v.lane_index for v in vehicles])
        target = lane.copy()
        held, cap = np.zeros(n, dtype=np.bool_), np.full(n, np.inf)
        for i, driver in fleet.drivers:
            if driver.target_lane_index is not driver.lane_index:
                target[i] = self.tables.number[driver.target_lane_index]
            commands = driver.commands
            held[i], cap[i] = commands.held, commands.speed_cap
        clock = np.array([getattr(v, "clock", now) for v in vehicles], dtype=np.float64)
        since = [getattr(v, "standing_since", math.inf) for v in vehicles]
        stood_s = clock - np.array(since, dtype=np.float64)
        before = [getattr(v, "line_before", None) or (None, 0.0) for v in vehicles]
        return Travellers(
            known=fleet.known,
            agent=fleet.agent,
            lane=lane,
            target=target,
            parameters=fleet.parameters,
            manners=fleet.manners,
            speed_cap=cap,
            held=held,
            stood_s=np.where(stood_s == -np.inf, 0.0, stood_s),
            last_path=self._numbers([getattr(v, "last_path", None) for v in vehicles]),
            ran_red=np.array([getattr(v, "ran_red", False) for v in vehicles], dtype=np.bool_),
            before_path=self._numbers([path for path, _ in before]),
            before_line=np.array([line for _, line in before], dtype=np.float64),
        )

    def _command(self, places: Places, who: Travellers) -> None:
        """Set everybody's commands, and who comes to which crossing, as `give_commands` does."""
        road, lanes, n = self.road, self.tables.lanes, len(self._fleet.vehicles)
        walkers, found = walkers_at_crossings(road), empty_ahead(n)
        used = np.zeros(len(road.network_info.road.crossings), dtype=np.bool_)
        used[list(walkers)] = True
        age = road.time_s - road.signal_since
        look_ahead(who, lanes, places, road.signals, age, used, found)
        self._note_ways(who, found)
        out = Demands(
            np.full(n, np.inf), np.full(n, np.inf), np.zeros(n, np.bool_), np.ones(n, np.bool_)
        )
        self._ask_at_lines(who, found, out.held)
        meetings = self._ask_at_crossings(who, found, walkers, out.stop_gap)
        demand(
            who, lanes, places, road.signals, found, self.tables.has_paths,
            np.full(lanes.length.size, -1), np.full(2 * who.lane.size, -1), out,
        )  # fmt: skip
        self._hand_out(out, meetings)
        self._force_lanes(who, found)
        arrivals: dict[tuple[int, int], list[Arrival]] = {}
        for way, _ in meetings.values():
            known = isinstance(way.vehicle, ProfileVehicle)
            given = way.vehicle.commands if known else None
            for place, arrival in find_arrivals(road, way, given):
                arrivals.setdefault(place, []).append(arrival)
        road.arrivals = arrivals

    def _note_ways(self, who: Travellers, found: Ahead) -> None:
        """Note each vehicle's path and the distance to its line, and who broke a rule there."""
        keys = self.tables.keys
        rows = zip(
            self._fleet.vehicles,
            found.path.tolist(),
            found.to_line.tolist(),
            who.last_path.tolist(),
            strict=True,
        )
        for vehicle, path, to_line, last in rows:
            vehicle.line_before = None if path < 0 else (keys[path], to_line)
            if last >= 0:
                vehicle.last_path = keys[last]
        for i in rows_of(found.left):
            vehicle = self._fleet.vehicles[i]
            vehicle.last_path, vehicle.ran_red = None, False
        for i in rows_of(found.crossed):
            vehicle = self._fleet.vehicles[i]
            record_violation(self.road, vehicle, keys[found.path[i]])
            who.ran_red[i] = getattr(vehicle, "ran_red", False)

    def _ask_at_lines(self, who: Travellers, found: Ahead, held: BoolArray) -> None:
        """Fill in who stops at the line for a light or a sign."""
        lanes, path = self.tables.lanes, found.path
        at_line = who.known & (path >= 0) & ~lanes.wrong[who.lane]
        at_line &= (found.to_line < RANGE_M) & (found.to_line > -ENTERED_M)
        signs = at_line & lanes.must_stop[path]
        held |= found.stops
        for i in rows_of(found.first_at_red | signs):
            vehicle, key = self._fleet.vehicles[i], self.tables.keys[path[i]]
            if found.first_at_red[i] and runs_red(vehicle, key):
                held[i] = False
            if signs[i] and not held[i]:
                held[i] = stops_at_sign(vehicle, key, float(found.to_line[i]))

    def _ask_at_crossings(
        self, who: Travellers, found: Ahead, walkers: Walkers, stop_gap: FloatArray
    ) -> Meetings:
        """Who comes to a crossing with pedestrians, and what that demands."""
        road = self.road
        meetings: Meetings = {}
        obeys = who.known & ~self.tables.lanes.wrong[who.lane]
        for i in rows_of(found.people | (found.passed & obeys)):
            vehicle = self._fleet.vehicles[i]
            if found.people[i]:
                way, commands = way_ahead(road, vehicle), DriverCommands()
                if obeys[i]:
                    yield_at_crossings(road, way, walkers, commands)
                    stop_gap[i] = commands.stop_gap
                meetings[i] = way, commands.yields_to
            elif any(met in vehicle.draws for met in self._met_at(who.lane[i], found.path[i])):
                for strip in way_ahead(road, vehicle).strips:
                    if strip.far + vehicle.LENGTH < 0.0:
                        record_encounter(road, vehicle, strip.crossing)
        return meetings

    def _met_at(self, lane: int, path: int) -> tuple[tuple[str, int], ...]:
        """What drivers note who meet pedestrians at the crossings of a lane and a path."""
        return self._met[lane] + (self._met[path] if path >= 0 else ())

    def _hand_out(self, out: Demands, meetings: Meetings) -> None:
        """Write the commands on the vehicles."""
        stop_gap, speed_cap = out.stop_gap.tolist(), out.speed_cap.tolist()
        held, changes = out.held.tolist(), out.changes.tolist()
        for i, driver in self._fleet.drivers:
            commands = driver.commands
            commands.stop_gap, commands.speed_cap = stop_gap[i], speed_cap[i]
            commands.held, commands.changes = held[i], changes[i]
            commands.forced_lane, commands.yields_to = None, NOBODY
        for i, (_, yields) in meetings.items():
            if yields:
                self._fleet.vehicles[i].commands.yields_to = yields

    def _force_lanes(self, who: Travellers, found: Ahead) -> None:
        """Ask drivers that may have to leave their lane which lane they head for."""
        road, lanes = self.road, self.tables.lanes
        astray = who.known & (found.path < 0) & (found.then >= 0)
        astray &= ~lanes.connector[who.lane] & ~lanes.wrong[who.lane]
        if road.network_info.wrong_side:
            for _, driver in self._fleet.drivers:
                if driver.wrong_way or driver.clock >= driver.schedule.wrong_way_at:
                    driver.commands.forced_lane = wrong_way_lane(road, driver)
        for i in rows_of(astray):
            driver = self._fleet.vehicles[i]
            if driver.commands.forced_lane is None:
                driver.commands.forced_lane = lane_to_get_over_to(road, way_ahead(road, driver))

    def _decide(self, places: Places, lane: IntArray) -> None:
        """Set every driver's lane to head for, steering and acceleration."""
        fleet, keys = self._fleet, self.tables.keys
        drivers, choice, go_at = self._read_drivers(lane)
        cut_in, n = np.zeros(len(lane), dtype=np.bool_), len(lane)
        lanes = self.tables.lanes
        if drivers.may_change.any():
            choose_lanes(drivers, lanes, places, DEFAULT_PARAMETERS, choice, cut_in)
            for i in rows_of(cut_in):
                fleet.vehicles[i].schedule_cut_in()
        stopping = np.zeros(n, dtype=np.bool_)
        for i, driver in fleet.drivers:
            schedule, clock = driver.schedule, driver.clock
            if not driver.crashed and (clock >= schedule.stop_at or clock < schedule.stop_until):
                stopping[i] = driver.wants_stop()
        steering, accel = np.zeros(n), np.zeros(n)
        accelerate(drivers, lanes, places, choice, stopping, go_at, accel)
        located = self.road.located
        on_line = places_on_lanes(self.tables, located.xy, choice)
        steer_all(drivers.active, on_line, located.heading, places.speed, places.length, steering)
        for i, driver in fleet.dawdlers:
            if drivers.active[i]:
                chance = float(driver.schedule.rng.random())
                accel[i] -= dawdling(driver.parameters, driver.speed, chance)
        angles, rates = steering.tolist(), accel.tolist()
        heads_for, starts = choice.tolist(), go_at.tolist()
        for i, driver in fleet.drivers:
            if driver.crashed:
                braking = -driver.parameters[COMFORT_DECEL]
                driver.action = {"steering": 0.0, "acceleration": braking}
                continue
            driver.action = {"steering": angles[i], "acceleration": rates[i]}
            driver.wanted_lane_index = keys[heads_for[i]]
            driver.go_at = starts[i]

    def _read_drivers(self, lane: IntArray) -> tuple[Drivers, IntArray, FloatArray]:
        """What drivers know when they decide, the lanes they head for already, and `go_at`."""
        fleet, number, n = self._fleet, self.tables.number, len(lane)
        flags = np.zeros((3, n), dtype=np.bool_)
        metres = np.full((4, n), np.inf)
        active, may_change, cutting_in = flags
        stop_gap, speed_cap, clock, go_at = metres
        choice, changing = lane.copy(), Counter[LaneIndex]()
        for _, driver in fleet.drivers:
            if driver.target_lane_index != driver.lane_index:
                changing[driver.target_lane_index] += 1
        for i, driver in fleet.drivers:
            if driver.crashed:
                continue
            active[i], commands, target = True, driver.commands, driver.target_lane_index
            stop_gap[i], speed_cap[i] = commands.stop_gap, commands.speed_cap
            clock[i], go_at[i] = driver.clock, driver.go_at
            if commands.forced_lane is not None:
                choice[i] = number[commands.forced_lane]
            elif driver.lane_index != target:
                goes_on = target if changing[target] == 1 else driver.go_on_changing()
                choice[i] = number[goes_on]
            elif driver.timer > driver.LANE_CHANGE_DELAY:
                driver.timer = 0.0
                if commands.changes and driver.speed >= CHANGE_LEAST_SPEED_MPS:
                    may_change[i], cutting_in[i] = True, driver.wants_cut_in()
        parameters = fleet.parameters
        drivers = Drivers(
            active, may_change, cutting_in, lane, parameters, speed_cap, stop_gap, clock
        )
        return drivers, choice, go_at

    # Moving ----------------------------------------------------------------------------------

    def step(self, dt: float) -> None:
        """Move everybody for ``dt`` seconds by highway-env's kinematic bicycle.

        The sines and tangents are numpy's, as in highway-env: those of kernels round otherwise.
        """
        self._refresh()
        fleet = self._fleet
        for _, vehicle in fleet.others:
            vehicle.step(dt)
        drivers = [driver for _, driver in fleet.drivers]
        if not drivers:
            return
        xy = np.array([v.position for v in drivers], dtype=np.float64)
        heading = np.array([v.heading for v in drivers], dtype=np.float64)
        speed = np.array([v.speed for v in drivers], dtype=np.float64)
        steering = np.array([v.action["steering"] for v in drivers], dtype=np.float64)
        accel = np.array([v.action["acceleration"] for v in drivers], dtype=np.float64)
        crashed = np.array([v.crashed for v in drivers], dtype=np.bool_)
        most = float(ProfileVehicle.MAX_SPEED)
        for i in rows_of(crashed | (speed > most)):
            drivers[i].clip_actions()
            action = drivers[i].action
            steering[i], accel[i] = action["steering"], action["acceleration"]
        half = fleet.length[fleet.known] / 2
        slip = np.arctan(1 / 2 * np.tan(steering))
        course = heading + slip
        xy[:, 0] += speed * np.cos(course) * dt
        xy[:, 1] += speed * np.sin(course) * dt
        heading += speed * np.sin(slip) / half * dt
        speed += accel * dt
        speed[speed < 0.0] = 0.0
        rows = zip(drivers, xy, heading.tolist(), speed.tolist(), strict=True)
        for driver, place, turned, now in rows:
            driver.position, driver.heading, driver.speed = place, turned, now
            driver.timer += dt
            driver.clock += dt
            driver.target_lane_index = driver.wanted_lane_index
            if now > STANDING_MPS:
                driver.standing_since = math.inf
            elif driver.standing_since == math.inf:
                driver.standing_since = driver.clock
        self._update_lanes(drivers, xy, half)

    def _update_lanes(
        self, drivers: list[ProfileVehicle], xy: FloatArray, half: FloatArray
    ) -> None:
        """Put vehicles on another lane if they change to it or reach their lane's end."""
        lanes = self.tables.lanes
        lane = self._numbers([v.lane_index for v in drivers])
        s = places_on_lanes(self.tables, xy, lane)[:, 0]
        changing = [v.target_lane_index != v.lane_index for v in drivers]
        moves = np.array(changing, dtype=np.bool_) | (s > lanes.length[lane])
        for i in rows_of(moves):
            drivers[i].on_state_update()
        ends = moves | (s + half >= lanes.length[lane])
        self.at_end = {id(drivers[i]) for i in rows_of(ends)}
