"""Argoverse: forecasting scenarios of both versions, and the sensor logs of the second."""
