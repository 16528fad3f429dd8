"""Changes of a driver on the road: another behaviour, or one thing that it does on command.

An action lasts `ACTION_S`; meanwhile no controller steers that driver, and afterwards it drives as
before. SUMO's safe speed, right of way and red lights still hold.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final

from sim.scenario import AgentSpec

ACTION_S: Final = 4.0
"""How long an action lasts, s (a lane change takes 2.5 s)."""


class Action(StrEnum):
    """Actions that a driver can be made to take."""

    BRAKE = "brake"
    """Brakes as hard as the driver ordinarily does, and stands if there is time left."""

    KEEP = "keep"
    """Keeps speed and lane."""

    ACCELERATE = "accelerate"
    """Accelerates as hard as the driver ordinarily does, past the speed limit too."""

    CHANGE_LEFT = "change-left"
    """Moves to the lane on the left unless vehicles would touch."""

    CHANGE_RIGHT = "change-right"
    """Moves to the lane on the right unless vehicles would touch."""


Change = AgentSpec | tuple[int, Action]
"""A driver as it goes on, or the id of one and what it does."""
