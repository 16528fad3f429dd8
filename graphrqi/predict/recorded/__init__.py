"""Prediction on recordings: base, neighbours and the network that corrects the base."""
