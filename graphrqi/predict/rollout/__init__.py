"""Driving a scene on by car-following and lane-changing laws."""
