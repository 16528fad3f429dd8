"""The road: lanes, how they connect, what they look like, and the files they are read from."""

from sim.road.road import (
    Connection,
    Crossing,
    Lane,
    LanePosition,
    MapKnowledge,
    Road,
    SignalPlan,
)

__all__ = [
    "Connection", "Crossing", "Lane", "LanePosition", "MapKnowledge", "Road", "SignalPlan",
]  # fmt: skip
