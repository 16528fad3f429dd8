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
        "generate": "experiments.benches.generate:BENCH",
        "classification": "experiments.benches.classification.bench:BENCH",
        "real-data": "experiments.benches.real_data:BENCH",
        "prediction": "experiments.benches.prediction.bench:BENCH",
        "loop": "experiments.benches.loop:BENCH",
    },
)
"""Every bench; its module is imported when it is asked for."""
