"""Our conflicts beside those of SUMO's device for surrogate safety measures (SSM).

Both watch the same episodes. We move outlines on at constant velocity; SUMO measures along lanes,
has post-encroachment times at crossings only, and no pedestrians.

References:
    https://sumo.dlr.de/docs/Simulation/Output/SSM_Device.html and SUMO's ``MSDevice_SSM.cpp``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from experiments.score.rows import Cell, Row, tidy_row
from scenarios import get_scenario
from sim.files import temporary_folder
from sim.frames import Tracks
from sim.input_files import read_tree
from sim.safety import CONFLICT_KINDS, ConflictKind, Conflicts, conflicts
from sim.scenario import sample_agents
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
"""Compared quantities, and SUMO's element of each."""

KINDS: Final = {
    **dict.fromkeys((1, 2, 3, 18), ConflictKind.FOLLOWING), 20: ConflictKind.ONCOMING,
    **dict.fromkeys(range(9, 18), ConflictKind.CROSSING),
}  # fmt: skip
"""Our kinds of SUMO's encounter types (``MSDevice_SSM.h``); all others are merging."""

PLACE: Final = ("first", "second", "begin_s", "end_s")
COLUMNS: Final = ["kind", "found_by", "measure", *MEASURES]
"""Columns that say which pair a conflict is of and when, and those of a comparison."""


def _read_ssm(path: Path) -> pd.DataFrame:
    """The conflicts in an output file of SUMO's device, once for each pair and time."""
    found: list[dict[str, Any]] = []
    for element in read_tree(path).iter("conflict"):
        known = {m.tag: m.attrib for m in element if m.get("value", "NA") != "NA"}
        values = {n: float(known[tag]["value"]) for n, tag in MEASURES.items() if tag in known}
        first, second = sorted((int(element.attrib["ego"]), int(element.attrib["foe"])))
        begin_s, end_s = float(element.attrib["begin"]), float(element.attrib["end"])
        for old in found:
            met = (old["first"], old["second"]) == (first, second)
            if met and old["begin_s"] <= end_s and begin_s <= old["end_s"]:
                old |= {**values, **old}  # the report of the other vehicle's device
                break
        else:
            code = int(next(known[tag] for tag in MEASURES.values() if tag in known)["type"])
            kind = KINDS.get(code, ConflictKind.MERGING)
            found.append({"first": first, "second": second, "begin_s": begin_s, "end_s": end_s,
                          "kind": kind.value, **values})  # fmt: skip
    table = pd.DataFrame(found, columns=[*PLACE, "kind", *MEASURES])
    return table.astype(dict.fromkeys((*PLACE, *MEASURES), np.float64))


def _compared(ours: Conflicts, theirs: pd.DataFrame) -> list[dict[str, Any]]:
    """A line for each conflict, matched by pair and time: its ``kind`` and who it was ``found_by``.

    ``measure`` says by which one we alone found it. Of conflicts that both found, the `MEASURES`
    are SUMO's less ours.
    """
    mine = pd.DataFrame({name: getattr(ours, name) for name in (*PLACE, *MEASURES)})
    mine["kind"] = [CONFLICT_KINDS[code].value for code in ours.kind]
    soon = mine["ttc_s"] <= WITHIN_S
    mine["measure"] = np.where(soon, "time to collision", "post-encroachment time")
    mine["drac_mps2"] = mine["drac_mps2"].where(soon)
    crosses = (mine["kind"] != ConflictKind.FOLLOWING.value) & (mine["pet_s"] <= WITHIN_S)
    mine = mine[soon | crosses].replace(np.inf, np.nan)
    met = theirs.reset_index().merge(
        mine.reset_index(), on=["first", "second"], suffixes=("", "_ours")
    )
    met = met[(met["begin_s"] <= met["end_s_ours"]) & (met["begin_s_ours"] <= met["end_s"])]
    both = met.drop_duplicates("index")
    both = both.assign(
        kind=both["kind_ours"], found_by="both", measure="",
        **{name: both[name] - both[f"{name}_ours"] for name in MEASURES},
    )  # fmt: skip
    none = dict.fromkeys(MEASURES, np.nan)
    alone = theirs.drop(both["index"]).assign(found_by="SUMO", measure="", **none)
    left = mine.drop(met["index_ours"].unique()).assign(found_by="we", **none)
    return [line for part in (both, alone, left) for line in part[COLUMNS].to_dict("records")]


def measure(
    seeds: Sequence[int] = (0, 1, 2), duration_s: float = 120.0,
    scenarios: Sequence[str] = SCENARIOS,
) -> Iterator[list[Row]]:  # fmt: skip
    """Counts by kind, finder and measure over all episodes; median differences, SUMO less ours."""
    cases: list[dict[str, Any]] = []
    for name in scenarios:
        scenario = get_scenario(name)(duration_s=duration_s)
        for seed in seeds:
            with temporary_folder("ssm") as folder:
                path = folder / "ssm.xml"
                settings = SumoSettings(options=(*DEVICE, "--device.ssm.file", str(path)))
                frames = run_with(scenario, sample_agents(scenario, seed), seed, settings)
                ours = conflicts(Tracks.from_frames(frames), scenario.road, WITHIN_S)
                cases += _compared(ours, _read_ssm(path))
    together = pd.DataFrame(cases, columns=COLUMNS)
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
