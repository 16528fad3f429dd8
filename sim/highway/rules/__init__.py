"""The rules of the road: what they demand of drivers and pedestrians, and how violations are found.

Everything here reads `sim.highway.state.RoadState` and decides; nothing here moves anything.
"""
