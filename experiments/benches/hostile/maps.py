"""A small valid map of every kind that is read, and a route file."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from experiments.benches.hostile import scenes
from experiments.benches.hostile.oracles import altered
from experiments.benches.hostile.sample import Sample
from sim.road.files import read_road_file

OPENDRIVE: Final = b"""<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="6"/>
<road id="1" length="300" junction="-1"><link><successor elementType="road" elementId="2"
 contactPoint="start"/></link><type s="0" type="town"><speed max="20" unit="m/s"/></type>
<planView><geometry s="0" x="0" y="0" hdg="0.3" length="300"><line/></geometry></planView>
<lanes><laneSection s="0"><center><lane id="0" type="none"/></center><right>
<lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></right>
</laneSection></lanes></road>
<road id="2" length="50" junction="-1"><planView><geometry s="0" x="287" y="89" hdg="0.3"
 length="50"><line/></geometry></planView><lanes><laneSection s="0"><center>
<lane id="0" type="none"/></center><right><lane id="-1" type="driving"><width sOffset="0" a="3.5"
 b="0" c="0" d="0"/></lane></right></laneSection></lanes></road>
</OpenDRIVE>
"""

OPENSTREETMAP: Final = b"""<?xml version="1.0"?>
<osm version="0.6"><node id="1" lat="48.1310" lon="11.5740"/>
<node id="2" lat="48.1330" lon="11.5740"><tag k="highway" v="traffic_signals"/></node>
<node id="3" lat="48.1350" lon="11.5740"/><node id="4" lat="48.1330" lon="11.5710"/>
<way id="10"><nd ref="1"/><nd ref="2"/><nd ref="3"/><tag k="highway" v="secondary"/>
<tag k="lanes" v="2"/><tag k="maxspeed" v="50"/></way>
<way id="11"><nd ref="4"/><nd ref="2"/><tag k="highway" v="tertiary"/></way></osm>
"""

ROUTES: Final = """<routes><vType id="car" vClass="passenger"/>
<route id="r" edges="{edge}"/><flow id="f" route="r" begin="0" end="600" vehsPerHour="300"/>
<flow id="g" type="car" period="12.5"><route edges="{edge}"/></flow>
<vehicle id="v" route="r" depart="5.5"/><vehicle id="w" depart="1:30"><route edges="{edge}"/>
</vehicle></routes>
"""


def lanelets() -> bytes:
    """A Lanelet2 map: two lanelets, one after the other."""
    nodes = {1: (0, 3), 2: (20, 3), 3: (40, 3), 4: (0, 0), 5: (20, 0), 6: (40, 0)}
    ways = {11: (1, 2), 12: (2, 3), 13: (4, 5), 14: (5, 6)}
    text = "".join(
        f'<node id="{i}" lat="0" lon="0"><tag k="local_x" v="{x}"/><tag k="local_y" v="{y}"/>'
        "</node>\n"
        for i, (x, y) in nodes.items()
    )
    for i, ends in ways.items():
        text += f'<way id="{i}">' + "".join(f'<nd ref="{n}"/>' for n in ends) + "</way>\n"
    for i, (left, right) in {21: (11, 13), 22: (12, 14)}.items():
        text += (
            f'<relation id="{i}"><member type="way" ref="{left}" role="left"/>'
            f'<member type="way" ref="{right}" role="right"/><tag k="type" v="lanelet"/>'
            '<tag k="speed_limit" v="50 km/h"/></relation>\n'
        )
    return f'<osm version="0.6">\n{text}</osm>\n'.encode()


def map_samples() -> dict[str, Sample]:
    """A valid map of every kind."""
    from scenarios import get_scenario
    from scenarios.own.routes import read_routes
    from scenarios.own.survey import survey
    from sim.road.maps.argoverse2 import static_map
    from sim.road.maps.stored import encode_road

    crossing = get_scenario("four_way_intersection")().road.source
    straight = get_scenario("straight_road")().road
    assert crossing is not None
    net, small = crossing.read_bytes(), straight.source.read_bytes()
    roads: dict[str, tuple[str, bytes, Callable[[Path], Any]]] = {
        "net": ("road.net.xml", net, altered.net_lanes),
        "net-small": ("road.net.xml", small, altered.net_lanes),
        "net.gz": ("road.net.xml.gz", gzip.compress(net, 1, mtime=0), altered.net_lanes),
        "lanelet2": ("a.osm", lanelets(), altered.lanelet_lanes),
        "argoverse2-map": (
            "log_map_archive_a.json", json.dumps(static_map(straight)).encode(),
            altered.argoverse2_lanes,
        ),
        "commonroad-map": ("scene.xml", scenes.COMMONROAD.encode(), altered.commonroad_lanes),
        "stored-road": ("a.road.json", encode_road(straight), altered.stored_lanes),
    }  # fmt: skip

    def road(file: str, oracle: Callable[[Path], Any]) -> Sample:
        return Sample(
            {}, lambda folder: read_road_file(folder / file),
            lambda folder: oracle(folder / file), altered.other_lanes,
        )  # fmt: skip

    found = {
        name: Sample({file: data}, one.read, one.oracle, one.differs)
        for name, (file, data, oracle) in roads.items()
        for one in [road(file, oracle)]
    }
    found["opendrive"] = Sample(
        {"a.xodr": OPENDRIVE}, lambda folder: survey(folder / "a.xodr"),
        lambda folder: altered.well_formed(folder / "a.xodr"), altered.other_opendrive,
    )  # fmt: skip
    found["openstreetmap"] = Sample(
        {"a.osm": OPENSTREETMAP}, lambda folder: survey(folder / "a.osm"),
        lambda folder: altered.well_formed(folder / "a.osm"), altered.other_openstreetmap,
    )  # fmt: skip
    edge = next(lane.edge for lane in straight.lanes if lane.cars and not lane.internal)
    found["routes"] = Sample(
        {"a.rou.xml": ROUTES.format(edge=edge).encode()},
        lambda folder: read_routes(folder / "a.rou.xml", straight),
        lambda folder: altered.well_formed(folder / "a.rou.xml"), altered.other_routes,
    )  # fmt: skip
    return found
