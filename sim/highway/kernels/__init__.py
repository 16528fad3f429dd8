"""The compiled engine: all vehicles decide and move in loops over arrays.

The vehicle objects are read at the beginning of a step and written at its end, so that a vehicle
whose place, speed or profile is changed between two steps drives on accordingly. Kernels work out
what every driver meets in every step. What is drawn at random or happens seldom (a red light met, a
pedestrian near a crossing, a driver on a wrong lane) is decided by the same functions that
`sim.highway.rules` and `sim.highway.vehicle` have for one vehicle, so the result is the same to the
bit.
"""
