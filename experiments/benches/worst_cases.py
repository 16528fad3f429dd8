"""The page of the predictions with the largest errors on recordings, family by family."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from typing import Final

import numpy as np
from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from sim.frames import FloatArray

WORST: Final = 10
"""Cases of each family that are shown, at most one of each vehicle."""

MARGIN_M: Final = 12.0
"""How much is shown around what a case is about, m."""

LEAST_SHARE: Final = 0.03
"""Futures that are less likely are not drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One prediction of one vehicle, and what happened.

    Attributes:
        family: what kind of place it is.
        recording: the dataset, the place and the recording.
        vehicle: its name there.
        time_s: the present.
        error_m: mean distance of the likeliest future.
        steady_error_m: the same for constant velocity.
        past: (P, 2) where it had been, m.
        truth: (K, 2) where it went, m.
        futures: (M, K, 2) where it might have gone, m.
        probability: (M,) of these futures.
        others: (Q, 2) where the others near by were at the present, m.
        lanes: centre lines of the lanes near by, each (L, 2), m; () without a map.
    """

    family: str
    recording: str
    vehicle: str
    time_s: float
    error_m: float
    steady_error_m: float
    past: FloatArray
    truth: FloatArray
    futures: FloatArray
    probability: FloatArray
    others: FloatArray
    lanes: tuple[FloatArray, ...]


def worst_of(cases: Iterable[Case]) -> list[Case]:
    """The `WORST` cases of each family, the worst first, and at most one of each vehicle."""
    found: list[Case] = []
    ordered = sorted(cases, key=lambda case: (case.family, -case.error_m))
    for _, those in groupby(ordered, key=lambda case: case.family):
        of_vehicle: dict[tuple[str, str], Case] = {}
        for case in those:
            of_vehicle.setdefault((case.recording, case.vehicle), case)
        found += list(of_vehicle.values())[:WORST]
    return found


def worst_cases_page(cases: Iterable[Case], predictor: str) -> str:
    """The page as HTML.

    Args:
        cases: of any families; the worst of each are shown.
        predictor: whose predictions they are.
    """
    families = [
        (family, [(_words(case), _picture(case)) for case in those])
        for family, those in groupby(worst_of(cases), key=lambda case: case.family)
    ]
    template = Environment(loader=PackageLoader("experiments.benches", "."), autoescape=True)
    return template.get_template("worst_cases.html").render(predictor=predictor, families=families)


def _words(case: Case) -> str:
    """The caption of a picture."""
    return (
        f"{case.recording}, vehicle {case.vehicle} at {case.time_s:.1f} s: "
        f"{case.error_m:.1f} m off on average, constant velocity {case.steady_error_m:.1f} m"
    )


def _picture(case: Case) -> Markup:
    """The lanes, the others, the past, what was predicted, and what happened."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    shown = case.probability >= min(LEAST_SHARE, float(case.probability.max()))
    about = np.concatenate([case.past, case.truth, case.futures[shown].reshape(-1, 2)])
    low, high = about.min(axis=0), about.max(axis=0)
    middle, half = (low + high) / 2.0, float((high - low).max()) / 2.0 + MARGIN_M
    with rc_context({"svg.hashsalt": _words(case)}):
        figure = Figure(figsize=(4.2, 4.2), layout="constrained")
        axes = figure.add_subplot()
        for lane in case.lanes:
            axes.plot(*lane.T, color="#99a1ab", linewidth=0.8, zorder=1)
        axes.plot(*case.others.T, "s", color="#99a1ab", markersize=4, label="others", zorder=2)
        best = int(case.probability.argmax())
        for number in np.flatnonzero(shown):
            way = np.concatenate([case.past[-1:], case.futures[number]])
            likeliest = number == best
            axes.plot(
                *way.T, color="#0072B2", linewidth=2.0 if likeliest else 1.0, zorder=3,
                alpha=1.0 if likeliest else 0.25 + 0.6 * float(case.probability[number]),
                label="predicted" if likeliest else None,
            )  # fmt: skip
        way = np.concatenate([case.past[-1:], case.truth])
        axes.plot(*way.T, "o-", color="#D55E00", markersize=2.5, label="happened", zorder=4)
        axes.plot(*case.past.T, color="#55606E", linewidth=2.0, label="past", zorder=5)
        (left, bottom), (right, top) = middle - half, middle + half
        axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="x, m", ylabel="y, m")
        axes.set_aspect("equal")
        figure.legend(loc="outside lower left", ncols=4, frameon=False, handlelength=1.6)
        out = io.StringIO()
        figure.savefig(out, format="svg", transparent=True, metadata={"Date": None})
    return Markup(out.getvalue()[out.getvalue().index("<svg") :])
