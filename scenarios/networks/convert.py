"""Maps of other kinds as SUMO nets, made by netconvert (``pip install graphrqi[networks]``).

OpenStreetMap and OpenDRIVE are read by netconvert itself. Lanelet2, CommonRoad and Argoverse 2 maps
are read as recordings read them, and written lane by lane for netconvert
(`scenarios.networks.plain_xml`). Nets can have their signals taken out or their limits lowered. A
net is kept for the next time under the hash of what it was made from.
"""

from __future__ import annotations

import hashlib
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from scenarios.networks.build import NET, cache_folder, find_program, program_path, run_program
from scenarios.networks.plain_xml import plain_files
from sim.files import temporary_folder, write_whole
from sim.input_files import read_bytes, read_tree, refuse_declarations
from sim.road import Road
from sim.road.maps.sources import Source, prepared
from sim.road.net import MAX_NET_BYTES, read_road
from sim.road.road_files import read_road_file

KINDS: Final[dict[str, str]] = {
    "sumo": "SUMO net",
    "openstreetmap": "OpenStreetMap",
    "opendrive": "OpenDRIVE",
    "lanelet2": "Lanelet2",
    "commonroad": "CommonRoad",
    "argoverse2": "Argoverse 2",
    "stored": "road of a dataset",
}
"""The kinds of maps that can be driven on, and what they are called."""

_COMMON: Final = (
    "--no-turnarounds", "true", "--offset.disable-normalization", "false",
    "--tls.default-type", "static",
)  # fmt: skip
OPTIONS: Final[dict[str, tuple[str, ...]]] = {
    "openstreetmap": (
        "--osm-files", "map.osm",
        *_COMMON, "--geometry.remove", "true", "--roundabouts.guess", "true",
        "--junctions.join", "true", "--tls.guess-signals", "true", "--tls.discard-simple", "true",
        "--tls.join", "true", "--ramps.guess", "true", "--keep-edges.by-vclass", "passenger",
        "--junctions.corner-detail", "5", "--junctions.limit-turn-speed", "5.5",
        "--osm.all-attributes", "false",
    ),
    "opendrive": (
        "--opendrive-files", "map.xodr",
        *_COMMON, "--opendrive.curve-resolution", "2", "--junctions.limit-turn-speed", "5.5",
    ),
    "sumo": ("--sumo-net-file", "map.net.xml", "--no-internal-links", "false"),
}  # fmt: skip
"""netconvert's options for the kinds of maps that it reads itself: first the file's own, then those
after SUMO's guide for OpenStreetMap. Signals have fixed programmes, turnarounds are left out, and
turns are as slow as in the shipped nets."""

LANE_OPTIONS: Final = (
    "--node-files", "map.nod.xml", "--edge-files", "map.edg.xml",
    "--connection-files", "map.con.xml",
    *_COMMON, "--junctions.limit-turn-speed", "5.5", "--geometry.remove", "false",
)  # fmt: skip
"""The same for the files of `scenarios.networks.plain_xml`."""

MOST_GAP_M: Final = 1.0
"""Lanes that a way joins without a path are at most this far apart, m (less than a vehicle moves in
a step)."""

_ROOT: Final = re.compile(
    rb"\A(?:\xef\xbb\xbf)?\s*(?:(?:<\?.*?\?>|<!--.*?-->)\s*)*<([A-Za-z_][\w.:-]*)", re.DOTALL
)
"""The root element of an XML file, behind its declaration and comments."""

LEAST_LIMIT_MPS: Final = 1.0
"""Lowest speed limit that may be asked for, m/s (walking pace)."""


@dataclass(frozen=True)
class MapFile:
    """A map of any kind, as netconvert takes it.

    Attributes:
        path: the file.
        kind: a key of ``KINDS``.
        source: its content, prepared for netconvert.
    """

    path: Path
    kind: str
    source: Source

    @cached_property
    def net(self) -> Path:
        """The SUMO net of the map: the file itself if it is one, else one made now or before.

        A SUMO net without paths over its junctions gets them if netconvert is there; without paths,
        vehicles would jump over the junctions.
        """
        if self.kind == "sumo" and (
            b'function="internal"' in self.source.content
            or not _jumps(read_road(self.path))
            or program_path("netconvert") is None
        ):
            return self.path
        return self._made

    @property
    def warnings(self) -> tuple[str, ...]:
        """Assumptions about the map, and netconvert's warnings when it makes the net."""
        if program_path("netconvert") is None:
            return self.source.warnings
        file = self._made.with_name("warnings.txt")
        warned = file.read_text(encoding="utf-8").splitlines() if file.is_file() else ()
        return (*self.source.warnings, *warned)

    @cached_property
    def _made(self) -> Path:
        """The net that netconvert makes of the map, kept for the next time with its warnings."""
        content = self.source.content
        road = None if self.kind in OPTIONS else read_road_file(self.path)
        options = LANE_OPTIONS if road is not None else OPTIONS[self.kind]
        if self.source.left_hand or (road is not None and road.left_hand):
            options = (*options, "--lefthand", "true")

        def make(net: Path) -> None:
            command = [find_program("netconvert"), *options]
            inputs = {options[1]: content} if road is None else plain_files(road)
            with temporary_folder("map") as scratch:
                for name, data in inputs.items():
                    (scratch / name).write_bytes(data)
                warned = run_program(command, scratch, net, str(self.path))
            write_whole(net.with_name("warnings.txt"), "\n".join(warned).encode("utf-8"))

        return _kept_net([self.kind, *options], content, make)


def open_map(path: Path, left_hand: bool | None = None) -> MapFile:
    """A map of any kind; ``left_hand`` is the side of traffic of OpenStreetMap, None as it says."""
    if path.is_dir():
        raise InputError(f"{path}: found a folder, expected a map file")
    content = read_bytes(path, MAX_NET_BYTES)
    refuse_declarations(path, content)
    kind = _kind(path, content)
    if left_hand is not None and kind != "openstreetmap":
        raise InputError(
            f"{path}: left_hand: found {KINDS[kind]}, expected OpenStreetMap: other maps say it"
        )
    return MapFile(path, kind, prepared(path, kind, content, left_hand))


def _kind(path: Path, content: bytes) -> str:
    """Kind of a map, by its file's name and content: a key of ``KINDS``."""
    name = path.name.lower().removesuffix(".gz")
    if name.endswith(".json"):
        return "stored" if name.endswith(".road.json") else "argoverse2"
    root = _ROOT.match(content)
    found = root.group(1) if root else b""
    if found == b"osm":
        relation = re.search(rb"""k\s*=\s*["']type["']\s+v\s*=\s*["']lanelet["']""", content)
        return "lanelet2" if relation else "openstreetmap"
    roots = {b"net": "sumo", b"OpenDRIVE": "opendrive", b"commonRoad": "commonroad"}
    if found not in roots:
        shown = f"<{found.decode()[:40]}>" if found else "no XML"
        raise InputError(f"{path}: found {shown}, expected a map: {', '.join(KINDS.values())}")
    return roots[found]


def name_of(path: Path) -> str:
    """Name of a map: its file's name up to the first dot.

    Examples:
        >>> name_of(Path("maps/old town.net.xml"))
        'old_town'
    """
    return re.sub(r"[^\w.-]+", "_", path.name.split(".")[0])[:60].strip("_") or "road"


def _jumps(road: Road) -> bool:
    """Whether any way leads over a gap between lanes without a path."""
    ends = {lane.id: lane.centerline for lane in road.lanes}
    return any(
        not link.via and math.dist(ends[link.from_lane][-1], ends[link.to_lane][0]) > MOST_GAP_M
        for link in road.connections
    )


def _kept_net(how: list[str], content: bytes, make: Callable[[Path], None]) -> Path:
    """The net that was made of some content in some way; `make` writes it if it is not there."""
    digest = hashlib.sha256("\0".join([*how, ""]).encode() + content).hexdigest()[:16]
    net = cache_folder() / "maps" / digest / NET
    if not net.is_file():
        net.parent.mkdir(parents=True, exist_ok=True)
        make(net)
    return net


def edited_net(net: Path, signals: bool = True, limit_mps: float | None = None) -> Path:
    """A net as it is, or without signals, or with lower limits, kept for the next time.

    Without signals, junctions are driven by priority. None leaves the limits as they are.
    """
    if limit_mps is not None and not LEAST_LIMIT_MPS <= limit_mps < math.inf:
        raise InputError(f"limit_mps: found {limit_mps}, expected at least {LEAST_LIMIT_MPS:g} m/s")
    if signals and limit_mps is None:
        return net

    def make(to: Path) -> None:
        root = read_tree(net)
        if not signals:
            _take_signals_out(root)
        for lane in root.iter("lane"):
            if limit_mps is not None and float(lane.attrib["speed"]) > limit_mps:
                lane.set("speed", f"{limit_mps:.2f}")
        write_whole(to, ET.tostring(root, encoding="utf-8", xml_declaration=True))

    what = ["edited", f"signals {signals}", f"limit {limit_mps}"]
    return _kept_net(what, read_bytes(net, MAX_NET_BYTES), make)


def _take_signals_out(root: ET.Element) -> None:
    """Let the priority rules of a net hold where it has lights."""
    for lights in root.findall("tlLogic"):
        root.remove(lights)
    for junction in root.iter("junction"):
        if str(junction.get("type")).startswith("traffic_light"):
            junction.set("type", "priority")
    for link in root.iter("connection"):
        if link.attrib.pop("tl", None) is not None:
            for name in ("linkIndex", "linkIndex2"):
                link.attrib.pop(name, None)
            state = str(link.get("state"))  # O and o are those of lights that are off
            link.set("state", {"O": "M", "o": "m"}.get(state, state))
