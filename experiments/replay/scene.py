"""Everything a replay shows of one episode, gathered once for the page, the film, the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Final

import numpy as np

from behaviors.errors import InputError
from behaviors.traits import ShownTrait
from experiments.console.progress import Progress
from experiments.data.scene_check import SCALED, is_scene
from experiments.data.units import image_scale
from experiments.data.windows import measured, traffic_of
from experiments.replay import layers
from experiments.replay.layers import Beliefs, Forecast, GraphHistory
from experiments.what_if.branches import branch_of, change_of
from experiments.what_if.outcomes import factual_of
from graphrqi.model_files import load_model
from sim.episode.annotate import annotate_recording, near_misses
from sim.formats import FORMATS
from sim.frames import Event, EventKind, Tracks
from sim.road import Road
from sim.scenario import AgentSpec
from sim.store.dataset import Dataset, Episode
from sim.store.schema import EpisodeEntry

SHOWN_EVERY_S: Final = 0.1
"""Time between two places that are kept of an agent, s; between them it moves straight."""

MAX_PLACES: Final = 1_000_000
"""Most places of agents in a page (some 4 MB); of longer episodes fewer are kept."""

NAMED: Final = 6
"""Most episodes that a message names."""

DEFAULT_PREDICTOR: Final = "graphrqi-predict"

PARKED_M: Final = 2.0
"""A vehicle that stays within this is parked, m (more than the noise of recordings)."""

DRAWN_QUANTILE: Final = 0.25
"""Vehicles in an image are drawn as long as so many of its boxes are at most."""

CAR_SHAPE: Final = 2.5
"""Length over width of a vehicle that is drawn for a box in an image (a car's)."""


@dataclass(frozen=True, slots=True, eq=False)
class ReplayScene:
    """One episode, ready to be drawn.

    Attributes:
        entry: what it is and how it was made.
        unit: of lengths, "m" or "px".
        road: where it happened; None if not known.
        tracks: everyone, at the times that are shown.
        agents: what was drawn for each agent, by id.
        shown_traits: the traits that were shown.
        beliefs: what a classifier believes.
        believer: who believes it, in words.
        graph: the traffic graph.
        forecasts: predictions, in order of time.
        predictor: whose; "" if there are none.
        notes: what a reader should know of the data, one sentence each.
        ghosts: of a counterfactual episode, where everyone factually was.
    """

    entry: EpisodeEntry
    unit: str
    road: Road | None
    tracks: Tracks
    agents: dict[int, AgentSpec]
    shown_traits: tuple[ShownTrait, ...]
    beliefs: Beliefs
    believer: str
    graph: GraphHistory
    forecasts: tuple[Forecast, ...]
    predictor: str
    notes: tuple[str, ...]
    ghosts: Tracks | None = None


def chosen_entry(dataset: Dataset, episode: str | None) -> EpisodeEntry:
    """The episode that is asked for; by default the first.

    It is called by its id, the beginning of its id, its name (the recording, with its folder or
    without, or the scenario and the index), or its scenario, of which it is the first then.
    """
    entries = dataset.manifest.episodes
    if not entries:
        raise InputError(f"{dataset.path}: found no episode, expected at least 1")
    if episode is None:
        return entries[0]
    found = [entry for entry in entries if entry.id.startswith(episode)]
    found = found or [entry for entry in entries if entry.name == episode]
    found = found or [e for e in entries if e.name.rpartition("/")[2] == episode]
    found = found or [entry for entry in entries if entry.scenario == episode][:1]
    if len(found) != 1:
        near = get_close_matches(episode, [e.name for e in entries], NAMED, cutoff=0.0)
        nearest = found or [e for name in dict.fromkeys(near) for e in entries if e.name == name]
        known = ", ".join(f"{e.id} ({e.name})" for e in nearest[:NAMED])
        more = ", ..." if len(nearest) > NAMED else ""
        raise InputError(
            f"--episode: found {len(found)} episodes called {episode!r}, expected one of "
            f"{known}{more}"
        )
    return found[0]


def gather(
    dataset: Dataset,
    entry: EpisodeEntry,
    *,
    model: str,
    labels: Path | None = None,
    predictor: str = DEFAULT_PREDICTOR,
    quiet: bool = True,
) -> ReplayScene:
    """Read an episode, and classify and predict in it what no file says.

    The classifier, a shipped one's name or a folder, is not used where a labels file of
    ``graphrqi classify`` is given. The predictor is a key of ``PREDICTORS``, or "none".
    """
    episode = dataset.read(entry)
    tracks, road = measured(episode), dataset.road(entry)
    if not tracks.ids.size or tracks.time_s.size < 2:
        raise InputError(
            f"{entry.name}: found {tracks.ids.size} agents in {tracks.time_s.size} frames, "
            "expected at least 1 in 2"
        )
    shown_traits = episode.shown_traits
    if entry.engine in FORMATS:  # a recording: nobody has looked yet
        events = tuple(near_misses(dataset.conflicts(entry)))
        if road is not None:
            events, shown_traits = annotate_recording(tracks, road)
        tracks = replace(tracks, events=_without_parked(tracks, events))
    forecasts: list[Forecast] = []
    with Progress("looking at the episode", 3, quiet) as progress:
        if labels is None:
            trained = load_model(model)
            beliefs = layers.believe(tracks, trained, is_scene(entry), traffic_of(entry))
            believer = trained.method.name
        else:
            beliefs, believer = layers.read_beliefs(labels, entry.id, tracks), labels.name
        progress.advance()
        if predictor != "none":
            forecasts = layers.forecast(tracks, beliefs, road, predictor)
        progress.advance()
        graph = layers.graph_history(tracks)
        progress.advance()
    scaled = entry.engine not in FORMATS or SCALED in entry.options
    unit = "m" if scaled else FORMATS[entry.engine].unit
    stride = max(1, round(SHOWN_EVERY_S / tracks.step_s))
    stride = max(stride, -(-tracks.row_speed.size // MAX_PLACES))
    if unit == "px":  # boxes are as large as the perspective makes them: draw cars of one size
        box = np.quantile(np.sqrt(tracks.length * tracks.width), DRAWN_QUANTILE)
        length = np.full(tracks.ids.size, float(box))
        tracks = replace(tracks, length=length, width=length / CAR_SHAPE)
    kept = tracks.part(np.arange(tracks.ids.size), slice(None, None, stride))
    ghosts, notes, branch = None, [], branch_of(entry)
    if branch is not None:
        said = f"what if driver {branch['agent']} had changed at {branch['at_s']} s"
        notes.append(f"{said}: {change_of(entry)}; dashed outlines: where everyone factually was")
        ghosts = layers.find_ghosts(dataset.read(factual_of(dataset, entry)).tracks, kept)
    notes += _notes(episode, road, unit, stride)
    return ReplayScene(
        entry=entry, unit=unit, road=road, tracks=kept,
        agents={spec.id: spec for spec in episode.agents}, shown_traits=shown_traits,
        beliefs=beliefs, believer=believer, graph=graph, forecasts=tuple(forecasts),
        predictor=predictor if forecasts else "", notes=tuple(notes), ghosts=ghosts,
    )  # fmt: skip


def _without_parked(tracks: Tracks, events: Sequence[Event]) -> tuple[Event, ...]:
    """The events but for near misses with a parked vehicle: passing it closely is no conflict."""
    parked = set()
    for row, agent in enumerate(tracks.ids.tolist()):
        places = tracks.row_xy[tracks.index.rows(row)]
        if len(places) and np.ptp(places, axis=0).max() < PARKED_M:
            parked.add(agent)
    near = EventKind.NEAR_MISS
    return tuple(e for e in events if e.kind is not near or not parked & {e.agent, e.other})


def _notes(episode: Episode, road: Road | None, unit: str, stride: int) -> list[str]:
    """Notes on the data for a reader."""
    known = episode.entry.options.get("notes")
    notes = [str(note) for note in known] if isinstance(known, list) else []
    if road is None:
        notes.append("no road is known: faint lines show where everyone went")
    if unit == "px":
        notes.append(
            "positions are pixels of an image, and all vehicles are drawn in one size: the shipped "
            "classifier and predictors were made for metres, so what they say here is a guess"
        )
    if episode.entry.options.get("pixels_per_m"):
        notes.append(f"seen in pixels: by sizes and speeds {image_scale(episode.tracks)}")
    if episode.tracks.behavior is None:
        notes.append("nobody's true behaviour is known in this data")
    shown_s = stride * episode.tracks.step_s
    if shown_s > 1.5 * SHOWN_EVERY_S:
        notes.append(f"places every {shown_s:.2g} s are kept, to keep the page small")
    return notes
