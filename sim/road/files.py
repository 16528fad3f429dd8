"""Reads a road from a file: a SUMO net, or the map of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from sim.input_files import broken_as_one_line, opened
from sim.road import Road

MAP_SUFFIX: Final = ".json"
"""Ending of an Argoverse 2 map."""

ENDINGS: Final = (".road.json", MAP_SUFFIX, ".net.xml")
"""Endings of the roads that a dataset keeps, in the order in which they are looked for."""

ROOT_BYTES: Final = 4096
"""Bytes of an XML file that are read to find its root element."""


def read_road_file(
    path: Path, name: str | None = None, origin: tuple[float, float] | None = None
) -> Road:
    """Read a road.

    Args:
        path: a SUMO net (``.net.xml``), an Argoverse 2 map (``.json``), a CommonRoad scenario
            (``.xml``), a Lanelet2 map (``.osm``), or a road that a dataset keeps
            (``.road.json``); XML may be gzipped.
        name: what to call the road; by default the file's name without its ending.
        origin: latitude and longitude of (0, 0), degrees, for a Lanelet2 map in such coordinates.

    Returns:
        The road.

    Raises:
        InputError: if the file is missing or broken, or has no drivable lane.
    """
    with broken_as_one_line(path, "a map"):
        if path.name.endswith((".osm", ".osm.gz", ".osm_xy")):
            from sim.road.maps import lanelet2

            return lanelet2.read_map(path, name, origin)
        if path.name.endswith(".road.json"):
            from sim.road.maps.stored import read_stored

            return read_stored(path, name)
        if path.suffix == MAP_SUFFIX:
            from sim.road.maps import argoverse2

            road = argoverse2.read_map(path, name)
            if road is None:
                raise InputError(f"{path}: found no lane segment, expected at least one")
            return road
        with opened(path) as file:
            commonroad = b"<commonRoad" in file.read(ROOT_BYTES)
        if commonroad:
            from sim.road.maps.commonroad import read_map

            return read_map(path, name)
        from sim.road.net import read_road

        return read_road(path, name)
