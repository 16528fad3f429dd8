"""Maps of all kinds: found, checked, drawn, and driven on by both engines."""

from __future__ import annotations

import importlib.util
import json
import subprocess
from pathlib import Path

import pytest
from typer.testing import CliRunner

from experiments.cli.commands import app
from experiments.generate.world_roads import straight_net
from scenarios.networks.build import find_program
from scenarios.networks.convert import open_map
from scenarios.own.scenario_file import own_road
from scenarios.own.survey import survey
from sim.engines import get_engine
from sim.road.net import read_road
from sim.scenario import sample_agents

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("sumo") is None, reason="needs netconvert: pip install .[networks]"
)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def crossroads_osm(maxspeed: str = "50", extra: str = "") -> str:
    """Two streets that cross at a signal."""
    nodes = {1: (48.1310, 11.5740), 2: (48.1330, 11.5740), 3: (48.1350, 11.5740),
             4: (48.1330, 11.5710), 5: (48.1330, 11.5770)}  # fmt: skip
    rows = [
        f'<node id="{n}" lat="{lat}" lon="{lon}">'
        + ('<tag k="highway" v="traffic_signals"/>' if n == 2 else "")
        + "</node>"
        for n, (lat, lon) in nodes.items()
    ]
    for way, refs, kind in ((10, (1, 2, 3), "secondary"), (11, (4, 2, 5), "tertiary")):
        rows.append(
            f'<way id="{way}">' + "".join(f'<nd ref="{ref}"/>' for ref in refs)
            + f'<tag k="highway" v="{kind}"/><tag k="lanes" v="2"/>'
            f'<tag k="maxspeed" v="{maxspeed}"/></way>'
        )  # fmt: skip
    return f'<?xml version="1.0"?>\n<osm version="0.6">{"".join(rows)}{extra}</osm>'


def straight_xodr(speed: str = "20", length: str = "300") -> str:
    """One road with a lane each way."""
    lane = '<lane id="{0}" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>'
    return f"""<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="6"/>
<road id="1" length="{length}" junction="-1"><type s="0" type="town"><speed max="{speed}"
 unit="m/s"/></type><planView><geometry s="0" x="0" y="0" hdg="0.3" length="{length}"><line/>
</geometry></planView><lanes><laneSection s="0"><left>{lane.format(1)}</left><center>
<lane id="0" type="none"/></center><right>{lane.format(-1)}</right></laneSection></lanes></road>
</OpenDRIVE>"""


def lanelet(number: int, left: tuple[int, int], right: tuple[int, int]) -> str:
    ways = "".join(
        f'<way id="{number * 10 + k}"><nd ref="{a}"/><nd ref="{b}"/><tag k="type" v="line_thin"/>'
        '<tag k="subtype" v="dashed"/></way>' for k, (a, b) in enumerate((left, right), 1)
    )  # fmt: skip
    return (
        ways + f'<relation id="{number}"><member type="way" ref="{number * 10 + 1}" role="left"/>'
        f'<member type="way" ref="{number * 10 + 2}" role="right"/><tag k="type" v="lanelet"/>'
        '<tag k="subtype" v="road"/><tag k="location" v="urban"/><tag k="one_way" v="yes"/>'
        '<tag k="participant:vehicle" v="yes"/></relation>'
    )


def two_lanelets() -> str:
    """A lane that goes on in another one, 240 m in all."""
    places = {1: (0, 2), 2: (120, 2), 3: (240, 2), 4: (0, -2), 5: (120, -2), 6: (240, -2)}
    nodes = "".join(
        f'<node id="{n}" lat="{y / 111320:.9f}" lon="{x / 111320:.9f}"><tag k="local_x" v="{x}"/>'
        f'<tag k="local_y" v="{y}"/></node>' for n, (x, y) in places.items()
    )  # fmt: skip
    both = lanelet(100, (1, 2), (4, 5)) + lanelet(200, (2, 3), (5, 6))
    ways, relations = [], []
    for part in both.replace("<relation", "\n<relation").replace("<way", "\n<way").split("\n"):
        (relations if part.startswith("<relation") else ways).append(part)
    return f'<osm version="0.6">{nodes}{"".join(ways)}{"".join(relations)}</osm>'


def commonroad() -> str:
    """Two lanelets, one after the other."""

    def bound(side: str, y: float, x0: float, x1: float) -> str:
        return f"<{side}><point><x>{x0}</x><y>{y}</y></point><point><x>{x1}</x><y>{y}</y></point></{side}>"  # noqa: E501

    rows = [
        f'<lanelet id="{n}">{bound("leftBound", 2, x, x + 100)}'
        f"{bound('rightBound', -2, x, x + 100)}{way}</lanelet>"
        for n, x, way in ((1, 0, '<successor ref="2"/>'), (2, 100, '<predecessor ref="1"/>'))
    ]
    return (
        '<commonRoad benchmarkID="A_B-1_1_T-1" commonRoadVersion="2020a" timeStepSize="0.1">'
        f"{''.join(rows)}</commonRoad>"
    )


def argoverse2() -> str:
    """Two lane segments, one after the other."""

    def segment(number: int, x: float, before: list[int], after: list[int]) -> dict[str, object]:
        def border(y: float) -> list[dict[str, float]]:
            return [{"x": x, "y": y, "z": 0.0}, {"x": x + 100, "y": y, "z": 0.0}]

        return {
            "id": number, "is_intersection": False, "lane_type": "VEHICLE",
            "left_lane_boundary": border(2.0), "left_lane_mark_type": "NONE",
            "right_lane_boundary": border(-2.0), "right_lane_mark_type": "NONE",
            "left_neighbor_id": None, "right_neighbor_id": None,
            "predecessors": before, "successors": after,
        }  # fmt: skip

    lanes = {"1": segment(1, 0.0, [], [2]), "2": segment(2, 100.0, [1], [])}
    return json.dumps({"lane_segments": lanes, "pedestrian_crossings": {}, "drivable_areas": {}})


MAPS = {
    "sumo.net.xml": straight_net(2, 20.0, 300.0),
    "streets.osm": crossroads_osm(),
    "road.xodr": straight_xodr(),
    "lanes.osm": two_lanelets(),
    "lanes.xml": commonroad(),
    "lanes.json": argoverse2(),
}
KINDS = ("sumo", "openstreetmap", "opendrive", "lanelet2", "commonroad", "argoverse2")


def everybody_leaves(net: Path, engine: str, flow: str | float = 900.0, **options) -> bool:
    scenario = own_road(net=net, flow=flow, duration_s=200.0, **options)
    agents = [a for a in sample_agents(scenario, 0) if a.depart_s < 20.0]
    assert agents
    entered: set[int] = set()
    for frame in get_engine(engine)(scenario, agents, 0):
        entered.update(frame.ids.tolist())
        if frame.time_s > 20.0 and len(entered) == len(agents) and not len(frame):
            return True
    return False


@pytest.mark.parametrize(("name", "kind"), list(zip(MAPS, KINDS, strict=True)))
def test_every_kind_of_map_is_surveyed_and_left_by_everybody(name, kind, tmp_path):
    path = tmp_path / name
    path.write_text(MAPS[name])
    assert open_map(path).kind == kind
    found = survey(path)
    assert {row["what"]: row["value"] for row in found.rows()}["routes"] > 0
    assert found.warnings == ()
    assert found.picture().startswith("<svg") and "polyline" in found.picture()  # noqa: PT018
    for engine in ("sumo", "highway"):
        assert everybody_leaves(path, engine)


@pytest.mark.parametrize(
    "options",
    [
        "--grid --grid.number 2 --grid.length 60 --grid.attach-length 60 -j right_before_left",
        "--spider --spider.arm-number 5 --spider.circle-number 1 -L 2 -j allway_stop",
        "--rand --rand.iterations 15 --seed 9 -L 3 --rand.random-lanenumber -j traffic_light",
    ],
)
def test_everybody_leaves_generated_nets(options, tmp_path):
    net = tmp_path / "made.net.xml"
    command = [find_program("netgenerate"), *options.split(), "-o", str(net)]
    subprocess.run(command, check=True, capture_output=True)
    for engine in ("sumo", "highway"):
        assert everybody_leaves(net, engine)


def test_a_net_without_paths_over_junctions_gets_them(tmp_path):
    net = tmp_path / "gaps.net.xml"
    options = "--grid --grid.number 2 --grid.attach-length 60 --no-internal-links"
    command = [find_program("netgenerate"), *options.split(), "-o", str(net)]
    subprocess.run(command, check=True, capture_output=True)
    road, made = read_road(net), own_road(net=net).road
    assert {lane.edge for lane in road.lanes} == {
        lane.edge for lane in made.lanes if not lane.internal
    }
    assert len(made.connections) == len(road.connections)
    assert all(link.via for link in made.connections)
    touching = tmp_path / "straight.net.xml"
    touching.write_text(straight_net(2, 20.0, 300.0))
    assert own_road(net=touching).road.source == touching


def test_the_command_writes_a_net_a_picture_and_a_scenario(tmp_path):
    path, out = tmp_path / "streets.osm", tmp_path / "town"
    path.write_text(crossroads_osm())
    done = CliRunner().invoke(app, ["road", str(path), "--out", str(out), "--json", "-"])
    assert done.exit_code == 0, done.output
    values = {row["metric"]: row["text"] or row["value"] for row in json.loads(done.stdout)}
    assert (values["map"], values["lacks"], values["warnings"]) == ("OpenStreetMap", "nothing", 0)
    assert (tmp_path / "town.svg").read_text().startswith("<svg")
    from scenarios import get_scenario

    assert get_scenario(str(tmp_path / "town.toml"))().road.signal_groups
