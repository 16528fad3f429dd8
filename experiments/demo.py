"""The whole loop on two scenarios: generate, train, classify, predict, report.

``python -m experiments.demo`` (or ``make demo``) leaves ``runs/demo``: the data, the models, all
figures as rows in ``rows.json``, and one page, ``report.html``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from experiments.console.notices import exit_on_user_error, show_notices
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.report.findings import findings
from experiments.report.page import read_source, write_report
from experiments.score.answers import scores_table
from experiments.score.labels import answer_episodes, scored_answers
from experiments.score.predictions import errors_table, predict_dataset
from experiments.score.rows import Row, dataset_id, show_table, stamped, write_rows
from experiments.training.classifier import train_model
from graphrqi.model_files import save_model
from sim.store.dataset import open_dataset

SCENARIOS: Final = ("straight_road", "four_way_intersection")
METHODS: Final = ("majority", "graphrqi", "graphrqi-invariant", "graphrqi-plus")
PREDICTORS: Final = (
    "constant-velocity", "car-following-blind", "car-following", "graphrqi-predict",
)  # fmt: skip
BEST_METHOD: Final = "graphrqi-plus"


def run_demo(
    out: Path,
    seed: int = 0,
    episodes: int = 20,
    duration_s: float = 150.0,
    jobs: int | None = None,
    quiet: bool = False,
) -> list[Row]:
    """Run the whole loop into a folder, and return all figures, as in its ``rows.json``.

    Methods learn from training episodes, are stopped and calibrated on validation episodes, and are
    scored on test episodes by their last answers. Predictors are given the classifier's beliefs,
    never the truth. What is in the folder already and fits is kept. There are at least 3 episodes
    of each scenario, three fifths of them to train.
    """
    data = out / "data"
    config = GenerateConfig(
        scenarios=SCENARIOS, episodes=episodes, seed=seed, duration_s=duration_s
    )
    generate(config, data, jobs, quiet)
    dataset = open_dataset(data)
    scores: list[Row] = []
    for method in METHODS:
        model = train_model([dataset], method, seed=seed, jobs=jobs, quiet=quiet)
        save_model(model, out / ("model" if method == BEST_METHOD else f"models/{method}"))
        answered = answer_episodes(model, [dataset], split="test", jobs=jobs, quiet=quiet)
        scores += [{**row, "method": method} for row in scored_answers(answered, method)]
    errors = predict_dataset(data, PREDICTORS, 5.0, str(out / "model"), jobs=jobs, quiet=True)
    known = dataset_id(dataset)
    rows = [*stamped(scores, "train", seed, known), *stamped(errors, "predict", seed, known)]
    write_rows(rows, out / "rows.json")
    return rows


def main() -> None:
    """Run the demo into ``runs/demo`` and print its tables and findings."""
    out = Path("runs/demo")
    rows = run_demo(out)
    page = write_report([out])
    answers = [row for row in rows if "method" in row]
    lines = scores_table(answers, ("scenario", "method"))
    show_table(rows, title="last answers about drivers", lines=lines)
    predictions = [row for row in rows if "predictor" in row]
    show_table(rows, title="predictions", lines=errors_table(predictions))
    for finding in findings(read_source(out)):
        print(f"- {finding}")
    print(f"\n{page}")


if __name__ == "__main__":
    show_notices()
    with exit_on_user_error():
        main()
