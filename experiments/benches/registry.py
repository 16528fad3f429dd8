"""The benches by name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from behaviors.registry import Registry

if TYPE_CHECKING:
    from experiments.benches.contract import Bench

BENCHES: Final[Registry[Bench[Any]]] = Registry(
    "bench",
    "graphrqi.benches",
    {
        "spectrum": "experiments.benches.spectrum.bench:BENCH",
        "behaviors": "experiments.benches.behaviors:BENCH",
        "highway": "experiments.benches.highway:BENCH",
        "generate": "experiments.benches.generate:BENCH",
        "classification": "experiments.benches.classification.bench:BENCH",
        "real-data": "experiments.benches.real_data:BENCH",
        "prediction": "experiments.benches.prediction.bench:BENCH",
        "navigation": "experiments.benches.navigation:BENCH",
        "loop": "experiments.benches.loop:BENCH",
        "branches": "experiments.benches.branches:BENCH",
        "blame": "experiments.benches.blame:BENCH",
        "drive": "experiments.benches.drive.bench:BENCH",
        "hostile": "experiments.benches.hostile.bench:BENCH",
        "roads": "experiments.benches.roads.bench:BENCH",
        "realism": "experiments.benches.realism.bench:BENCH",
        "calibration": "experiments.benches.calibration:BENCH",
    },
)
"""Every bench; its module is imported when it is asked for."""
