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
import pandas as pd

from experiments.score.rows import Cell, Row, tidy_row
from scenarios import get_scenario
from sim.files import temporary_folder
from sim.frames import FloatArray, Tracks
from sim.input_files import read_tree
from sim.safety import CONFLICT_KINDS, ConflictKind, Conflicts, conflicts
from sim.scenario import Scenario, sample_agents
from sim.sumo.engine import run_with
from sim.sumo.vehicle_types import SumoSettings

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


def read_ssm(path: Path) -> list[SumoConflict]:
    """The conflicts in an output file of SUMO's device, once for each pair and time."""
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
            span_s = np.array([begin_s, end_s])
            found.append(SumoConflict((low, high), span_s, kind, np.array(values)))
    return found


def _kind(code: int) -> ConflictKind:
    """Our kind of an encounter type of SUMO (``MSDevice_SSM.h``)."""
    if code in (1, 2, 3, 18):
        return ConflictKind.FOLLOWING
    if code == 20:
        return ConflictKind.ONCOMING
    return ConflictKind.CROSSING if 9 <= code <= 17 else ConflictKind.MERGING


def compare(ours: Conflicts, theirs: Sequence[SumoConflict]) -> pd.DataFrame:
    """A line for each conflict, matched by pair and time: its ``kind`` and who it was ``found_by``.

    ``measure`` says by which one we alone found it. Of conflicts that both found, the `MEASURES`
    are SUMO's less ours.
    """
    near_ttc = ours.ttc_s <= WITHIN_S
    values = np.stack([ours.ttc_s, np.where(near_ttc, ours.drac_mps2, np.nan), ours.pet_s], axis=1)
    values[np.isinf(values)] = np.nan
    follows = ours.kind == CONFLICT_KINDS.index(ConflictKind.FOLLOWING)
    left = near_ttc | (~follows & (ours.pet_s <= WITHIN_S))
    near = left.copy()
    cases: list[tuple[str, str, str, FloatArray]] = []
    none = np.full(len(MEASURES), np.nan)
    for each in theirs:
        begin_s, end_s = each.span_s
        same = (ours.first == each.pair[0]) & (ours.second == each.pair[1]) & near
        same &= (ours.begin_s <= end_s) & (begin_s <= ours.end_s)
        left &= ~same
        if same.any():
            i = int(same.argmax())
            cases.append((CONFLICT_KINDS[ours.kind[i]].value, "both", "", each.values - values[i]))
        else:
            cases.append((each.kind.value, "SUMO", "", none))
    for row in np.flatnonzero(left):
        measure = "time to collision" if near_ttc[row] else "post-encroachment time"
        cases.append((CONFLICT_KINDS[ours.kind[row]].value, "we", measure, none))
    lines = [(*case[:3], *case[3]) for case in cases]
    return pd.DataFrame(lines, columns=["kind", "found_by", "measure", *MEASURES])


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
    """Counts by kind, finder and measure over all episodes; median differences, SUMO less ours."""
    cases = []
    for name in scenarios:
        scenario = get_scenario(name)(duration_s=duration_s)
        for seed in seeds:
            tracks, theirs = watch(scenario, seed)
            cases.append(compare(conflicts(tracks, scenario.road, WITHIN_S), theirs))
    together = pd.concat(cases)
    rows = []
    for names, some in together.groupby(["kind", "found_by", "measure"], dropna=False):
        words = map(str, names)
        keys: dict[str, Cell] = dict(zip(("kind", "found_by", "measure"), words, strict=True))
        rows.append(tidy_row(keys, "conflicts", len(some), n=len(together)))
        for metric in MEASURES:
            known = some[metric].dropna()
            if len(known):
                rows.append(tidy_row(keys, f"{metric}_difference", known.median(), n=len(known)))
    yield rows
