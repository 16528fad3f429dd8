"""Runs a scenario in SUMO through libsumo and yields `Frame`s.

libsumo holds one simulation per process: a second `run` in the same process is refused while the
first is open. Run episodes in parallel in separate processes.

References:
    Lopez et al. (2018), Microscopic traffic simulation using SUMO, IEEE ITSC.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import sys
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from behaviors.errors import InputError
from sim.files import temporary_folder
from sim.frames import Frame
from sim.scenario import AgentSpec, Scenario, check_agents
from sim.sumo.control import Change
from sim.sumo.control.controls import Controls
from sim.sumo.control.jaywalking import jaywalking_places
from sim.sumo.frame_reader import FrameReader
from sim.sumo.vehicle_types import DEFAULT_SETTINGS, SumoSettings, route_file

SUMO_OPTIONS: Final[tuple[str, ...]] = (
    "--thread-rngs", "64", "--collision.action", "warn", "--collision.mingap-factor", "0",
    "--collision.check-junctions", "true", "--intermodal-collision.action", "warn",
    "--time-to-teleport", "-1", "--ignore-junction-blocker", "60", "--max-depart-delay", "60",
    "--xml-validation.routes", "always", "--no-step-log", "true", "--no-warnings", "true",
    "--duration-log.disable", "true",
)  # fmt: skip
"""SUMO's options for every run: vehicles never teleport, and those that collide drive on."""


class SumoError(InputError):
    """SUMO could not run: one line with SUMO's own reason."""


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
    """Drive a scenario in SUMO as `run` does; drivers of the same profiles follow by IDM."""
    return run_with(scenario, agents, seed, SumoSettings(law="IDM"))


def run_with(
    scenario: Scenario,
    agents: Sequence[AgentSpec],
    seed: int,
    settings: SumoSettings,
    alternatives: Sequence[AgentSpec] = (),
) -> Generator[Frame, Change | None]:
    """As `run`, with what is the same for all vehicles, and with drivers that change.

    ``alternatives`` are drivers as they may become. One of them sent to the generator replaces the
    driver of the same id before the next step; an id with an action makes it act. A driver that
    cannot change is an `InputError`.
    """
    check_agents(scenario, agents, seed)
    road, step_s = scenario.road, scenario.step_s
    if not road.source.is_file():
        raise InputError(f"{road.source}: found no file, expected a SUMO net (.net.xml)")
    if abs(step_s * 1000 - round(step_s * 1000)) > 1e-6:
        raise InputError(f"step_s: found {step_s}, expected whole milliseconds")
    ordered = sorted(agents, key=lambda a: a.id)

    def frames() -> Generator[Frame, Change | None]:
        with _started(scenario, ordered, seed, settings, alternatives) as (sumo, log, steps):
            import libsumo

            step_ms = round(step_s * 1000) // steps
            reader = FrameReader(sumo, road, ordered)
            controls = Controls(sumo, road, ordered, step_ms / 1000)
            try:
                for index in range(scenario.steps):
                    time_s = (index + 1) * step_s
                    try:
                        for step in range(index * steps + 1, (index + 1) * steps + 1):
                            sumo.simulation_step(0.0)
                            now_s = step * step_ms / 1000
                            controls.step(now_s, *reader.names())
                            reader.note(now_s, controls.overtaking.removed)
                        frame = reader.read(time_s, controls.jaywalking.speeds)
                    except (libsumo.TraCIException, libsumo.FatalTraCIError) as error:
                        reason = _reason(log, str(error))
                        raise SumoError(f"sumo: stopped at {time_s:g} s: {reason}") from None
                    changed = yield frame
                    if changed is not None:
                        controls.change(changed, time_s)
            finally:
                if controls.jaywalking.moved:
                    sumo.simulation_step(0.0)  # libsumo crashes if closed after moving an agent

    return frames()


def step_bare(scenario: Scenario, agents: Sequence[AgentSpec], seed: int) -> None:
    """As `run`, without controllers and frames: the least that `run` can cost."""
    with _started(scenario, agents, seed, DEFAULT_SETTINGS, ()) as (sumo, _, steps):
        for _ in range(scenario.steps * steps):
            sumo.simulation_step(0.0)


@contextlib.contextmanager
def _started(
    scenario: Scenario, agents: Sequence[AgentSpec], seed: int, settings: SumoSettings,
    alternatives: Sequence[AgentSpec],
) -> Iterator[tuple[Any, Path, int]]:  # fmt: skip
    """A simulation: libsumo's C module, which is quicker, the log, and SUMO's steps per frame."""
    os.environ.setdefault("LIBSUMO_AS_TRACI", "quiet")  # otherwise libsumo prints a warning
    import libsumo
    from libsumo import _libsumo

    if libsumo.isLoaded():
        raise SumoError(
            "sumo: found a simulation running in this process, expected none: close its "
            "frames first or use another process"
        )
    milliseconds = round(scenario.step_s * 1000)
    steps = math.ceil(milliseconds / (settings.longest_step_s * 1000) - 1e-9)
    while milliseconds % steps:
        steps += 1
    with temporary_folder("sumo") as scratch:
        routes, log = scratch / "agents.rou.xml", scratch / "sumo.err"
        lines = route_file(agents, jaywalking_places(scenario.road, agents), settings, alternatives)
        routes.write_text("\n".join(lines), encoding="utf-8")
        arguments = [
            "--net-file", str(scenario.road.source),
            "--route-files", str(routes),
            "--seed", str(seed),
            "--step-length", f"{milliseconds // steps / 1000:.3f}",
            "--lanechange.duration", f"{settings.lane_change_s:g}",
            "--log", str(log),
            *SUMO_OPTIONS,
            *settings.options,
        ]  # fmt: skip
        try:
            try:
                with _stderr_written_to(log):
                    libsumo.start(["sumo", *arguments])
            except (libsumo.TraCIException, libsumo.FatalTraCIError) as error:
                raise SumoError(f"sumo: could not start: {_reason(log, str(error))}") from None
            yield _libsumo, log, steps
        finally:
            if libsumo.isLoaded():
                libsumo.close()


@contextlib.contextmanager
def _stderr_written_to(path: Path) -> Iterator[None]:
    """Redirect stderr of C code to a file: SUMO writes its error messages only there."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with path.open("wb") as file:
            os.dup2(file.fileno(), 2)
            yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _reason(log: Path, fallback: str) -> str:
    """The first error message in SUMO's log, in one line; the fallback if there is none."""
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines() if log.exists() else []
    for number, line in enumerate(lines):
        if line.startswith("Error:"):
            rest = itertools.takewhile(lambda one: one.startswith(" "), lines[number + 1 :])
            return " ".join([line.removeprefix("Error:").strip(), *(one.strip() for one in rest)])
    return " ".join(fallback.split()) or "no reason given"
