"""The SUMO simulation of this process: starting and closing it, and SUMO's error messages."""

from __future__ import annotations

import contextlib
import itertools
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from behaviors.errors import InputError


class SumoError(InputError):
    """SUMO could not run: one line with SUMO's own reason."""


class Simulation:
    """The simulation of this process; libsumo can run only one at a time."""

    def __init__(self) -> None:
        self.running = False

    def start(self, arguments: list[str], log: Path) -> Any:
        """Start a simulation.

        Args:
            arguments: SUMO's options.
            log: the file for SUMO's messages.

        Returns:
            libsumo's C module, whose functions are quicker than libsumo's own.

        Raises:
            SumoError: if a simulation is running, or SUMO refuses the options.
        """
        os.environ.setdefault("LIBSUMO_AS_TRACI", "quiet")  # otherwise libsumo prints a warning
        import libsumo
        from libsumo import _libsumo

        if self.running or libsumo.isLoaded():
            raise SumoError(
                "sumo: found a simulation running in this process, expected none: close its "
                "frames first or use another process"
            )
        try:
            with _stderr_written_to(log):
                libsumo.start(["sumo", *arguments])
        except (libsumo.TraCIException, libsumo.FatalTraCIError) as error:
            if libsumo.isLoaded():
                libsumo.close()
            raise SumoError(f"sumo: could not start: {sumo_reason(log, str(error))}") from None
        self.running = True
        return _libsumo

    def close(self) -> None:
        """Close the simulation that `start` opened."""
        import libsumo

        self.running = False
        libsumo.close()


SIMULATION: Final = Simulation()


@contextlib.contextmanager
def _stderr_written_to(path: Path) -> Iterator[None]:
    """Redirect stderr of C code to a file: SUMO writes its error messages only there."""
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


def sumo_reason(log: Path, fallback: str) -> str:
    """The first error message in SUMO's log, in one line; the fallback if there is none."""
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines() if log.exists() else []
    for number, line in enumerate(lines):
        if line.startswith("Error:"):
            rest = itertools.takewhile(lambda one: one.startswith(" "), lines[number + 1 :])
            return " ".join([line.removeprefix("Error:").strip(), *(one.strip() for one in rest)])
    return " ".join(fallback.split()) or "no reason given"
