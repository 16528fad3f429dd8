"""Simulation: frames, tracks, road geometry, engines and file formats."""
