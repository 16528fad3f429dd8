"""Compiles the kernels that classifying and predicting need, so that a first use need not wait.

``make install`` runs it as ``python -m experiments.cli.compile_kernels``. Either engine drives a
four-way intersection, and every frame is classified and predicted; numba caches the kernels
compiled on the way. Where everything is there already it takes some seconds.
"""

from __future__ import annotations

from typing import Final

from experiments.console.exit_codes import exit_on_user_error
from experiments.console.notices import show_notices

ENGINES: Final = ("sumo", "highway")
DURATION_S: Final = 20.0
"""How long either engine drives, s: until vehicles meet, which some kernels are needed for."""


def compile_kernels() -> None:
    """Classify and predict the frames of both engines."""
    from graphrqi.predict import predict
    from graphrqi.predict.recorded.predictor import predict_recorded
    from graphrqi.predict.scene.scene import make_scene
    from graphrqi.stream import load_stream
    from scenarios import SCENARIOS
    from sim.engines import get_engine
    from sim.scenario import sample_agents

    scenario = SCENARIOS["four_way_intersection"](duration_s=DURATION_S)
    agents = sample_agents(scenario, seed=0)
    for engine in ENGINES:
        stream = load_stream("graphrqi-plus")
        for frame in get_engine(engine)(scenario, agents, 0):
            posterior = stream.update(frame)
            predict(stream.history, posterior, scenario.road, horizon_s=5.0)
        predict(stream.history, posterior, None, horizon_s=5.0)
        seen = make_scene(stream.history, scenario.road).history
        predict_recorded(seen, 50, None, scenario.road)


if __name__ == "__main__":
    show_notices()
    with exit_on_user_error():
        compile_kernels()
