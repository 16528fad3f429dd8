"""Broken SUMO nets are refused in one line; those that are read make lanes, paths and signals."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import pytest

import scenarios
from behaviors.errors import InputError
from sim.road.net import read_road

NET = Path(scenarios.__file__).parent / "networks" / "four_way_intersection" / "road.net.xml"


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_road(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message.removeprefix(f"{path}: ")


def changed(tmp_path: Path, pattern: str, new: str) -> Path:
    text, count = re.subn(pattern, new, NET.read_text(), count=1)
    assert count == 1
    path = tmp_path / "changed.net.xml"
    path.write_text(text)
    return path


def test_a_lane_whose_way_leads_back_to_it_ends(tmp_path: Path) -> None:
    text = NET.read_text()
    lane, link = next(
        (m[1], m[0])
        for m in re.finditer(r'<connection from="[^"]*"[^>]* via="(:[^"]*)"[^>]*/>', text)
    )
    edge, _, index = lane.rpartition("_")
    own = re.search(
        rf'<connection from="{re.escape(edge)}"[^>]*fromLane="{index}"[^>]*?(?=/>)', text
    )
    assert own is not None
    assert link in text
    path = tmp_path / "loop.net.xml"
    path.write_text(text.replace(own[0], re.sub(r' via="[^"]*"', "", own[0]) + f' via="{lane}"'))
    assert refused(path) == f"lane {lane!r}: found a way that leads back to it"


@pytest.mark.parametrize(
    ("pattern", "new", "found"),
    [
        (r'(<lane id="[^:"]*_1"[^>]*) speed="[^"]*"', r'\1 speed="nan"', "speed nan"),
        (r'(<lane id="[^:"]*_1"[^>]*) speed="[^"]*"', r'\1 speed="-3"', "speed -3"),
        (r'(<lane id="[^:"]*_1"[^>]*) shape="[^"]*"', r'\1 shape="0,0"', "1 points"),
        (r'(<lane id="[^:"]*_1"[^>]*) shape="[^"]*"', r'\1 shape="0,0 nan,1"', "not finite"),
        (r'(<lane id="[^:"]*_1"[^>]*) shape="[^"]*"', r'\1 shape="0,0 1e8,1"', "1e+08 m"),
        (r'(<lane id="[^:"]*_1"[^>]*) shape="[^"]*"', r'\1 shape=""', "broken file"),
        (r'<phase duration="[^"]*"', '<phase duration="-60"', "broken durations"),
        (r'(<phase duration="[^"]*" state=)"[^"]*"', r'\1"xyz"', "broken file"),
        (r"<net ", '<!DOCTYPE net [<!ENTITY a "b">]><net ', "document type"),
        (r"</net>", "", "broken file"),
    ],
)
def test_what_is_no_road_is_refused(tmp_path: Path, pattern: str, new: str, found: str) -> None:
    assert found in refused(changed(tmp_path, pattern, new))


@pytest.mark.parametrize("cut", [0, 5, 300, -1, -6])
def test_cut_packed_nets_are_refused(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "cut.net.xml.gz"
    path.write_bytes(gzip.compress(NET.read_bytes(), mtime=0)[:cut])
    refused(path)
