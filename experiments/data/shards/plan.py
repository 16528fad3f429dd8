"""Which episodes a dataset consists of, in blocks, and which of them a part makes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

from behaviors.errors import InputError
from experiments.data.configuration import GenerateConfig
from experiments.data.episode import Task
from experiments.data.worlds.episode import WorldsConfig, WorldTask
from scenarios import get_scenario
from sim.scenario import Scenario
from sim.store.catalogue import checksum
from sim.store.schema import BLOCK_EPISODES, EpisodeEntry, EpisodeMeta
from sim.store.writing import made_with

AnyConfig: TypeAlias = GenerateConfig | WorldsConfig
AnyTask: TypeAlias = Task | WorldTask


@dataclass(frozen=True, slots=True)
class Part:
    """One part of a generation that several commands share.

    Attributes:
        number: from 1 on.
        of: how many parts there are.
    """

    number: int
    of: int

    def __str__(self) -> str:
        """As it is given on the command line."""
        return f"{self.number}/{self.of}"


def read_part(text: str | None) -> Part | None:
    """A part as the command line has it.

    Args:
        text: ``3/200``; None for everything.

    Raises:
        InputError: if it is something else.

    Examples:
        >>> read_part("3/200")
        Part(number=3, of=200)
    """
    if text is None:
        return None
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text)
    part = Part(int(found[1]), int(found[2])) if found else None
    if part is None or not 1 <= part.number <= part.of:
        raise InputError(f"part: found {text!r}, expected K/N with K from 1 to N, such as 3/200")
    return part


def key_of(what: AnyTask | EpisodeMeta, worlds: bool) -> tuple[str, int]:
    """What tells one planned episode from another: its scenario and index, or a world's index."""
    if worlds or isinstance(what, WorldTask):
        return "", what.index
    return _name_of(what.scenario) if isinstance(what, Task) else what.scenario, what.index


@cache
def _name_of(scenario: str) -> str:
    return get_scenario(scenario).name


def planned_count(config: AnyConfig) -> int:
    """How many episodes a configuration asks for."""
    if isinstance(config, WorldsConfig):
        return config.worlds
    return config.episodes * len(config.scenarios)


def blocks(config: AnyConfig) -> Iterator[tuple[int, list[AnyTask]]]:
    """Every block's number and its episodes, by index, then in the order of the scenarios."""
    last = config.worlds if isinstance(config, WorldsConfig) else config.episodes
    for begin in range(0, last, BLOCK_EPISODES):
        indices = range(begin, min(begin + BLOCK_EPISODES, last))
        yield (
            begin // BLOCK_EPISODES,
            [WorldTask(config, i) for i in indices]
            if isinstance(config, WorldsConfig)
            else [Task(config, name, i) for i in indices for name in config.scenarios],
        )


@dataclass(frozen=True, slots=True)
class Share:
    """What a command makes of one block.

    Attributes:
        block: number of the block.
        tasks: the episodes to make.
        whole: whether these are all of the block.
    """

    block: int
    tasks: Sequence[AnyTask]
    whole: bool


def shares(config: AnyConfig, part: Part | None) -> Iterator[Share]:
    """What one part makes, block by block. All parts together make everything once.

    Parts take whole blocks where there are enough of them, else equal numbers of episodes.

    Args:
        config: what the dataset is generated from.
        part: which part; None for everything.
    """
    if part is None:
        for number, tasks in blocks(config):
            yield Share(number, tasks, True)
        return
    total = planned_count(config)
    last = config.worlds if isinstance(config, WorldsConfig) else config.episodes
    count = -(-last // BLOCK_EPISODES)
    if count >= part.of:
        first, end = (k * count // part.of for k in (part.number - 1, part.number))
        for number, tasks in blocks(config):
            if first <= number < end:
                yield Share(number, tasks, True)
        return
    first, end = (k * total // part.of for k in (part.number - 1, part.number))
    at = 0
    for number, tasks in blocks(config):
        low, high = max(first - at, 0), min(end - at, len(tasks))
        if low < high:
            yield Share(number, tasks[low:high], high - low == len(tasks))
        at += len(tasks)


def belongs_to(config: AnyConfig) -> Callable[[EpisodeMeta], bool]:
    """What tells whether an episode is one that a configuration asks for.

    An entry must also have happened on the scenario's road as that is now.
    """
    scenarios: dict[tuple[str, object], tuple[Scenario, str]] = {}
    named = {}
    if isinstance(config, GenerateConfig):
        named = {get_scenario(given).name: given for given in config.scenarios}

    def belongs(made: EpisodeMeta) -> bool:
        if isinstance(config, WorldsConfig):
            wanted = WorldTask(config, made.index).meta() if made.index < config.worlds else None
            return wanted == meta_of(made)
        if made.scenario not in named or made.index >= config.episodes:
            return False
        given = named[made.scenario]
        key = made.scenario, str(made.options.get("limit_mps"))
        if key not in scenarios:
            scenario = config.scenario(given, made.index)
            scenarios[key] = scenario, checksum(scenario.road.source.read_bytes())
        scenario, road = scenarios[key]
        if isinstance(made, EpisodeEntry) and made.road != road:
            return False
        return meta_of(made) == Task(config, given, made.index).meta(scenario)

    return belongs


def config_in(configuration: Mapping[str, Any]) -> AnyConfig:
    """The configuration that a catalogue says a dataset was made from.

    Raises:
        ValidationError: if it is none.
    """
    fields = {name: value for name, value in configuration.items() if name != "made_with"}
    model: type[WorldsConfig | GenerateConfig] = (
        WorldsConfig if "worlds" in fields else GenerateConfig
    )
    return model.model_validate(fields)


def check_versions(what: str, configuration: Mapping[str, Any], engine: str) -> None:
    """Refuse to make episodes again with other packages than they were made with.

    Args:
        what: name of the dataset, for messages.
        configuration: of its catalogue.
        engine: registered name of the engine.

    Raises:
        InputError: if the versions installed here are others.
    """
    here, there = made_with(engine), configuration.get("made_with")
    if here != there:
        raise InputError(f"{what}: was made with {there}, found {here}; install those versions")


def meta_of(made: EpisodeMeta) -> EpisodeMeta:
    """What an episode is made from, without what came of it."""
    return EpisodeMeta(**{name: getattr(made, name) for name in EpisodeMeta.model_fields})


def configuration_of(config: AnyConfig) -> dict[str, Any]:
    """What a dataset's catalogue says of how it was made."""
    dumped = config.model_dump(mode="json", exclude_none=True)
    return {**dumped, "made_with": dict(made_with(config.engine))}
