"""The roads that the predictor for recordings is trained on beside random worlds.

Random worlds have straight roads, ramps and right-angled junctions. Recordings also cover
roundabouts, where lanes bend, and nearly empty motorways.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate

ROUNDABOUTS: Final = ((13.0, 1), (20.0, 1), (20.0, 2), (30.0, 2), (45.0, 2))
"""Radius of the ring, m, and lanes of each roundabout (from the smallest that a bus can pass to
those of country roads)."""

ROUNDABOUT_EPISODES, ROUNDABOUT_ENGINE = 2, "sumo-idm"
"""Episodes of each roundabout, and which law drives there."""

ROUNDABOUT_LIMITS_MPS: Final = (13.89, 8.33, 11.11, 16.67)
"""Limits of the roundabouts' arms, which their episodes take in turn, m/s."""

MOTORWAYS: Final = ("motorway", "motorway_ramps")
MOTORWAY_EPISODES: Final = 8
MOTORWAY_LIMITS_MPS: Final = (22.22, 50.0, 27.78, 36.11)
"""Episodes of each motorway, and the limits that they take in turn, m/s."""

EPISODE_S: Final = 60.0
"""Length of all episodes, s."""


def generate_roads(work: Path, seed: int, quiet: bool = False) -> list[Path]:
    """Generate the episodes of roundabouts and free motorways; needs netconvert.

    Args:
        work: folder for the data.
        seed: of drivers.
        quiet: whether to show no progress.

    Returns:
        The datasets of motorways and of roundabouts.

    Raises:
        InputError: if a program is missing.
    """
    work.mkdir(parents=True, exist_ok=True)
    rings = [_roundabout(work, radius_m, lanes) for radius_m, lanes in ROUNDABOUTS]
    kinds = {
        "free": GenerateConfig(
            scenarios=MOTORWAYS, episodes=MOTORWAY_EPISODES, seed=seed + 1, duration_s=EPISODE_S,
            flow="light", limits_mps=MOTORWAY_LIMITS_MPS,
        ),
        "roundabouts": GenerateConfig(
            scenarios=tuple(map(str, rings)), episodes=ROUNDABOUT_EPISODES, seed=seed,
            engine=ROUNDABOUT_ENGINE, duration_s=EPISODE_S, limits_mps=ROUNDABOUT_LIMITS_MPS,
        ),
    }  # fmt: skip
    found = []
    for kind, config in kinds.items():
        found.append(work / f"recorded-{kind}")
        generate(config, found[-1], None, quiet)
    return found


def _roundabout(work: Path, radius_m: float, lanes: int) -> Path:
    """The scenario's file of a roundabout."""
    file = work / f"roundabout-{radius_m:g}-{lanes}.toml"
    file.write_text(
        f'scenario = "roundabout"\nlanes = {lanes}\noptions = {{ radius_m = {radius_m} }}\n',
        encoding="utf-8",
    )
    return file
