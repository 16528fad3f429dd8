"""What a dataset on disk consists of: every table, every column, and the catalogue.

    DATASET/
      episodes.parquet              the catalogue: a row per episode; how it was made and a checksum
                                    for every other file in its metadata
      README.md                     the data card, for people
      roads/<sha256>.net.xml        the road of the episodes, as a SUMO net (or, of recordings, as
                                    it came: .json, an Argoverse 2 map)
      TABLE/scenario=S/split=P/FIRST-LAST.parquet
                                    a shard: the rows of several episodes, those of the scenario's
                                    indices FIRST to LAST that are of this split

TABLE is one of

      steps       one row per agent and time step; one row group per episode
      agents      one row per agent
      frames      one row per time step
      signals     one row per change of a traffic light
      events      one row per event
      traits      one row per shown trait

Every row says in ``episode`` to which episode it belongs. While a dataset is being made, finished
episodes wait in ``episodes/<id>/``, a file for each table and ``episode.json``, until all of their
shard are there. Datasets of schema version 1 consist of such folders and a ``manifest.json``; they
are read as well.

Positions are agents' centres, x east and y north in metres; headings are radians counter-clockwise
from +x in (-pi, pi]; speeds m/s along the heading; times s. Labels are words. The tables are plain
Parquet and open as they are in pandas, polars, duckdb and pyarrow.

Simulated steps are float32 rounded to multiples of ``POSITION_QUANTUM`` and ``HEADING_QUANTUM``,
which is finer than any observer could measure and makes the files small. Recordings brought in
from elsewhere are stored as float64, exactly.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

import pyarrow as pa
from pydantic import BaseModel, ConfigDict, Field, JsonValue

from behaviors.labels import BEHAVIORS
from behaviors.profiles import PROFILE_FIELDS
from sim.frames import KINDS

SCHEMA_VERSION: Final = 2
"""Version of a dataset's layout. Raised whenever a reader of the old version could misread the new
one. Version 1 had a folder for each episode and ``manifest.json``."""

EPISODE_VERSION: Final = 1
"""Version of an episode's content, which is part of what its id is the hash of."""

POSITION_QUANTUM: Final = 2.0**-10
"""Simulated positions, m, and speeds, m/s, are multiples of this: about a millimetre (cars are
measured to centimetres at best)."""

HEADING_QUANTUM: Final = 2.0**-13
"""Simulated headings, rad, are multiples of this: 0.007 degrees (finer than any measurement)."""

MAX_CELLS: Final = 5 * 10**7
"""Most times that one episode may have, and signal groups times times (0.45 GB of times and
states)."""

MAX_OBJECTS: Final = 10**6
"""Most agents, events, traits, changes of lights and edges of routes that one episode may have (as
many agents as a recording may have; as Python objects they take up to 3 GB)."""

BLOCK_EPISODES: Final = 5000
"""Number of episodes of a block; a shard holds episodes of one block of a scenario. What is in a
shard follows from the episodes of its block alone, so blocks can be made in any order, and a
dataset that grows keeps its whole blocks (with 10 to 120 s per episode, shards have 60 to 250
MB)."""

MAX_SHARD_STEPS: Final = 5 * 10**7
"""Most agent-steps of a shard: it ends before the episode that would exceed this (some 250 MB at 5
bytes each)."""

MAX_SHARD_ROWS: Final = 10**6
"""Most agents and most frames of a shard: it ends before the episode that would exceed this (its
smaller tables are read as a whole)."""

Split = Literal["train", "validation", "test"]

_SPLIT_CYCLE: Final[tuple[Split, ...]] = ("train", "validation", "test", "train", "train")


def split_of(index: int) -> Split:
    """The split of a scenario's episode by its index: 60 % train, 20 % validation, 20 % test.

    The pattern does not depend on how many episodes there are, so a dataset can grow and every
    episode keeps its split; from three episodes on there is one of each.

    Args:
        index: 0 for a scenario's first episode.

    Returns:
        The split.

    Examples:
        >>> [split_of(i) for i in range(6)]
        ['train', 'validation', 'test', 'train', 'train', 'train']
    """
    return _SPLIT_CYCLE[index % len(_SPLIT_CYCLE)]


def steps_schema(exact: bool) -> pa.Schema:
    """Columns of ``steps.parquet``: one row per agent and step, sorted by agent, then step.

    Args:
        exact: whether the numbers are float64 as they came; otherwise rounded float32.

    Returns:
        The schema. ``agent`` is the id in ``agents.parquet``, ``step`` the row of
        ``frames.parquet``, ``time_s`` that row's time.
    """
    number = pa.float64() if exact else pa.float32()
    return pa.schema(
        [
            pa.field("agent", pa.int64(), nullable=False),
            pa.field("step", pa.int32(), nullable=False),
            pa.field("time_s", pa.float64(), nullable=False),
            pa.field("x_m", number, nullable=False),
            pa.field("y_m", number, nullable=False),
            pa.field("heading_rad", number, nullable=False),
            pa.field("speed_mps", number, nullable=False),
        ]
    )


AGENTS: Final = pa.schema(
    [
        pa.field("agent", pa.int64(), nullable=False),
        pa.field("name", pa.string(), nullable=False),  # the source's own id
        pa.field("kind", pa.string(), nullable=False),  # car bus truck motorcycle bicycle ...
        pa.field("behavior", pa.string()),  # null: not known, or does not drive
        pa.field("style", pa.string()),  # aggressive, conservative; null: not known
        pa.field("length_m", pa.float64(), nullable=False),
        pa.field("width_m", pa.float64(), nullable=False),
        pa.field("depart_s", pa.float64(), nullable=False),  # when it is due to enter
        pa.field("route", pa.list_(pa.string()), nullable=False),  # edges, first to last
        pa.field("walking_speed_mps", pa.float64(), nullable=False),  # 0 for those that drive
        pa.field("seed", pa.int64(), nullable=False),  # of the agent's own chance decisions
        pa.field("jaywalks", pa.bool_(), nullable=False),  # crosses anywhere and on red
        *(pa.field(name, pa.float64()) for name in PROFILE_FIELDS),  # null: no profile
    ]
)
"""Columns of ``agents.parquet``: one row per agent, in order of id."""

FRAMES: Final = pa.schema([pa.field("time_s", pa.float64(), nullable=False)])
"""Columns of ``frames.parquet``: one row per time step; row i is step i."""

SIGNALS_TABLE: Final = pa.schema(
    [
        pa.field("step", pa.int32(), nullable=False),
        pa.field("time_s", pa.float64(), nullable=False),
        pa.field("group", pa.int16(), nullable=False),  # signal group of the road
        pa.field("state", pa.string(), nullable=False),  # red yellow green off
    ]
)
"""Columns of ``signals.parquet``: the state of every group at step 0, then every change."""

EVENTS: Final = pa.schema(
    [
        pa.field("time_s", pa.float64(), nullable=False),
        pa.field("kind", pa.string(), nullable=False),
        pa.field("agent", pa.int64(), nullable=False),  # whose event it is
        pa.field("other", pa.int64()),  # the second party
        pa.field("rule", pa.string(), nullable=False),  # the rule, or the cause
    ]
)
"""Columns of ``events.parquet``: one row per event, in time order."""

TRAITS_TABLE: Final = pa.schema(
    [
        pa.field("agent", pa.int64(), nullable=False),  # the agent that showed it
        pa.field("trait", pa.string(), nullable=False),  # a row of the paper's trait table
        pa.field("begin_s", pa.float64(), nullable=False),
        pa.field("end_s", pa.float64(), nullable=False),
        pa.field("value", pa.float64(), nullable=False),  # the detector's number
        pa.field("other", pa.int64()),  # the second party
    ]
)
"""Columns of ``traits.parquet``: the shown traits, found by `behaviors.traits`, in time order.
The detector gives meaning and unit of the value. Empty for recordings."""

EPISODE_FILES: Final = (
    "steps.parquet",
    "agents.parquet",
    "frames.parquet",
    "signals.parquet",
    "events.parquet",
    "traits.parquet",
)
"""The tables of an episode."""

TABLES: Final = tuple(name.removesuffix(".parquet") for name in EPISODE_FILES)
"""Names of the tables, each a folder of a dataset."""


def table_schema(name: FileName, exact: bool = False) -> pa.Schema:
    """The columns of one of an episode's tables.

    Args:
        name: of ``EPISODE_FILES``.
        exact: of steps, as for `steps_schema`.
    """
    if name == "steps.parquet":
        return steps_schema(exact)
    return {
        "agents.parquet": AGENTS,
        "frames.parquet": FRAMES,
        "signals.parquet": SIGNALS_TABLE,
        "events.parquet": EVENTS,
        "traits.parquet": TRAITS_TABLE,
    }[name]


def shard_schema(name: FileName, exact: bool = False) -> pa.Schema:
    """The columns of one table of a shard: ``episode``, then those of the episode's own table.

    Frames say their step, too, because a shard has the frames of several episodes.

    Args:
        name: of ``EPISODE_FILES``.
        exact: of steps, as for `steps_schema`.

    Examples:
        >>> shard_schema("frames.parquet").names
        ['episode', 'step', 'time_s']
    """
    added = [pa.field("episode", pa.string(), nullable=False)]
    if name == "frames.parquet":
        added.append(pa.field("step", pa.int32(), nullable=False))
    return pa.schema([*added, *table_schema(name, exact)])


CATALOGUE: Final = pa.schema(
    [
        pa.field("id", pa.string(), nullable=False),
        pa.field("scenario", pa.string(), nullable=False),
        pa.field("engine", pa.string(), nullable=False),
        pa.field("split", pa.string(), nullable=False),
        pa.field("index", pa.int64(), nullable=False),
        pa.field("seed", pa.uint64(), nullable=False),
        pa.field("recording", pa.string()),  # the recording's own name; null: simulated
        pa.field("flow", pa.string()),  # option of that name, in words; null: not given
        pa.field("mix", pa.string()),  # option of that name as JSON with sorted keys; null: none
        pa.field("frames", pa.int64(), nullable=False),
        pa.field("agents", pa.int64(), nullable=False),  # that were seen
        pa.field("agent_steps", pa.int64(), nullable=False),
        *(pa.field(name, pa.int32(), nullable=False) for name in (*BEHAVIORS, *KINDS)),  # drawn
        pa.field("road", pa.string()),  # checksum; null: not known
        pa.field("exact", pa.bool_(), nullable=False),  # float64 as it came, not rounded float32
        pa.field("shard", pa.string(), nullable=False),  # name of its shard, without ending
        pa.field("row_group", pa.int32(), nullable=False),  # of the shard's steps
        pa.field("options", pa.string(), nullable=False),  # JSON
        pa.field("made_with", pa.string(), nullable=False),  # JSON
    ]
)
"""Columns of ``episodes.parquet``, the catalogue: one row per episode, by scenario, engine, index
and id. A count of drawn agents stands under each behaviour and kind."""

FileName = Literal[
    "steps.parquet",
    "agents.parquet",
    "frames.parquet",
    "signals.parquet",
    "events.parquet",
    "traits.parquet",
]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
EpisodeId = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
ShardPath = Annotated[
    str,
    Field(
        pattern=rf"^({'|'.join(TABLES)})/scenario=[A-Za-z0-9_.~%-]+/split=[a-z]+/[0-9-]+\.parquet$"
    ),
]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class FileEntry(_Strict):
    """One file of a dataset.

    Attributes:
        sha256: checksum of its content.
        size: bytes.
    """

    sha256: Sha256
    size: Annotated[int, Field(ge=0)]


class EpisodeMeta(_Strict):
    """What an episode is made from.

    Attributes:
        scenario: registered name of the scenario, or the recording's name.
        engine: registered name of the engine, or the format's key for a recording.
        seed: seed of the population and of the engine.
        index: 0 for the scenario's first episode; decides the split.
        split: which part of the data the episode belongs to.
        options: what the scenario was called with.
        made_with: version of each package that determines the bytes.
    """

    scenario: Annotated[str, Field(min_length=1, max_length=200)]
    engine: Annotated[str, Field(min_length=1, max_length=200)]
    seed: Annotated[int, Field(ge=0)] = 0
    index: Annotated[int, Field(ge=0)] = 0
    split: Split = "train"
    options: dict[str, JsonValue] = {}
    made_with: dict[str, str] = {}


class EpisodeEntry(EpisodeMeta):
    """An episode in a manifest.

    Attributes:
        id: hash of what the episode was made from; the name of its folder.
        road: checksum of its road, which is ``roads/<road>.net.xml``, ``.json`` or ``.road.json``;
            None where unknown.
        frames: time steps.
        agents: agents that were seen.
        agent_steps: its rows of the table of steps.
        files: every file of the episode, where it has files of its own.
        shard: name of its shard, without folder and ending; None where it has files of its own.
        row_group: of the shard's steps.
        exact: whether its numbers are float64 as they came; None where it has files of its own.
        drawn: how many agents of each behaviour and kind were drawn, where the catalogue says so.
    """

    id: EpisodeId
    road: Sha256 | None = None
    frames: Annotated[int, Field(ge=0)]
    agents: Annotated[int, Field(ge=0)]
    agent_steps: Annotated[int, Field(ge=0)]
    files: dict[FileName, FileEntry] = {}
    shard: Annotated[str, Field(pattern=r"^[0-9]{6,18}-[0-9]{6,18}(-[0-9]{1,9})?$")] | None = None
    row_group: Annotated[int, Field(ge=0)] = 0
    exact: bool | None = None
    drawn: dict[str, Annotated[int, Field(ge=0)]] = {}

    @property
    def recording(self) -> str | None:
        """Name of the recording that it was read from; None for a simulated episode."""
        recording = self.options.get("recording")
        return recording if isinstance(recording, str) else None

    @property
    def file(self) -> str | None:
        """The file that the recording was read from; None for a simulated episode."""
        file = self.options.get("file")
        return file if isinstance(file, str) else None

    @property
    def name(self) -> str:
        """What people call it: its recording, or its scenario and index."""
        return self.recording or f"{self.scenario} {self.index}"


EPISODE_FIELDS: Final = (
    *EpisodeMeta.model_fields,
    *("id", "road", "frames", "agents", "agent_steps", "files"),
)
"""What ``episode.json`` says of an episode with files of its own."""


class Header(_Strict):
    """What a dataset says of itself as a whole. Nothing in it differs between two equal runs.

    Attributes:
        schema_version: version of the layout.
        configuration: what the dataset was generated or imported with.
        roads: size in bytes of every road file, by its checksum.
        files: size and checksum of every shard, by its path in the dataset.
    """

    schema_version: int
    configuration: dict[str, JsonValue]
    roads: dict[Sha256, Annotated[int, Field(ge=0)]]
    files: dict[ShardPath, FileEntry] = {}


class Manifest(Header):
    """Everything that is known of a dataset, and the content of a ``manifest.json``.

    Attributes:
        episodes: every episode, by scenario and index.
    """

    episodes: tuple[EpisodeEntry, ...]
