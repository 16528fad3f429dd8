"""Reads a road from a SUMO net or an Argoverse 2 map."""

from __future__ import annotations

from pathlib import Path

from behaviors.errors import InputError
from sim.road import Road

MAP_SUFFIX = ".json"
"""Ending of an Argoverse 2 map; all others are SUMO nets."""


def read_road_file(path: Path, name: str | None = None) -> Road:
    """Read a road.

    Args:
        path: a SUMO net (``.net.xml``) or an Argoverse 2 map (``.json``).
        name: what to call the road; by default the file's name without its ending.

    Returns:
        The road.

    Raises:
        InputError: if the file is missing or broken, or has no drivable lane.
    """
    if path.suffix != MAP_SUFFIX:
        from sim.road.net import read_road

        return read_road(path, name)

    from sim.road.maps.argoverse2 import read_map

    road = read_map(path, name)
    if road is None:
        raise InputError(f"{path}: found no lane segment, expected at least one")
    return road
