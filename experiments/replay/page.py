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
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray

from behaviors.errors import InputError, lookup
from behaviors.labels import BEHAVIORS, COLORS, TRAITS, UNKNOWN_COLOR
from behaviors.profiles import PROFILE_FIELDS
from experiments.console.notices import LOGGER
from experiments.data.exchange import as_dataset
from experiments.replay.pictures import STILL, check_picture, ramp_color, write_picture
from experiments.replay.scene import DEFAULT_PREDICTOR, ReplayScene, chosen_entry, gather
from graphrqi.posterior import LABEL_PROBABILITY
from graphrqi.predict import PREDICTORS
from graphrqi.stream import DEFAULT_MODEL
from sim.files import write_whole
from sim.formats import FORMATS
from sim.frames import KINDS, SIGNALS, EventKind, FloatArray, Tracks
from sim.road import Road
from sim.road.shapes import road_shapes
from sim.store.dataset import open_dataset

SCRIPTS: Final = (
    "data.js", "view.js", "colors.js", "road.js", "draw.js", "timeline.js", "panel.js", "player.js",
)  # fmt: skip
"""In the order in which they are joined."""

UNITS: Final = {"x": 0.01, "y": 0.01, "heading": 0.0015, "speed": 0.05, "future": 0.1}
"""Steps to which places (m or pixels), headings (rad), speeds and futures are rounded."""

MODES: Final = ("true", "predicted", "confidence", "speed", "w")
"""Colourings of agents."""

RAMP: Final = [ramp_color(share) for share in np.linspace(0.0, 1.0, 17)]
"""Colours of a scale from low to high; the page interpolates between them."""

DTYPES: Final = {"u1": "Uint8", "u2": "Uint16", "i4": "Int32", "f4": "Float32"}
"""Little-endian numbers that a browser reads as typed arrays."""


def write_replay(
    source: Path,
    out: Path,
    *,
    episode: str | None = None,
    format: str | None = None,
    net: Path | None = None,
    labels: Path | None = None,
    model: str = DEFAULT_MODEL,
    predictor: str = DEFAULT_PREDICTOR,
    color: str | None = None,
    begin_s: float | None = None,
    end_s: float | None = None,
    picture: Path | None = None,
    quiet: bool = False,
) -> list[Path]:
    """Implement ``graphrqi replay``: write the page of an episode, and return all files written.

    Source, format and net are those of `experiments.data.exchange.as_dataset`, the episode that of
    `chosen_entry`, and labels, model and predictor those of `gather`. The colour is one of
    ``MODES``; None for the truth where it is known. The picture (.png, .pdf or .svg) or film (.mp4
    or .gif) is drawn beside the page.

    By default a page opens when the road has filled to half and there are beliefs, a film lasts as
    long as the episode, and a picture shows the fullest moment. Other times are in s.

    Raises:
        InputError: if an option or a file is wrong.
        OSError: if something cannot be written.
    """
    if color is not None:
        lookup({mode: mode for mode in MODES}, color, "color")
    if predictor != "none":
        PREDICTORS[predictor]
    if picture is not None:
        check_picture(picture, films=True)
    if end_s is not None and (picture is None or picture.suffix.lower() in STILL):
        raise InputError(f"--end-s: found {end_s:g}, expected --picture of a film (.gif, .mp4)")
    with as_dataset(source, format, net) as folder:
        dataset = open_dataset(folder)
        entry, many = chosen_entry(dataset, episode), len(dataset.manifest.episodes)
        if episode is None and many > 1:
            LOGGER.info("%s: showing %s, the first of %d episodes", source, entry.name, many)
        scene = gather(dataset, entry, model=model, labels=labels, predictor=predictor, quiet=quiet)
    first_s, last_s = float(scene.tracks.time_s[0]), float(scene.tracks.time_s[-1])
    if begin_s is not None and not min(first_s, 0.0) <= begin_s <= last_s:
        raise InputError(
            f"--begin-s: found {begin_s:g}, expected a time from {first_s:g} to {last_s:g} s"
        )
    mode = color or ("predicted" if scene.tracks.behavior is None else "true")
    if picture is not None:  # first, since it checks the film's times
        write_picture(scene, picture, mode, begin_s, end_s, quiet)
    write_page(scene, out, mode, begin_s)
    return [out] if picture is None else [out, picture]


def write_page(scene: ReplayScene, out: Path, mode: str, begin_s: float | None = None) -> None:
    """Write the page of a scene; the HTML file appears whole or not at all.

    Agents are coloured by one of ``MODES`` at first. The page opens at a time, s; None for when the
    road has filled to half and there are beliefs.
    """
    folder = resources.files("experiments.replay") / "page"
    style = (folder / "style.css").read_text()
    script = "\n".join((folder / name).read_text() for name in SCRIPTS)
    script = f'"use strict";\n(() => {{\n{script}\n}})();\n'
    shown = {"mode": mode, "at": _opening_s(scene) if begin_s is None else begin_s}
    data = json.dumps({**_data(scene), "open": shown}, allow_nan=False, separators=(",", ":"))
    for mark in "&<>":  # no HTML parser takes a string in the data for markup
        data = data.replace(mark, f"\\u{ord(mark):04x}")
    environment = Environment(
        loader=PackageLoader("experiments.replay", "page"), autoescape=True,
        undefined=StrictUndefined, trim_blocks=True,
    )  # fmt: skip
    page = environment.get_template("page.html").render(
        title=scene.entry.name, style=style, script=script, style_hash=_csp_hash(style),
        script_hash=_csp_hash(script), data=data,
    )  # fmt: skip
    write_whole(out, page.encode())


def _csp_hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _opening_s(scene: ReplayScene) -> float:
    """The first time at which there are beliefs and half of the largest number of agents, s."""
    tracks, beliefs = scene.tracks, scene.beliefs
    present = tracks.index.counts()
    half_full_s = float(tracks.time_s[int(np.argmax(2 * present >= present.max()))])
    known = np.isfinite(beliefs.probability).all(axis=2).any(axis=0)
    wanted = known & (beliefs.time_s >= half_full_s - 1e-6)
    return float(beliefs.time_s[int(wanted.argmax())]) if wanted.any() else half_full_s


def _data(scene: ReplayScene) -> dict[str, Any]:
    """All that the page's script reads."""
    entry, tracks = scene.entry, scene.tracks
    begin_s = float(tracks.time_s[0])
    row: dict[int | None, int] = {agent: i for i, agent in enumerate(tracks.ids.tolist())}
    made: dict[str, Any] = {"engine": entry.engine, "seed": entry.seed, "split": entry.split}
    specs = [scene.agents.get(agent) for agent in tracks.ids.tolist()]
    profiles = [None if spec is None else spec.profile for spec in specs]
    agents = _sizes(tracks).assign(
        name=tracks.names,
        truth=-1 if tracks.behavior is None else tracks.behavior,
        profile=[
            profile and [[n, float(f"{getattr(profile, n):.3g}")] for n in PROFILE_FIELDS]
            for profile in profiles
        ],
    )
    xy = tracks.row_xy
    extent = scene.road.bounds if scene.road else (*xy.min(axis=0), *xy.max(axis=0))
    index, packed = pack(_arrays(scene))
    return {
        "title": entry.name,
        "facts": {
            "episode": entry.id,
            **({"format": entry.engine} if entry.engine in FORMATS else made),
            "beliefs": scene.believer,
            "predictor": scene.predictor or "none",
            "agents": int(tracks.ids.size),
        },
        "notes": list(scene.notes),
        "unit": scene.unit,
        "begin": begin_s,
        "units": UNITS,
        "extent": _flat(np.array(extent)),
        "behaviors": [
            {"name": str(b), "style": b.style.value, "color": COLORS[b]} for b in BEHAVIORS
        ],
        "labelled": {"style": LABEL_PROBABILITY},
        "unknown": UNKNOWN_COLOR,
        "ramp": RAMP,
        "kinds": [k.value for k in KINDS],
        "signalNames": [s.value for s in SIGNALS],
        "agents": agents.to_dict("records"),
        "ghosts": [] if scene.ghosts is None else _sizes(scene.ghosts).to_dict("records"),
        "ahead": [] if scene.futures is None else scene.futures.ahead_s.tolist(),
        "signals": [  # the steps at which each group's state changes, with the new state
            [[int(step), int(states[step])] for step in np.flatnonzero(np.diff(states, prepend=-1))]
            for states in tracks.signals
        ],
        "road": None if scene.road is None else _road(scene.road),
        "events": [
            {
                "kind": e.kind.value,
                "time": round(e.time_s - begin_s, 3),
                "agent": row.get(e.agent, -1),
                "other": row.get(e.other, -1),
                "rule": e.words if e.kind is EventKind.NEAR_MISS else e.rule,
            }
            for e in tracks.events
        ],
        "grave": [k.value for k in (EventKind.COLLISION, EventKind.NEAR_MISS)],
        "traits": [
            {"name": trait.value, "behavior": behavior.code} for trait, behavior in TRAITS.items()
        ],
        "shownTraits": [
            [list(TRAITS).index(x.trait), row.get(x.agent, -1),
             round(x.begin_s - begin_s, 2), round(x.end_s - begin_s, 2)]
            for x in scene.shown_traits
        ],
        "index": index,
        "packed": packed,
    }  # fmt: skip


def _sizes(tracks: Tracks) -> pd.DataFrame:
    columns = {"length": tracks.length.round(2), "width": tracks.width.round(2)}
    return pd.DataFrame({"kind": tracks.kind, **columns})


def _flat(shape: FloatArray) -> list[float]:
    return [round(v, 2) for v in shape.ravel().tolist()]


def _road(road: Road) -> dict[str, Any]:
    shapes = road_shapes(road)
    lines = ("paving", "asphalt", "dashes", "edges", "middles", "bars")
    return {
        **{name: [_flat(shape) for shape in getattr(shapes, name)] for name in lines},
        "stops": [{"line": _flat(stop.line), "signal": stop.signal} for stop in shapes.stops],
    }


def _arrays(scene: ReplayScene) -> dict[str, NDArray[Any]]:
    """What changes with time.

    Agents' places are one after another, in runs of steps without a gap. Probabilities are in
    255ths, all 0 where nothing is believed. |w| is given as roots in 254ths of the largest, 255 for
    nobody.
    """
    tracks, graph, futures = scene.tracks, scene.graph, scene.futures
    begin_s, agent, step = tracks.time_s[0], tracks.index.agent, tracks.index.step
    runs = np.flatnonzero(tracks.index.begins)
    largest = np.nan_to_num(graph.w).max(axis=0, initial=0.0)
    share = np.sqrt(np.nan_to_num(graph.w) / np.maximum(largest, 1e-12)[None])
    edges = graph.edges[np.argsort(graph.edges[:, 2], kind="stable")]
    found = {
        "time": (tracks.time_s - begin_s).astype("f4"),
        "x": differences(tracks.row_xy[:, 0], UNITS["x"]),
        "y": differences(tracks.row_xy[:, 1], UNITS["y"]),
        "heading": differences(np.unwrap(tracks.row_heading), UNITS["heading"]),
        "speed": differences(tracks.row_speed, UNITS["speed"]),
        "runAgent": agent[runs].astype("u2"),
        "runStep": step[runs].astype("i4"),
        "runSize": np.diff(runs, append=agent.size).astype("i4"),
        "beliefTime": (scene.beliefs.time_s - begin_s).astype("f4"),
        "belief": np.rint(np.nan_to_num(scene.beliefs.probability) * 255.0).astype("u1"),
        "graphTime": (graph.time_s - begin_s).astype("f4"),
        "w": np.where(np.isfinite(graph.w), np.rint(share * 254.0), 255).astype("u1"),
        "wLargest": largest.astype("f4"),
        "edgeA": edges[:, 0].astype("u2"),
        "edgeB": edges[:, 1].astype("u2"),
        "edgeBegin": edges[:, 2].astype("i4"),
        "edgeEnd": edges[:, 3].astype("i4"),
    }
    if scene.ghosts is not None:
        ghosts = scene.ghosts
        found |= {
            "ghostOf": ghosts.index.agent.astype("u2"),
            "ghostStep": ghosts.index.step.astype("i4"),
            "ghostXY": differences(ghosts.row_xy, UNITS["x"]),
            "ghostHeading": ghosts.row_heading.astype("f4"),
        }
    if futures is not None:
        instants, begins = np.unique(futures.time_s, return_index=True)
        found |= {
            "future": differences(futures.xy.reshape(-1, 2), UNITS["future"]),
            "futureAgent": futures.agent.astype("u2"),
            "futureProbability": np.rint(futures.probability * 255.0).astype("u1"),
            "forecastTime": (instants - begin_s).astype("f4"),
            "forecastBegin": np.append(begins, futures.agent.size).astype("i4"),
        }
    return found


def pack(arrays: dict[str, NDArray[Any]]) -> tuple[dict[str, list[Any]], str]:
    """Put arrays, each of a type in ``DTYPES``, into one text.

    Also returned is what is where, by name: type, offset in bytes, count.
    """
    index: dict[str, list[Any]] = {}
    packed = b""
    for name, array in arrays.items():
        kind = array.dtype.newbyteorder("<").str.lstrip("<|")
        index[name] = [DTYPES[kind], len(packed), array.size]
        packed += array.astype(f"<{kind}").tobytes()
        packed += bytes(-len(packed) % 4)  # a typed array begins at a multiple of its size
    return index, base64.b64encode(zlib.compress(packed, 9)).decode()


def differences(values: FloatArray, unit: float) -> NDArray[np.int32]:
    """Values (n, ...), rounded to a unit, as differences along the first axis, as flat numbers."""
    return np.diff(np.rint(values / unit), axis=0, prepend=0).astype(np.int32).ravel()
