"""Runs a scenario in SUMO through libsumo and yields `Frame`s.

libsumo holds one simulation per process: a second `run` in the same process is refused while the
first is open. Run episodes in parallel in separate processes.

References:
    Lopez et al. (2018), Microscopic traffic simulation using SUMO, IEEE ITSC.
"""

from __future__ import annotations

import contextlib
import math
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from sim.frames import AgentKind, Event, EventKind, FloatArray, Frame
from sim.road import Road
from sim.road.net import signal_code
from sim.scenario import AgentSpec, CarFollowing, Scenario, check_agents
from sim.sumo.control.controls import Controls
from sim.sumo.control.jaywalking import jaywalking_places
from sim.sumo.vehicle_poses import draw
from sim.sumo.vehicle_types import route_file

LONGEST_STEP_S: Final = 0.1
"""SUMO's own step is at most this long; frames further apart are made of several steps."""

OPTIONS: Final[tuple[str, ...]] = (
    "--thread-rngs", "64",
    "--collision.action", "warn",
    "--collision.mingap-factor", "0",
    "--collision.check-junctions", "true",
    "--intermodal-collision.action", "warn",
    "--time-to-teleport", "-1",
    "--ignore-junction-blocker", "60",
    "--lanechange.duration", "2.5",
    "--max-depart-delay", "60",
    "--xml-validation.routes", "always",
    "--no-step-log", "true",
    "--no-warnings", "true",
    "--duration-log.disable", "true",
)  # fmt: skip
"""SUMO's options for every run: nobody teleports, collisions are reported and go on. A lane change
takes 2.5 s (observed: 1 to 13 s, mostly 2 to 5; Toledo and Zohar 2007, Transportation Research
Record 1999)."""


class SumoError(InputError):
    """SUMO could not run: one line with SUMO's own reason."""


class _Simulation:
    """The one simulation of this process."""

    def __init__(self) -> None:
        self.running = False

    def start(self, arguments: list[str], log: Path) -> Any:
        """Start libsumo and return its C module (the quick getters)."""
        os.environ.setdefault("LIBSUMO_AS_TRACI", "quiet")  # its warning would go to stdout
        import libsumo
        from libsumo import _libsumo

        if self.running or libsumo.isLoaded():
            raise SumoError(
                "sumo: found a simulation running in this process, expected none: close its "
                "frames first or use another process"
            )
        try:
            with _stderr_kept_in(log):
                libsumo.start(["sumo", *arguments])
        except (libsumo.TraCIException, libsumo.FatalTraCIError) as error:
            if libsumo.isLoaded():
                libsumo.close()
            raise SumoError(f"sumo: could not start: {_reason(log, str(error))}") from None
        self.running = True
        return _libsumo

    def close(self) -> None:
        """Close the simulation that `start` opened."""
        import libsumo

        self.running = False
        libsumo.close()


_SIMULATION: Final = _Simulation()


@contextlib.contextmanager
def _stderr_kept_in(path: Path) -> Iterator[None]:
    """Send what C code writes to stderr to a file: SUMO tells its reasons only there.

    libsumo holds Python's lock meanwhile, so nobody else's words are caught.
    """
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with path.open("wb") as file:
            os.dup2(file.fileno(), 2)
            try:
                yield
            finally:
                os.dup2(kept, 2)
    finally:
        os.close(kept)


def _reason(log: Path, fallback: str) -> str:
    """The first error that SUMO told, in one line."""
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines() if log.exists() else []
    for number, line in enumerate(lines):
        if line.startswith("Error:"):
            told = [line.removeprefix("Error:").strip()]
            for more in lines[number + 1 :]:
                if not more.startswith(" "):
                    break
                told.append(more.strip())
            return " ".join(told)
    return " ".join(fallback.split()) or "no reason given"


def run(scenario: Scenario, agents: Sequence[AgentSpec], seed: int) -> Iterator[Frame]:
    """Drive a scenario in SUMO.

    Args:
        scenario: the road, the duration and the step.
        agents: who travels, as drawn by `sim.scenario.sample_agents`.
        seed: seed of the simulator's own noise; the same seed gives the same frames to the bit.

    Yields:
        Frames from time ``step_s`` to ``duration_s``. Who never found room to enter is in none.

    Raises:
        SumoError: if SUMO refuses the net or the routes, fails on the way, or is already running
            in this process.
        InputError: if the net is missing or the agents or the seed are not usable.
    """
    return _run(scenario, agents, seed, "Krauss")


def run_idm(scenario: Scenario, agents: Sequence[AgentSpec], seed: int) -> Iterator[Frame]:
    """Drive a scenario in SUMO where everybody follows by IDM instead of Krauss's law; see `run`.

    For drivers of the same profiles whose car-following is another one: what is learned from both
    is less of either law's signature.
    """
    return _run(scenario, agents, seed, "IDM")


def _run(
    scenario: Scenario, agents: Sequence[AgentSpec], seed: int, law: CarFollowing
) -> Iterator[Frame]:
    _check(scenario, agents, seed)
    ordered = tuple(sorted(agents, key=lambda a: a.id))
    return cast("Iterator[Frame]", _steps(scenario, ordered, seed, law, steer=True, read=True))


def _check(scenario: Scenario, agents: Sequence[AgentSpec], seed: int) -> None:
    check_agents(scenario, agents, seed)
    if not scenario.road.source.is_file():
        raise InputError(f"{scenario.road.source}: found no file, expected a SUMO net (.net.xml)")
    milliseconds = scenario.step_s * 1000
    if abs(milliseconds - round(milliseconds)) > 1e-6:
        raise InputError(f"step_s: found {scenario.step_s}, expected whole milliseconds")


def _substeps(step_s: float) -> tuple[int, int]:
    """How many SUMO steps make a frame, and each one's length in ms."""
    milliseconds = round(step_s * 1000)
    count = math.ceil(milliseconds / (LONGEST_STEP_S * 1000) - 1e-9)
    while milliseconds % count:
        count += 1
    return count, milliseconds // count


def _start(
    scenario: Scenario,
    agents: Sequence[AgentSpec],
    seed: int,
    step_ms: int,
    scratch: Path,
    law: CarFollowing,
) -> tuple[Any, Path]:
    """Start the simulation; returns libsumo's C module and where the log is."""
    routes, log = scratch / "agents.rou.xml", scratch / "sumo.err"
    lines = route_file(agents, jaywalking_places(scenario.road, agents), law)
    try:
        routes.write_text("\n".join(lines), encoding="utf-8")
    except OSError as error:
        raise SumoError(
            f"sumo: {routes}: found no way to write it ({error.strerror}), expected room for the "
            "routes: free some, or set TMPDIR to another folder"
        ) from None
    arguments = [
        "--net-file", str(scenario.road.source),
        "--route-files", str(routes),
        "--seed", str(seed),
        "--step-length", f"{step_ms / 1000:.3f}",
        "--log", str(log),
        *OPTIONS,
    ]  # fmt: skip
    return _SIMULATION.start(arguments, log), log


def step_bare(
    scenario: Scenario,
    agents: Sequence[AgentSpec],
    seed: int,
    *,
    steer: bool = False,
    read: bool = False,
) -> None:
    """Drive a scenario and leave out what `run` does beside stepping: the floor of what it costs.

    Args:
        scenario: as in `run`.
        agents: as in `run`.
        seed: as in `run`.
        steer: whether controllers steer, which makes another traffic.
        read: whether frames are read.

    Raises:
        SumoError: as in `run`.
    """
    _check(scenario, agents, seed)
    ordered = tuple(sorted(agents, key=lambda a: a.id))
    for _ in _steps(scenario, ordered, seed, "Krauss", steer=steer, read=read):
        pass


def _steps(
    scenario: Scenario,
    agents: tuple[AgentSpec, ...],
    seed: int,
    law: CarFollowing,
    *,
    steer: bool,
    read: bool,
) -> Iterator[Frame | None]:
    """Frames, or None for each where none is read."""
    substeps, step_ms = _substeps(scenario.step_s)
    with tempfile.TemporaryDirectory(prefix="graphrqi-sumo-") as scratch:
        sumo, log = _start(scenario, agents, seed, step_ms, Path(scratch), law)
        controls: Controls | None = None
        meddled = False  # whether controllers took somebody away or placed somebody
        try:
            reader = _Reader(sumo, scenario.road, agents)
            if steer:
                controls = Controls(sumo, scenario.road, agents, step_ms / 1000)
            import libsumo

            for index in range(1, scenario.steps + 1):
                try:
                    for part in range(1, substeps + 1):
                        sumo.simulation_step(0.0)
                        now_s = ((index - 1) * substeps + part) * step_ms / 1000
                        if read:
                            reader.watch(now_s)
                        if controls is not None:
                            controls.step(now_s, *reader.present(again=meddled))
                            reader.note_removed(controls.removed, now_s)
                            meddled = bool(controls.removed) or controls.moved
                    frame = None
                    if read:
                        walking = {} if controls is None else controls.walking_speeds
                        again = meddled or controls is None
                        frame = reader.read(index * scenario.step_s, walking, again=again)
                except (libsumo.TraCIException, libsumo.FatalTraCIError) as error:
                    raise SumoError(
                        f"sumo: stopped at {index * scenario.step_s:g} s: "
                        f"{_reason(log, str(error))}"
                    ) from None
                yield frame
        finally:
            try:
                if controls is not None and controls.moved:
                    sumo.simulation_step(0.0)  # closing right after placing someone crashes libsumo
            finally:
                _SIMULATION.close()


def _turns(road: Road) -> FloatArray:
    """(2, 2) south-west and north-east corners of the box in which the road's ways turn, m."""
    lines = [
        road.lanes[road.lane_index[name]].centerline
        for link in road.connections
        if link.direction != "straight"
        for name in link.via
    ]
    if not lines:
        return np.array([[np.inf, np.inf], [-np.inf, -np.inf]])
    points = np.concatenate(lines)
    return np.stack([points.min(axis=0), points.max(axis=0)])


@dataclass(frozen=True, slots=True)
class _Roll:
    """Who is on the road, until somebody comes or goes.

    Attributes:
        vehicles: their names, in SUMO's order.
        persons: likewise.
        order: (n,) places in vehicles and persons by ascending row.
        rows: (n,) rows of the agents, ascending.
        angle: per vehicle, SUMO's angle of those that have just come, else 0.
        ids: (n,) as in a frame.
        length: (n,) likewise.
        width: (n,) likewise.
        kind: (n,) likewise.
    """

    vehicles: Sequence[str]
    persons: Sequence[str]
    order: NDArray[np.int64]
    rows: NDArray[np.int64]
    angle: FloatArray
    ids: NDArray[np.int64]
    length: FloatArray
    width: FloatArray
    kind: NDArray[np.int8]


class _Reader:
    """Reads the state of the running simulation into frames.

    SUMO gives the centre of the front bumper and degrees clockwise from north; frames have the
    centre of the box and radians counter-clockwise from east.
    """

    def __init__(self, sumo: Any, road: Road, agents: Sequence[AgentSpec]) -> None:
        self._sumo = sumo
        self._plans = road.signal_plans
        self._groups = len(road.signal_groups)
        self._row = {str(a.id): row for row, a in enumerate(agents)}
        self._ids = np.array([a.id for a in agents], dtype=np.int64)
        self._length = np.array([a.length_m for a in agents])
        self._width = np.array([a.width_m for a in agents])
        self._kind = np.array([a.kind.code for a in agents], dtype=np.int8)
        self._walks = np.array([a.kind is AgentKind.PEDESTRIAN for a in agents], dtype=bool)
        self._before = np.full((len(agents), 4), np.nan)
        self._turns = _turns(road)
        self._walk = any(a.kind is AgentKind.PEDESTRIAN for a in agents)
        self._touching: set[tuple[int, int]] = set()
        self._events: list[Event] = []
        self._present: tuple[Sequence[str], Sequence[str]] = ((), ())
        self._known = self._roll(*self._present)
        self._letters: tuple[str, ...] = ()
        self._signals = self._codes()

    def watch(self, time_s: float) -> None:
        """Note what happened in the last simulation step."""
        collisions = self._sumo.simulation_getCollisions()
        if not collisions and not self._touching:
            return
        touching = {(int(c.collider), int(c.victim)) for c in collisions}
        for pair in sorted(touching):
            kind = EventKind.CONTACT if pair in self._touching else EventKind.COLLISION
            self._events.append(Event(kind, time_s, *pair))
        self._touching = touching

    def present(self, again: bool) -> tuple[Sequence[str], Sequence[str]]:
        """Names of the vehicles and of the pedestrians on the road after a simulation step.

        As long as nobody comes or goes they are the same two objects.

        Args:
            again: whether to ask in any case: SUMO does not count whom controllers take away, nor
                what happened in a step after which nobody asked.
        """
        sumo = self._sumo
        changed = again or sumo.simulation_getDepartedNumber() or sumo.simulation_getArrivedNumber()
        if self._walk and not changed:
            changed = sumo.simulation_getDepartedPersonNumber()
            changed = changed or sumo.simulation_getArrivedPersonNumber()
        if changed:
            present = sumo.vehicle_getIDList(), sumo.person_getIDList() if self._walk else ()
            if present != self._present:
                self._present = present
        return self._present

    def note_removed(self, agents: Sequence[int], time_s: float) -> None:
        """Note who was taken off the road."""
        for agent in agents:
            self._events.append(
                Event(EventKind.REMOVAL, time_s, agent, rule="stood on the wrong side")
            )

    def read(self, time_s: float, walking_speeds: Mapping[str, float], again: bool) -> Frame:
        """The state now, with the events since the last reading.

        Args:
            time_s: simulated time, s.
            walking_speeds: speeds, m/s, of pedestrians whose speed SUMO does not know.
            again: whether who is there has to be asked since `present` was.
        """
        sumo = self._sumo
        vehicles, persons = self.present(again=True) if again else self._present
        known = self._known
        if vehicles is not known.vehicles or persons is not known.persons:
            known = self._known = self._roll(vehicles, persons)
        n = known.rows.size
        places: Iterator[float] = chain.from_iterable(map(sumo.vehicle_getPosition, vehicles))
        speeds: Iterator[float] = map(sumo.vehicle_getSpeed, vehicles)
        angle = known.angle
        if persons:
            places = chain(places, chain.from_iterable(map(sumo.person_getPosition, persons)))
            walking = map(sumo.person_getSpeed, persons)
            if walking_speeds:
                walking = map(walking_speeds.get, persons, walking)
            speeds = chain(speeds, walking)
            angle = np.concatenate(
                [angle, np.fromiter(map(sumo.person_getAngle, persons), np.float64, len(persons))]
            )
        front = np.fromiter(places, np.float64, 2 * n)
        xy, heading, speed = draw(
            known.order, known.rows, front, np.fromiter(speeds, np.float64, n), angle,
            self._length, self._walks, self._turns, self._before,
        )  # fmt: skip
        for array in (xy, heading, speed):
            array.setflags(write=False)
        events, self._events = tuple(self._events), []
        return Frame(
            time_s=time_s,
            ids=known.ids,
            xy=xy,
            heading=heading,
            speed=speed,
            length=known.length,
            width=known.width,
            kind=known.kind,
            signals=self._read_signals(),
            events=events,
        )

    def _roll(self, vehicles: Sequence[str], persons: Sequence[str]) -> _Roll:
        """Who is present, and what of them stays the same until somebody comes or goes."""
        n = len(vehicles) + len(persons)
        rows = np.fromiter(map(self._row.__getitem__, chain(vehicles, persons)), np.int64, n)
        angle = np.zeros(len(vehicles))
        for i in np.flatnonzero(np.isnan(self._before[rows[: len(vehicles)], 0])).tolist():
            angle[i] = self._sumo.vehicle_getAngle(vehicles[i])  # asked for once, of the new
        order = rows.argsort()
        rows = rows[order]
        told = (self._ids[rows], self._length[rows], self._width[rows], self._kind[rows])
        for array in told:
            array.setflags(write=False)
        return _Roll(vehicles, persons, order, rows, angle, *told)

    def _read_signals(self) -> NDArray[np.int8]:
        read = self._sumo.trafficlight_getRedYellowGreenState
        letters = tuple(read(plan.id) for plan in self._plans)
        if letters != self._letters:
            self._letters = letters
            self._signals = self._codes()
        return self._signals

    def _codes(self) -> NDArray[np.int8]:
        codes = np.zeros(self._groups, dtype=np.int8)
        for plan, letters in zip(self._plans, self._letters, strict=False):
            for group, link in zip(plan.groups, plan.links, strict=True):
                codes[group] = signal_code(letters[link])
        codes.setflags(write=False)
        return codes
