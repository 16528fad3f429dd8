"""SUMO's lane-change modes: which of its own reasons and checks a vehicle's changes obey.

The bits are those of SUMO's ``setLaneChangeMode`` command.
"""

from __future__ import annotations

from typing import Final

ORDINARY: Final = 1621
"""SUMO's default: changes for every reason of its own, and what is commanded."""

NOTHING: Final = 0
"""No change but what is commanded."""

COLLISIONS_ONLY: Final = 256
"""Only what is commanded, refused only if boxes would touch."""
