"""Values that no frame, history or export may have are refused and not changed in silence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS
from graphrqi.posterior import Posterior
from graphrqi.predict import predict
from sim.episode.buffer import FrameBuffer
from sim.formats.argoverse.forecasting1 import write
from sim.frames import Frame, Tracks


def frame(
    ids: object = (1, 2), kind: object = (0, 5), signals: object = (), t: float = 0.0
) -> Frame:
    n = np.size(ids)
    some = np.ones(n)
    return Frame(t, ids, np.ones((n, 2)), some, some, some, some, kind, signals)  # type: ignore[arg-type]


@example([2**53 + 1, 0.0], "ids")
@given(
    st.lists(st.integers(-(2**70), 2**70) | st.floats(allow_nan=True), max_size=4),
    st.sampled_from(["ids", "kind"]),
)
def test_codes_and_ids_are_kept_or_refused(values: list[float], field: str) -> None:
    n = len(values)
    other = {"ids": np.arange(n), "kind": np.zeros(n, np.int8)}
    try:
        made = frame(**{**other, field: values})
    except InputError:
        return
    assert all(a == b for a, b in zip(getattr(made, field).tolist(), values, strict=True))


def test_what_would_wrap_is_refused() -> None:
    with pytest.raises(InputError, match=r"Frame\.kind: found int64 values, expected int8"):
        frame(kind=np.array([0, 300]))
    with pytest.raises(InputError, match=r"Frame\.ids: found uint64 values, expected int64"):
        frame(ids=np.array([1, 2**63], dtype=np.uint64))
    assert frame(ids=np.array([1, 2], dtype=np.uint64)).ids.tolist() == [1, 2]


def test_signals_of_no_state_are_refused() -> None:
    buffer = FrameBuffer(5)
    buffer.push(frame(signals=(0, 3)))
    with pytest.raises(InputError, match=r"frame\.signals: found other codes than 0 to 3"):
        buffer.push(frame(signals=(0, 99), t=1.0))
    with pytest.raises(InputError, match=r"frame\.ids: found ids that do not ascend"):
        buffer.push(frame(ids=(2, 1), signals=(0, 3), t=1.0))
    assert len(buffer) == 1


def tracks(names: tuple[str, ...] = ("a", "b"), **changes: object) -> Tracks:
    n, t = len(names), 60
    x = np.arange(t) * np.ones((n, 1))
    values: dict[str, object] = {
        "ids": np.arange(n), "names": names, "kind": [0] * n, "length": [4.0] * n,
        "width": [2.0] * n, "time_s": np.arange(t) / 10, "xy": np.stack([x, x], axis=2),
        "heading": np.zeros((n, t)), "speed": np.ones((n, t)), "valid": np.ones((n, t), bool),
        "signals": np.zeros((0, t), np.int8),
    }  # fmt: skip
    return Tracks(**{**values, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"ids": [1, 0]}, "ids that do not ascend"),
        ({"ids": [1, 1]}, "ids that do not ascend"),
        ({"kind": [0, 9]}, "other codes than 0 to 5"),
        ({"signals": np.full((1, 60), 99, np.int8)}, "other codes than 0 to 3"),
    ],
)
def test_histories_that_nobody_can_have_seen_are_refused(
    changes: dict[str, object], found: str
) -> None:
    nobody = Posterior(np.empty(0, np.int64), np.empty((0, len(BEHAVIORS))))
    with pytest.raises(InputError, match=found):
        predict(tracks(**changes), nobody, None)


@pytest.mark.parametrize("name", ["=1+1", "+cmd", "@SUM(A1)", "-x", "a\rb", "a\nb", "\x1b[2J"])
def test_ids_that_a_spreadsheet_would_run_are_not_exported(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="expected a plain id"):
        write(tmp_path, "e", tracks(("a", name)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["-7", "b,c", 'd"e', "plain", "\u00e4"])
def test_plain_ids_are_exported(tmp_path: Path, name: str) -> None:
    assert write(tmp_path, "e", tracks(("a", name)))
