"""The benches by name, each at full size and at a quick one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, cast

from behaviors.registry import Registry
from experiments.console.tables import Row


def _generate(quick: bool) -> list[Row]:
    from experiments.benches.generate import measure

    return measure(quick)


def _spectrum(quick: bool) -> list[Row]:
    from experiments.benches.spectrum import run_spectrum_bench, run_spectrum_study

    if quick:
        return [*run_spectrum_bench(sizes=(25, 50), steps=10), *run_spectrum_study(50, 50)]
    return [*run_spectrum_bench(), *run_spectrum_study()]


def _behaviors(quick: bool) -> list[Row]:
    from experiments.benches.behaviors import run_behaviors_bench

    return cast("list[Row]", run_behaviors_bench(quick=quick))


def _highway(quick: bool) -> list[Row]:
    from experiments.benches.highway import run_highway_bench

    rows = run_highway_bench((20,), 2.0, 10) if quick else run_highway_bench()
    return list(rows)


def _classification(quick: bool) -> list[Row]:
    from experiments.benches.classification import run_classification_bench

    return run_classification_bench(quick)


def _real_data(quick: bool) -> list[Row]:
    from experiments.benches.real_data import run_real_data_bench

    return run_real_data_bench(quick=quick)


def _prediction(quick: bool) -> list[Row]:
    from experiments.benches.prediction import run_prediction_bench

    return run_prediction_bench(quick)


def _navigation(quick: bool) -> list[Row]:
    from experiments.benches.navigation import run_navigation_bench

    return run_navigation_bench(quick)


def _loop(quick: bool) -> list[Row]:
    from experiments.benches.loop import run_loop_bench

    return [row for engine in ("sumo", "highway") for row in run_loop_bench(quick, engine)]


BENCHES: Final[Registry[Callable[[bool], list[Row]]]] = Registry(
    "bench",
    "graphrqi.benches",
    {
        "spectrum": _spectrum,
        "behaviors": _behaviors,
        "highway": _highway,
        "generate": _generate,
        "classification": _classification,
        "real-data": _real_data,
        "prediction": _prediction,
        "navigation": _navigation,
        "loop": _loop,
    },
)
"""Every bench; each takes whether to be quick and returns flat rows."""


NEED_RECORDINGS: Final = frozenset({"real-data"})
"""Benches on recordings, which are found through the environment variable ``GRAPHRQI_DATA``."""


def run_bench(name: str, quick: bool = False) -> list[Row]:
    """Run a bench.

    Args:
        name: a key of ``BENCHES``.
        quick: small sizes, to see that it works.

    Returns:
        Flat rows: what was measured, then metric, value, low, high, n.

    Raises:
        InputError: if there is no such bench.
    """
    return BENCHES[name](quick)
