"""Prediction on recordings: base, neighbours, the network that corrects the base, and rivals."""
