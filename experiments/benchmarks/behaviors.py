"""Do drivers behave as they are labelled? Every behaviour against the paper's traits, in numbers.

Episodes are driven, watched with the trait detectors, and counted per driver; the intervals are by
bootstrap over drivers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from behaviors.labelling import label_from_traits
from behaviors.labels import BEHAVIORS, Behavior, Trait, read_behaviors, tables_of
from behaviors.traits import FOLLOWING_MPS, DetectorInputs, ShownTrait, lane_changes, waits
from experiments.data.parallel import in_parallel
from experiments.score.rows import Cell, Row, tidy_row
from scenarios import SCENARIOS, get_scenario
from sim.engines import get_engine
from sim.episode.annotate import annotate
from sim.frames import Event, EventKind, Frame, Tracks
from sim.scenario import Scenario, sample_agents

FREE_HEADWAY_S, STEADY_MPS2 = 6.0, 0.3
"""A road is free for a driver with this headway or more, s; the largest acceleration of a driver at
the speed that it has chosen, m/s2."""

CLEARING_S, RESAMPLES = 300.0, 1000
"""Episodes are driven on for so long, s, so that vehicles can leave; bootstrap resamples."""

METRICS: Final[dict[str, tuple[str, str]]] = {
    "red_run_share": ("red_runs", "red_faced"),
    "yield_share": ("yields", "crossing_encounters"),
    "headway_median_s": ("headway", ""),
    "lane_changes_per_km": ("lane_changes", "km"),
    "cut_ins_per_km": ("cut_ins", "km"),
    "over_limit_share": ("over_limit_s", "free_s"),
    "unprovoked_stops_per_km": ("unprovoked_stops", "km"),
    "wait_per_encounter_s": ("wait_s", "waits"),
    "wrong_way_m": ("wrong_way_m", "drivers"),
    "collisions_caused": ("collisions", ""),
    "pedestrians_hit": ("pedestrians_hit", ""),
    "label_agreement": ("agrees", "drivers"),
}
"""The count above and the count below of each metric: "" for a median (of ``headway``, each
driver's own median, NaN without any) or a sum."""

WALKS, UNLABELLED = -2, -1
"""Codes of pedestrians, and of other road users without a label."""

COUNTS: Final = (
    *dict.fromkeys(name for pair in METRICS.values() for name in pair if name), "jaywalks",
)  # fmt: skip
"""Counts of every road user."""

ENCOUNTERS: Final = (EventKind.YIELDED, EventKind.NOT_YIELDED)
"""Encounters of a driver with a pedestrian that wants to cross."""

COUNTED: Final[dict[EventKind, tuple[str, ...]]] = {
    EventKind.RED_RUN: ("red_runs", "red_faced", "waits"),
    EventKind.STOP_ROLLED: ("waits",),
    EventKind.YIELDED: ("crossing_encounters", "yields"),
    EventKind.NOT_YIELDED: ("crossing_encounters", "waits"),
}
"""Counts that an event adds to. A driver that did not wait, in spite of a rule, waited for 0 s."""

SHOWN: Final = {
    Trait.CUTTING_IN: "cut_ins", Trait.NOT_MOVING: "unprovoked_stops", Trait.JAYWALKING: "jaywalks",
}  # fmt: skip
"""The count that a shown trait adds to."""


def count_scenario(
    scenario: Scenario, seed: int, engine: str = "sumo", clearing_s: float = CLEARING_S
) -> pd.DataFrame:
    """Drive one episode and count what its drivers did, and for ``clearing_s`` more what they do.

    There is a line for each pedestrian and labelled driver: a code ``behavior``, and ``COUNTS``.
    Encounters with pedestrians are found in the tracks. An engine whose frames report them counts
    itself: in highway-env, pedestrians step out only in front of drivers that wait.
    """
    agents = sample_agents(scenario, seed)
    longer = dataclasses.replace(scenario, duration_s=scenario.duration_s + clearing_s)
    reported: list[Event] = []

    def frames() -> Iterator[Frame]:
        for frame in get_engine(engine)(longer, agents, seed):
            reported.extend(event for event in frame.events if event.kind in ENCOUNTERS)
            yield frame

    tracks = Tracks.from_frames(frames(), {a.id: a.behavior for a in agents})
    classes = (*BEHAVIORS, *scenario.behaviors)
    if tracks.behavior is not None:
        code = np.array([*map(classes.index, tracks.classes), -1], dtype=np.int8)
        tracks = dataclasses.replace(tracks, behavior=code[tracks.behavior], classes=classes)
    found = annotate(tracks, longer.road)
    events = list(found.events)
    if reported:
        events = [event for event in events if event.kind not in ENCOUNTERS] + reported
    return _counted(tracks, found.inputs, events, found.shown_traits)


def _counted(
    tracks: Tracks, seen: DetectorInputs, events: Sequence[Event], traits: Sequence[ShownTrait]
) -> pd.DataFrame:
    """Count what the road users of an episode did."""
    none = np.full(tracks.ids.size, UNLABELLED)
    labels = none if tracks.behavior is None else tracks.behavior
    table = {name: np.zeros(tracks.ids.size) for name in COUNTS}
    row = {int(agent): i for i, agent in enumerate(tracks.ids)}
    table["drivers"][:] = 1.0
    row_index = seen.row_index

    def in_all(values: NDArray[Any]) -> NDArray[Any]:
        return np.bincount(row_index.agent, values, minlength=tracks.ids.size)

    table["km"] = in_all(seen.speed) * seen.step_s / 1000.0
    steady = (np.abs(seen.closing) < 1.5) & (seen.headway < FREE_HEADWAY_S)
    followed = pd.Series(np.where(steady, seen.headway, np.nan)).groupby(row_index.agent).median()
    table["headway"] = followed.reindex(range(tracks.ids.size)).to_numpy()
    np.add.at(table["lane_changes"], row_index.agent[lane_changes(seen)], 1.0)
    free = _free(seen)
    table["free_s"] = in_all(free) * seen.step_s
    table["over_limit_s"] = in_all(free & (seen.speed > seen.limit)) * seen.step_s
    for found in waits(seen):
        table["waits"][found.agent] += 1.0
        table["wait_s"][found.agent] += found.value
    for event in events:
        i = row[event.agent]
        for name in COUNTED.get(event.kind, ()):
            table[name][i] += 1.0
        if event.kind is EventKind.STOPPED and event.rule == "red light":
            table["red_faced"][i] += 1.0
        elif event.kind is EventKind.COLLISION and event.other is not None:
            walks = not seen.drives[row[event.other]]
            table["pedestrians_hit" if walks else "collisions"][i] += 1.0
    of_agent: dict[int, list[ShownTrait]] = {agent: [] for agent in row}
    for found in traits:
        i = row[found.agent]
        of_agent[found.agent].append(found)
        if found.trait in SHOWN:
            table[SHOWN[found.trait]][i] += 1.0
        elif found.trait is Trait.WRONG_DIRECTION:
            table["wrong_way_m"][i] += found.value
    for agent, i in row.items():
        label = label_from_traits(of_agent[agent])
        table["agrees"][i] = label is not None and label.code == labels[i]
    users = pd.DataFrame({"behavior": np.where(seen.drives, labels, WALKS), **table})
    return users[users["behavior"] != UNLABELLED]


def _free(seen: DetectorInputs) -> NDArray[np.bool_]:
    """(m,) whether an agent drives at its chosen speed with no road user near ahead."""
    before = np.roll(seen.speed, 1)
    before[seen.row_index.begins] = 0.0  # who has just come is not known to drive evenly
    change = np.abs(seen.speed - before) / seen.step_s
    near = seen.gap < FREE_HEADWAY_S * np.maximum(seen.speed, FOLLOWING_MPS)
    near |= seen.stop_distance < 60.0
    return np.asarray(seen.driving & ~near & (change < STEADY_MPS2))


def rows_of(
    counts: pd.DataFrame, engine: str, scenario: str, classes: Sequence[Behavior] = BEHAVIORS
) -> list[Row]:
    """One row per behaviour and metric, with a 95 % interval over drivers.

    ``n`` is the number of drivers with something to count. Codes stand for the ``classes``.
    """
    rng = np.random.default_rng(0)
    place: dict[str, Cell] = {"engine": engine, "scenario": scenario}
    found: list[Row] = []
    for code, behavior in enumerate(classes):
        mine = counts[counts["behavior"] == code]
        weights = np.zeros((RESAMPLES, 0), dtype=np.int64)
        if len(mine):
            weights = rng.multinomial(len(mine), np.full(len(mine), 1 / len(mine)), RESAMPLES)
        for metric, (above, below) in METRICS.items():
            top = mine[above].to_numpy()
            n, value, drawn = len(mine), float(top.sum()), None
            if metric == "headway_median_s":
                top = top[np.isfinite(top)]
                n = top.size
                value = float(np.median(top)) if n else np.nan
                drawn = np.median(top[rng.integers(n, size=(RESAMPLES, n))], axis=1) if n else None
            elif below:
                bottom = mine[below].to_numpy()
                n = int((bottom > 0).sum())
                with np.errstate(invalid="ignore", divide="ignore"):
                    value = float(top.sum() / bottom.sum())
                    drawn = (weights @ top) / (weights @ bottom) if n else None
            low, high = (None, None) if drawn is None else np.nanpercentile(drawn, [2.5, 97.5])
            keys = {**place, "behavior": behavior.value}
            found.append(tidy_row(keys, metric, value, low, high, n))
    walkers = counts[counts["behavior"] == WALKS]
    keys = {**place, "behavior": "pedestrian"}
    return [*found, tidy_row(keys, "jaywalks", walkers["jaywalks"].sum(), n=len(walkers))]


def measure(
    scenarios: Sequence[str] = (), engine: str = "sumo", seeds: Sequence[int] = (0, 1, 2, 3, 4),
    duration_s: float = 600.0, jobs: int | None = None, behaviors: str | None = None,
) -> Iterator[list[Row]]:  # fmt: skip
    """Rows of every behaviour and trait in each scenario; last, of several together, as ``all``.

    Scenarios are keys of ``SCENARIOS`` (() for all), each with an episode of ``duration_s`` for
    every seed. Behaviours of one's own, as `read_behaviors` takes them, drive beside the six.
    """
    names = [get_scenario(name).name for name in scenarios] or list(SCENARIOS)
    everything: list[pd.DataFrame] = []
    own = read_behaviors(behaviors)
    classes = (*BEHAVIORS, *own)
    for name in names:
        made = get_scenario(name)(duration_s=duration_s, behaviors=tables_of(own))
        tasks = [(made, seed, engine) for seed in seeds]
        counted = list(in_parallel(count_scenario, tasks, jobs))
        everything += counted
        yield rows_of(pd.concat(counted), engine, name, classes)
    if len(names) > 1:
        yield rows_of(pd.concat(everything), engine, "all", classes)
