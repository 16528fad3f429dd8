"""How likely a drive is for drivers' numbers: `filter.tell` with its arrays set up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphrqi.calibrate.drives import Drive
from graphrqi.calibrate.laws import Law

FloatArray = NDArray[np.float64]


def log_likelihood(law: Law, logs: FloatArray, drive: Drive, newer: float) -> FloatArray:
    """(K,) log-likelihoods of a drive.

    Args:
        law: the law.
        logs: (K, D) logarithms of numbers, columns as ``laws.FIELDS[law]``; K is a multiple of
            ``filter.LANES``.
        drive: of the driver.
        newer: as ``posterior.moving_on`` has it.

    Examples:
        >>> from graphrqi.calibrate.drives import Stretch, make_drive
        >>> from graphrqi.calibrate.laws import prior
        >>> t = np.arange(0.0, 20.0, 0.1)
        >>> drive = make_drive([Stretch(t, 10.0 * t, 17.0 + 10.0 * t)])
        >>> tried = np.tile(prior(Law.IDM)[0], (32, 1))
        >>> tried[0, 1] = np.log(4.0)  # it keeps 1.7 s, or 1.4 s and the gap at a standstill
        >>> told = log_likelihood(Law.IDM, tried, drive, 0.5)
        >>> bool(told[0] < told[1])
        True
    """
    from graphrqi.calibrate.filter import tell

    out = np.empty(len(logs))
    rows = np.minimum(drive.rows, 1e9)  # leaders that are none
    tell(law.code, logs, 0.0, rows, drive.begins, drive.steps(newer), out)
    return out
