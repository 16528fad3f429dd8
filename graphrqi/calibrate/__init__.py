"""Calibration: each recorded driver's car-following numbers, and the population that they form."""
