"""Simulating a scene ahead by a car-following law."""
