"""How well the beliefs about drivers agree with what those drivers are seen doing.

A classifier may be wrong, about one driver or, far from where it was trained, about all. Each
behaviour foretells a wished speed and, by the car-following law, an acceleration now; how likely
they make what is seen, under the beliefs against under none, tells how far the beliefs can be
trusted, and the same of everybody else tells how far the classifier can be.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.rollout import agreement_kernel
from graphrqi.predict.rollout.driver_table import DriverTable
from graphrqi.predict.rollout.route import ACCELERATION_SD
from graphrqi.predict.scene.scene import Scene

FloatArray = NDArray[np.float64]

WISH_SD: Final = 0.18
"""How far drivers of one behaviour differ in the logarithm of their wished speed (our choice: the
scenarios' spread of 15 %, and how well a wish is seen)."""

OVER: Final = 0.03
"""Excess over the wished speed, as its logarithm, that says nothing (our choice)."""

MOST_ACCELERATION, MOST_WISH = 4.0, 8.0
"""Log-likelihood lost at most for one acceleration and for a wish (our choice)."""

LEAST_BELIEF: Final = 1e-4
"""No behaviour is believed in less."""

SUM_SCALE: Final = 5.0
"""What the sum over the others is divided by, and the most that it then is (our choice)."""


def agreement(
    scene: Scene, probability: FloatArray, asked: FloatArray, table: DriverTable
) -> FloatArray:
    """How much more likely the beliefs make what is seen than no beliefs would.

    Args:
        scene: the present.
        probability: (n, 6) beliefs; uniform rows for drivers of whom nothing is known.
        asked: (6, n) acceleration that each behaviour would have now, m/s2.
        table: calibrated driver numbers.

    Returns:
        (n, 3) logarithm of the ratio for the driver itself, its mean over all other
        drivers of whom something is believed, and its scaled sum over them.
    """
    seen = scene.seen
    return np.asarray(
        agreement_kernel.agreement(
            probability, LEAST_BELIEF, scene.accel, asked, ACCELERATION_SD, scene.on_path,
            seen.free_factor, seen.least_factor, np.log(table.behavior[:, 0]), WISH_SD, OVER,
            MOST_ACCELERATION, MOST_WISH, SUM_SCALE,
        )
    )  # fmt: skip
