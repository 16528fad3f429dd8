"""Runs a scenario in SUMO through libsumo and yields `Frame`s.

libsumo holds one simulation per process: a second `run` in the same process is refused while the
first is open. Run episodes in parallel in separate processes.

References:
    Lopez et al. (2018), Microscopic traffic simulation using SUMO, IEEE ITSC.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, cast

from behaviors.errors import InputError
from sim.files import temporary_folder
from sim.frames import Frame
from sim.scenario import AgentSpec, Scenario, check_agents
from sim.sumo.control.acting import Command
from sim.sumo.control.controls import Controls
from sim.sumo.control.jaywalking import jaywalking_places
from sim.sumo.frame_reader import FrameReader
from sim.sumo.settings import DEFAULT_SETTINGS, SumoSettings
from sim.sumo.simulation import SIMULATION, SumoError, sumo_reason
from sim.sumo.vehicle_types import route_file

SUMO_OPTIONS: Final[tuple[str, ...]] = (
    "--thread-rngs", "64",
    "--collision.action", "warn",
    "--collision.mingap-factor", "0",
    "--collision.check-junctions", "true",
    "--intermodal-collision.action", "warn",
    "--time-to-teleport", "-1",
    "--ignore-junction-blocker", "60",
    "--max-depart-delay", "60",
    "--xml-validation.routes", "always",
    "--no-step-log", "true",
    "--no-warnings", "true",
    "--duration-log.disable", "true",
)  # fmt: skip
"""SUMO's options for every run: vehicles never teleport, and those that collide drive on."""


def run(scenario: Scenario, agents: Sequence[AgentSpec], seed: int) -> Iterator[Frame]:
    """Drive a scenario in SUMO; drivers follow by Krauss's law.

    Args:
        scenario: the road, the duration and the step.
        agents: the road-agents, as drawn by `sim.scenario.sample_agents`.
        seed: seed of the simulator's own noise; the same seed gives the same frames to the bit.

    Yields:
        Frames from time ``step_s`` to ``duration_s``. Agents that find no room to enter are in
        none.

    Raises:
        SumoError: if SUMO refuses the net or the routes, fails on the way, or is already running
            in this process.
        InputError: if the net is missing or the agents or the seed are not usable.
    """
    return run_with(scenario, agents, seed, DEFAULT_SETTINGS)


def run_idm(scenario: Scenario, agents: Sequence[AgentSpec], seed: int) -> Iterator[Frame]:
    """Drive a scenario in SUMO; drivers follow by IDM. See `run`.

    The profiles are the same. A model that is trained on both laws depends less on the traces that
    either law leaves in the motion.
    """
    return run_with(scenario, agents, seed, SumoSettings(law="IDM"))


def run_with(
    scenario: Scenario,
    agents: Sequence[AgentSpec],
    seed: int,
    settings: SumoSettings,
    alternatives: Sequence[AgentSpec] = (),
) -> Generator[Frame, AgentSpec | Command | None]:
    """As `run`, with another law, lane discipline or step, and with drivers that change.

    Args:
        scenario: as in `run`.
        agents: as in `run`.
        seed: as in `run`.
        settings: what is the same for all vehicles.
        alternatives: drivers as they may become. One of them sent to the generator replaces the
            driver of the same id before the next step, and a `Command` makes its driver act.

    Raises:
        InputError: as in `run`, and if a driver that is to change cannot.
    """
    _check(scenario, agents, seed)
    return cast(
        "Generator[Frame, AgentSpec | Command | None]",
        _steps(scenario, agents, seed, settings, alternatives, steer=True, read=True),
    )


def _check(scenario: Scenario, agents: Sequence[AgentSpec], seed: int) -> None:
    check_agents(scenario, agents, seed)
    if not scenario.road.source.is_file():
        raise InputError(f"{scenario.road.source}: found no file, expected a SUMO net (.net.xml)")
    milliseconds = scenario.step_s * 1000
    if abs(milliseconds - round(milliseconds)) > 1e-6:
        raise InputError(f"step_s: found {scenario.step_s}, expected whole milliseconds")


def _substeps(step_s: float, longest_s: float) -> tuple[int, int]:
    """How many SUMO steps there are per frame, and the length of each, ms."""
    milliseconds = round(step_s * 1000)
    count = math.ceil(milliseconds / (longest_s * 1000) - 1e-9)
    while milliseconds % count:
        count += 1
    return count, milliseconds // count


def _start(
    scenario: Scenario,
    agents: Sequence[AgentSpec],
    seed: int,
    step_ms: int,
    scratch: Path,
    settings: SumoSettings,
    alternatives: Sequence[AgentSpec],
) -> tuple[Any, Path]:
    """Start the simulation; returns libsumo's C module and the path of the log."""
    routes, log = scratch / "agents.rou.xml", scratch / "sumo.err"
    lines = route_file(agents, jaywalking_places(scenario.road, agents), settings, alternatives)
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
        "--lanechange.duration", f"{settings.lane_change_s:g}",
        "--log", str(log),
        *SUMO_OPTIONS,
        *settings.options,
    ]  # fmt: skip
    return SIMULATION.start(arguments, log), log


def step_bare(
    scenario: Scenario,
    agents: Sequence[AgentSpec],
    seed: int,
    *,
    steer: bool = False,
    read: bool = False,
) -> None:
    """As `run`, without controllers and frames unless asked for: the least that `run` can cost."""
    _check(scenario, agents, seed)
    for _ in _steps(scenario, agents, seed, DEFAULT_SETTINGS, (), steer=steer, read=read):
        pass


def _steps(
    scenario: Scenario,
    agents: Sequence[AgentSpec],
    seed: int,
    settings: SumoSettings,
    alternatives: Sequence[AgentSpec],
    *,
    steer: bool,
    read: bool,
) -> Generator[Frame | None, AgentSpec | Command | None]:
    """Frames, or None for each where none is read; what is sent to it changes a driver at once."""
    agents = sorted(agents, key=lambda a: a.id)
    substeps, step_ms = _substeps(scenario.step_s, settings.longest_step_s)
    with temporary_folder("sumo") as scratch:
        sumo, log = _start(scenario, agents, seed, step_ms, scratch, settings, alternatives)
        controls: Controls | None = None
        intervened = False  # whether controllers removed or placed an agent in the last step
        try:
            reader = FrameReader(sumo, scenario.road, agents)
            if steer:
                controls = Controls(sumo, scenario.road, agents, step_ms / 1000)
            import libsumo

            for index in range(1, scenario.steps + 1):
                try:
                    for part in range(1, substeps + 1):
                        sumo.simulation_step(0.0)
                        now_s = ((index - 1) * substeps + part) * step_ms / 1000
                        if read:
                            reader.note_collisions(now_s)
                        if controls is not None:
                            controls.step(now_s, *reader.names(again=intervened))
                            reader.note_removed(controls.removed, now_s)
                            intervened = bool(controls.removed) or controls.moved
                    frame = None
                    if read:
                        walking = {} if controls is None else controls.walking_speeds
                        again = intervened or controls is None
                        frame = reader.read(index * scenario.step_s, walking, again=again)
                except (libsumo.TraCIException, libsumo.FatalTraCIError) as error:
                    raise SumoError(
                        f"sumo: stopped at {index * scenario.step_s:g} s: "
                        f"{sumo_reason(log, str(error))}"
                    ) from None
                changed = yield frame
                if changed is not None and controls is not None:
                    controls.change(changed, index * scenario.step_s)
        finally:
            try:
                if controls is not None and controls.moved:
                    sumo.simulation_step(0.0)  # libsumo crashes if closed after moving an agent
            finally:
                SIMULATION.close()
