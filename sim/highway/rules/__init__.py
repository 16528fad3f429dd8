"""The rules of the road: what they demand of drivers and pedestrians, and who broke them.

Everything here reads `sim.highway.state.RoadState` and decides; nothing here moves anything.
"""
