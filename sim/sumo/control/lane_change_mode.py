"""SUMO's lane-change modes: for which reasons a vehicle changes lanes, and what it checks before.

The bits are those of SUMO's ``setLaneChangeMode`` command.
"""

from __future__ import annotations

from typing import Final

ORDINARY: Final = 1621
"""SUMO's default: changes for all of SUMO's reasons, and by command."""

NOTHING: Final = 0
"""Changes by command only."""

COLLISIONS_ONLY: Final = 256
"""Changes by command only, refused only if vehicles would touch."""
