"""The roads that the predictor for recordings is trained on beside random worlds.

Random worlds have straight roads, ramps and right-angled junctions. Recordings are made at
roundabouts and in old towns, too, where lanes bend and streets meet at any angle. Motorways are
here so that all of these do not outweigh them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from scenarios.networks.build import find_program, run_program

ROUNDABOUTS: Final = ((13.0, 1), (20.0, 1), (20.0, 2), (30.0, 2), (45.0, 2))
"""Radius of the ring, m, and lanes of each roundabout (from the smallest that a bus can pass to
those of country roads)."""

ROUNDABOUT_EPISODES, ROUNDABOUT_S = 4, 120.0
"""Episodes of each roundabout, and their length, s."""

ROUNDABOUT_LIMITS_MPS: Final = (13.89, 8.33, 11.11, 16.67)
"""Limits of the roundabouts' arms, which their episodes take in turn, m/s."""

TOWNS: Final = 12
"""Towns, each with a net of its own."""

TOWN_S, TOWN_FLOW = 150.0, 1400.0
"""Length of their episodes, s, and vehicles per hour in each town (some 40 at a time)."""

TOWN_LIMITS_MPS: Final = (8.33, 10.0, 11.11, 13.89)
TOWN_CONTROLS: Final = ("priority", "traffic_light", "right_before_left")
"""Limits and usual controls of junctions that towns take in turn."""

TOWN_OPTIONS: Final = (
    "--rand", "--rand.iterations", "25", "--rand.min-distance", "60", "--rand.max-distance",
    "220", "--rand.min-angle", "50", "--rand.connectivity", "0.9", "--no-turnarounds", "true",
    "--tls.guess", "true",
)  # fmt: skip
"""Streets of 60 to 220 m that meet at angles of 50 degrees and more (blocks of towns that were not
planned)."""

MOTORWAYS: Final = ("motorway", "motorway_ramps")
MOTORWAY_EPISODES, MOTORWAY_S = 4, 120.0
MOTORWAY_LIMITS_MPS: Final = (22.22, 36.11, 27.78, 33.33)
"""Episodes of each motorway, their length, s, and the limits that they take in turn, m/s."""

ROUNDABOUT_ENGINE, TOWN_ENGINE = "sumo-idm", "sumo"
"""Which law drives where (each of both)."""


def generate_roads(work: Path, seed: int, quiet: bool = False) -> list[Path]:
    """Generate the episodes of roundabouts, towns and motorways; needs netconvert and netgenerate.

    Args:
        work: folder for the data.
        seed: of drivers and nets.
        quiet: whether to show no progress.

    Returns:
        The datasets of roundabouts, of towns, and of motorways.

    Raises:
        InputError: if a program is missing.
    """
    work.mkdir(parents=True, exist_ok=True)
    rings = [_roundabout(work, radius_m, lanes) for radius_m, lanes in ROUNDABOUTS]
    towns = [_town(work, seed + index, index) for index in range(TOWNS)]
    kinds = {
        "roundabouts": GenerateConfig(
            scenarios=tuple(map(str, rings)), episodes=ROUNDABOUT_EPISODES, seed=seed,
            engine=ROUNDABOUT_ENGINE, duration_s=ROUNDABOUT_S, limits_mps=ROUNDABOUT_LIMITS_MPS,
        ),
        "towns": GenerateConfig(
            scenarios=tuple(map(str, towns)), episodes=1, seed=seed, engine=TOWN_ENGINE,
            duration_s=TOWN_S, flow=TOWN_FLOW,
        ),
        "motorways": GenerateConfig(
            scenarios=MOTORWAYS, episodes=MOTORWAY_EPISODES, seed=seed, duration_s=MOTORWAY_S,
            limits_mps=MOTORWAY_LIMITS_MPS,
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


def _town(work: Path, seed: int, index: int) -> Path:
    """The net of a town."""
    file = work / f"town-{index}.net.xml"
    if not file.is_file():
        own = (
            "--seed", str(seed), "--default.lanenumber", str(1 + index % 2),
            "--default.speed", str(TOWN_LIMITS_MPS[index % len(TOWN_LIMITS_MPS)]),
            "--default-junction-type", TOWN_CONTROLS[index % len(TOWN_CONTROLS)],
        )  # fmt: skip
        run_program([find_program("netgenerate"), *TOWN_OPTIONS, *own], work, file)
    return file
