"""What a dataset on disk consists of: every table, every column, and the manifest.

    DATASET/
      manifest.json                 what is inside, how it was made, a checksum for every file
      README.md                     the data card, for people
      roads/<sha256>.net.xml        the road of the episodes, as a SUMO net (or, of recordings, as
                                    it came: .json, an Argoverse 2 map)
      episodes/<id>/
        episode.json                the manifest's entry of this episode
        steps.parquet               one row per agent and time step
        agents.parquet              one row per agent
        frames.parquet              one row per time step
        signals.parquet             one row per change of a traffic light
        events.parquet              one row per event
        traits.parquet              one row per shown trait

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

from behaviors.profiles import PROFILE_FIELDS

SCHEMA_VERSION: Final = 1
"""Raised whenever a reader of the old version could misread the new one."""

POSITION_QUANTUM: Final = 2.0**-10
"""Simulated positions, m, and speeds, m/s, are multiples of this: about a millimetre (our choice:
cars are measured to centimetres at best)."""

HEADING_QUANTUM: Final = 2.0**-13
"""Simulated headings, rad, are multiples of this: 0.007 degrees (our choice: finer than any
measurement)."""

MAX_CELLS: Final = 5 * 10**7
"""Most agents times steps that one episode may have as dense arrays (our choice: 1.65 GB, 33 bytes
for each, so that reading one stays within 2 GB)."""

MAX_OBJECTS: Final = 10**6
"""Most agents, events, traits, changes of lights and edges of routes that one episode may have (our
choice: as many agents as a recording may have; as Python objects they take up to 3 GB)."""

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
        agent_steps: rows of ``steps.parquet``.
        files: every file of the episode.
    """

    id: EpisodeId
    road: Sha256 | None = None
    frames: Annotated[int, Field(ge=0)]
    agents: Annotated[int, Field(ge=0)]
    agent_steps: Annotated[int, Field(ge=0)]
    files: dict[FileName, FileEntry]

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


class Manifest(_Strict):
    """The content of ``manifest.json``. Nothing in it differs between two equal runs.

    Attributes:
        schema_version: version of this file's description of the data.
        configuration: what the dataset was generated or imported with.
        roads: size in bytes of every road file, by its checksum.
        episodes: every episode, by scenario and index.
    """

    schema_version: int
    configuration: dict[str, JsonValue]
    roads: dict[Sha256, Annotated[int, Field(ge=0)]]
    episodes: tuple[EpisodeEntry, ...]
