"""Odd maps in all six formats: what maps of strangers have, and ours do not.

Nets come from netgenerate and netconvert (extra ``networks``); OpenDRIVE from netconvert and by
hand; OpenStreetMap by hand; Lanelet2, CommonRoad and Argoverse 2 maps from nets, lane by lane.
"""

from __future__ import annotations

import math
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from experiments.benches.roads.lane_maps import argoverse2_map, commonroad_map, lanelet2_map
from scenarios.networks.build import FOLDER as SHIPPED_FOLDER
from scenarios.networks.build import NET, find_program
from sim.road.net import read_road

Point = tuple[float, float]

GENERATED: Final[Mapping[str, str]] = {
    "grid": "--grid --grid.number 2 --grid.attach-length 80 -L 2 -j traffic_light",
    "lanes_of_20_m": "--grid --grid.number 3 --grid.length 34 --grid.attach-length 34",
    "left_hand_traffic": "--lefthand --grid --grid.number 2 --grid.attach-length 90 -L 2",
    "no_junction_lanes": "--grid --grid.number 3 --grid.attach-length 60 --no-internal-links",
    "dead_ends": "--rand --rand.iterations 14 --seed 3 -j right_before_left",
    "dead_ends_without_turning": "--rand --rand.iterations 14 --seed 5 --no-turnarounds true",
    "lanes_come_and_go": "--rand --rand.iterations 18 --seed 8 -L 3 --rand.random-lanenumber "
    "--turn-lanes 1 -j allway_stop",
    "spider_without_ends": "--spider --spider.arm-number 5 --spider.circle-number 2 -L 2",
    "right_before_left_everywhere": "--grid --grid.number 3 --grid.length 60 "
    "--grid.attach-length 60 -j right_before_left",
}
"""Nets of netgenerate by name: its options."""


class _Plain:
    """A net written edge by edge for netconvert."""

    def __init__(self, nodes: Mapping[str, Point], **options: str) -> None:
        self._nodes, self.edges = nodes, list[str]()
        self._options = options

    def edge(self, begin: str, end: str, **given: object) -> None:
        """An edge between two nodes, with attributes of netconvert's plain XML."""
        known = {"numLanes": 1, "speed": 13.89, "priority": 1, **given}
        words = " ".join(f'{k}="{v}"' for k, v in known.items())
        name = known.get("id", f"{begin}_{end}")
        self.edges.append(f'<edge id="{name}" from="{begin}" to="{end}" {words}/>')

    def files(self) -> dict[str, str]:
        """Text by file name."""
        nodes = "".join(
            f'<node id="{name}" x="{x}" y="{y}" type="{self._options.get(name, "priority")}"/>'
            for name, (x, y) in self._nodes.items()
        )
        return {
            "odd.nod.xml": f"<nodes>{nodes}</nodes>",
            "odd.edg.xml": f"<edges>{''.join(self.edges)}</edges>",
        }


def _one_way_loop() -> _Plain:
    """A one-way ring of eight edges, with one way in and one way out."""
    ring = {
        f"r{k}": (60 * math.cos(k * math.pi / 4), 60 * math.sin(k * math.pi / 4)) for k in range(8)
    }
    net = _Plain({**ring, "in": (200.0, 0.0), "out": (-200.0, 0.0)})
    for k in range(8):
        net.edge(f"r{k}", f"r{(k + 1) % 8}", priority=3)
    net.edge("in", "r0")
    net.edge("r4", "out")
    return net


def _closed_ring() -> _Plain:
    """A one-way ring that nobody can enter or leave."""
    net = _Plain({"a": (0, 0), "b": (120, 0), "c": (120, 120), "d": (0, 120)})
    for one, then in ("ab", "bc", "cd", "da"):
        net.edge(one, then)
    return net


def _unreachable_parts() -> _Plain:
    """A street, a ring that no way leads to, and one that no way leads out of."""
    places = {"a": (0, 0), "b": (200, 0), "c": (400, 0), "d": (200, 200), "e": (280, 260)}
    places |= {"f": (120, 260), "g": (600, 300), "h": (700, 300), "i": (650, 380)}
    net = _Plain(places)
    for one, then in ("ab", "bc", "bd", "de", "ef", "fd", "gh", "hi", "ig"):
        net.edge(one, then)
    return net


def _only_turning_round() -> _Plain:
    """Streets whose ends lead back only."""
    net = _Plain({"a": (0, 0), "b": (150, 0), "c": (300, 40)})
    for one, then in ("ab", "ba", "bc", "cb"):
        net.edge(one, then)
    return net


def _crossing_bridges() -> _Plain:
    """Two roads with two lanes each way that cross without meeting, and a ramp between them."""
    net = _Plain({
        "w": (-200, 0), "m": (60, 0), "e": (250, 0), "s": (0, -200), "k": (0, 60), "n": (0, 250),
    })  # fmt: skip
    for one, then in ("wm", "me", "em", "mw", "sk", "kn", "nk", "ks"):
        net.edge(one, then, numLanes=2, priority=3)
    net.edge("m", "k", shape="60,0 45,45 0,60")
    return net


def _motorway_exit() -> _Plain:
    """Three lanes that become two, beside a slip road of one, next to a lane for buses."""
    net = _Plain({"a": (0, 0), "b": (400, 0), "c": (800, 0), "d": (760, -60)})
    net.edge("a", "b", numLanes=3, speed=36.1, priority=9)
    net.edge("b", "c", numLanes=2, speed=36.1, priority=9)
    net.edge("b", "d", numLanes=1, speed=22.2, priority=5)
    return net


def _broken_line() -> _Plain:
    """A road whose points coincide and whose line doubles back, with a limit of 3 m/s."""
    net = _Plain({"a": (0, 0), "b": (200, 0), "c": (400, 0)})
    net.edge("a", "b", shape="0,0 50,0 50,0 50.0001,0 200,0", speed=3.0)
    net.edge("b", "c", shape="200,0 300,0 290,0.5 400,0", numLanes=2)
    return net


PLAIN: Final = {
    "one_way_loop": _one_way_loop, "closed_ring": _closed_ring,
    "unreachable_parts": _unreachable_parts, "only_turning_round": _only_turning_round,
    "crossing_bridges": _crossing_bridges, "motorway_exit": _motorway_exit,
    "broken_line": _broken_line,
}  # fmt: skip
"""Nets by name, edge by edge."""

TURNING: Final = frozenset({"only_turning_round"})
"""Nets of which netconvert makes ways back."""

Way = tuple[Sequence[int], Mapping[str, str]]


def _osm(nodes: Mapping[int, Point], ways: Sequence[Way], lit: Sequence[int] = ()) -> str:
    """OpenStreetMap's XML of nodes, m from 50 degrees north, and ways with their tags."""
    metres = 111_320.0
    rows = [
        f'<node id="{n}" lat="{50 + y / metres:.8f}" '
        f'lon="{8 + x / metres / math.cos(math.radians(50)):.8f}">'
        + ('<tag k="highway" v="traffic_signals"/>' if n in lit else "")
        + "</node>"
        for n, (x, y) in nodes.items()
    ]
    for number, (refs, tags) in enumerate(ways, start=100):
        nds = "".join(f'<nd ref="{ref}"/>' for ref in refs)
        words = "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())
        rows.append(f'<way id="{number}">{nds}{words}</way>')
    return f'<?xml version="1.0"?>\n<osm version="0.6">{"".join(rows)}</osm>\n'


def _osm_maps() -> dict[str, str]:
    square = {k * 10 + j: (150.0 * k, 150.0 * j) for k in range(4) for j in range(4)}
    streets: list[Way] = [([k * 10 + j for j in range(4)], {"highway": "residential"})
                          for k in range(4)]  # fmt: skip
    streets += [([k * 10 + j for k in range(4)], {"highway": "tertiary", "lanes": "2"})
                for j in range(4)]  # fmt: skip
    fast = {"highway": "motorway", "oneway": "yes", "lanes": "3", "maxspeed": "none"}
    link = {"highway": "motorway_link", "oneway": "yes", "maxspeed": "60"}
    junction = {1: (0.0, 0.0), 2: (500.0, 0.0), 3: (900.0, 0.0), 4: (1500.0, 0.0),
                5: (200.0, -120.0), 6: (1200.0, -120.0), 7: (700.0, -300.0), 8: (700.0, 300.0),
                9: (700.0, -120.0)}  # fmt: skip
    ring = {k: (25 * math.cos(k * math.pi / 4), 25 * math.sin(k * math.pi / 4)) for k in range(8)}
    arms = {10 + k: (200 * math.cos(k * math.pi / 2), 200 * math.sin(k * math.pi / 2))
            for k in range(4)}  # fmt: skip
    bridge = {1: (-200.0, 0.0), 2: (200.0, 0.0), 3: (0.0, -200.0), 4: (0.0, 200.0)}
    double = {1: (0.0, 0.0), 2: (100.0, 0.0), 3: (100.0, 0.0), 4: (250.0, 0.0), 5: (100.0, 150.0)}
    return {
        "town_without_limits": _osm(square, streets, lit=(11, 22)),
        "motorway_junction": _osm(junction, [
            ((1, 2, 3, 4), fast), ((5, 2), link), ((3, 6), link), ((7, 9, 8), {
                "highway": "secondary", "bridge": "yes", "layer": "1", "maxspeed": "50 mph"}),
            ((9, 5), {"highway": "unclassified", "oneway": "yes"}),
        ]),
        "roundabout": _osm(ring | arms, [
            ([*range(8), 0], {"highway": "tertiary", "junction": "roundabout"}),
            *(([10 + k, 2 * k], {"highway": "tertiary", "maxspeed": "30"}) for k in range(4)),
        ]),
        "bridge_over_street": _osm(bridge, [
            ((1, 2), {"highway": "primary", "lanes": "4", "maxspeed": "70"}),
            ((3, 4), {"highway": "residential", "bridge": "yes", "layer": "1"}),
        ]),
        "coinciding_points": _osm(double, [
            ((1, 2, 3, 4), {"highway": "secondary", "maxspeed": "50"}),
            ((3, 5), {"highway": "residential", "maxspeed": "fast"}),
            ((2, 99), {"highway": "residential"}),
            ((5, 5), {"highway": "service"}),
        ]),
    }  # fmt: skip


def _xodr_road(number: int, line: str, length: float, lanes: str, **given: str) -> str:
    words = " ".join(f'{k}="{v}"' for k, v in given.items())
    return (
        f'<road id="{number}" length="{length}" junction="-1" {words}><link/><planView>{line}'
        f'</planView><lanes><laneSection s="0">{lanes}</laneSection></lanes></road>'
    )


def _xodr_maps() -> dict[str, str]:
    """OpenDRIVE by hand: traffic on the left, a curve with no limit, parts that do not meet."""
    lane = '<lane id="{0}" type="driving" level="false"><width sOffset="0" a="{1}" b="0" c="0" '
    lane += 'd="0"/></lane>'
    centre = '<center><lane id="0" type="none" level="false"/></center>'
    both = f"<left>{lane.format(1, 3.5)}</left>{centre}<right>{lane.format(-1, 3.5)}</right>"
    one_way = f"{centre}<right>{lane.format(-1, 3.25)}{lane.format(-2, 3.25)}</right>"
    line = '<geometry s="0" x="{0}" y="{1}" hdg="{2}" length="{3}">{4}</geometry>'
    head = '<?xml version="1.0"?>\n<OpenDRIVE><header revMajor="1" revMinor="6"/>'
    arc = line.format(0, 0, 0, 300, '<arc curvature="0.01"/>')
    straight = line.format(0, 0, 0.4, 250, "<line/>")
    apart = line.format(900, 900, 0, 80, "<line/>")
    return {
        "left_hand_street": head + _xodr_road(1, straight, 250, both, rule="LHT") + "</OpenDRIVE>",
        "curve_without_limit": head + _xodr_road(1, arc, 300, one_way) + "</OpenDRIVE>",
        "parts_apart": head + _xodr_road(1, straight, 250, both, rule="RHT")
        + _xodr_road(2, apart, 80, one_way) + "</OpenDRIVE>",
    }  # fmt: skip


AS_OPENDRIVE: Final = ("roundabout", "motorway_ramps", "four_way_intersection")
"""Shipped nets that netconvert writes as OpenDRIVE."""

LANE_BY_LANE: Final[Mapping[str, str]] = {
    "roundabout": str(SHIPPED_FOLDER / "roundabout" / NET),
    "ramps": str(SHIPPED_FOLDER / "motorway_ramps" / NET),
    "grid": "grid.net.xml",
    "dead_ends": "dead_ends.net.xml",
}
"""Nets that are written as Lanelet2, CommonRoad and Argoverse 2 maps."""


def write_odd_maps(folder: Path) -> list[Path]:
    """Make all odd maps.

    Args:
        folder: where; it must exist.

    Returns:
        The files, in order of their names.

    Raises:
        InputError: if netgenerate or netconvert is missing or refuses something.
    """
    for name, options in GENERATED.items():
        made = ["-o", str(folder / f"{name}.net.xml")]
        _run("netgenerate", [*options.split(), *made], folder)
    for name, make in PLAIN.items():
        files = make().files()
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
        turn = [] if name in TURNING else ["--no-turnarounds", "true"]
        inputs = ["--node-files", "odd.nod.xml", "--edge-files", "odd.edg.xml"]
        _run("netconvert", [*inputs, *turn, "-o", f"{name}.net.xml"], folder)
        for file in files:
            (folder / file).unlink()
    for name in AS_OPENDRIVE:
        net = str(SHIPPED_FOLDER / name / NET)
        _run("netconvert", ["-s", net, "--opendrive-output", f"{name}.xodr"], folder)
    texts = {f"{name}.osm": text for name, text in _osm_maps().items()}
    texts |= {f"{name}.xodr": text for name, text in _xodr_maps().items()}
    for name, net in LANE_BY_LANE.items():
        road = read_road(folder / net, name)
        texts[f"{name}_lanelets.osm"] = lanelet2_map(road)
        texts[f"{name}_lanelets.xml"] = commonroad_map(road)
        texts[f"{name}_segments.json"] = argoverse2_map(road)
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="utf-8")
    return sorted(path for path in folder.iterdir() if path.is_file())


def _run(program: str, options: list[str], folder: Path) -> None:
    command = [find_program(program), *options, "--no-warnings", "true"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        said = (done.stderr.strip().splitlines() or ["no reason given"])[0]
        raise InputError(f"{program}: refused {' '.join(options):.200}: {said:.200}")
