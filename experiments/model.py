"""Train again what ships in the package: ``python -m experiments.model`` (or ``make model``).

The classifier and the predictors are trained on different episodes, since a classifier knows its
own training drivers too well. The data stay in ``runs/model``; running again goes on with them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from experiments.demo import BEST_METHOD, SCENARIOS
from experiments.generate import GenerateConfig, generate
from experiments.predictor_training import calibrate_drivers, train_predictors
from experiments.train import train_dataset
from graphrqi.methods import MODELS
from graphrqi.predict import learned
from graphrqi.predict.drivers import CARD

CLASSIFIER_SEED: Final = 2020
PREDICTOR_SEED: Final = 2021
"""Seeds of the two datasets (our choice: unlike anything that examples use)."""

CLASSIFIER_EPISODES: Final = 30
PREDICTOR_EPISODES: Final = 15
"""Per scenario, 300 s each, 60 % of them for training (our choice: more gained little)."""


def build_models(work: Path, quiet: bool = False) -> None:
    """Generate the data and train the drivers' numbers, the classifier and the predictors.

    Args:
        work: folder for the data.
        quiet: whether to show no progress.
    """
    data = {}
    for name, seed, episodes in (
        ("classifier", CLASSIFIER_SEED, CLASSIFIER_EPISODES),
        ("predictor", PREDICTOR_SEED, PREDICTOR_EPISODES),
    ):
        data[name] = work / name
        config = GenerateConfig(scenarios=SCENARIOS, episodes=episodes, seed=seed)
        generate(config, data[name], None, quiet)
    train_dataset(data["classifier"], BEST_METHOD, MODELS / BEST_METHOD, quiet=quiet)
    package = Path(learned.__file__).parent
    calibrate_drivers(data["predictor"], package / CARD, quiet=quiet)
    train_predictors(data["predictor"], BEST_METHOD, package, quiet=quiet)


if __name__ == "__main__":
    build_models(Path("runs/model"))
