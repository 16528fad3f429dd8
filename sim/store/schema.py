"""Layout of a dataset on disk: every table, every column, and the catalogue.

    DATASET/
      episodes.parquet              the catalogue: a row per episode; how it was made and a checksum
                                    for every other file in its metadata; written last
      README.md                     the data card, for people
      roads/<sha256>.net.xml        the road of the episodes, as a SUMO net (or, of recordings, as
                                    it came: .json, an Argoverse 2 map)
      TABLE/scenario=S/split=P/FIRST-LAST.parquet
                                    a shard: those of the scenario's episodes FIRST to LAST that are
                                    of this split, a row group for each

Every row says in ``episode`` to which episode it belongs. A shard's table of agents is written
last and lists, in its metadata, the shard's episodes and files. A stopped run therefore continues
after the finished shards.

Positions are agents' centres, x east and y north in metres; headings are radians counter-clockwise
from +x in (-pi, pi]; speeds m/s along the heading; times s. Labels are words. The tables are plain
Parquet and open as they are in pandas, polars, duckdb and pyarrow.

Simulated steps are float32 rounded to multiples of ``POSITION_QUANTUM`` and ``HEADING_QUANTUM``,
which is finer than any observer could measure and makes the files small. Recordings are stored as
float64, exactly.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal, get_args

import pyarrow as pa
from pydantic import BaseModel, ConfigDict, Field, JsonValue

from behaviors.labels import BEHAVIORS
from behaviors.profiles import PROFILE_FIELDS
from sim.frames import KINDS

SCHEMA_VERSION: Final = 3
"""Version of a dataset's layout. Raised whenever a reader of the old version could misread the new
one."""

EPISODE_VERSION: Final = 2
"""Version of an episode's content, which is part of what its id is the hash of."""

POSITION_QUANTUM: Final = 2.0**-10
"""Simulated positions, m, and speeds, m/s, are multiples of this: about a millimetre (cars are
measured to centimetres at best)."""

DERIVED_QUANTUM: Final = 2.0**-7
"""Gaps and distances along lanes, m, and accelerations, m/s², of simulated episodes are multiples
of this: below a centimetre."""

HEADING_QUANTUM: Final = 2.0**-13
"""Simulated headings, rad, are multiples of this: 0.007 degrees (finer than any measurement)."""

MAX_STEPS: Final = 5 * 10**7
"""Most agent-steps that one episode may have, and signal groups times times (they take some 2 GB of
memory)."""

SMALLEST_BLOCK, LARGEST_BLOCK, BLOCKS_OF_A_SIZE = 5, 640, 32
"""Episodes in the first blocks of a scenario and in the last ones of a very long one, and how many
blocks of each size lie between."""

Split = Literal["train", "validation", "test"]

_SPLIT_CYCLE: Final[tuple[Split, ...]] = ("train", "validation", "test", "train", "train")


def split_of(index: int) -> Split:
    """The split of a scenario's episode by its index: 60 % train, 20 % validation, 20 % test.

    The pattern does not depend on the number of episodes, so every episode keeps its split when a
    dataset grows. Three episodes already give one of each.

    Args:
        index: 0 for a scenario's first episode.

    Returns:
        The split.

    Examples:
        >>> [split_of(i) for i in range(6)]
        ['train', 'validation', 'test', 'train', 'train', 'train']
    """
    return _SPLIT_CYCLE[index % len(_SPLIT_CYCLE)]


def block_of(index: int) -> tuple[int, int]:
    """The block that a scenario's episode belongs to: the episodes that one worker makes.

    Blocks are small at first, so that all processors have work in a small dataset, and grow, so
    that a large one has few files. They depend on the index alone, so a dataset can grow.

    Args:
        index: 0 for a scenario's first episode.

    Returns:
        The first and the last index of the block.

    Examples:
        >>> block_of(0), block_of(7), block_of(161), block_of(325), block_of(10**6)
        ((0, 4), (5, 9), (160, 164), (320, 329), (999680, 1000319))
    """
    begin = SMALLEST_BLOCK * BLOCKS_OF_A_SIZE
    doublings = max((index // begin).bit_length() - 1, 0)
    size = min(SMALLEST_BLOCK << doublings, LARGEST_BLOCK)
    first = index - index % size
    return first, first + size - 1


def _column(name: str, kind: pa.DataType) -> pa.Field:
    """A column that has a value in every row."""
    return pa.field(name, kind, nullable=False)


_OF_EPISODE: Final = _column("episode", pa.string())


def steps_schema(exact: bool) -> pa.Schema:
    """Columns of ``steps``: one row per agent and step, sorted by agent, then step.

    Args:
        exact: whether the numbers are float64 as they came; otherwise rounded float32.

    Returns:
        The schema. ``agent`` is the id in ``agents``, ``step`` that in ``frames``, ``time_s`` its
        time. Columns after ``speed_mps`` are null where unknown, such as on unknown roads.
    """
    number = pa.float64() if exact else pa.float32()
    return pa.schema(
        [
            _OF_EPISODE,
            _column("agent", pa.int64()),
            _column("step", pa.int32()),
            _column("time_s", pa.float64()),
            _column("x_m", number),
            _column("y_m", number),
            _column("heading_rad", number),
            _column("speed_mps", number),
            pa.field("lane", pa.string()),  # id of the road's lane; null: on none
            pa.field("lane_s_m", number),  # distance along the lane
            pa.field("acceleration_mps2", number),  # change of speed since the step before
            pa.field("leader", pa.int64()),  # the agent ahead on its way
            pa.field("gap_m", number),  # bumper to bumper to the leader
        ]
    )


AGENTS: Final = pa.schema(
    [
        _OF_EPISODE,
        _column("agent", pa.int64()),
        _column("name", pa.string()),  # the source's own id
        _column("kind", pa.string()),  # car bus truck motorcycle bicycle ...
        pa.field("behavior", pa.string()),  # null: not known, or does not drive
        pa.field("style", pa.string()),  # aggressive, conservative; null: not known
        _column("length_m", pa.float64()),
        _column("width_m", pa.float64()),
        _column("depart_s", pa.float64()),  # when it is due to enter
        pa.field("route", pa.list_(pa.field("element", pa.string())), nullable=False),  # edges
        _column("walking_speed_mps", pa.float64()),  # 0 for those that drive
        _column("seed", pa.int64()),  # of the agent's own chance decisions
        _column("jaywalks", pa.bool_()),  # crosses anywhere and on red
        *(pa.field(name, pa.float64()) for name in PROFILE_FIELDS),  # null: no profile
    ]
)
"""Columns of ``agents``: one row per agent, in order of id."""

FRAMES: Final = pa.schema(
    [
        _OF_EPISODE,
        _column("step", pa.int32()),
        _column("time_s", pa.float64()),
    ]
)
"""Columns of ``frames``: one row per time step."""

SIGNALS_TABLE: Final = pa.schema(
    [
        _OF_EPISODE,
        _column("step", pa.int32()),
        _column("time_s", pa.float64()),
        _column("group", pa.int16()),  # signal group of the road
        _column("state", pa.string()),  # red yellow green off
    ]
)
"""Columns of ``signals``: the state of every group at step 0, then every change."""

EVENTS: Final = pa.schema(
    [
        _OF_EPISODE,
        _column("time_s", pa.float64()),
        _column("kind", pa.string()),
        _column("agent", pa.int64()),  # whose event it is
        pa.field("other", pa.int64()),  # the second party
        _column("rule", pa.string()),  # the rule, or the cause
        pa.field("end_s", pa.float64()),  # collision: when the two last touch
        pa.field("time_to_collision_s", pa.float64()),  # near miss: the least one
        pa.field("post_encroachment_s", pa.float64()),  # near miss: one was there so soon after
        pa.field("distance_m", pa.float64()),  # wrong way: how far
        pa.field("cut_in_headway_s", pa.float64()),  # collision after a cut-in: the gap it left
    ]
)
"""Columns of ``events``: one row per event, in time order; a collision is one event. Numbers that
do not belong to an event are null."""

TRAITS_TABLE: Final = pa.schema(
    [
        _OF_EPISODE,
        _column("agent", pa.int64()),  # the agent that showed it
        _column("trait", pa.string()),  # a row of the paper's trait table
        _column("begin_s", pa.float64()),
        _column("end_s", pa.float64()),
        _column("value", pa.float64()),  # the detector's number
        pa.field("other", pa.int64()),  # the second party
    ]
)
"""Columns of ``traits``: the shown traits, found by `behaviors.traits`, in time order. The detector
gives meaning and unit of the value. Empty for recordings."""

CONFLICTS: Final = pa.schema(
    [
        _OF_EPISODE,
        _column("first", pa.int64()),  # agents, the smaller id first
        _column("second", pa.int64()),
        _column("kind", pa.string()),  # following merging crossing oncoming ...
        _column("begin_s", pa.float64()),
        _column("end_s", pa.float64()),
        pa.field("ttc_s", pa.float64()),  # least time to collision; null: never on that course
        pa.field("ttc_time_s", pa.float64()),  # when
        pa.field("mttc_s", pa.float64()),  # the same with accelerations
        pa.field("drac_mps2", pa.float64()),  # largest deceleration to avoid the crash
        pa.field("pet_s", pa.float64()),  # post-encroachment time; null: no place in common
        pa.field("pet_time_s", pa.float64()),  # when the later one came there
        pa.field("gap_m", pa.float64()),  # least distance of the outlines
        pa.field("closing_mps", pa.float64()),  # how fast it shrank then
        pa.field("delta_v_mps", pa.float64()),  # of the lighter one, had they collided
        pa.field("passed_first", pa.int64()),  # the one that was there first
        pa.field("priority", pa.int64()),  # the one with priority; null if the map does not give it
        _column("near_miss", pa.bool_()),
    ]
)
"""Columns of ``conflicts``: one row per encounter of two road users, as `sim.safety.Conflicts` has
them, by begin and ids."""

TableName = Literal["steps", "agents", "frames", "signals", "events", "traits", "conflicts"]

TABLES: Final[tuple[TableName, ...]] = get_args(TableName)
"""Names of the tables, each a folder of a dataset."""


def table_schema(table: TableName, exact: bool = False) -> pa.Schema:
    """The columns of a table.

    Args:
        table: which.
        exact: of steps, as for `steps_schema`.

    Examples:
        >>> table_schema("frames").names
        ['episode', 'step', 'time_s']
    """
    return {
        "steps": steps_schema(exact),
        "agents": AGENTS,
        "frames": FRAMES,
        "signals": SIGNALS_TABLE,
        "events": EVENTS,
        "traits": TRAITS_TABLE,
        "conflicts": CONFLICTS,
    }[table]


CATALOGUE: Final = pa.schema(
    [
        _column("id", pa.string()),
        _column("scenario", pa.string()),
        _column("engine", pa.string()),
        _column("split", pa.string()),
        _column("index", pa.int64()),
        _column("seed", pa.uint64()),
        pa.field("recording", pa.string()),  # the recording's own name; null: simulated
        pa.field("flow", pa.string()),  # option of that name, in words; null: not given
        pa.field("mix", pa.string()),  # option of that name as JSON with sorted keys; null: none
        _column("frames", pa.int64()),
        _column("agents", pa.int64()),  # that were seen
        _column("agent_steps", pa.int64()),
        *(_column(name, pa.int32()) for name in (*BEHAVIORS, *KINDS)),  # drawn
        pa.field("road", pa.string()),  # checksum; null: not known
        _column("exact", pa.bool_()),  # float64 as it came, not rounded float32
        _column("shard", pa.string()),  # name of its shard, without ending
        _column("options", pa.string()),  # JSON
        _column("made_with", pa.string()),  # JSON
    ]
)
"""Columns of ``episodes.parquet``, the catalogue: one row per episode, by scenario, engine, index
and id. A count of drawn agents stands under each behaviour and kind."""

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
EpisodeId = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class FileEntry(_Strict):
    """One file of a dataset.

    Attributes:
        sha256: checksum of its content.
        size: bytes.
        rows: of the table; 0 for a road.
    """

    sha256: Sha256
    size: Annotated[int, Field(ge=0)]
    rows: Annotated[int, Field(ge=0)] = 0


class EpisodeMeta(_Strict):
    """Metadata of an episode.

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
    """An episode of a dataset: a row of its catalogue.

    Attributes:
        id: hash of what the episode was made from.
        road: checksum of its road, which is ``roads/<road>.net.xml``, ``.json`` or ``.road.json``;
            None where unknown.
        frames: time steps.
        agents: agents that were seen.
        agent_steps: its rows of the table of steps.
        exact: whether its numbers are float64 as they came.
        drawn: how many agents of each behaviour and kind were drawn.
    """

    id: EpisodeId
    road: Sha256 | None = None
    frames: Annotated[int, Field(ge=0)]
    agents: Annotated[int, Field(ge=0)]
    agent_steps: Annotated[int, Field(ge=0)]
    exact: bool = False
    drawn: dict[str, Annotated[int, Field(ge=0)]] = {}

    @property
    def shard(self) -> str:
        """Name of its shard, without folder and ending."""
        return "{:06}-{:06}".format(*block_of(self.index))

    @property
    def recording(self) -> str | None:
        """Name of the recording that it was read from; None for a simulated episode."""
        return self._option("recording")

    @property
    def file(self) -> str | None:
        """The file that the recording was read from; None for a simulated episode."""
        return self._option("file")

    @property
    def behaviors(self) -> dict[str, Any]:
        """Behaviours of one's own, beside the six, as `behaviors.read_behaviors` takes them."""
        found = self.options.get("behaviors", {})
        return found if isinstance(found, dict) else {}

    def _option(self, name: str) -> str | None:
        value = self.options.get(name)
        return value if isinstance(value, str) else None

    @property
    def name(self) -> str:
        """Display name: its recording, or its scenario and index."""
        return self.recording or f"{self.scenario} {self.index}"


class Header(_Strict):
    """Metadata of a dataset. Nothing in it differs between two equal runs.

    Attributes:
        schema_version: version of the layout.
        configuration: what the dataset was generated or imported with.
        files: size and checksum of every shard's tables and every road, by name.
    """

    schema_version: int
    configuration: dict[str, JsonValue]
    files: dict[str, FileEntry] = {}


class Manifest(Header):
    """Everything that is known of a dataset.

    Attributes:
        episodes: every episode, by scenario and index.
    """

    episodes: tuple[EpisodeEntry, ...]
