"""The paper's pedestrian figure: a driver predicted to let somebody cross, and one that is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from experiments.figure_files import write_figure
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.scene.scene import Scene
from sim.frames import PEDESTRIAN, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN_M: Final = 45.0
"""The picture shows this much around the driver, m."""


@dataclass(frozen=True, eq=False)
class YieldCase:
    """A driver before an occupied crossing.

    Attributes:
        predictor: whose prediction.
        chance: the predicted chance that it yields.
        yielded: whether it did.
        poses: (n, 5) x, y, heading, length, width of everyone near, the driver first.
        walks: (n,) whether each of them walks.
        futures: (K, H, 2) predicted places of the driver, m.
        probability: (K,).
        truth: (H, 2) where it went, m.
        lanes: centre lines.
        crossings: centre lines and widths.
    """

    predictor: str
    chance: float
    yielded: bool
    poses: FloatArray
    walks: np.ndarray[tuple[int], np.dtype[np.bool_]]
    futures: FloatArray
    probability: FloatArray
    truth: FloatArray
    lanes: tuple[FloatArray, ...]
    crossings: tuple[tuple[FloatArray, float], ...]

    @classmethod
    def of(
        cls, scene: Scene, prediction: Prediction, row: int, chance: float, yielded: bool,
        truth: FloatArray, predictor: str,
    ) -> YieldCase:  # fmt: skip
        """What is drawn of one driver of a scene."""
        away = np.hypot(*(scene.xy - scene.xy[row]).T)
        away[row] = -1.0
        near = np.argsort(away, kind="stable")
        near = near[away[near] < SHOWN_M]
        history = scene.history
        poses = np.column_stack([scene.xy, scene.heading, history.length, history.width])[near]
        return cls(
            predictor=predictor, chance=chance, yielded=yielded,
            poses=poses, walks=history.kind[near] == PEDESTRIAN, futures=prediction.xy[row],
            probability=prediction.probability[row], truth=truth,
            lanes=tuple(x.centerline for x in scene.road.lanes if not x.walking),
            crossings=tuple((c.centerline, c.width_m) for c in scene.road.crossings),
        )  # fmt: skip


def clearest(cases: Sequence[YieldCase]) -> list[YieldCase]:
    """The driver that yielded and was most expected to, and the one that did not and was least."""
    yes = [case for case in cases if case.yielded]
    no = [case for case in cases if not case.yielded]
    found = [max(yes, key=lambda c: c.chance)] if yes else []
    return found + ([min(no, key=lambda c: c.chance)] if no else [])


def draw_cases(cases: Sequence[YieldCase], path: Path) -> None:
    """Draw cases side by side.

    Args:
        cases: at least one.
        path: picture to write; its ending says the format.

    Raises:
        OSError: if it cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4 * len(cases), 5.2), layout="constrained")
    for axis, case in zip(figure.subplots(1, len(cases), squeeze=False)[0], cases, strict=True):
        for line in case.lanes:
            axis.plot(*line.T, color="#d9d9d9", linewidth=14, solid_capstyle="butt", zorder=0)
        for line, width_m in case.crossings:
            axis.plot(*line.T, color="#fff3b0", linewidth=2.2 * width_m, zorder=1)
        order = np.argsort(case.probability)
        for k in order:
            axis.plot(
                *case.futures[k].T, color="#0072B2", zorder=3,
                linewidth=1.5, alpha=0.25 + 0.75 * float(case.probability[k]),
                label=f"{case.predictor}, 5 s" if k == order[-1] else None,
            )  # fmt: skip
            axis.plot(*case.futures[k, -1], "o", color="#0072B2", markersize=4, zorder=3,
                      alpha=0.25 + 0.75 * float(case.probability[k]))  # fmt: skip
        axis.plot(*case.truth.T, "--", color="#D55E00", zorder=4, label="what it did")
        for i, (x, y, heading, length, width) in enumerate(case.poses):
            _draw_pose(axis, x, y, heading, length, width, bool(case.walks[i]), driver=i == 0)
        x, y = case.poses[0, :2]
        ahead = 15.0 * np.array([np.cos(case.poses[0, 2]), np.sin(case.poses[0, 2])])
        axis.set_xlim(x + ahead[0] - SHOWN_M / 1.5, x + ahead[0] + SHOWN_M / 1.5)
        axis.set_ylim(y + ahead[1] - SHOWN_M / 2.5, y + ahead[1] + SHOWN_M / 2.5)
        axis.set_aspect("equal")
        did = "it yielded" if case.yielded else "it did not yield"
        axis.set_title(f"chance of yielding {case.chance:.0%}; {did}")
        axis.set_xlabel("x, m")
        axis.legend(loc="lower left", fontsize="small")
    write_figure(figure, path, dpi=130)


def _draw_pose(
    axis: Axes, x: float, y: float, heading: float, length: float, width: float, walks: bool,
    *, driver: bool,
) -> None:  # fmt: skip
    """Draw the outline of a vehicle, or a pedestrian as a dot."""
    from matplotlib.patches import Polygon

    if walks:
        axis.plot([x], [y], "o", color="#009E73", markersize=6, zorder=5)
        return
    cos, sin = np.cos(heading), np.sin(heading)
    corner = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * (length / 2, width / 2)
    turned = corner @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
    axis.add_patch(Polygon(turned, color="#CC79A7" if driver else "#8C8C8C", zorder=5))
