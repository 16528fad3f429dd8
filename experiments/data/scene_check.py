"""Plausibility of a recording as a scene, by its positions and sizes.

Some recordings overlay actors of several scenes, have invented times, or reuse ids. Their drivers
cannot be classified. A finding counts only with enough evidence against sensor noise (up to half a
metre) and dense traffic. All limits are our choice.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from experiments.data.units import image_scale, in_metres
from sim.formats.common.doubts import doubt_of_times, size_doubt
from sim.formats.common.recording import Recording
from sim.frames import PEDESTRIAN, FloatArray, Tracks
from sim.geometry import to_own_frame
from sim.store.schema import EpisodeEntry

SCALED: Final = "scale_estimated"
"""Option of episodes that were in pixels and are in metres by an estimated scale."""

DOUBTED: Final = "no_scene"
"""Option of episodes whose recording is not a plausible scene: the reason."""

LOOK_S: Final = 0.5
"""Time between looks at overlaps, s."""

LOOKS, SIZED = 10, 3
"""Fewest looks that say that times are wrong, and fewest vehicles that say that a size is."""

CORE, LONGEST_CORE_M, LEAST_CORE_M = 0.5, 2.5, 0.25
"""Vehicles overlap where outlines of this share of their sizes do; longest core, less than a lane's
width as headings may be wrong, and least core, for sources without sizes, m."""

OVERLAPPING, OVERLAPPING_BOXES, OVERLAPPING_IDS = 0.02, 0.2, 6
"""Largest share of overlapping vehicles, also where outlines are unknown, and the fewest that count
(a tracker may see one truck as two)."""

NEAREST_M: Final = 1.0
"""No scene, whatever the outlines, if half of the vehicles have another centre nearer than this."""

FASTEST_MPS, JUMP_M, JUMPING, JUMPING_IDS = 90.0, 5.0, 0.1, 3
"""Vehicles jump that go faster and farther than this, m/s and m; largest share of such ids, and the
fewest that count."""


def check_scene(tracks: Tracks, outlines: bool = True) -> tuple[str, ...]:
    """Reasons not to believe that a recording, in metres, is a scene, a sentence each.

    Without ``outlines``, sizes are those of boxes in an image, which overlap without touching.
    """
    tracks = tracks.part(np.flatnonzero(tracks.kind != PEDESTRIAN), slice(None))
    index = tracks.index
    count = np.unique(index.agent).size
    if not count:
        return ()
    looks = _looks(tracks.time_s)
    nearest_m, hits, overlapping = _overlaps(tracks, looks)
    looked = max(int(np.isin(index.step, looks).sum()), 1)
    share = hits / looked
    near = 2 * int((nearest_m < NEAREST_M).sum()) > max(looked, 2 * OVERLAPPING_IDS)
    most = OVERLAPPING if outlines else OVERLAPPING_BOXES
    doubts: list[str | None] = []
    if count >= OVERLAPPING_IDS and (near or (overlapping >= OVERLAPPING_IDS and share > most)):
        apart = float(np.median(nearest_m)) if nearest_m.size else math.nan
        doubts.append(
            f"{share:.0%} of the vehicles lie within another one (median distance to the next "
            f"centre {apart:.1f} m): actors are superimposed"
        )
    if len(looks) >= LOOKS:
        doubts.append(doubt_of_times(tracks))
        doubts.append(size_doubt(tracks) if outlines and count >= SIZED else None)
    at = np.flatnonzero(~index.begins[1:])  # steps from one frame to the next
    moved_m = np.hypot(*(tracks.row_xy[at + 1] - tracks.row_xy[at]).T)
    far_m = FASTEST_MPS * np.diff(tracks.time_s)[index.step[at]] + JUMP_M
    jumps = np.unique(index.agent[at[moved_m > far_m]]).size
    if jumps >= JUMPING_IDS and jumps > JUMPING * count:
        doubts.append(f"{jumps} of {count} ids jump from place to place")
    return tuple(doubt for doubt in doubts if doubt)


def is_scene(entry: EpisodeEntry) -> bool:
    """Whether an episode is plausible as a scene, as recorded by `admitted`."""
    return DOUBTED not in entry.options


def admitted(recording: Recording, unit: str) -> tuple[Recording, str | None]:
    """A recording in metres, and the doubt that it is a scene in one sentence; None without one.

    The scale of a unit other than "m" is estimated. Notes say what was estimated and doubted.
    """
    if unit != "m":
        scale = image_scale(recording.tracks)
        kept = tuple(note for note in recording.notes if "no scale" not in note)
        said = f"the format has no scale: by sizes and speeds {scale} at mid-height"
        recording = replace(
            recording, tracks=in_metres(recording.tracks, scale), notes=(*kept, said)
        )
    doubts = check_scene(recording.tracks, outlines=unit == "m")
    if not doubts:
        return recording, None
    doubt = f"no scene that can be believed: {'; '.join(doubts)}"
    return replace(recording, notes=(*recording.notes, doubt)), doubt


def _looks(time_s: FloatArray) -> list[int]:
    """The frames that are looked at, `LOOK_S` apart."""
    looks: list[int] = []
    for step, time in enumerate(time_s.tolist()):
        if not looks or time >= time_s[looks[-1]] + LOOK_S - 1e-6:
            looks.append(step)
    return looks


def _overlaps(tracks: Tracks, looks: list[int]) -> tuple[FloatArray, int, int]:
    """Distances to the next centre, m, how often vehicles lie within others, and how many do."""
    nearest: list[FloatArray] = [np.empty(0)]
    hits, who = 0, set[int]()
    sides = np.stack([tracks.length, tracks.width], axis=1)
    for step in looks:
        here = tracks.index.at(step)
        if here.size < 2:
            continue
        agent, xy = tracks.index.agent[here], tracks.row_xy[here]
        tree = cKDTree(xy)
        nearest.append(np.asarray(tree.query(xy, k=2)[0])[:, 1])
        pairs = tree.query_pairs(LONGEST_CORE_M * math.sqrt(2.0), output_type="ndarray")
        one, other = np.concatenate([pairs, pairs[:, ::-1]]).T
        away = np.abs(to_own_frame(xy[other], xy[one], tracks.row_heading[here[one]]))
        core = 0.5 * CORE * (sides[agent[one]] + sides[agent[other]])
        core = np.clip(core, LEAST_CORE_M, LONGEST_CORE_M)
        found = np.unique(one[(away < core).all(axis=1)])
        hits += found.size
        who.update(agent[found].tolist())
    return np.concatenate(nearest), hits, len(who)
