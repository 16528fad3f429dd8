"""What SUMO's own models cannot do: rule breaking, cut-ins, jaywalking, changes on command.

Controllers act after a simulation step on the agents whose profiles ask for it, in SUMO's order.
Each agent's random decisions come from its own generator.
"""

from enum import StrEnum

from sim.scenario import AgentSpec


class Action(StrEnum):
    """Actions that a driver can be made to take.

    Meanwhile no controller steers that driver. SUMO's safe speed, right of way and red lights
    still hold.
    """

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
