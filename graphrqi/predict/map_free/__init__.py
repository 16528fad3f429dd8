"""Prediction for recordings that come without a map."""
