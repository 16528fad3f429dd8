"""Our conflicts beside those of SUMO's device for surrogate safety measures (SSM).

Both watch the same episodes. We move outlines on at constant velocity; SUMO measures along lanes:

- following: bumper to bumper on the lane to which SUMO assigns a vehicle, also while it changes
- crossing: the later vehicle's way to the area that the lanes share, if it comes there before the
  earlier one has left
- post-encroachment time at crossings only, for that area; no pedestrians

References:
    https://sumo.dlr.de/docs/Simulation/Output/SSM_Device.html and SUMO's ``MSDevice_SSM.cpp``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from experiments.score.rows import Row, tidy_row
from scenarios import get_scenario
from sim.files import temporary_folder
from sim.frames import FloatArray, Tracks
from sim.safety import CONFLICT_KINDS, Bodies, ConflictKind, Conflicts, conflicts, pair_measures
from sim.scenario import Scenario, sample_agents
from sim.sumo.engine import run_with
from sim.sumo.settings import SumoSettings
from sim.xml_tree import read_tree

SCENARIOS: Final = ("straight_road", "four_way_intersection", "motorway_ramps")

WITHIN_S: Final = 5.0
"""A conflict has a time to collision or post-encroachment time of at most this, s."""

DEVICE: Final = (
    "--device.ssm.probability", "1",
    "--device.ssm.measures", "TTC DRAC PET",
    "--device.ssm.thresholds", f"{WITHIN_S} 1000 {WITHIN_S}",
    "--device.ssm.range", "150",
    "--device.ssm.extratime", f"{WITHIN_S}",
)  # fmt: skip
"""SUMO's device in every vehicle; braking alone makes no conflict."""

MEASURES: Final = {"ttc_s": "minTTC", "drac_mps2": "maxDRAC", "pet_s": "PET"}
"""What is compared, and SUMO's element of each."""


class SumoConflict(NamedTuple):
    """A conflict by SUMO's device: ids, (2,) begin and end, (3,) values of ``MEASURES`` or nan."""

    pair: tuple[int, int]
    span_s: FloatArray
    kind: ConflictKind
    values: FloatArray
    ttc_time_s: float


class Case(NamedTuple):
    """A conflict: who found it, why the other did not, and (3,) SUMO's measures less ours."""

    kind: ConflictKind
    found_by: str
    reason: str
    difference: FloatArray


def read_ssm(path: Path) -> list[SumoConflict]:
    """The conflicts in an output file of SUMO's device, once for each pair and time.

    Raises:
        InputError: if the file is missing or no XML.
    """
    found: list[SumoConflict] = []
    for element in read_tree(path).iter("conflict"):
        known = {m.tag: m.attrib for m in element if m.get("value", "NA") != "NA"}
        values = [float(known.get(tag, {}).get("value", "nan")) for tag in MEASURES.values()]
        low, high = sorted((int(element.attrib["ego"]), int(element.attrib["foe"])))
        begin_s, end_s = float(element.attrib["begin"]), float(element.attrib["end"])
        for old in found:
            if old.pair == (low, high) and old.span_s[0] <= end_s and begin_s <= old.span_s[1]:
                old.values[:] = np.where(np.isnan(old.values), values, old.values)
                break  # the report of the other vehicle's device
        else:
            kind = _kind(int(next(known[tag] for tag in MEASURES.values() if tag in known)["type"]))
            time_s = float(known.get("minTTC", {}).get("time", "nan"))
            span_s = np.array([begin_s, end_s])
            found.append(SumoConflict((low, high), span_s, kind, np.array(values), time_s))
    return found


def _kind(code: int) -> ConflictKind:
    """Our kind of an encounter type of SUMO (``MSDevice_SSM.h``)."""
    if code in (1, 2, 3, 18):
        return ConflictKind.FOLLOWING
    if code == 20:
        return ConflictKind.ONCOMING
    return ConflictKind.CROSSING if 9 <= code <= 17 else ConflictKind.MERGING


def compare(tracks: Tracks, ours: Conflicts, theirs: Sequence[SumoConflict]) -> Iterator[Case]:
    """Match conflicts by pair and time, and say where they differ and why."""
    near_ttc, none = ours.ttc_s <= WITHIN_S, np.full(len(MEASURES), np.nan)
    values = np.stack([ours.ttc_s, np.where(near_ttc, ours.drac_mps2, np.nan), ours.pet_s], axis=1)
    values[np.isinf(values)] = np.nan
    follows = ours.kind == CONFLICT_KINDS.index(ConflictKind.FOLLOWING)
    left = near_ttc | (~follows & (ours.pet_s <= WITHIN_S))
    near = left.copy()
    for each in theirs:
        begin_s, end_s = each.span_s
        same = (ours.first == each.pair[0]) & (ours.second == each.pair[1]) & near
        same &= (ours.begin_s <= end_s) & (begin_s <= ours.end_s)
        left &= ~same
        if same.any():
            i = int(same.argmax())
            yield Case(CONFLICT_KINDS[ours.kind[i]], "both", "", each.values - values[i])
        else:
            yield Case(each.kind, "SUMO", _reason_of_sumo(tracks, each), none)
    for row in np.flatnonzero(left):
        kind = CONFLICT_KINDS[ours.kind[row]]
        yield Case(kind, "we", _our_reason(kind, bool(near_ttc[row])), none)


def _our_reason(kind: ConflictKind, near_ttc: bool) -> str:
    """Why SUMO does not report a conflict of ours."""
    if kind == ConflictKind.PEDESTRIAN:
        return "SUMO sees no pedestrians"
    return "outlines meet" if near_ttc else "post-encroachment time alone"


def _reason_of_sumo(tracks: Tracks, conflict: SumoConflict) -> str:
    """Why we do not report a conflict of SUMO, by the outlines' courses at its least time."""
    if np.isnan(conflict.ttc_time_s):
        return "post-encroachment time alone"
    ttc_s = pair_measures(*bodies_at(tracks, conflict.pair, conflict.ttc_time_s)).ttc_s[0]
    if ttc_s <= WITHIN_S:
        return "outlines meet, a nearer one between"
    return "outlines miss" if np.isinf(ttc_s) else "outlines meet later"


def bodies_at(tracks: Tracks, pair: tuple[int, int], time_s: float) -> list[Bodies]:
    """The two bodies, each as arrays of one, in the frame nearest to a time."""
    step = int(np.abs(tracks.time_s - time_s).argmin())
    rows = [slice(k, k + 1) for k in np.searchsorted(tracks.ids, pair)]
    none = np.zeros(1)
    return [
        Bodies(
            tracks.xy[r, step], tracks.heading[r, step], tracks.speed[r, step], none,
            tracks.length[r], tracks.width[r],
        )
        for r in rows
    ]  # fmt: skip


def watch(scenario: Scenario, seed: int) -> tuple[Tracks, list[SumoConflict]]:
    """An episode in SUMO with the device in every vehicle."""
    with temporary_folder("ssm") as folder:
        path = folder / "ssm.xml"
        settings = SumoSettings(options=(*DEVICE, "--device.ssm.file", str(path)))
        frames = run_with(scenario, sample_agents(scenario, seed), seed, settings)
        tracks = Tracks.from_frames(frames)
        return tracks, read_ssm(path)


def measure(
    seeds: Sequence[int], duration_s: float, scenarios: Sequence[str] = SCENARIOS
) -> Iterator[list[Row]]:
    """Counts by kind, finder and reason over all episodes; median differences, SUMO less ours."""
    cases: list[Case] = []
    for name in scenarios:
        scenario = get_scenario(name)(duration_s=duration_s)
        for seed in seeds:
            tracks, theirs = watch(scenario, seed)
            cases += compare(tracks, conflicts(tracks, scenario.road, WITHIN_S), theirs)
    rows = []
    for kind, found_by, reason in sorted({case[:3] for case in cases}):
        some = [c.difference for c in cases if c[:3] == (kind, found_by, reason)]
        keys = {"kind": kind.value, "found_by": found_by, "reason": reason}
        rows.append(tidy_row(keys, "conflicts", len(some), n=len(cases)))
        for metric, values in zip(MEASURES, np.array(some).T, strict=True):
            known = values[~np.isnan(values)]
            if known.size:
                middle = float(np.median(known))
                rows.append(tidy_row(keys, f"{metric}_difference", middle, n=known.size))
    yield rows
