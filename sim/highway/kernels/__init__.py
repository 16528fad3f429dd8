"""The compiled engine: everybody on any road decides and moves in loops over arrays.

The vehicle objects stay what they are: they are read at the beginning of a step and written at its
end, so a vehicle that is changed in between (its place, speed or profile) drives on accordingly.
Kernels work out what every driver meets in every step. What is drawn at random or happens seldom
(a red light met, a pedestrian near a crossing, a driver on a wrong lane) is decided by the same
functions that `sim.highway.rules` and `sim.highway.vehicle` have for one vehicle, so the result
is the same to the bit.
"""
