"""The whole loop on both scenarios: generate, train, classify, predict, report.

``python -m experiments.demo`` (or ``make demo``) leaves ``runs/demo``: the data, the models, the
numbers in ``metrics.json`` and one page, ``report.html``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from experiments.console.exit_codes import exit_on_user_error
from experiments.console.notices import show_notices
from experiments.generate.configuration import GenerateConfig
from experiments.generate.dataset import generate
from experiments.report.page import printed_tables, write_report
from experiments.report.run_file import Metrics, RunFile, Score, installed, read_run, write_run
from experiments.report.tables import Table
from experiments.rows import write_json
from experiments.scoring.prediction import metrics_tree, predict_dataset
from experiments.training.classifier import train_model
from graphrqi.model_files import save_model
from sim.store.dataset import open_dataset

SCENARIOS: Final = ("straight_road", "four_way_intersection")
METHODS: Final = ("majority", "graphrqi", "graphrqi-invariant", "graphrqi-plus")
PREDICTORS: Final = (
    "constant-velocity", "car-following-blind", "car-following", "graphrqi-predict",
)  # fmt: skip
BEST_METHOD: Final = "graphrqi-plus"
EPISODES: Final = 20
"""Per scenario: 12 to train, 4 to validate, 4 to test."""
DURATION_S: Final = 150.0
HORIZON_S: Final = 5.0

PROTOCOL: Final = (
    "Every episode is a seed of its own. Methods were trained on the training episodes, stopped "
    "and calibrated on the validation episodes, and are scored on test episodes that they never "
    "saw, from positions only. Predictors are given the classifier's beliefs, never the truth."
)


def run_demo(
    out: Path,
    seed: int = 0,
    episodes: int = EPISODES,
    duration_s: float = DURATION_S,
    jobs: int | None = None,
    quiet: bool = False,
) -> Metrics:
    """Run the whole loop.

    Args:
        out: the run's folder; what is there already and fits is kept.
        seed: same seed, same numbers.
        episodes: per scenario, at least 3.
        duration_s: of each episode.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        The numbers, as in ``metrics.json``.
    """
    data = out / "data"
    config = GenerateConfig(
        scenarios=SCENARIOS, episodes=episodes, seed=seed, duration_s=duration_s
    )
    generate(config, data, jobs, quiet)
    dataset = open_dataset(data)
    classification: dict[str, dict[str, dict[str, Score]]] = {s: {} for s in SCENARIOS}
    confusion: dict[str, dict[str, list[list[int]]]] = {s: {} for s in SCENARIOS}
    for method in METHODS:
        model, scored = train_model([dataset], method, seed=seed, jobs=jobs, quiet=quiet)
        save_model(model, out / ("model" if method == BEST_METHOD else f"models/{method}"))
        for scenario, found in scored.items():
            classification[scenario][method] = {
                name: _score(value.as_dict()) for name, value in found.scores.items()
            }
            if method == BEST_METHOD:
                confusion[scenario][method] = found.confusion.tolist()

    rows = predict_dataset(data, PREDICTORS, HORIZON_S, str(out / "model"), jobs=jobs, quiet=True)
    tree = metrics_tree(rows)
    prediction = {
        scenario: {
            predictor: {
                kind: {h: _score(value) for h, value in horizons.items()}
                for kind, horizons in kinds.items()
            }
            for predictor, kinds in predictors.items()
        }
        for scenario, predictors in tree.items()
    }
    metrics = Metrics(classification=classification, prediction=prediction)
    run = RunFile(
        name=out.name,
        seed=seed,
        configuration=config.model_dump(mode="json"),
        packages=installed(),
        dataset="data",
        model="model",
        protocol=PROTOCOL,
        findings=findings(metrics),
        confusion=confusion,
    )
    write_run(out, run, metrics)
    write_json(rows, out / "prediction.json")
    return metrics


def _score(found: dict[str, Any]) -> Score:
    unknown = found["low"] is None or found["low"] != found["low"]  # NaN with one episode
    low, high = (None, None) if unknown else (found["low"], found["high"])
    return Score(value=found["value"], low=low, high=high, n=found["n"], split=found["split"])


def findings(metrics: Metrics) -> list[str]:
    """What the numbers say, in sentences, good or bad."""
    said = []
    for scenario, methods in metrics.classification.items():
        majority = methods[BEST_METHOD]["majority_weighted_accuracy"].value
        plus, spectrum = methods[BEST_METHOD], methods["graphrqi"]
        said.append(
            f"{scenario}: {BEST_METHOD} names the right behaviour in "
            f"{100 * plus['weighted_accuracy'].value:.0f} % of all windows (majority class "
            f"{100 * majority:.0f} %) and the right style in "
            f"{100 * plus['style_balanced_accuracy'].value:.0f} % (balanced)."
        )
        lift = spectrum["weighted_accuracy"].value - majority
        said.append(
            f"{scenario}: rows of the eigenvector matrix alone, as in the paper, are "
            f"{'above' if lift > 0 else 'below'} the majority class in accuracy by "
            f"{100 * abs(lift):.1f} percentage points, with macro-F1 "
            f"{spectrum['macro_f1'].value:.2f} (chance is about 0.17)."
        )
    for scenario in metrics.classification:
        predictors = metrics.prediction[scenario]
        blind = predictors["car-following-blind"]["ade_m"]["5s"].value
        aware = predictors["car-following"]["ade_m"]["5s"].value
        change = 100 * (1 - aware / blind)
        said.append(
            f"{scenario}: knowing the behaviour makes the mean displacement error over 5 s "
            f"{abs(change):.1f} % {'smaller' if change > 0 else 'larger'} than one average driver "
            f"does ({aware:.2f} m against {blind:.2f} m)."
        )
        best = predictors["graphrqi-predict"]["ade_m"]["5s"].value
        straight = predictors["constant-velocity"]["ade_m"]["5s"].value
        said.append(
            f"{scenario}: graphrqi-predict is off by {best:.2f} m on average over 5 s, "
            f"constant velocity by {straight:.2f} m."
        )
    return said


def _print(title: str, table: Table) -> None:
    from rich.console import Console
    from rich.table import Table as RichTable

    shown = RichTable("", *table.columns, title=title, title_justify="left")
    for name, cells in table.rows:
        shown.add_row(name, *(f"{c.value} {c.interval}".strip() for c in cells))
    console = Console(highlight=False)
    Console(highlight=False, width=max(console.width, 150)).print(shown)


def main() -> None:
    """Run the demo into ``runs/demo`` and print its tables."""
    out = Path("runs/demo")
    metrics = run_demo(out)
    page = write_report(out)
    for title, table in printed_tables(metrics):
        _print(f"{title}: {table.title}", table)
    for finding in read_run(out)[0].findings:
        print(f"- {finding}")
    print(f"\n{page}")


if __name__ == "__main__":
    show_notices()
    with exit_on_user_error():
        main()
