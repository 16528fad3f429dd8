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

import json
from typing import Annotated, Any, Final, Literal, TypeVar, get_args
from urllib.parse import quote

import pyarrow as pa
from pydantic import BaseModel, ConfigDict, Field, JsonValue

from behaviors.labels import BEHAVIORS
from behaviors.profiles import PROFILE_FIELDS
from sim.frames import KINDS

T = TypeVar("T")

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

    Every episode keeps its split when a dataset grows. Three episodes already give one of each.
    """
    return _SPLIT_CYCLE[index % len(_SPLIT_CYCLE)]


def block_of(index: int) -> tuple[int, int]:
    """First and last episode of the block of a scenario's episodes that one worker makes.

    Blocks are small at first, so that all processors have work, and grow, so that a large dataset
    has few files. They depend on the index alone, so a dataset can grow.

    Examples:
        >>> block_of(0), block_of(7), block_of(161), block_of(325), block_of(10**6)
        ((0, 4), (5, 9), (160, 164), (320, 329), (999680, 1000319))
    """
    begin = SMALLEST_BLOCK * BLOCKS_OF_A_SIZE
    doublings = max((index // begin).bit_length() - 1, 0)
    size = min(SMALLEST_BLOCK << doublings, LARGEST_BLOCK)
    first = index - index % size
    return first, first + size - 1


def shard_file(table: TableName, scenario: str, split: str, index: int) -> str:
    """The file of a table that holds an episode, below the dataset's folder."""
    first, last = block_of(index)
    folder = f"{table}/scenario={quote(scenario, safe='')}/split={split}"
    return f"{folder}/{first:06}-{last:06}.parquet"


def _schema(**columns: Any) -> pa.Schema:
    """A schema: a type for each column; ``[type]`` for a column that may be null."""
    return pa.schema(
        pa.field(name, *kind) if isinstance(kind, list) else pa.field(name, kind, nullable=False)
        for name, kind in columns.items()
    )


BOOL, INT, FLOAT, TEXT = pa.bool_(), pa.int64(), pa.float64(), pa.string()


def steps_schema(exact: bool) -> pa.Schema:
    """Columns of ``steps``: one row per agent and step, sorted by agent, then step.

    ``agent`` is the id in ``agents``, ``step`` that in ``frames``, ``time_s`` its time. Numbers are
    float64 as they came if ``exact``; otherwise rounded float32. Columns after ``speed_mps`` are
    null where unknown, such as on unknown roads.
    """
    number = FLOAT if exact else pa.float32()
    return _schema(
        episode=TEXT,
        agent=INT,
        step=pa.int32(),
        time_s=FLOAT,
        x_m=number,
        y_m=number,
        heading_rad=number,
        speed_mps=number,
        lane=[TEXT],  # id of the road's lane; null: on none
        lane_s_m=[number],  # distance along the lane
        acceleration_mps2=[number],  # change of speed since the step before
        leader=[INT],  # the agent ahead on its way
        gap_m=[number],  # bumper to bumper to the leader
    )


AGENTS: Final = _schema(
    episode=TEXT,
    agent=INT,
    name=TEXT,  # the source's own id
    kind=TEXT,  # car bus truck motorcycle bicycle ...
    behavior=[TEXT],  # null: not known, or does not drive
    style=[TEXT],  # aggressive, conservative; null: not known
    length_m=FLOAT,
    width_m=FLOAT,
    depart_s=FLOAT,  # when it is due to enter
    route=pa.list_(pa.field("element", TEXT)),  # edges
    walking_speed_mps=FLOAT,  # 0 for those that drive
    seed=INT,  # of the agent's own chance decisions
    jaywalks=BOOL,  # crosses anywhere and on red
    **{name: [FLOAT] for name in PROFILE_FIELDS},  # null: no profile
)
"""Columns of ``agents``: one row per agent, in order of id."""

FRAMES: Final = _schema(episode=TEXT, step=pa.int32(), time_s=FLOAT)
"""Columns of ``frames``: one row per time step."""

SIGNALS_TABLE: Final = _schema(
    episode=TEXT,
    step=pa.int32(),
    time_s=FLOAT,
    group=pa.int16(),  # signal group of the road
    state=TEXT,  # red yellow green off
)
"""Columns of ``signals``: the state of every group at step 0, then every change."""

EVENTS: Final = _schema(
    episode=TEXT,
    time_s=FLOAT,
    kind=TEXT,
    agent=INT,  # whose event it is
    other=[INT],  # the second party
    rule=TEXT,  # the rule, or the cause
    end_s=[FLOAT],  # collision: when the two last touch
    time_to_collision_s=[FLOAT],  # near miss: the least one
    post_encroachment_s=[FLOAT],  # near miss: one was there so soon after
    distance_m=[FLOAT],  # wrong way: how far
    cut_in_headway_s=[FLOAT],  # collision after a cut-in: the gap it left
)
"""Columns of ``events``: one row per event, in time order; a collision is one event. Numbers that
do not belong to an event are null."""

TRAITS_TABLE: Final = _schema(
    episode=TEXT,
    agent=INT,  # the agent that showed it
    trait=TEXT,  # a row of the paper's trait table
    begin_s=FLOAT,
    end_s=FLOAT,
    value=FLOAT,  # the detector's number
    other=[INT],  # the second party
)
"""Columns of ``traits``: the shown traits, found by `behaviors.traits`, in time order. The detector
gives meaning and unit of the value. Empty for recordings."""

CONFLICTS: Final = _schema(
    episode=TEXT,
    first=INT,  # agents, the smaller id first
    second=INT,
    kind=TEXT,  # following merging crossing oncoming ...
    begin_s=FLOAT,
    end_s=FLOAT,
    ttc_s=[FLOAT],  # least time to collision; null: never on that course
    ttc_time_s=[FLOAT],  # when
    mttc_s=[FLOAT],  # the same with accelerations
    drac_mps2=[FLOAT],  # largest deceleration to avoid the crash
    pet_s=[FLOAT],  # post-encroachment time; null: no place in common
    pet_time_s=[FLOAT],  # when the later one came there
    gap_m=[FLOAT],  # least distance of the outlines
    closing_mps=[FLOAT],  # how fast it shrank then
    delta_v_mps=[FLOAT],  # of the lighter one, had they collided
    passed_first=[INT],  # the one that was there first
    priority=[INT],  # the one with priority; null if the map does not give it
    near_miss=BOOL,
)
"""Columns of ``conflicts``: one row per encounter of two road users, as `sim.safety.Conflicts` has
them, by begin and ids."""

TableName = Literal["steps", "agents", "frames", "signals", "events", "traits", "conflicts"]

TABLES: Final[tuple[TableName, ...]] = get_args(TableName)
"""Names of the tables, each a folder of a dataset."""


def table_schema(table: TableName, exact: bool = False) -> pa.Schema:
    """The columns of a table; ``exact`` is of steps, as for `steps_schema`."""
    others = AGENTS, FRAMES, SIGNALS_TABLE, EVENTS, TRAITS_TABLE, CONFLICTS
    return dict(zip(TABLES, (steps_schema(exact), *others), strict=True))[table]


DRAWN: Final = (*map(str, BEHAVIORS), *map(str, KINDS))
"""Columns of the catalogue that count drawn agents."""

CATALOGUE: Final = _schema(
    id=TEXT,
    scenario=TEXT,
    engine=TEXT,
    split=TEXT,
    index=INT,
    seed=pa.uint64(),
    recording=[TEXT],  # the recording's own name; null: simulated
    flow=[TEXT],  # option of that name, in words; null: not given
    mix=[TEXT],  # option of that name as JSON with sorted keys; null: none
    frames=INT,
    agents=INT,  # that were seen
    agent_steps=INT,
    **{name: pa.int32() for name in DRAWN},
    road=[TEXT],  # checksum; null: not known
    exact=BOOL,  # float64 as it came, not rounded float32
    shard=TEXT,  # name of its shard, without ending
    options=TEXT,  # JSON
    made_with=TEXT,  # JSON
)
"""Columns of ``episodes.parquet``, the catalogue: one row per episode, by scenario, engine, index
and id. A count of drawn agents stands under each behaviour and kind."""

EPISODES: Final = "episodes.parquet"
"""Name of the catalogue; it is written last, so where it is the dataset is complete."""

WORDS: Final = [field.name for field in CATALOGUE if field.type == "string" and field.name != "id"]
"""Columns of the catalogue of which many rows have the same words."""

METADATA_KEY: Final = "graphrqi"
"""Under which key a Parquet file says in JSON what belongs to the file as a whole."""


def words_of(option: JsonValue) -> str | None:
    """How the catalogue says an option of an episode: a word as it is, anything else as JSON."""
    return option if option is None or isinstance(option, str) else as_json(option)


def as_json(value: object) -> str:
    """One line of JSON; equal values give equal lines."""
    return json.dumps(value, sort_keys=True, allow_nan=False)


Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Count = Annotated[int, Field(ge=0)]
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
    size: Count
    rows: Count = 0


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
    seed: Count = 0
    index: Count = 0
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
    frames: Count
    agents: Count
    agent_steps: Count
    exact: bool = False
    drawn: dict[str, Count] = {}

    @property
    def shard(self) -> str:
        """Name of its shard, without folder and ending."""
        return "{:06}-{:06}".format(*block_of(self.index))

    @property
    def recording(self) -> str | None:
        """Name of the recording that it was read from; None for a simulated episode."""
        return self._option("recording", str)

    @property
    def file(self) -> str | None:
        """The file that the recording was read from; None for a simulated episode."""
        return self._option("file", str)

    @property
    def behaviors(self) -> dict[str, Any] | None:
        """Behaviours of one's own, beside the six, as `behaviors.read_behaviors` takes them."""
        return self._option("behaviors", dict)

    @property
    def name(self) -> str:
        """Display name: its recording, or its scenario and index."""
        return self.recording or f"{self.scenario} {self.index}"

    def _option(self, name: str, kind: type[T]) -> T | None:
        found = self.options.get(name)
        return found if isinstance(found, kind) else None


class Shard(_Strict):
    """A shard that is finished; its table of agents says this in its metadata.

    Attributes:
        configuration: what the dataset is made from.
        entries: its episodes, in order.
        files: size and checksum of its roads and other tables, by name.
    """

    configuration: dict[str, JsonValue]
    entries: tuple[EpisodeEntry, ...]
    files: dict[str, FileEntry]


class Header(_Strict):
    """Metadata of a dataset. Nothing in it differs between two equal runs.

    Attributes:
        schema_version: version of the layout.
        configuration: what the dataset was generated or imported with.
        files: size and checksum of every shard's tables and every road, by name.
    """

    schema_version: Annotated[int, Field(ge=SCHEMA_VERSION, le=SCHEMA_VERSION)]
    configuration: dict[str, JsonValue]
    files: dict[str, FileEntry] = {}


class Manifest(Header):
    """Everything that is known of a dataset.

    Attributes:
        episodes: every episode, by scenario and index.
    """

    episodes: tuple[EpisodeEntry, ...]
