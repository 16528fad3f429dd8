"""Drivers for use elsewhere: SUMO's vTypeDistribution, and a table of IDM, Krauss and MOBIL."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior, read_behaviors
from behaviors.profiles import PROFILE_FIELDS, sample_profile
from sim.files import new_folder
from sim.frames import AgentKind
from sim.scenario import DIMENSIONS_M, IMPERFECTION, AgentSpec
from sim.store.dataset import is_dataset, open_dataset
from sim.sumo.vehicle_types import type_element

DRIVERS_OF_EACH: Final = 20
"""Drivers that stand for each behaviour (our choice: its spread shows)."""

NOT_IN_SUMO: Final = (
    "yield_probability", "red_run_probability", "stop_roll_probability", "cut_in_rate_per_min",
    "stop_rate_per_min", "wrong_way_rate_per_min", "lapse_rate_per_min", "lapse_s",
    "overlook_probability",
)  # fmt: skip
"""Numbers that no attribute of a vType has: controllers act on them while SUMO runs."""

IN_TABLE: Final = {
    "speed_factor": "idm_v0_per_limit",
    "time_headway_s": "idm_T_s",
    "min_gap_m": "idm_s0_m",
    "max_accel_mps2": "idm_a_mps2",
    "comfort_decel_mps2": "idm_b_mps2",
    "politeness": "mobil_p",
    "reaction_time_s": "reaction_time_s",
    "perception_noise": "gap_error",
}
"""Columns of the table by the profile's numbers; Krauss's tau, decel and minGap are T, b and s0."""


def export_types(source: str, out: Path) -> list[Path]:
    """Write ``vtypes.add.xml`` and ``drivers.csv`` into a new or empty folder.

    The source is a dataset, whose mix the shares are; or behaviours as `read_behaviors` takes them,
    beside the six in equal shares.
    """
    shares, types, rows = _shares(source), list[str](), list[dict[str, Any]]()
    length, width, _ = DIMENSIONS_M[AgentKind.CAR]
    for behavior, share in shares.items():
        rng = np.random.default_rng(0)
        for number in range(DRIVERS_OF_EACH):
            name, each = f"{behavior}_{number}", share / DRIVERS_OF_EACH
            profile = sample_profile(behavior.profile, rng)
            agent = AgentSpec(0, AgentKind.CAR, behavior, profile, (), 0.0, length, width)
            types.append("    " + type_element(agent, name, each))
            rows.append(
                {"driver": name, "behavior": str(behavior), "style": str(behavior.style),
                 "share": each}
                | {column: getattr(profile, field) for field, column in IN_TABLE.items()}
                | {"krauss_sigma": IMPERFECTION}
            )  # fmt: skip
    said = [
        f"{behavior}: " + ", ".join(f"{n} {getattr(behavior.profile, n):g}" for n in NOT_IN_SUMO)
        for behavior in shares
    ]
    notes = [f"not expressed by vTypes: {', '.join(NOT_IN_SUMO)}", *said]
    xml = [
        "<additional>", *(f"  <!-- {note} -->" for note in notes),
        '  <vTypeDistribution id="drivers">', *types, "  </vTypeDistribution>", "</additional>", "",
    ]  # fmt: skip
    left_out = ", ".join(name for name in PROFILE_FIELDS if name not in IN_TABLE)
    table = pd.DataFrame(rows).to_csv(index=False, float_format="%.6g")
    with new_folder(out) as folder:
        (folder / "vtypes.add.xml").write_text("\n".join(xml))
        (folder / "drivers.csv").write_text(
            f"# not expressed by IDM, Krauss and MOBIL: {left_out}\n{table}"
        )
    return [out / "vtypes.add.xml", out / "drivers.csv"]


def _shares(source: str) -> dict[Behavior, float]:
    """The share of each behaviour."""
    if is_dataset(source):
        dataset = open_dataset(source)
        mixes = [entry.options.get("mix") for entry in dataset.episodes()]
        found = [mix for mix in mixes if isinstance(mix, Mapping)]
        if not found:
            raise InputError(f"{source}: found no mix of behaviours, expected a generated dataset")
        number: Any = {b: np.mean([mix.get(b, 0.0) for mix in found]) for b in dataset.behaviors}
        return {b: float(share) for b, share in number.items() if share > 0}
    known = (*BEHAVIORS, *read_behaviors(source))
    return dict.fromkeys(known, 1.0 / len(known))
