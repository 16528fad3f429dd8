"""Home seen by worse sensors: noise of positions, frame rates, lost frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from experiments.benches.classification.recordings import (
    UNDISTURBED,
    Disturbed,
    Recordings,
)
from experiments.benches.classification.rows import keys_of
from experiments.benches.classification.streams import answer_rows, by_age, stream_all
from experiments.score.rows import Row
from graphrqi.methods import Model

NOISE_M: Final = (0.03, 0.1, 0.25, 0.5)
"""Standard deviations of positions, m."""

LOST: Final = (0.05, 0.15, 0.3)
"""Shares of frames lost."""

RATES_HZ: Final = (25.0, 5.0, 2.5)
"""Frame rates, beside the usual 10 Hz. More than is simulated lies on splines."""

FINE_STEP_S: Final = 0.04
"""A simulation that itself steps at 25 Hz, s: its drivers react more often than usual ones."""


def disturbances(levels: int | None = None) -> list[Disturbed]:
    """What the usual recordings are disturbed by, at the first levels of each kind."""
    kinds = {
        "position noise": NOISE_M,
        "correlated noise": NOISE_M,
        "dropped frames": LOST,
        "frame rate": RATES_HZ,
    }
    return [
        UNDISTURBED,
        *(Disturbed(name, level) for name, found in kinds.items() for level in found[:levels]),
    ]


def noise_rows(
    models: Mapping[str, tuple[str, Model]],
    usual: Recordings,
    fine: Recordings,
    jobs: int | None = None,
    levels: int | None = None,
) -> list[Row]:
    """Rows of the protocol ``noise``.

    Args:
        models: by the words that say how each was trained: its method's name and the model.
        usual: usual traffic that nothing was trained on.
        fine: the same drivers in a simulation that steps at ``FINE_STEP_S``.
        jobs: processes; None for one per core.
        levels: of each disturbance; None for all.

    Returns:
        By model, scenario, disturbance and age.
    """
    rows: list[Row] = []
    for trained, (method, model) in models.items():
        for disturbed in disturbances(levels):
            about = str(disturbed) or "undisturbed"
            rows += _rows(usual, method, model, disturbed, f"{trained}, {about}", jobs)
        about = f"{trained}, simulated at {1 / FINE_STEP_S:g} Hz"
        rows += _rows(fine, method, model, UNDISTURBED, about, jobs)
    return rows


def _rows(
    recordings: Recordings,
    method: str,
    model: Model,
    disturbed: Disturbed,
    variation: str,
    jobs: int | None,
) -> list[Row]:
    dataset = recordings.dataset
    calls = [(dataset.path, entry, i) for i, entry in enumerate(dataset.manifest.episodes)]
    samples, probability = stream_all(calls, model, jobs, disturbed)
    rows: list[Row] = []
    for scenario in dataset.scenarios:
        chosen = recordings.scenario[samples.episode] == scenario
        for window_s, here, answers in by_age(samples.where(chosen), probability[chosen]):
            keys = keys_of("noise", scenario, method, window_s, variation)
            rows += answer_rows(here, answers, keys)
    return rows
