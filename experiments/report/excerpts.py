"""Excerpts of a run's unseen episodes: how early and how sure its answers were, and its errors.

Each of these episodes gets its replay beside the report, and the worst cases link to it.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import urlencode

import numpy as np
from numpy.typing import NDArray

from behaviors.labelling import characteristic_traits
from behaviors.labels import BEHAVIORS, TRAITS, Style
from experiments.console.progress import Progress
from experiments.data.parallel import in_parallel
from experiments.replay.page import write_page
from experiments.replay.pictures.painter import Painter, png_bytes
from experiments.replay.scene import ReplayScene, gather
from experiments.report.charts import Axis, Chart, Line, Point
from experiments.report.tables import Cell, Table
from experiments.scoring.metrics import balanced_accuracy, bootstrap, confusion, reliability
from sim.frames import FloatArray, IntArray
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry

EPISODES: Final = 4
"""Unseen episodes of each scenario that are shown."""

CASES: Final = 3
"""Worst cases of each sort that are shown for each scenario."""

SECONDS: Final = (1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0)
"""Lengths of observation after which answers are scored, s."""


@dataclass(frozen=True, slots=True)
class WorstCase:
    """An agent about which the run was wrong.

    Attributes:
        sort: "classification" or "prediction".
        badness: how wrong; the probability given to the wrong behaviour, or metres.
        said: one sentence on it.
        href: where to see it, relative to the report.
    """

    sort: str
    badness: float
    said: str
    href: str


@dataclass(frozen=True, slots=True, eq=False)
class EpisodeExcerpt:
    """What one episode shows.

    Attributes:
        seconds: (n,) how long a driver had been observed when a belief was kept, s.
        truth: (n,) that driver's true code.
        probability: (n, 6) the belief.
        cases: the worst cases.
        shown: (6, traits) how many drivers of each behaviour characteristically showed each trait.
        drivers: (6,) how many drivers of each behaviour there were.
        w: mean |w| of aggressive and of conservative drivers.
        pictures: the fullest moment, by predicted behaviour and by |w|, as PNG.
        href: its replay at that moment.
    """

    seconds: FloatArray
    truth: NDArray[np.int8]
    probability: FloatArray
    cases: tuple[WorstCase, ...]
    shown: IntArray
    drivers: IntArray
    w: tuple[float, float]
    pictures: tuple[bytes, bytes]
    href: str


@dataclass(frozen=True, slots=True)
class ScenarioExcerpt:
    """What the unseen episodes of one scenario show, for the page.

    Attributes:
        scenario: its name.
        basis: how many episodes and drivers it rests on.
        charts: how early and how sure the answers were.
        traits: which behaviour showed which trait.
        cases: the worst of each sort.
        pictures: data addresses of one moment, by predicted behaviour and by |w|.
        href: the replay of that moment.
        w: mean |w| of aggressive and of conservative drivers.
    """

    scenario: str
    basis: str
    charts: tuple[Chart, ...]
    traits: Table | None
    cases: tuple[WorstCase, ...]
    pictures: tuple[str, str]
    href: str
    w: tuple[str, str]


def take_excerpts(
    folder: Path, dataset: str, model: str, scenarios: Sequence[str], predictor: str,
    jobs: int | None = None, quiet: bool = True,
) -> list[ScenarioExcerpt]:  # fmt: skip
    """Summarise a run's unseen episodes and write their replays.

    Args:
        folder: the run's; replays go into ``replays`` in it.
        dataset: its dataset, relative to the folder.
        model: its model, relative to the folder.
        scenarios: names of the scenarios.
        predictor: the predictor whose predictions are shown.
        jobs: processes; None for one per core.
        quiet: whether to show no progress.

    Returns:
        One entry per scenario that has unseen episodes.
    """
    opened = open_dataset(folder / dataset)
    (folder / "replays").mkdir(exist_ok=True)
    chosen = {name: opened.episodes("test", name)[:EPISODES] for name in scenarios}
    arguments = [
        (folder, dataset, model, entry, predictor) for part in chosen.values() for entry in part
    ]
    found: dict[str, list[EpisodeExcerpt]] = {}
    with Progress("excerpting episodes", len(arguments), quiet) as progress:
        for given, excerpt in zip(arguments, in_parallel(excerpt_of, arguments, jobs), strict=True):
            found.setdefault(given[3].scenario, []).append(excerpt)
            progress.advance()
    return [
        _scenario_excerpt(scenario, found[scenario]) for scenario in scenarios if scenario in found
    ]


def excerpt_of(
    folder: Path, dataset: str, model: str, entry: EpisodeEntry, predictor: str
) -> EpisodeExcerpt:
    """Summarise one episode and write its replay."""
    scene = gather(
        open_dataset(folder / dataset), entry, model=str(folder / model), predictor=predictor
    )
    page = f"replays/{entry.id}.html"
    write_page(scene, folder / page, "predicted")
    moment = float(scene.tracks.time_s[scene.tracks.as_rows().counts().argmax()])
    agent, sample = _scored_beliefs(scene)
    behavior = scene.tracks.behavior
    truth = np.full(scene.tracks.ids.size, -1, np.int8) if behavior is None else behavior
    first_s = scene.tracks.time_s[scene.tracks.as_rows().first_steps()]
    shown, drivers = _traits(scene, truth)
    return EpisodeExcerpt(
        seconds=scene.beliefs.time_s[sample] - first_s[agent],
        truth=truth[agent],
        probability=scene.beliefs.probability[agent, sample].astype(np.float64),
        cases=(*_wrongly_classified(scene, truth, page), *_badly_predicted(scene, page)),
        shown=shown,
        drivers=drivers,
        w=(_mean_w(scene, truth, Style.AGGRESSIVE), _mean_w(scene, truth, Style.CONSERVATIVE)),
        pictures=(
            png_bytes(Painter(scene, "predicted", words=False).draw(moment)),
            png_bytes(Painter(scene, "w", words=False).draw(moment)),
        ),
        href=_link(page, moment),
    )


def _scored_beliefs(scene: ReplayScene) -> tuple[IntArray, IntArray]:
    """Rows and time indices of the beliefs about drivers whose truth is known."""
    behavior = scene.tracks.behavior
    truth = np.full(scene.tracks.ids.size, -1) if behavior is None else behavior
    believed = np.isfinite(scene.beliefs.probability).all(axis=2)
    agent, sample = np.nonzero(believed & (truth >= 0)[:, None])
    return agent, sample


def _link(page: str, time_s: float, agent: str = "") -> str:
    query = {"t": f"{time_s:.1f}", "mode": "predicted"} | ({"agent": agent} if agent else {})
    return f"{page}#{urlencode(query)}"


def _wrongly_classified(scene: ReplayScene, truth: NDArray[np.int8], page: str) -> list[WorstCase]:
    """Drivers about which the last belief is wrong, the surest first."""
    cases = []
    for row in np.flatnonzero(truth >= 0):
        believed = scene.beliefs.probability[row]
        samples = np.flatnonzero(np.isfinite(believed).all(axis=1))
        if not samples.size:
            continue
        last = believed[samples[-1]]
        code = int(last.argmax())
        if code == truth[row]:
            continue
        surest = int(samples[believed[samples, code].argmax()])
        time_s, name = float(scene.beliefs.time_s[surest]), scene.tracks.names[row]
        said = (
            f"driver {name} is {BEHAVIORS[truth[row]]}, taken for {BEHAVIORS[code]} with "
            f"{100 * last[code]:.0f} % at last"
        )
        cases.append(
            WorstCase("classification", float(last[code]), said, _link(page, time_s, name))
        )
    return sorted(cases, key=lambda case: -case.badness)[:CASES]


def _badly_predicted(scene: ReplayScene, page: str) -> list[WorstCase]:
    """Agents that ended farthest from their likeliest future, each at most once."""
    tracks = scene.tracks
    worst: dict[int, tuple[float, float]] = {}
    for forecast in scene.forecasts:
        end_s = forecast.time_s + float(forecast.ahead_s[-1])
        step = int(np.searchsorted(tracks.time_s, end_s - 1e-3))
        if step >= tracks.time_s.size:
            continue
        likeliest = np.flatnonzero(np.diff(forecast.agent, prepend=-1) != 0)
        agent = forecast.agent[likeliest]
        away = np.hypot(*(forecast.xy[likeliest, -1] - tracks.xy[agent, step]).T)
        for row, error in zip(agent.tolist(), away.tolist(), strict=True):
            if np.isfinite(error) and error > worst.get(row, (0.0, 0.0))[0]:
                worst[row] = (error, forecast.time_s)
    cases = []
    for row, (error, time_s) in worst.items():
        name = tracks.names[row]
        said = f"agent {name}, predicted at {time_s:.1f} s, ended {error:.1f} {scene.unit} away"
        cases.append(WorstCase("prediction", error, said, _link(page, time_s, name)))
    return sorted(cases, key=lambda case: -case.badness)[:CASES]


def _traits(scene: ReplayScene, truth: NDArray[np.int8]) -> tuple[IntArray, IntArray]:
    names = list(TRAITS)
    shown = np.zeros((len(BEHAVIORS), len(names)), dtype=np.int64)
    drivers = np.bincount(truth[truth >= 0], minlength=len(BEHAVIORS))
    for row in np.flatnonzero(truth >= 0):
        mine = [x for x in scene.shown_traits if x.agent == scene.tracks.ids[row]]
        for trait in characteristic_traits(mine):
            shown[truth[row], names.index(trait)] += 1
    return shown, drivers


def _mean_w(scene: ReplayScene, truth: NDArray[np.int8], style: Style) -> float:
    codes = [b.code for b in BEHAVIORS if b.style is style]
    values = scene.graph.w[np.isin(truth, codes)]
    values = values[np.isfinite(values)]
    return float(values.mean()) if values.size else float("nan")


def _scenario_excerpt(scenario: str, episodes: Sequence[EpisodeExcerpt]) -> ScenarioExcerpt:
    episode = np.concatenate([np.full(k.truth.size, i) for i, k in enumerate(episodes)])
    seconds = np.concatenate([k.seconds for k in episodes])
    truth = np.concatenate([k.truth for k in episodes])
    probability = np.concatenate([k.probability for k in episodes])
    drivers = np.sum([k.drivers for k in episodes], axis=0)
    charts = (
        _early_chart(scenario, episode, seconds, truth, probability),
        _reliability_chart(scenario, episode, truth, probability),
    )
    cases = sorted((c for k in episodes for c in k.cases), key=lambda case: -case.badness)
    chosen = [
        *[c for c in cases if c.sort == "classification"][:CASES],
        *[c for c in cases if c.sort == "prediction"][:CASES],
    ]
    first = episodes[0]
    means = [np.array([k.w[style] for k in episodes]) for style in (0, 1)]
    return ScenarioExcerpt(
        scenario=scenario,
        basis=f"{len(episodes)} unseen episodes, {int(drivers.sum())} drivers",
        charts=tuple(chart for chart in charts if chart),
        traits=_trait_table(np.sum([k.shown for k in episodes], axis=0), drivers),
        cases=tuple(chosen),
        pictures=(_address(first.pictures[0]), _address(first.pictures[1])),
        href=first.href,
        w=(_mean_words(means[0]), _mean_words(means[1])),
    )


def _mean_words(values: FloatArray) -> str:
    known = values[np.isfinite(values)]
    return f"{known.mean():.3f}" if known.size else "unknown"


def _address(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode()


def _early_chart(
    scenario: str, episode: IntArray, seconds: FloatArray, truth: NDArray[np.int8],
    probability: FloatArray,
) -> Chart:  # fmt: skip
    """Balanced accuracy against length of observation, with 95 % intervals over episodes."""
    points = []
    for after in SECONDS:
        here = np.abs(seconds - after) < 0.26
        if here.sum() < 2 * len(BEHAVIORS):
            continue
        matrices = confusion(truth[here], probability[here].argmax(axis=1), episode[here])
        value, low, high = bootstrap(balanced_accuracy, matrices)
        known = np.isfinite(low)
        points.append(Point(after, value, low if known else None, high if known else None))
    chance = Line(
        "chance", tuple(Point(p.x, 1 / len(BEHAVIORS)) for p in points), "#8C8C8C", thin=True
    )
    return Chart(
        f"{scenario}: how early", Axis("observed, s"),
        Axis("balanced accuracy", low=0.0, high=1.0),
        (Line("this run's model", tuple(points)), chance) if points else (),
    )  # fmt: skip


def _reliability_chart(
    scenario: str, episode: IntArray, truth: NDArray[np.int8], probability: FloatArray
) -> Chart | None:
    """Share of right answers against confidence."""
    if not truth.size:
        return None
    answers, sure, right = reliability(truth, probability, episode).sum(axis=0).T
    points = tuple(
        Point(float(s / n), float(r / n))
        for n, s, r in zip(answers, sure, right, strict=True)
        if n >= 10
    )
    ideal = Line("as sure as right", (Point(0.0, 0.0), Point(1.0, 1.0)), "#8C8C8C", thin=True)
    return Chart(
        f"{scenario}: how sure, how right", Axis("confidence", low=0.0, high=1.0),
        Axis("share that is right", low=0.0, high=1.0),
        (Line("this run's model", points), ideal) if points else (),
    )  # fmt: skip


def _trait_table(shown: IntArray, drivers: IntArray) -> Table | None:
    """Share of each behaviour's drivers that characteristically showed each trait."""
    seen = np.flatnonzero(shown.sum(axis=0))
    if not seen.size:
        return None
    traits = list(TRAITS)
    rows = tuple(
        (
            traits[t].value,
            tuple(
                Cell(
                    f"{100 * shown[b.code, t] / drivers[b.code]:.0f} %" if drivers[b.code] else "",
                    expected=TRAITS[traits[t]] is b,
                )
                for b in BEHAVIORS
            ),
        )
        for t in seen
    )
    return Table(
        "Traits shown",
        "Drivers of each true behaviour that showed a trait often enough to be characteristic. "
        "Framed: the behaviour to which the paper's trait table assigns it.",
        "trait",
        tuple(f"{b} ({drivers[b.code]})" for b in BEHAVIORS),
        rows,
    )
