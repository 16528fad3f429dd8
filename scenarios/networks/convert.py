"""Maps of other kinds as SUMO nets, made by netconvert (``pip install graphrqi[networks]``).

OpenStreetMap and OpenDRIVE are read by netconvert itself. Lanelet2, CommonRoad and Argoverse 2 maps
are read as recordings read them, and written lane by lane for netconvert
(`scenarios.networks.lanes`). Nets can have their signals taken out or their limits lowered. A net
is kept for the next time under the hash of what it was made from.
"""

from __future__ import annotations

import hashlib
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from scenarios.networks.build import NET, cache_folder, find_program, has_program, run_program
from sim.files import temporary_folder, write_whole
from sim.input_files import read_bytes
from sim.road import Road
from sim.road.files import read_road_file
from sim.road.maps.sources import Source, prepared
from sim.road.net import MAX_NET_BYTES, read_road
from sim.xml_tree import read_tree, refuse_declarations

MAX_MAP_BYTES: Final = 2**28
"""Largest map, unpacked (256 MiB, as of nets)."""

LONGEST_S: Final = 600.0
"""netconvert may take this long for a map, s (a district takes seconds)."""

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
        *_COMMON, "--geometry.remove", "true", "--roundabouts.guess", "true",
        "--junctions.join", "true", "--tls.guess-signals", "true", "--tls.discard-simple", "true",
        "--tls.join", "true", "--ramps.guess", "true", "--keep-edges.by-vclass", "passenger",
        "--junctions.corner-detail", "5", "--junctions.limit-turn-speed", "5.5",
        "--osm.all-attributes", "false",
    ),
    "opendrive": (
        *_COMMON, "--opendrive.curve-resolution", "2", "--junctions.limit-turn-speed", "5.5",
    ),
    "sumo": ("--no-internal-links", "false"),
    "lanes": (*_COMMON, "--junctions.limit-turn-speed", "5.5", "--geometry.remove", "false"),
}  # fmt: skip
"""netconvert's options for each kind of map, after SUMO's guide for OpenStreetMap. Signals have
fixed programmes, turnarounds are left out, and turns are as slow as in the shipped nets."""

MOST_GAP_M: Final = 1.0
"""Lanes that a way joins without a path are at most this far apart, m (less than a vehicle moves in
a step)."""

_READ_BY_NETCONVERT: Final[dict[str, tuple[str, ...]]] = {
    "openstreetmap": ("--osm-files", "map.osm"),
    "opendrive": ("--opendrive-files", "map.xodr"),
    "sumo": ("--sumo-net-file", "map.net.xml"),
}
"""Kinds of maps that netconvert reads itself: its option for them, and a file's name."""

_PLAIN_FILES: Final = (
    "--node-files", "map.nod.xml", "--edge-files", "map.edg.xml",
    "--connection-files", "map.con.xml",
)  # fmt: skip
"""netconvert's options for the files of `scenarios.networks.lanes`."""

WARNINGS: Final = "warnings.txt"
"""The file beside a net that holds what netconvert warned of, line by line."""

_ROOT: Final = re.compile(
    rb"\A(?:\xef\xbb\xbf)?\s*(?:(?:<\?.*?\?>|<!--.*?-->)\s*)*<([A-Za-z_][\w.:-]*)", re.DOTALL
)
"""The root element of an XML file, behind its declaration and comments."""

LEAST_LIMIT_MPS: Final = 1.0
"""Lowest speed limit that may be asked for, m/s (walking pace)."""

_WITHOUT_LIGHTS: Final = {"O": "M", "o": "m"}
"""A link's state without its light, by its state with one that is off."""

_UNUSABLE: Final = re.compile(r"[^\w.-]+")


def kind_of(path: Path, content: bytes | None = None) -> str:
    """Kind of a map, by its file's name and content: a key of ``KINDS``.

    Args:
        path: the file.
        content: what it holds, unpacked; None if it is still to be read.

    Raises:
        InputError: if the file is missing, too large, declares a document type, or is not a map.
    """
    content = _content(path) if content is None else content
    name = path.name.lower().removesuffix(".gz")
    if name.endswith(".road.json"):
        return "stored"
    if name.endswith(".json"):
        return "argoverse2"
    root = _ROOT.match(content)
    found = root.group(1) if root else b""
    if found == b"osm":
        relation = re.search(rb"""k\s*=\s*["']type["']\s+v\s*=\s*["']lanelet["']""", content)
        return "lanelet2" if relation else "openstreetmap"
    roots = {b"net": "sumo", b"OpenDRIVE": "opendrive", b"commonRoad": "commonroad"}
    if found in roots:
        return roots[found]
    shown = f"<{found.decode()[:40]}>" if found else "no XML"
    raise InputError(f"{path}: found {shown}, expected a map: {', '.join(KINDS.values())}")


def _content(path: Path) -> bytes:
    """A map's bytes, unpacked; refused if they declare a document type."""
    if path.is_dir():
        raise InputError(f"{path}: found a folder, expected a map file")
    data = read_bytes(path, MAX_MAP_BYTES)
    refuse_declarations(path, data)
    return data


def name_of(path: Path) -> str:
    """Name of a map: its file's name up to the first dot.

    Examples:
        >>> name_of(Path("maps/old town.net.xml"))
        'old_town'
    """
    return _UNUSABLE.sub("_", path.name.split(".")[0])[:60].strip("_") or "road"


def source_of(path: Path, left_hand: bool | None = None) -> tuple[str, Source]:
    """Kind of a map, and its content as netconvert takes it.

    Args:
        path: a map.
        left_hand: whether traffic drives on the left; None for what the map says.

    Raises:
        InputError: if the file is broken or no map.
    """
    content = _content(path)
    kind = kind_of(path, content)
    if left_hand is not None and kind != "openstreetmap":
        raise InputError(
            f"{path}: left_hand: found {KINDS[kind]}, expected OpenStreetMap: other maps say it"
        )
    return kind, prepared(path, kind, content, left_hand)


def drivable_net(path: Path, left_hand: bool | None = None) -> Path:
    """The SUMO net of a map: the file itself if it is one, else one made now or before.

    A SUMO net without paths over its junctions gets them if netconvert is there; without paths,
    vehicles would jump over the junctions.

    Args:
        path: a map.
        left_hand: whether traffic drives on the left, of OpenStreetMap; None for what it says.

    Returns:
        The path of a SUMO net.

    Raises:
        InputError: if the map is broken, netconvert refuses it, or is needed and missing.
    """
    kind, source = source_of(path, left_hand)
    if kind == "sumo" and (
        b'function="internal"' in source.content
        or not _jumps(read_road(path))
        or not has_program("netconvert")
    ):
        return path
    return _made_net(path, source, kind)


def warnings_of(path: Path, left_hand: bool | None = None) -> tuple[str, ...]:
    """Warnings of netconvert when it makes a net of a map; none if netconvert is missing.

    Args:
        path: a map.
        left_hand: as in `drivable_net`.

    Raises:
        InputError: if the map is broken or netconvert refuses it.
    """
    kind, source = source_of(path, left_hand)
    if not has_program("netconvert"):
        return source.assumed
    file = _made_net(path, source, kind).with_name(WARNINGS)
    warned = file.read_text(encoding="utf-8").splitlines() if file.is_file() else ()
    return (*source.assumed, *warned)


def _made_net(path: Path, source: Source, kind: str) -> Path:
    """The net that netconvert makes of a map, kept for the next time."""
    inputs = _READ_BY_NETCONVERT.get(kind, _PLAIN_FILES)
    options = OPTIONS[kind if kind in OPTIONS else "lanes"]
    left_hand = source.left_hand or (kind not in OPTIONS and read_road_file(path).left_hand)
    options = (*options, "--lefthand", "true") if left_hand else options

    def make(net: Path) -> None:
        files = {inputs[1]: source.content}
        if kind not in OPTIONS:
            from scenarios.networks.lanes import plain_files

            plain = plain_files(read_road_file(path))
            files = {name: text.encode("utf-8") for name, text in plain.items()}
        command = [find_program("netconvert"), *inputs, *options]
        with temporary_folder("map") as scratch:
            for name, data in files.items():
                (scratch / name).write_bytes(data)
            warnings = run_program(command, scratch, net, what=str(path), within_s=LONGEST_S)
        write_whole(net.with_name(WARNINGS), "\n".join(warnings).encode("utf-8"))

    return _kept_net([kind, "oncoming lanes apart", *options], source.content, make)


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
    """A net as it is, or without signals, or with lower limits.

    Args:
        net: a SUMO net.
        signals: whether traffic lights work; without them, junctions are driven by priority.
        limit_mps: greatest speed limit, m/s; None for the net's own.

    Returns:
        The net itself if nothing changes, else one that is kept for the next time.

    Raises:
        InputError: if the limit is out of range or the net broken.
    """
    if limit_mps is not None and not LEAST_LIMIT_MPS <= limit_mps < math.inf:
        raise InputError(f"limit_mps: found {limit_mps}, expected at least {LEAST_LIMIT_MPS:g} m/s")
    if signals and limit_mps is None:
        return net

    def make(to: Path) -> None:
        root = read_tree(net)
        if root.tag != "net":
            raise InputError(f"{net}: found <{root.tag:.40}>, expected a SUMO net")
        if not signals:
            _take_signals_out(root)
        if limit_mps is not None:
            _lower_limits(net, root, limit_mps)
        write_whole(to, ET.tostring(root, encoding="utf-8", xml_declaration=True))

    what = ["edited", f"signals {signals}", f"limit {limit_mps}"]
    return _kept_net(what, read_bytes(net, MAX_NET_BYTES), make)


def _take_signals_out(root: ET.Element) -> None:
    for lights in root.findall("tlLogic"):
        root.remove(lights)
    for junction in root.iter("junction"):
        if str(junction.get("type")).startswith("traffic_light"):
            junction.set("type", "priority")
    for link in root.iter("connection"):
        if link.attrib.pop("tl", None) is not None:
            link.attrib.pop("linkIndex", None)
            link.attrib.pop("linkIndex2", None)
            state = str(link.get("state"))
            link.set("state", _WITHOUT_LIGHTS.get(state, state))


def _lower_limits(path: Path, root: ET.Element, limit_mps: float) -> None:
    for lane in root.iter("lane"):
        text = str(lane.get("speed"))
        try:
            speed = float(text)
        except ValueError:
            raise InputError(f"{path}: lane speed: found {text[:40]!r}, expected m/s") from None
        if speed > limit_mps:
            lane.set("speed", f"{limit_mps:.2f}")
