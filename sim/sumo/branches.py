"""Exact branches of a running SUMO episode: one second, continued in several ways.

A trunk is a process of its own that runs an episode and holds nothing else. Copying that process
(``fork``) copies the whole simulation with its random numbers. An unchanged branch repeats the
trunk's next frames to the bit; a changed branch differs by the changed driver alone. SUMO's own
saved states do not restore exactly.

Linux only: other systems cannot copy a running process, or end its copies with it.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import socket
import subprocess
import sys
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator, Sequence
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from typing import Any, Final, NoReturn, Self

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from sim.frames import Frame
from sim.scenario import AgentSpec, CarFollowing, Scenario, with_behavior
from sim.sumo.control.acting import Action, Command
from sim.sumo.control.controls import NAMED
from sim.sumo.engine import run_with
from sim.sumo.settings import SumoSettings

FRAMES_A_MESSAGE: Final = 20
"""Frames are sent in groups: each message costs some 50 microseconds (measured)."""

ENGINE_LAWS: Final[dict[str, CarFollowing]] = {"sumo": "Krauss", "sumo-idm": "IDM"}
"""The engines whose episodes can be branched, and the law by which their drivers follow."""

_MEMORY: Final = {"GLIBC_TUNABLES": "glibc.malloc.hugetlb=1", "PYTHONMALLOC": "malloc"}
"""Memory in huge pages: a fork copies fewer page tables and takes half the time (measured)."""

_PR_SET_PDEATHSIG: Final = 1
"""Number of the ``prctl`` call that ends a process together with its parent (linux/prctl.h)."""


class _Closing(ABC):
    """Something that a ``with`` block closes at its end."""

    def __enter__(self) -> Self:
        """Use it in a ``with`` block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    @abstractmethod
    def close(self) -> None:
        """End it."""


class Branch(_Closing):
    """One continuation of a trunk; iterating over it gives its frames.

    Closing a branch, or leaving its ``with`` block, ends its process; the trunk is not affected.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def __iter__(self) -> Iterator[Frame]:
        """Frames after the instant of the branch, in order of time.

        Raises:
            InputError: if the simulation failed, or its process was ended from outside.
        """
        yield from _received(self._connection, "branch")

    def close(self) -> None:
        """End the branch; frames that were not read are lost."""
        self._connection.close()


class Trunk(_Closing):
    """A SUMO episode that can be continued in several ways from the same instant.

    Args:
        scenario: the road, the duration and the step.
        agents: the drawn agents.
        seed: of the simulator's own noise.
        engine: "sumo" or "sumo-idm".

    Raises:
        InputError: on other systems than Linux, or with an engine that is not SUMO's.
    """

    def __init__(
        self, scenario: Scenario, agents: Sequence[AgentSpec], seed: int, engine: str = "sumo"
    ) -> None:
        check_platform()
        if engine not in ENGINE_LAWS:
            raise InputError(f"engine: found {engine!r}, expected {' or '.join(ENGINE_LAWS)}")
        here, there = socket.socketpair()
        with there:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "sim.sumo.branches", str(there.fileno())],
                pass_fds=[there.fileno()],
                env={**os.environ, **_MEMORY},
            )
        self._connection: Connection = Connection(here.detach())
        self._drivers = {a.id: a for a in agents if a.profile is not None}
        self._spread, self._population = scenario.spread, scenario.population
        others = tuple(
            self.alternative(agent.id, behavior)
            for agent in self._drivers.values()
            for behavior in (*BEHAVIORS, *scenario.behaviors)
        )
        self._connection.send((scenario, tuple(agents), seed, ENGINE_LAWS[engine], others))

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
        changed: AgentSpec | Command | None = None
        if agent is not None and to is not None:
            changed = (
                Command(self.driver(agent).id, to)
                if isinstance(to, Action)
                else self.alternative(agent, to)
            )
        here, there = socket.socketpair()
        with there:
            self._connection.send((until_s, changed, True))
            send_handle(self._connection, there.fileno(), self.process_id)
        return Branch(Connection(here.detach()))

    def drives(self, agent: int) -> bool:
        """Whether a driver of that id exists in the episode, at any time."""
        return agent in self._drivers

    def driver(self, agent: int) -> AgentSpec:
        """A driver of the episode.

        Raises:
            InputError: if no driver of that id exists.
        """
        if agent not in self._drivers:
            raise InputError(
                f"agent {agent}: found no such driver in the episode, expected one such as "
                f"{', '.join(map(str, sorted(self._drivers)[:NAMED]))}"
            )
        return self._drivers[agent]

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


def check_platform() -> None:
    """Refuse systems that cannot copy a running process.

    Raises:
        InputError: on other systems than Linux.
    """
    if sys.platform != "linux":
        raise InputError(f"branches of a running episode: found {sys.platform}, expected Linux")


def _received(connection: Connection, whose: str) -> Iterator[Frame]:
    """Frames from a connection, until the sender says that these are all."""
    while True:
        try:
            message = connection.recv()
        except (EOFError, OSError):
            raise InputError(f"{whose}: its process ended before its last frame") from None
        if isinstance(message, str):
            raise InputError(message)
        if not message:
            return
        for fields in message:
            yield Frame(**fields)


def _send(connection: Connection, frames: Iterator[Frame], until_s: float) -> bool:
    """Send frames up to a time, then an empty message; False after the reason of a failure."""
    group: list[dict[str, Any]] = []
    try:
        for frame in frames:
            # the receiver rebuilds a frame, checked and read-only
            group.append({name: getattr(frame, name) for name in frame.__dataclass_fields__})
            last = frame.time_s >= until_s - 1e-9
            if last or len(group) == FRAMES_A_MESSAGE:
                connection.send(group)
                group = []
            if last:
                break
        if group:
            connection.send(group)
        connection.send([])
    except InputError as error:
        connection.send(str(error))
        return False
    return True


def _serve(connection: Connection) -> None:
    """Run an episode as the other end of the connection asks for it."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the system clears up ended branches
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the parent, which ends this
    scenario, agents, seed, law, alternatives = connection.recv()
    frames: Generator[Frame, AgentSpec | Command | None] | None = None
    with contextlib.suppress(EOFError, OSError):
        while True:
            until_s, to, is_branch = connection.recv()
            if frames is None:
                try:
                    frames = run_with(scenario, agents, seed, SumoSettings(law), alternatives)
                except InputError as error:
                    connection.send(str(error))
                    return
            if not is_branch:
                if not _send(connection, frames, until_s):
                    return
                continue
            handle, trunk = recv_handle(connection), os.getpid()
            if os.fork() == 0:
                _be_branch(trunk, connection, Connection(handle), _changed(frames, to), until_s)
            os.close(handle)


def _changed(
    frames: Generator[Frame, AgentSpec | Command | None], to: AgentSpec | Command | None
) -> Iterator[Frame]:
    """The frames after a driver has changed."""
    if to is not None:
        with contextlib.suppress(StopIteration):
            yield frames.send(to)
    yield from frames


def _be_branch(
    trunk: int, control: Connection, out: Connection, frames: Iterator[Frame], until_s: float
) -> NoReturn:
    """Work of the copied process; it ends without any of Python's exit code."""
    try:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() == trunk:  # else the trunk ended before the line above
            control.close()
            _send(out, frames, until_s)
            out.close()
    except (OSError, KeyboardInterrupt):
        os._exit(1)  # the reader of this branch is gone
    os._exit(0)


if __name__ == "__main__":
    _serve(Connection(int(sys.argv[1])))
