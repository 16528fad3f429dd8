"""The state of the traffic at one time (`Frame`) and over an episode (`Tracks`).

Conventions, converted once where data enters: positions are the outlines' centres, x east and y
north in metres. Headings are radians counter-clockwise from +x; everything else is SI. Ground
truth (who is which behaviour) is never in a `Frame`: it lives in `sim.scenario.AgentSpec`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields
from enum import StrEnum
from functools import cached_property
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError, counted
from behaviors.labels import BEHAVIORS, Behavior
from behaviors.row_index import RowIndex
from sim.checked_arrays import cast, check_and_freeze, frozen
from sim.events import Event as Event
from sim.events import EventKind as EventKind

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
CodeArray = NDArray[np.int8]
BoolArray = NDArray[np.bool_]


class AgentKind(StrEnum):
    """Kind of a road agent; the members' order is the code order (``.code``)."""

    CAR = "car"
    BUS = "bus"
    TRUCK = "truck"
    MOTORCYCLE = "motorcycle"
    BICYCLE = "bicycle"
    PEDESTRIAN = "pedestrian"

    @property
    def code(self) -> int:
        """Position in ``KINDS``, as stored in ``Frame.kind``."""
        return KINDS.index(self)


KINDS: Final[tuple[AgentKind, ...]] = tuple(AgentKind)
"""The code order of kinds: code c means ``KINDS[c]``."""

MAX_MAGNITUDE: Final = 1e9
"""Largest absolute position, time, heading, speed or size of an agent (beyond any UTM
coordinate)."""

PEDESTRIAN: Final = KINDS.index(AgentKind.PEDESTRIAN)
"""The code of a pedestrian: the only kind that does not drive."""


class Signal(StrEnum):
    """State of one signal group; the members' order is the code order."""

    RED = "red"
    YELLOW = "yellow"
    GREEN = "green"
    OFF = "off"

    @property
    def code(self) -> int:
        """Position in ``SIGNALS``, as stored in ``Frame.signals``."""
        return SIGNALS.index(self)


SIGNALS: Final[tuple[Signal, ...]] = tuple(Signal)
"""The code order of signal states: code c means ``SIGNALS[c]``."""


def says_stop(signals: CodeArray) -> BoolArray:
    """Select the signals that are red or yellow, of codes into ``SIGNALS``."""
    return np.asarray((signals == Signal.RED.code) | (signals == Signal.YELLOW.code))


def _empty_signals() -> CodeArray:
    return np.empty(0, dtype=np.int8)


_FRAME_ARRAYS: Final[tuple[tuple[str, np.dtype[Any], tuple[int, ...]], ...]] = (
    ("ids", np.dtype(np.int64), ()),
    ("xy", np.dtype(np.float64), (2,)),
    ("heading", np.dtype(np.float64), ()),
    ("speed", np.dtype(np.float64), ()),
    ("length", np.dtype(np.float64), ()),
    ("width", np.dtype(np.float64), ()),
    ("kind", np.dtype(np.int8), ()),
    ("signals", np.dtype(np.int8), ()),
)
"""Array fields of a frame, types and shapes after the first axis; all but signals are as long as
``ids``. Checked by hand, because a frame is made at every step of a simulation."""


@dataclass(frozen=True, slots=True)
class Frame:
    """Every road-agent at one instant, in ascending order of id.

    Attributes:
        time_s: simulated time, s.
        ids: (n,) agent ids, ascending, unique within an episode.
        xy: (n, 2) centre of each agent's outline, m.
        heading: (n,) rad, counter-clockwise from +x, in (-pi, pi].
        speed: (n,) m/s, along the heading.
        length: (n,) m.
        width: (n,) m.
        kind: (n,) codes into ``KINDS``.
        signals: (s,) codes into ``SIGNALS``, one per signal group of the road; empty if none.
        events: what happened since the previous frame.
    """

    time_s: float
    ids: IntArray
    xy: FloatArray
    heading: FloatArray
    speed: FloatArray
    length: FloatArray
    width: FloatArray
    kind: CodeArray
    signals: CodeArray = field(default_factory=_empty_signals)
    events: tuple[Event, ...] = ()

    def __post_init__(self) -> None:
        """Check shapes and make the arrays read-only."""
        if not isinstance(self.time_s, (float, int, np.floating, np.integer)):
            raise InputError(f"Frame.time_s: found {self.time_s!r:.60}, expected seconds")
        n: int | None = None
        for name, dtype, tail in _FRAME_ARRAYS:
            given = array = getattr(self, name)
            if type(array) is not np.ndarray or array.dtype is not dtype:
                array = cast(f"Frame.{name}", array, dtype)
            shape = array.shape
            if name == "signals" or n is None:
                if len(shape) != 1:
                    raise InputError(f"Frame.{name}: found shape {shape}, expected ('any',)")
                n = shape[0] if n is None else n
            elif shape != (n, *tail):
                raise InputError(f"Frame.{name}: found shape {shape}, expected {(n, *tail)}")
            if array.flags.writeable:
                array = frozen(array)
            if array is not given:
                object.__setattr__(self, name, array)

    def __len__(self) -> int:
        """How many agents there are."""
        return int(self.ids.size)

    def __repr__(self) -> str:
        """The time, the agents by kind, and counts of signals and events."""
        mean = f", mean speed {self.speed.mean():.1f} m/s" if len(self) else ""
        return (
            f"Frame({self.time_s:g} s: {_by_kind(self.kind)}{mean}, "
            f"{counted(self.signals.size, 'signal group')}, {counted(len(self.events), 'event')})"
        )

    @property
    def driving(self) -> BoolArray:
        """(n,) whether each agent drives (is not a pedestrian)."""
        return np.asarray(self.kind != PEDESTRIAN)


MOVING: Final = ("xy", "heading", "speed")
OF_AGENTS: Final = ("kind", "length", "width")
"""Fields of frames that change with time, and those that are the agents' own."""

_NOBODY: Final = Frame(0.0, [], np.empty((0, 2)), [], [], [], [], [])  # type: ignore[arg-type]

BREAK_S: Final = 1.0
"""Longest time between two frames without a break, s."""

BREAK_STEPS: Final = 3.0
"""Most usual steps that may lie between two frames without a break."""

MAX_CELLS: Final = 5 * 10**7
"""Most agents times times of dense arrays (all four together take 1.65 GB)."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """A whole episode: N agents at T times, and where each was while it was present.

    An agent is present for a small part of a long recording, so tracks keep a row for each time at
    which each is present, by agent, then by time. The dense arrays ``xy``, ``heading``, ``speed``
    and ``valid`` are filled on first use; above ``MAX_CELLS`` they raise an `InputError`.

    Attributes:
        ids: (N,) agent ids, ascending.
        names: (N,) the source's own ids, as strings.
        kind: (N,) codes into ``KINDS``.
        length: (N,) m.
        width: (N,) m.
        time_s: (T,) s, increasing.
        index: the agent and the time of each of the m rows.
        row_xy: (m, 2) where the agents were, m.
        row_heading: (m,) rad.
        row_speed: (m,) m/s.
        signals: (S, T) codes into ``SIGNALS``.
        behavior: (N,) codes into ``classes`` (-1: no label), or None without labels.
        events: every event, in time order.
        classes: the behaviours that codes stand for: the six, then those of one's own.
    """

    ids: IntArray
    names: tuple[str, ...]
    kind: CodeArray
    length: FloatArray
    width: FloatArray
    time_s: FloatArray
    index: RowIndex
    row_xy: FloatArray
    row_heading: FloatArray
    row_speed: FloatArray
    signals: CodeArray
    behavior: CodeArray | None = None
    events: tuple[Event, ...] = ()
    classes: tuple[Behavior, ...] = BEHAVIORS

    def __post_init__(self) -> None:
        """Check shapes and make the arrays read-only."""
        n, t, m = np.shape(self.ids)[0], np.shape(self.time_s)[0], self.index.agent.size
        shapes: dict[str, tuple[Any, tuple[int | None, ...]]] = {
            "ids": (np.int64, (n,)),
            "kind": (np.int8, (n,)),
            "length": (np.float64, (n,)),
            "width": (np.float64, (n,)),
            "time_s": (np.float64, (t,)),
            "row_xy": (np.float64, (m, 2)),
            "row_heading": (np.float64, (m,)),
            "row_speed": (np.float64, (m,)),
            "signals": (np.int8, (None, t)),
        }
        if self.behavior is not None:
            shapes["behavior"] = (np.int8, (n,))
        check_and_freeze(self, shapes)
        if (self.index.agents, self.index.times) != (n, t):
            found = f"{self.index.agents} agents at {self.index.times} times"
            raise InputError(f"Tracks: found rows of {found}, expected {n} and {t}")
        if len(self.names) != n:
            raise InputError(f"Tracks.names: found {len(self.names)} names, expected {n}")

    @classmethod
    def of_dense(cls, *, xy: Any, heading: Any, speed: Any, valid: Any, **facts: Any) -> Tracks:
        """Tracks from arrays of all agents at all times; what is not valid is left out.

        Args:
            xy: (N, T, 2) m.
            heading: (N, T) rad.
            speed: (N, T) m/s.
            valid: (N, T) whether the agent is present at that time.
            facts: the attributes of tracks that are not of rows.

        Raises:
            InputError: if the shapes do not fit.

        Examples:
            >>> Tracks.of_dense(
            ...     ids=[7], names=("7",), kind=[0], length=[4.0], width=[2.0], time_s=[0.1, 0.2],
            ...     xy=[[[0.0, 0.0], [3.0, 4.0]]], heading=[[0.0, 0.0]], speed=[[0.0, 5.0]],
            ...     valid=[[False, True]], signals=np.zeros((0, 2))).speed
            array([[nan,  5.]])
        """
        n, t = np.shape(facts["ids"])[0], np.shape(facts["time_s"])[0]
        seen = np.asarray(valid, dtype=bool)
        rows = {}
        for name, given, tail in (("xy", xy, (2,)), ("heading", heading, ()), ("speed", speed, ())):
            found, expected = np.asarray(given, dtype=np.float64), (n, t, *tail)
            if found.shape != expected or seen.shape != (n, t):
                shape = found.shape if seen.shape == (n, t) else seen.shape
                raise InputError(f"Tracks.{name}: found shape {shape}, expected {expected}")
            rows[f"row_{name}"] = found[seen]
        return cls(index=RowIndex.of(seen), **rows, **facts)

    def with_dense(self, **changes: Any) -> Tracks:
        """The same tracks with some arguments of `of_dense` replaced."""
        names = {name for f in fields(self) if not (name := f.name).startswith(("row_", "index"))}
        names |= {*MOVING, "valid"}
        return Tracks.of_dense(**changes, **{n: getattr(self, n) for n in names - set(changes)})

    @cached_property
    def xy(self) -> FloatArray:
        """(N, T, 2) m; NaN where not valid."""
        return self._dense("xy", np.nan, self.row_xy)

    @cached_property
    def heading(self) -> FloatArray:
        """(N, T) rad; NaN where not valid."""
        return self._dense("heading", np.nan, self.row_heading)

    @cached_property
    def speed(self) -> FloatArray:
        """(N, T) m/s; NaN where not valid."""
        return self._dense("speed", np.nan, self.row_speed)

    @cached_property
    def valid(self) -> BoolArray:
        """(N, T) whether the agent is present at that time."""
        return self._dense("valid", False, np.ones(self.row_speed.size, dtype=bool))

    def _dense(self, name: str, empty: Any, values: NDArray[Any]) -> NDArray[Any]:
        """One quantity as a read-only array of all agents at all times."""
        index = self.index
        if index.agents * index.times > MAX_CELLS:
            raise InputError(
                f"Tracks.{name}: found {index.agents} agents at {index.times} times, expected a "
                f"product of at most {MAX_CELLS}: cut the recording in time"
            )
        tail = values.shape[1:]
        filled = np.full((index.agents * index.times, *tail), empty, values.dtype)
        filled[index.cells] = values
        return frozen(filled.reshape(index.agents, index.times, *tail))

    def __getstate__(self) -> dict[str, Any]:
        """Pickled state: the fields without the dense arrays."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @classmethod
    def from_frames(
        cls,
        frames: Iterable[Frame],
        behaviors: dict[int, Behavior | None] | None = None,
        names: dict[int, str] | None = None,
    ) -> Tracks:
        """Tracks of all agents that are in a frame of one episode.

        Args:
            frames: frames in time order.
            behaviors: the true behaviour of each agent id, if known.
            names: the source's name of each id; by default the id.
        """
        seq = list(frames)
        if any(after.time_s <= before.time_s for before, after in pairwise(seq)):
            raise InputError("frames: found times out of order, expected later and later ones")

        def joined(name: str) -> NDArray[Any]:
            """One array of all frames after each other."""
            return np.concatenate([getattr(_NOBODY, name), *(getattr(f, name) for f in seq)])

        ids, agent = np.unique(joined("ids"), return_inverse=True)
        step = np.repeat(np.arange(len(seq)), [f.ids.size for f in seq])
        order = np.argsort(agent, kind="stable")
        index = RowIndex.of_rows(agent[order], step[order], ids.size, len(seq))
        last = np.zeros(ids.size, dtype=np.int64)
        last[agent] = np.arange(agent.size)  # kind and size are those of the last frame
        codes, classes = None, BEHAVIORS
        if behaviors is not None:
            labels = [behaviors.get(int(i)) for i in ids]
            classes = tuple(dict.fromkeys((*BEHAVIORS, *(b for b in labels if b is not None))))
            codes = np.array([-1 if b is None else classes.index(b) for b in labels], dtype=np.int8)
        return cls(
            index=index,
            **{f"row_{name}": joined(name)[order] for name in MOVING},
            ids=ids,
            names=tuple((names or {}).get(int(i), str(int(i))) for i in ids),
            **{name: joined(name)[last] for name in OF_AGENTS},
            time_s=np.array([f.time_s for f in seq], dtype=np.float64),
            signals=np.stack([f.signals for f in seq or [_NOBODY]], axis=1)[:, : len(seq)],
            behavior=codes,
            events=tuple(e for f in seq for e in f.events),
            classes=classes,
        )

    def frame(self, step: int) -> Frame:
        """The frame at index ``step``: the agents that are valid there."""
        time_s = float(self.time_s[step])
        before = float(self.time_s[step - 1]) if step > 0 else -np.inf
        at = self.index.at(step)
        rows = self.index.agent[at]
        return Frame(
            time_s=time_s,
            ids=self.ids[rows],
            **{name: getattr(self, f"row_{name}")[at] for name in MOVING},
            **{name: getattr(self, name)[rows] for name in OF_AGENTS},
            signals=self.signals[:, step],
            events=tuple(e for e in self.events if before < e.time_s <= time_s),
        )

    def frames(self) -> Iterator[Frame]:
        """All frames in time order, as an engine yields them."""
        for step in range(self.time_s.size):
            yield self.frame(step)

    def window(self, stop: int, steps: int) -> Tracks:
        """The recent past of the agents that are present at index ``stop - 1``, its last column.

        Args:
            stop: index after the last frame.
            steps: how many frames at most; fewer at the beginning of the recording.
        """
        columns = slice(max(0, stop - steps), stop)
        return self.part(self.index.agent[self.index.at(stop - 1)], columns)

    def part(self, rows: IntArray, columns: slice | IntArray) -> Tracks:
        """Some agents at some of the times, with the events between the first and the last of them.

        Args:
            rows: indices of the agents, ascending.
            columns: which times, at least one; as indices, ascending.
        """
        begin, end = self.time_s[columns][0], self.time_s[columns][-1]
        at, index = self.index.part(rows, columns)
        return Tracks(
            index=index,
            **{f"row_{name}": getattr(self, f"row_{name}")[at] for name in MOVING},
            ids=self.ids[rows],
            names=tuple(self.names[i] for i in rows),
            **{name: getattr(self, name)[rows] for name in OF_AGENTS},
            time_s=self.time_s[columns],
            signals=self.signals[:, columns],
            behavior=None if self.behavior is None else self.behavior[rows],
            events=tuple(e for e in self.events if begin <= e.time_s <= end),
            classes=self.classes,
        )

    @cached_property
    def step_s(self) -> float:
        """The median time between frames, s."""
        if self.time_s.size < 2:
            raise InputError(f"Tracks.time_s: found {self.time_s.size} frames, expected at least 2")
        return float(np.median(np.diff(self.time_s)))

    @property
    def walking(self) -> BoolArray:
        """(m,) whether the agent of each row is a pedestrian."""
        return np.asarray((self.kind == PEDESTRIAN)[self.index.agent])

    def agent_and_time(self, row: int) -> tuple[int, float]:
        """The agent's id and the time, s, of a row."""
        index = self.index
        return int(self.ids[index.agent[row]]), float(self.time_s[index.step[row]])

    def positions(self, agent: IntArray, step: IntArray) -> FloatArray:
        """(..., 2) positions of agents at times, both as indices, m; NaN where not present."""
        row, present = self.index.find(agent, step)
        found = np.full((*row.shape, 2), np.nan)
        found[present] = self.row_xy[row[present]]
        return found

    def between_breaks(self) -> Iterator[Tracks]:
        """The parts between breaks, in order of time; itself where there are none.

        A break is a time between two frames of more than `BREAK_S` and of more than `BREAK_STEPS`
        usual ones. A part has at least two frames, and the agents that are seen in it.
        """
        longest_s = max(BREAK_S, BREAK_STEPS * self.step_s)
        begins = [0, *(np.flatnonzero(np.diff(self.time_s) > longest_s) + 1).tolist()]
        if len(begins) == 1:
            yield self
            return
        for begin, end in pairwise([*begins, self.time_s.size]):
            if end - begin > 1:
                part = self.part(np.arange(self.ids.size), slice(begin, end))
                seen = np.flatnonzero(np.diff(part.index.first))
                yield part.part(seen, slice(None))

    def __repr__(self) -> str:
        """The agents by kind, the times, and counts of labels, signals and events."""
        labelled = 0 if self.behavior is None else int((self.behavior >= 0).sum())
        parts = [
            _by_kind(self.kind),
            self._times(),
            counted(self.row_speed.size, "row"),
            f"{labelled} labelled",
            counted(len(self.signals), "signal group"),
            counted(len(self.events), "event"),
        ]
        return f"Tracks({', '.join(parts)})"

    def _times(self) -> str:
        if self.time_s.size < 2:
            return counted(self.time_s.size, "frame")
        first, last = self.time_s[0], self.time_s[-1]
        return f"{self.time_s.size} frames from {first:g} to {last:g} s every {self.step_s:.3g} s"

    def _repr_html_(self) -> str:
        """A table with a row per kind of agent, for notebooks."""
        import pandas

        rows = [np.bincount(self.index.agent, w, self.ids.size) for w in (None, self.row_speed)]
        agents = pandas.DataFrame(
            {"kind": self.kind, "agents": 1, "rows": rows[0], "mean speed, m/s": rows[1],
             "labelled": 0 if self.behavior is None else self.behavior >= 0}
        )  # fmt: skip
        table = agents.groupby("kind").sum().rename(index=lambda code: str(KINDS[code]))
        table["mean speed, m/s"] = (table["mean speed, m/s"] / table["rows"]).round(1)
        shown = table.reset_index().to_html(index=False)
        return f"<p>Tracks: {self._times()}</p>{shown}"

    def to_pandas(self) -> Any:
        """A pandas table with a row for each time at which each agent is present.

        Returns:
            A data frame by agent and time: id, name, kind, time_s (s), x, y (m), heading (rad),
            speed (m/s), length, width (m). The column behavior is missing without labels.
        """
        import pandas

        rows, columns = self.index.agent, self.index.step
        codes = np.full(len(self.ids), -1) if self.behavior is None else self.behavior
        kinds = np.array([str(kind) for kind in KINDS], dtype=object)
        behaviors = np.array([*map(str, self.classes), None], dtype=object)  # code -1 is the last
        return pandas.DataFrame(
            {
                "id": self.ids[rows],
                "name": np.array(self.names, dtype=object)[rows],
                "kind": kinds[self.kind[rows]],
                "time_s": self.time_s[columns],
                "x": self.row_xy[:, 0],
                "y": self.row_xy[:, 1],
                "heading": self.row_heading,
                "speed": self.row_speed,
                "length": self.length[rows],
                "width": self.width[rows],
                "behavior": behaviors[codes[rows]],
            }
        )


def _by_kind(codes: CodeArray) -> str:
    """How many agents there are of each kind."""
    counts = np.bincount(codes, minlength=len(KINDS)).tolist()
    parts = [f"{count} {kind}" for kind, count in zip(KINDS, counts, strict=True) if count]
    return counted(codes.size, "agent") + (f" ({', '.join(parts)})" if parts else "")
