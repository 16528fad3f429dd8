"""SUMO nets with their signals taken out or their speed limits lowered."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Final

from behaviors.errors import InputError
from scenarios.networks.convert import kept_net
from sim.files import write_whole
from sim.input_files import read_bytes
from sim.road.net import MAX_NET_BYTES
from sim.xml_tree import read_tree

LEAST_LIMIT_MPS: Final = 1.0
"""Lowest speed limit that may be asked for, m/s (walking pace)."""

_WITHOUT_LIGHTS: Final = {"O": "M", "o": "m"}
"""A link's state without its light, by its state with one that is off."""


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
    return kept_net(what, read_bytes(net, MAX_NET_BYTES), make)


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
