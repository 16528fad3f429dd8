"""Driving a scene on by a car-following law."""
