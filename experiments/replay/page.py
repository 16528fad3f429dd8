"""The replay page: one HTML file that needs no other file and no network.

All arrays of a page become one zlib stream, which browsers inflate themselves; ``page/data.js``
reads it. Style and script are inlined from ``page/``; the page's own security policy lets exactly
these run and nothing be fetched, so that a name in hostile data can neither act nor call out.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from behaviors.labels import BEHAVIORS, COLORS, TRAITS, UNKNOWN_COLOR
from behaviors.profiles import PROFILE_FIELDS
from experiments.replay.scene import ReplayScene
from graphrqi.posterior import LABEL_PROBABILITY
from sim.files import write_whole
from sim.formats import FORMATS
from sim.frames import KINDS, SIGNALS, EventKind, FloatArray, IntArray, Tracks
from sim.road.shapes import road_shapes

SCRIPTS: Final = (
    "data.js", "view.js", "colors.js", "road.js", "draw.js", "timeline.js", "panel.js", "player.js",
)  # fmt: skip
"""In the order in which they are joined."""

UNITS: Final = {"x": 0.01, "y": 0.01, "heading": 0.0015, "speed": 0.05, "future": 0.1}
"""Steps to which places (m or pixels), headings (rad), speeds and futures are rounded."""

MODES: Final = ("true", "predicted", "confidence", "speed", "w")
"""Colourings of agents."""

RAMP_STOPS: Final = 17

RAMP_BEGIN: Final = 0.12
"""Where in viridis the ramp begins (darker colours could not be seen on a dark road)."""


def ramp_color(share: float) -> str:
    """The colour of a share, 0 to 1, as in HTML: viridis without its darkest end."""
    place = RAMP_BEGIN + (1.0 - RAMP_BEGIN) * min(max(share, 0.0), 1.0)
    return str(to_hex(colormaps["viridis"](place)))


def ramp() -> list[str]:
    """Colours of a scale from low to high; the page interpolates between them."""
    return [ramp_color(share) for share in np.linspace(0.0, 1.0, RAMP_STOPS)]


DTYPES: Final = {"u1": "Uint8", "u2": "Uint16", "i4": "Int32", "f4": "Float32"}
"""Little-endian numbers that a browser reads as typed arrays."""


def write_page(scene: ReplayScene, out: Path, mode: str, begin_s: float | None = None) -> None:
    """Write the page of a scene; the HTML file appears whole or not at all.

    Agents are coloured by one of ``MODES`` at first. The page opens at a time, s; None for when the
    road has filled to half and there are beliefs.
    """
    folder = resources.files("experiments.replay") / "page"
    style = (folder / "style.css").read_text()
    script = (
        '"use strict";\n(() => {\n'
        + "\n".join((folder / name).read_text() for name in SCRIPTS)
        + "\n})();\n"
    )
    environment = Environment(
        loader=PackageLoader("experiments.replay", "page"), autoescape=True,
        undefined=StrictUndefined, trim_blocks=True,
    )  # fmt: skip
    page = environment.get_template("page.html").render(
        title=scene.entry.name, style=style, script=script, style_hash=_csp_hash(style),
        script_hash=_csp_hash(script), data=_json(_data(scene, mode, begin_s)),
    )  # fmt: skip
    write_whole(out, page.encode())


def _csp_hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _json(value: object) -> str:
    """JSON that no HTML parser takes for markup, whatever the strings in it say."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _data(scene: ReplayScene, mode: str, begin_at_s: float | None) -> dict[str, Any]:
    """All that the page's script reads."""
    tracks = scene.tracks
    begin_s = float(tracks.time_s[0])
    arrays: dict[str, NDArray[Any]] = {"time": (tracks.time_s - begin_s).astype("f4")}
    _places(tracks, arrays)
    _beliefs(scene, arrays)
    _graph(scene, arrays)
    meta: dict[str, Any] = {"ghosts": _ghosts(scene, arrays), "ahead": _forecasts(scene, arrays)}
    if tracks.signals.size:
        meta["signals"] = _signal_changes(tracks.signals)
    index, packed = pack(arrays)
    entry = scene.entry
    made: dict[str, Any] = {"engine": entry.engine, "seed": entry.seed, "split": entry.split}
    facts = {
        "episode": entry.id,
        **({"format": entry.engine} if entry.engine in FORMATS else made),
        "beliefs": scene.believer,
        "predictor": scene.predictor or "none",
        "agents": int(tracks.ids.size),
    }
    return meta | {
        "title": scene.entry.name,
        "facts": facts,
        "notes": list(scene.notes),
        "unit": scene.unit,
        "begin": begin_s,
        "units": UNITS,
        "extent": _extent(scene),
        "open": {"mode": mode, "at": _opening_s(scene) if begin_at_s is None else begin_at_s},
        "behaviors": [
            {"name": str(b), "style": b.style.value, "color": COLORS[b]} for b in BEHAVIORS
        ],
        "labelled": {"style": LABEL_PROBABILITY},
        "unknown": UNKNOWN_COLOR,
        "ramp": ramp(),
        "kinds": [k.value for k in KINDS],
        "signalNames": [s.value for s in SIGNALS],
        "agents": _agents(scene),
        "road": _road(scene),
        "events": [
            {
                "kind": e.kind.value,
                "time": round(e.time_s - begin_s, 3),
                "agent": _row(tracks.ids, e.agent),
                "other": -1 if e.other is None else _row(tracks.ids, e.other),
                "rule": e.words if e.kind is EventKind.NEAR_MISS else e.rule,
            }
            for e in tracks.events
        ],
        "grave": [k.value for k in (EventKind.COLLISION, EventKind.NEAR_MISS)],
        "traits": [
            {"name": trait.value, "behavior": behavior.code} for trait, behavior in TRAITS.items()
        ],
        "shownTraits": [
            [
                list(TRAITS).index(x.trait),
                _row(tracks.ids, x.agent),
                round(x.begin_s - begin_s, 2),
                round(x.end_s - begin_s, 2),
            ]
            for x in scene.shown_traits
        ],
        "index": index,
        "packed": packed,
    }


def _opening_s(scene: ReplayScene) -> float:
    """The first time at which there are beliefs and half of the largest number of agents, s."""
    tracks, beliefs = scene.tracks, scene.beliefs
    present = tracks.index.counts()
    half_full_s = float(tracks.time_s[int(np.argmax(2 * present >= present.max()))])
    known = np.isfinite(beliefs.probability).all(axis=2).any(axis=0)
    wanted = known & (beliefs.time_s >= half_full_s - 1e-6)
    return float(beliefs.time_s[int(wanted.argmax())]) if wanted.any() else half_full_s


def _row(ids: IntArray, agent: int) -> int:
    """Index of an id among the page's agents; -1 for one that is never seen."""
    at = int(np.searchsorted(ids, agent))
    return at if at < ids.size and ids[at] == agent else -1


def _agents(scene: ReplayScene) -> list[dict[str, Any]]:
    tracks = scene.tracks
    found = []
    for i, agent in enumerate(tracks.ids.tolist()):
        spec = scene.agents.get(agent)
        profile = None if spec is None else spec.profile
        numbers = [
            [name, float(f"{getattr(profile, name):.3g}")] for name in PROFILE_FIELDS if profile
        ]
        found.append({
            "name": tracks.names[i],
            **_size(tracks.kind[i], tracks.length[i], tracks.width[i]),
            "truth": -1 if tracks.behavior is None else int(tracks.behavior[i]),
            "profile": numbers or None,
        })  # fmt: skip
    return found


def _size(kind: int, length: float, width: float) -> dict[str, Any]:
    return {
        "kind": int(kind), "length": round(float(length), 2), "width": round(float(width), 2)
    }  # fmt: skip


def _places(tracks: Tracks, arrays: dict[str, NDArray[Any]]) -> None:
    """The agents' places, one after another, and the runs of steps without a gap."""
    agent, step = tracks.index.agent, tracks.index.step
    columns = {
        "x": tracks.row_xy[:, 0], "y": tracks.row_xy[:, 1],
        "heading": np.unwrap(tracks.row_heading), "speed": tracks.row_speed,
    }  # fmt: skip
    for name, values in columns.items():
        arrays[name] = differences(values, UNITS[name])
    begins = np.flatnonzero((np.diff(agent, prepend=-1) != 0) | (np.diff(step, prepend=-2) != 1))
    arrays["runAgent"] = agent[begins].astype("u2")
    arrays["runStep"] = step[begins].astype("i4")
    arrays["runSize"] = np.diff(begins, append=agent.size).astype("i4")


def _extent(scene: ReplayScene) -> list[float]:
    """x0, y0, x1, y1 of what is worth showing."""
    if scene.road is not None:
        return [round(v, 2) for v in scene.road.bounds]
    xy = scene.tracks.row_xy
    return _flat(np.stack([xy.min(axis=0), xy.max(axis=0)]))


def _beliefs(scene: ReplayScene, arrays: dict[str, NDArray[Any]]) -> None:
    """(N, S, 6) probabilities in 255ths; all 0 where nothing is believed."""
    probability = scene.beliefs.probability
    arrays["beliefTime"] = (scene.beliefs.time_s - scene.tracks.time_s[0]).astype("f4")
    arrays["belief"] = np.rint(np.nan_to_num(probability) * 255.0).astype("u1").ravel()


def _graph(scene: ReplayScene, arrays: dict[str, NDArray[Any]]) -> None:
    """|w| as roots in 254ths of the largest, 255 for nobody; edges by sample."""
    w = scene.graph.w
    largest = np.nan_to_num(w).max(axis=0, initial=0.0)
    share = np.sqrt(np.nan_to_num(w) / np.maximum(largest, 1e-12)[None])
    shown = np.where(np.isfinite(w), np.rint(share * 254.0), 255)
    arrays["graphTime"] = (scene.graph.time_s - scene.tracks.time_s[0]).astype("f4")
    arrays["w"] = shown.astype("u1").ravel()
    arrays["wLargest"] = largest.astype("f4")
    edges = scene.graph.edges[np.argsort(scene.graph.edges[:, 2], kind="stable")]
    arrays["edgeA"], arrays["edgeB"] = edges[:, 0].astype("u2"), edges[:, 1].astype("u2")
    arrays["edgeBegin"], arrays["edgeEnd"] = edges[:, 2].astype("i4"), edges[:, 3].astype("i4")


def _ghosts(scene: ReplayScene, arrays: dict[str, NDArray[Any]]) -> list[dict[str, Any]]:
    """Sizes of the agents of the factual episode; their places where these differ."""
    ghosts = scene.ghosts
    if ghosts is None:
        return []
    arrays["ghostOf"] = ghosts.index.agent.astype("u2")
    arrays["ghostStep"] = ghosts.index.step.astype("i4")
    arrays["ghostXY"] = differences(ghosts.row_xy, UNITS["x"])
    arrays["ghostHeading"] = ghosts.row_heading.astype("f4")
    return [_size(*one) for one in zip(ghosts.kind, ghosts.length, ghosts.width, strict=True)]


def _forecasts(scene: ReplayScene, arrays: dict[str, NDArray[Any]]) -> list[float]:
    """Times ahead of the places of futures, s; futures one after another."""
    if not scene.forecasts:
        return []
    xy = np.concatenate([f.xy for f in scene.forecasts])
    arrays["future"] = differences(xy.reshape(-1, 2), UNITS["future"])
    arrays["futureAgent"] = np.concatenate([f.agent for f in scene.forecasts]).astype("u2")
    likely = np.concatenate([f.probability for f in scene.forecasts])
    arrays["futureProbability"] = np.rint(likely * 255.0).astype("u1")
    times = np.array([f.time_s for f in scene.forecasts]) - scene.tracks.time_s[0]
    arrays["forecastTime"] = times.astype("f4")
    begins = np.cumsum([0, *(f.agent.size for f in scene.forecasts)])
    arrays["forecastBegin"] = begins.astype("i4")
    return [float(each) for each in scene.forecasts[0].ahead_s]


def _signal_changes(signals: NDArray[np.int8]) -> list[list[list[int]]]:
    """Of each signal group, the steps at which its state changes and the new state."""
    found = []
    for states in signals:
        at = np.flatnonzero(np.diff(states, prepend=-1) != 0)
        found.append([[int(step), int(states[step])] for step in at])
    return found


def _flat(shape: FloatArray) -> list[float]:
    return [round(v, 2) for v in shape.ravel().tolist()]


def _road(scene: ReplayScene) -> dict[str, Any] | None:
    if scene.road is None:
        return None
    shapes = road_shapes(scene.road)
    lines = ("paving", "asphalt", "dashes", "edges", "middles", "bars")
    return {
        **{name: [_flat(shape) for shape in getattr(shapes, name)] for name in lines},
        "stops": [{"line": _flat(stop.line), "signal": stop.signal} for stop in shapes.stops],
    }


def pack(arrays: Mapping[str, NDArray[Any]]) -> tuple[dict[str, list[Any]], str]:
    """Put arrays, each of a type in ``DTYPES``, into one text.

    Also returned is what is where, by name: type, offset in bytes, count.
    """
    index: dict[str, list[Any]] = {}
    parts: list[bytes] = []
    offset = 0
    for name, array in arrays.items():
        kind = array.dtype.newbyteorder("<").str.lstrip("<|")
        data = np.ascontiguousarray(array, dtype=f"<{kind}").tobytes()
        index[name] = [DTYPES[kind], offset, array.size]
        data += bytes(-len(data) % 4)  # a typed array begins at a multiple of its size
        parts.append(data)
        offset += len(data)
    return index, base64.b64encode(zlib.compress(b"".join(parts), 9)).decode()


def differences(values: FloatArray, unit: float) -> NDArray[np.int32]:
    """Values (n, ...), rounded to a unit, as differences along the first axis, as flat numbers."""
    return np.diff(np.rint(values / unit), axis=0, prepend=0).astype(np.int32).ravel()
