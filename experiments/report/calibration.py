"""The page of a calibration: the population beside the six profiles, and the drives it fits."""

from __future__ import annotations

from typing import Final

import numpy as np

from behaviors.labels import BEHAVIORS
from behaviors.populations import NUMBERS, Population
from behaviors.profiles import PROFILES
from experiments.report.charts import Axis, Chart, Line, Point
from experiments.report.templates import rendered
from experiments.scoring.calibration import Calibrated
from graphrqi.calibrate.driving_on import driven_places, errors_of, longest_led
from graphrqi.calibrate.laws import Law

WORDS: Final[dict[str, str]] = {
    "desired_speed_mps": "desired speed, m/s",
    "time_headway_s": "time headway, s",
    "min_gap_m": "minimum gap, m",
    "max_accel_mps2": "acceleration, m/s²",
    "comfort_decel_mps2": "comfortable braking, m/s²",
}
"""The numbers' names on the page."""

PAIRS_SHOWN: Final = 2
"""How many of the best and of the worst fitted drives are shown."""

LINE_POINTS: Final = 120
"""Points of a drawn line."""


def calibration_page(calibrated: Calibrated) -> str:
    """The page as HTML.

    Args:
        calibrated: the drivers under both laws.
    """
    law = calibrated.better
    population = calibrated.population(law)
    known = calibrated.laws[law].summary().known.mean(axis=0)
    return rendered(
        "calibration.html",
        name=calibrated.source,
        law=str(law),
        drivers=len(calibrated.drivers),
        counts=calibrated.laws[law].counts,
        told=[calibrated.law_told(law) for law in (Law.IDM, Law.KRAUSS)],
        marginals=[_marginal(population, number) for number in NUMBERS],
        numbers=[
            (WORDS[n], population.median[k], population.log_spread[k], known[k],
             population.correlation[k])
            for k, n in enumerate(NUMBERS)
        ],
        words=[WORDS[n] for n in NUMBERS],
        profiles=[
            (str(b), [population.quantile(n, getattr(PROFILES[b], n)) for n in NUMBERS[1:]])
            for b in BEHAVIORS
        ],
        drives=_drives(calibrated, law),
    )  # fmt: skip


def _marginal(population: Population, number: str) -> Chart:
    """A number's density over the population, and where the six profiles' medians lie."""
    k = NUMBERS.index(number)
    centre, spread = np.log(population.median[k]), max(float(population.log_spread[k]), 1e-3)
    logs = np.linspace(centre - 3.0 * spread, centre + 3.0 * spread, LINE_POINTS)
    density = np.exp(-0.5 * ((logs - centre) / spread) ** 2)
    lines = [
        Line("population", tuple(
            Point(float(np.exp(x)), float(y)) for x, y in zip(logs, density, strict=True)
        ))
    ]  # fmt: skip
    if number in NUMBERS[1:]:
        for behavior in BEHAVIORS:
            at = float(getattr(PROFILES[behavior], number))
            lines.append(Line(str(behavior), (Point(at, 0.0), Point(at, 0.5))))
    return Chart(WORDS[number], Axis(WORDS[number]), Axis("density over its largest"), tuple(lines))


def _drives(calibrated: Calibrated, law: Law) -> list[tuple[str, float, Chart]]:
    """The best and worst fitted drives: words, error of the gap, m, and a chart."""
    fitted = calibrated.laws[law]
    logs = fitted.logs.mean(axis=1)
    errors = []
    for i, driver in enumerate(calibrated.drivers):
        drive = longest_led(driver.drive)
        if drive is not None:
            errors.append((float(errors_of(law, logs[i], [drive])[0]), i, drive))
    errors.sort(key=lambda one: one[:2])
    half = min(PAIRS_SHOWN, len(errors) // 2)
    chosen = [*errors[:half], *errors[len(errors) - max(half, 1) :]]
    shown = []
    for place, (error, i, drive) in enumerate(chosen):
        driver = calibrated.drivers[i]
        watched = np.flatnonzero(drive.rows[1] > 0.0)
        time_s = np.asarray(drive.step_s * watched, dtype=np.float64)
        leader, driven = drive.rows[3], driven_places(law, logs[i : i + 1], drive)[0]
        gaps = (("recorded", leader - drive.rows[0]), ("simulated", leader - driven))
        every = max(1, time_s.size // LINE_POINTS)
        lines = [
            Line(name, tuple(
                Point(float(t), float(g))
                for t, g in zip(time_s[::every], gap[watched][::every], strict=True)
            ))
            for name, gap in gaps
        ]  # fmt: skip
        which = "best" if place < half else "worst"
        title = f"{which} fitted: {driver.name} of {calibrated.recording[i]}"
        shown.append((title, error, Chart(title, Axis("time, s"), Axis("gap, m"), tuple(lines))))
    return shown
