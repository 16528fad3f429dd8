"""The command every scenario has: ``python -m scenarios.NAME`` runs it headless."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from behaviors.display import printable
from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from scenarios import ScenarioEntry, get_scenario
from sim.engines import ENGINES, get_engine
from sim.frames import EventKind, Frame
from sim.scenario import AgentSpec, Scenario, sample_agents


@dataclass
class RunSummary:
    """Counts and sums over the frames of a run.

    Attributes:
        frames: how many frames there were.
        entered: ids of the agents that are in a frame.
        events: how often each kind of event happened.
        distance_m: sum of speed times step over all that drive, m.
        driving_s: time driven by all that drive, s.
    """

    frames: int = 0
    entered: set[int] = field(default_factory=set)
    events: Counter[EventKind] = field(default_factory=Counter)
    distance_m: float = 0.0
    driving_s: float = 0.0

    def count(self, frames: Iterable[Frame], step_s: float) -> Iterator[Frame]:
        """Yield the frames and count what is in them."""
        for frame in frames:
            self.frames += 1
            self.entered.update(frame.ids.tolist())
            self.events.update(event.kind for event in frame.events)
            driving = frame.driving
            self.distance_m += float(frame.speed[driving].sum()) * step_s
            self.driving_s += float(driving.sum()) * step_s
            yield frame

    def lines(self, agents: Sequence[AgentSpec]) -> list[str]:
        """The summary as lines of text."""
        present = [a for a in agents if a.id in self.entered]
        kinds = Counter(a.kind for a in present)
        behaviors = Counter(a.behavior for a in present if a.behavior is not None)
        speed = self.distance_m / self.driving_s if self.driving_s else 0.0
        return [
            f"frames: {self.frames}",
            f"agents: {len(present)} of {len(agents)} entered ("
            + ", ".join(f"{kind} {count}" for kind, count in sorted(kinds.items()))
            + ")",
            "behaviours: " + ", ".join(f"{b} {behaviors[b]}" for b in BEHAVIORS),
            f"mean speed: {speed:.2f} m/s",
            f"collisions: {self.events[EventKind.COLLISION]}",
        ]


FLAGS: Final[dict[str, dict[str, Any]]] = {
    "flow": {"help": "light, medium, dense or vehicles per hour"},
    "mix": {"help": "shares of behaviours or styles: aggressive=.2,timid=.8"},
    "kinds": {"help": "share of each kind: car=.9,truck=.1"},
    "spread": {"type": float, "help": "spread between drivers of one behaviour"},
    "population": {"help": "drivers' numbers: a name (graphrqi list) or a file"},
    "duration_s": {"type": float, "help": "length, s"},
    "step_s": {"type": float, "help": "time between frames, s"},
}
"""The options that have a flag of their own, where the scenario takes them."""


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def read_options(
    texts: Sequence[str], flags: Collection[str]
) -> dict[str, bool | int | float | str]:
    """Options given as ``NAME=VALUE``: true, false, a number, or a word.

    Args:
        texts: as given on the command line, after ``--set``.
        flags: options that have a flag of their own.

    Raises:
        InputError: if one is written otherwise, or has a flag of its own.

    Examples:
        >>> read_options(["blocks=8", "crossing=true"], ["flow"])
        {'blocks': 8, 'crossing': True}
    """
    found: dict[str, bool | int | float | str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name:
            raise InputError(f"--set: found {text!r}, expected NAME=VALUE")
        if name in flags:
            raise InputError(f"--set: found {name}, expected {_flag(name)} for it")
        found[name] = _value(value)
    return found


def _value(text: str) -> bool | int | float | str:
    if text in ("true", "false"):
        return text == "true"
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return text


ROADS: Final[dict[str, str]] = {
    "--net": "another road: a SUMO net, or a map that netconvert makes one of",
    "--file": "another scenario: its TOML file",
}
"""The options that stand for another scenario than the command's own."""


def parser(name: str) -> argparse.ArgumentParser:
    """The options of a scenario's command."""
    made = argparse.ArgumentParser(
        prog=f"python -m scenarios.{name}",
        description="Run the scenario headless and print a summary.",
        epilog=f"example: python -m scenarios.{name} --flow dense --seed 1 --duration-s 60",
    )
    made.add_argument("--engine", default="sumo", help=f"one of {', '.join(ENGINES)}")
    made.add_argument("--seed", type=int, default=0)
    options = get_scenario(name).options
    roads = made.add_mutually_exclusive_group()
    for flag, meaning in ROADS.items():
        roads.add_argument(flag, metavar="FILE", help=meaning)
    made.add_argument("--routes", metavar="FILE", help="SUMO routes for --net or --file")
    for option, settings in FLAGS.items():
        if option in options:
            default = options[option].default
            shown = "" if default is None else f" (default {default})"
            made.add_argument(_flag(option), **{**settings, "help": settings["help"] + shown})
    made.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="another option of the scenario, such as "
        + ", ".join(option for option in options if option not in FLAGS),
    )
    made.add_argument("--out", type=Path, help="folder to write the episode to")
    return made


def main(name: str, arguments: Sequence[str] | None = None) -> int:
    """Run a scenario from the command line.

    Args:
        name: a key of ``SCENARIOS``.
        arguments: the command's arguments; by default those of the process.

    Returns:
        0, or 2 after one line on stderr if an option is not usable.
    """
    options = parser(name).parse_args(arguments)
    try:
        flags = {option: getattr(options, option, None) for option in FLAGS}
        given = {option: value for option, value in flags.items() if value is not None}
        given |= read_options(options.set, FLAGS)
        if options.routes is not None:
            given["routes"] = options.routes
        entry = get_scenario(options.net or options.file or name)
        scenario = entry(**given)
        agents = sample_agents(scenario, options.seed)
        summary = _run(entry, scenario, agents, options, given)
    except OSError as error:
        sys.stderr.write(
            f"scenarios.{name}: error: {printable(str(options.out))}: {error.strerror}\n"
        )
        return 2
    except InputError as error:
        sys.stderr.write(f"scenarios.{name}: error: {printable(str(error))}\n")
        return 2
    sys.stdout.write("\n".join([f"scenario: {scenario.name}", *summary.lines(agents)]) + "\n")
    return 0


def _run(
    entry: ScenarioEntry,
    scenario: Scenario,
    agents: Sequence[AgentSpec],
    options: argparse.Namespace,
    given: Mapping[str, Any],
) -> RunSummary:
    summary = RunSummary()
    frames = summary.count(
        get_engine(options.engine)(scenario, agents, options.seed), scenario.step_s
    )
    if options.out is None:
        for _ in frames:
            pass
        return summary
    from sim.store.schema import EpisodeMeta
    from sim.store.writing import made_with, new_dataset

    defaults = entry.options
    chosen = {
        **({"flow": defaults["flow"].default} if "flow" in defaults else {}),
        **{name: str(value) if name == "routes" else value for name, value in given.items()},
        **scenario.population_option,
        "mix": {str(behavior): share for behavior, share in scenario.mix.items()},
        "kinds": {str(kind): share for kind, share in scenario.kinds.items()},
        "spread": scenario.spread,
        "duration_s": scenario.duration_s,
        "step_s": scenario.step_s,
    }
    meta = EpisodeMeta(
        scenario=scenario.name,
        engine=options.engine,
        seed=options.seed,
        options=chosen,
        made_with=made_with(options.engine),
    )
    with new_dataset(options.out, {"scenario": scenario.name, **chosen}) as dataset:
        dataset.write_episode(meta, frames, agents, scenario.road.source)
    return summary
