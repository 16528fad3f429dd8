"""Trajectory prediction: a history, beliefs about the drivers and the road in, futures out.

``PREDICTORS`` names every predictor; each is a function ``(scene, posterior) -> Prediction``.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

from behaviors.errors import InputError
from behaviors.registry import Registry, own_function

if TYPE_CHECKING:
    from graphrqi.posterior import Posterior
    from graphrqi.predict.prediction import Prediction
    from graphrqi.predict.scene.scene import Scene
    from sim.episode.window import Window
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


def get_predictor(name: str) -> Predictor:
    """The predictor of that name.

    Raises:
        InputError: if the name is unknown; the message suggests the nearest one.
    """
    return PREDICTORS[name]


def chosen_predictor(name: str) -> Predictor:
    """The predictor that a user asks for.

    A name that was read from a file goes to `get_predictor`, which runs no other code than ours and
    that of installed packages.

    Args:
        name: a key of ``PREDICTORS``, or "module:function" of the user's own; the module may lie in
            the working folder.

    Raises:
        InputError: if the name is unknown; in a call, if the user's function does not return a
            `Prediction`.
    """
    from graphrqi.predict.prediction import Prediction

    if ":" not in name:
        return get_predictor(name)
    function = own_function("predictor", name)

    def checked(scene: Scene, posterior: Posterior) -> Prediction:
        prediction = function(scene, posterior)
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
    from graphrqi.predict.scene.scene import (
        LEARNED_S,
        check_history,
        check_horizon,
        make_scene,
        since_break,
    )

    function = get_predictor(predictor)
    check_map(predictor, road)
    check_horizon(horizon_s)
    check_history(history)
    if window is not None:
        history = window.of_tracks(history)
    history = since_break(history)
    network = None
    if weights is not None and predictor == "graphrqi-predict":
        from graphrqi.predict.learned.predictors import with_weights
        from graphrqi.predict.recorded.network import trained_network

        network, function = trained_network(weights), with_weights(weights)
    if road is None:
        from graphrqi.predict.extrapolation import WITHOUT_MAP
        from graphrqi.predict.prediction import STEP_S
        from graphrqi.predict.recorded.predictor import predict_recorded

        if history.time_s.size == 0:
            raise InputError("history: found no frame, expected at least 1")
        present = history.window(history.time_s.size, history.time_s.size)
        steps = round(horizon_s / STEP_S)
        if predictor in WITHOUT_MAP:
            return WITHOUT_MAP[predictor](present, steps)
        return predict_recorded(present, steps, network)
    scene = make_scene(history, road, max(horizon_s, LEARNED_S))
    return function(scene, posterior).until(horizon_s)


__all__ = ["PREDICTORS", "check_map", "chosen_predictor", "get_predictor", "predict"]
