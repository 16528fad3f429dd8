"""Calibration: what the positions of recorded drivers say about their car-following numbers.

`recorded.recorded_drivers` finds who follows whom in a recording, `posterior.calibrate` infers each
driver's numbers under a law, and the population that they are drawn from.
"""
