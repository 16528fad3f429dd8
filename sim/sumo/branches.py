"""Exact branches of a running SUMO episode: one second, continued in several ways.

A trunk is a process of its own that runs an episode and holds nothing else. Copying that process
(``fork``) copies the whole simulation with its random numbers. An unchanged branch repeats the
trunk's next frames to the bit; a changed branch differs by the changed driver alone. SUMO's own
saved states do not restore exactly.

Linux only: other systems cannot copy a running process.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Generator, Iterator, Sequence
from contextlib import AbstractContextManager
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from typing import Any, Final

from behaviors.errors import InputError, lookup
from behaviors.labels import BEHAVIORS, Behavior
from sim.frames import Frame
from sim.scenario import AgentSpec, CarFollowing, Scenario, with_behavior
from sim.sumo.control import Action, Change
from sim.sumo.control.controls import NAMED
from sim.sumo.engine import run_with
from sim.sumo.vehicle_types import SumoSettings

ENGINE_LAWS: Final[dict[str, CarFollowing]] = {"sumo": "Krauss", "sumo-idm": "IDM"}
"""The engines whose episodes can be branched, and the law by which their drivers follow."""

_MEMORY: Final = {"GLIBC_TUNABLES": "glibc.malloc.hugetlb=1", "PYTHONMALLOC": "malloc"}
"""Memory in huge pages: a fork copies fewer page tables and takes half the time."""


class Branch(Connection):
    """One continuation of a trunk; iterating over it gives its frames.

    Closing a branch, or leaving its ``with`` block, ends its process; the trunk is not affected.
    """

    def __iter__(self) -> Iterator[Frame]:
        """Frames after the instant of the branch, in order of time.

        Raises:
            InputError: if the simulation failed, or its process was ended from outside.
        """
        return _received(self, "branch")


class Trunk(AbstractContextManager["Trunk"]):
    """A SUMO episode that can be continued in several ways from the same instant.

    Args:
        scenario: the road, the duration and the step.
        agents: the drawn agents.
        seed: of the simulator's own noise.
        engine: "sumo" or "sumo-idm".

    Attributes:
        drivers: every driver of the episode, at any time, by id.

    Raises:
        InputError: on other systems than Linux, or with an engine that is not SUMO's.
    """

    def __init__(
        self, scenario: Scenario, agents: Sequence[AgentSpec], seed: int, engine: str = "sumo"
    ) -> None:
        check_platform()
        law = lookup(ENGINE_LAWS, engine, "engine of branches")
        here, there = socket.socketpair()
        with there:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "sim.sumo.branches", str(there.fileno())],
                pass_fds=[there.fileno()],
                env={**os.environ, **_MEMORY},
                process_group=0,  # Ctrl-C ends the parent, which ends this
            )
        self._connection: Connection = Connection(here.detach())
        self.drivers = {a.id: a for a in agents if a.profile is not None}
        self._spread, self._population = scenario.spread, scenario.population
        others = tuple(
            self.alternative(agent, behavior)
            for agent in self.drivers
            for behavior in (*BEHAVIORS, *scenario.behaviors)
        )
        self._connection.send((scenario, tuple(agents), seed, SumoSettings(law), others))

    def advance(self, until_s: float) -> tuple[Frame, ...]:
        """Drive the trunk on.

        Args:
            until_s: simulated time of the last frame, s.

        Returns:
            The frames since the last call.

        Raises:
            InputError: if the simulation failed.
        """
        self._connection.send((until_s, None, False))
        return tuple(_received(self._connection, "trunk"))

    def branch(
        self, until_s: float, agent: int | None = None, to: Behavior | Action | None = None
    ) -> Branch:
        """Copy the trunk as it stands, and let the copy drive on.

        Args:
            until_s: simulated time of the branch's last frame, s.
            agent: id of a driver who goes on differently in the branch.
            to: another behaviour, with the profile that `Trunk.alternative` gives; or an action,
                after which the driver goes on by its own behaviour.

        Returns:
            The branch; it runs beside the trunk and beside other branches. Without a driver who
            changes, its frames are those that the trunk will give. If the driver is not on the
            road, is overtaking on the wrong side, or has no lane to change to, reading the branch
            is an `InputError`.

        Raises:
            InputError: if no such driver exists, or only one of ``agent`` and ``to`` is given.
        """
        if (agent is None) != (to is None):
            raise InputError("branch: found only one of agent and change, expected both or none")
        changed: Change | None = None
        if agent is not None and isinstance(to, Action):
            changed = self.driver(agent).id, to
        elif agent is not None and isinstance(to, Behavior):
            changed = self.alternative(agent, to)
        here, there = socket.socketpair()
        with there:
            self._connection.send((until_s, changed, True))
            send_handle(self._connection, there.fileno(), self.process_id)
        return Branch(here.detach())

    def driver(self, agent: int) -> AgentSpec:
        """A driver of the episode.

        Raises:
            InputError: if no driver of that id exists.
        """
        if agent not in self.drivers:
            some = ", ".join(map(str, sorted(self.drivers)[:NAMED]))
            raise InputError(
                f"agent {agent}: found no such driver in the episode, expected one such as {some}"
            )
        return self.drivers[agent]

    def alternative(self, agent: int, behavior: Behavior) -> AgentSpec:
        """A driver as it is with another behaviour: `sim.scenario.with_behavior`'s.

        Raises:
            InputError: if no driver of that id exists.
        """
        return with_behavior(self.driver(agent), behavior, self._spread, self._population)

    @property
    def process_id(self) -> int:
        """Number of the process that runs the episode; branches are its children."""
        return self._process.pid

    def close(self) -> None:
        """End the trunk and every branch that still runs."""
        self._connection.close()
        self._process.wait()

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()


def check_platform() -> None:
    """Refuse systems that cannot copy a running process, which are all but Linux."""
    if sys.platform != "linux":
        raise InputError(f"branches of a running episode: found {sys.platform}, expected Linux")


def _received(connection: Connection, whose: str) -> Iterator[Frame]:
    """Frames from a connection, until the sender says that these are all."""
    while True:
        try:
            fields = connection.recv()
        except (EOFError, OSError):
            raise InputError(f"{whose}: its process ended before its last frame") from None
        if isinstance(fields, str):
            raise InputError(fields)
        if fields is None:
            return
        yield Frame(**fields)  # made again, so that it is checked and read-only


def _send(connection: Connection, frames: Iterator[Frame], until_s: float) -> None:
    """Send frames up to a time, then None, or instead the reason of a failure."""
    reason = None
    try:
        for frame in frames:
            connection.send({name: getattr(frame, name) for name in frame.__dataclass_fields__})
            if frame.time_s >= until_s - 1e-9:
                break
    except InputError as error:
        reason = str(error)
    connection.send(reason)


def _serve(connection: Connection) -> None:
    """Run an episode as the other end of the connection asks for it, then end all branches."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the system clears up ended branches
    with (
        contextlib.suppress(EOFError, OSError),
        contextlib.closing(_episode(*connection.recv())) as frames,
    ):
        while True:
            until_s, to, is_branch = connection.recv()
            if not is_branch:
                _send(connection, frames, until_s)
                continue
            handle = recv_handle(connection)
            if os.fork() == 0:
                try:
                    connection.close()
                    _send(Connection(handle), _changed(frames, to), until_s)
                finally:
                    os._exit(0)  # without any of Python's exit code
            os.close(handle)
    os.killpg(0, signal.SIGKILL)


def _episode(*arguments: Any) -> Generator[Frame, Change | None]:
    """The frames of an episode, whose failures all come with the first."""
    yield from run_with(*arguments)


def _changed(frames: Generator[Frame, Change | None], to: Change | None) -> Iterator[Frame]:
    """The frames after a driver has changed."""
    if to is not None:
        with contextlib.suppress(StopIteration):
            yield frames.send(to)
    yield from frames


if __name__ == "__main__":
    _serve(Connection(int(sys.argv[1])))
