"""First steps with every recording: conversion to metres, and a check of its plausibility."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from experiments.data.scene_check import check_scene
from experiments.data.units import image_scale, in_metres
from sim.formats.common.recording import Recording
from sim.store.schema import EpisodeEntry

SCALED: Final = "scale_estimated"
"""Option of episodes that were in pixels and are in metres by an estimated scale."""

DOUBTED: Final = "no_scene"
"""Option of episodes whose recording is not a plausible scene: the reason."""


def is_scene(entry: EpisodeEntry) -> bool:
    """Whether an episode is plausible as a scene, as recorded by `admitted`."""
    return DOUBTED not in entry.options


def admitted(recording: Recording, unit: str) -> tuple[Recording, str | None]:
    """A recording in metres, and the reasons why it is not plausible as a scene.

    Args:
        recording: as read.
        unit: of its format: "m", or "px", whose scale is estimated.

    Returns:
        The recording, in metres, its notes with what was estimated and doubted; and the doubt in
        one sentence, None where it is a scene.
    """
    if unit != "m":
        scale = image_scale(recording.tracks)
        kept = tuple(note for note in recording.notes if "no scale" not in note)
        said = f"the format has no scale: by sizes and speeds {scale} at mid-height"
        recording = replace(
            recording, tracks=in_metres(recording.tracks, scale), notes=(*kept, said)
        )
    found = check_scene(recording.tracks, outlines=unit == "m")
    if not found.doubts:
        return recording, None
    doubt = f"no scene that can be believed: {'; '.join((*found.doubts, *found.remarks))}"
    return replace(recording, notes=(*recording.notes, doubt)), doubt
