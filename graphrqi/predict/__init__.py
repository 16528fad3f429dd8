"""Trajectory prediction: a history, beliefs about the drivers and the road in, futures out.

``PREDICTORS`` names every predictor; each is a function ``(scene, posterior) -> Prediction``.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from behaviors.errors import InputError
from behaviors.registry import Registry, own_function

if TYPE_CHECKING:
    from graphrqi.posterior import Posterior
    from graphrqi.predict.prediction import Prediction
    from graphrqi.predict.scene.scene import Scene, Unmapped
    from sim.episode.live import Window
    from sim.frames import Tracks
    from sim.road import Road

    Predictor: TypeAlias = Callable[[Scene, Posterior], Prediction]

PREDICTORS: Final[Registry[Predictor]] = Registry(
    "predictor",
    "graphrqi.predictors",
    {
        "constant-velocity": "graphrqi.predict.extrapolation:constant_velocity",
        "constant-acceleration": "graphrqi.predict.extrapolation:constant_acceleration",
        "kalman": "graphrqi.predict.extrapolation:kalman",
        "car-following": "graphrqi.predict.rollout.following:aware",
        "car-following-blind": "graphrqi.predict.rollout.following:blind",
        "lstm": "graphrqi.predict.learned.predictors:lstm",
        "graphrqi-predict": "graphrqi.predict.learned.predictors:graphrqi_predict",
    },
)
"""Every predictor by name."""

NO_MAP_NEEDED: Final = ("constant-velocity", "constant-acceleration", "kalman", "graphrqi-predict")
"""Predictors that work without a map; `graphrqi-predict` then uses its network for recordings."""


def chosen_predictor(name: str) -> Predictor:
    """The predictor that a user asks for.

    A name that was read from a file is looked up in ``PREDICTORS`` alone, which runs no other code
    than ours and that of installed packages.

    Args:
        name: a key of ``PREDICTORS``, or "module:function" of the user's own; the module may lie in
            the working folder.

    Raises:
        InputError: if the name is unknown; in a call, if the user's function fails or does not
            return a `Prediction`.
    """
    from graphrqi.predict.prediction import Prediction

    if ":" not in name:
        return PREDICTORS[name]
    function = own_function("predictor", name)

    def checked(scene: Scene, posterior: Posterior) -> Prediction:
        try:
            prediction = function(scene, posterior)
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            raise InputError(
                f"predictor: found {type(error).__name__} in {name!r}, {where.filename} line "
                f"{where.lineno}: {error}; expected a Prediction"
            ) from error
        if not isinstance(prediction, Prediction):
            raise InputError(
                f"predictor: found {type(prediction).__name__} from {name!r}, expected a Prediction"
            )
        return prediction

    return checked


def check_map(name: str, road: Road | None) -> None:
    """Refuse predictors that need a map where there is none.

    Args:
        name: a key of ``PREDICTORS``, or "module:function".
        road: the map, if there is one.

    Raises:
        InputError: if the predictor needs a map and ``road`` is None.
    """
    if road is None and name not in NO_MAP_NEEDED:
        raise InputError(
            f"road: found none for the predictor {name!r}, expected a map, or one of "
            f"{', '.join(NO_MAP_NEEDED)}"
        )


def predict(
    history: Tracks,
    posterior: Posterior,
    road: Road | None,
    horizon_s: float = 5.0,
    predictor: str = "graphrqi-predict",
    weights: Path | None = None,
    window: Window | None = None,
) -> Prediction:
    """Predict where every agent of a history will be.

    Args:
        history: tracks whose last column is the present.
        posterior: beliefs about the drivers; others count as unknown.
        road: the map; without one, only predictors of `NO_MAP_NEEDED` answer.
        horizon_s: how far ahead, s.
        predictor: a key of ``PREDICTORS``.
        weights: folder that ``graphrqi train --predictor`` wrote; None for the shipped network.
        window: which agents are predicted; None for everybody.

    Returns:
        Futures of every agent present now, every 0.1 s up to the horizon.

    Raises:
        InputError: if the predictor is unknown or lacks its map, the horizon is too short, or the
            history is empty or not finite.
    """
    from graphrqi.predict.prediction import STEP_S
    from graphrqi.predict.scene.scene import (
        LEARNED_S,
        Unmapped,
        check_history,
        check_horizon,
        make_scene,
        present_agents,
        since_break,
    )

    function: Callable[[Any, Posterior], Prediction] = PREDICTORS[predictor]
    check_map(predictor, road)
    check_horizon(horizon_s)
    check_history(history)
    if window is not None:
        history = window.of_tracks(history)
    if weights is not None and predictor == "graphrqi-predict":
        from graphrqi.predict.learned.predictors import with_weights

        function = with_weights(Path(weights))
    if road is None:
        scene: Scene | Unmapped = Unmapped(
            present_agents(since_break(history)), round(horizon_s / STEP_S)
        )
    else:
        scene = make_scene(history, road, max(horizon_s, LEARNED_S))
    return function(scene, posterior).until(horizon_s)


__all__ = ["PREDICTORS", "check_map", "chosen_predictor", "predict"]
