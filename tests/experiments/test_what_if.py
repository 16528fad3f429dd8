"""What-if datasets: the factual episode is generate's, branches differ by one driver, repairs."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from behaviors import InputError
from behaviors.labels import BEHAVIORS, Behavior
from experiments.cli.commands import main
from experiments.generate.configuration import GenerateConfig
from experiments.replay.pictures import write_paths
from experiments.replay.scene import find_ghosts
from experiments.what_if.branches import branch_of, change_of, make_what_if
from experiments.what_if.outcomes import branches_of, delays, factual_of, new_incidents
from sim.frames import Event, EventKind, Frame, Tracks
from sim.store.dataset import open_dataset
from sim.sumo.control import Action
from tests.experiments.shared import content

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="branches need Linux")
EPISODE = GenerateConfig(
    scenarios=("straight_road",), episodes=1, seed=3, duration_s=24.0, flow="dense"
)
AT_S, AGENT = 14.0, 4
CONFIG = {
    "episode": EPISODE, "at_s": AT_S, "agent": AGENT,
    "changes": (Behavior.TIMID, Behavior.IMPATIENT, Action.BRAKE),
}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("what-if") / "data"
    make_what_if(**CONFIG, folder=folder, quiet=True)
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path / "data")
    return tmp_path / "data"


def test_branches_begin_at_the_instant_and_differ_by_one_driver(made: Path) -> None:
    dataset = open_dataset(made)
    happened = dataset.read(factual_of(dataset))
    branched = branches_of(dataset)
    assert [change_of(entry) for entry in branched] == ["timid", "impatient", "brake"]
    for entry in branched:
        episode = dataset.read(entry)
        tracks, change = episode.tracks, change_of(entry)
        kind = "action" if change == "brake" else "behavior"
        assert branch_of(entry) == {"at_s": AT_S, "agent": AGENT, kind: change}
        assert tracks.time_s[0] == pytest.approx(AT_S + 0.1)
        assert tracks.time_s[-1] == happened.tracks.time_s[-1]
        assert all(event.time_s > AT_S for event in tracks.events)
        assert all(trait.begin_s > AT_S for trait in episode.shown_traits)
        differing = {
            one.id for one, two in zip(episode.agents, happened.agents, strict=True) if one != two
        }
        assert differing == (set() if kind == "action" else {AGENT})
        if kind == "behavior":
            row = int(np.searchsorted(tracks.ids, AGENT))
            assert tracks.behavior is not None
            assert tracks.behavior[row] == BEHAVIORS.index(change)
        far = np.abs(tracks.xy[:, 0, 0] - tracks.xy[tracks.ids == AGENT][0, 0, 0]) > 60.0
        there = np.searchsorted(happened.tracks.ids, tracks.ids)
        column = int(np.searchsorted(happened.tracks.time_s, AT_S + 0.05))
        assert far.any()
        assert np.array_equal(tracks.xy[far, 0], happened.tracks.xy[there[far], column])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"at_s": 14.05}, "at_s: found 14.05, expected a multiple of 0.1 s"),
        ({"at_s": 24.0}, "at_s: found 24"),
        ({"agent": 9999}, "agent 9999: found no such driver in the episode, expected one such as"),
        ({"changes": ()}, "expected --behavior or --action"),
        ({"changes": (Behavior.TIMID,) * 2}, "expected each once"),
        ({"at_s": 0.1}, "agent 4: found it not on the road at 0.1 s, expected one that is"),
        ({"episode": EPISODE.model_copy(update={"engine": "highway"})}, "found 'highway'"),
    ],
    ids=["between frames", "at the end", "nobody", "no change", "twice", "too early", "engine"],
)
def test_what_cannot_be_asked_is_refused_and_leaves_nothing(
    change: dict[str, object], said: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=said):
        make_what_if(**{**CONFIG, **change}, folder=tmp_path / "new", quiet=True)
    assert not (tmp_path / "new").exists()


def test_the_command_draws_and_its_dataset_replays(
    made: Path, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    command = [
        "what-if", "straight_road", "--at-s", "14", "--agent", "4", "--behavior", "timid",
        "--behavior", "impatient", "--action", "brake", "--seed", "3", "--duration-s", "24",
        "--flow", "dense", "--out", "data", "--picture", "paths.png", "--json", "table.json",
        "--quiet",
    ]  # fmt: skip
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert ended.value.code == 0
    assert content(folder) == content(made)
    assert Path("paths.png").read_bytes().startswith(b"\x89PNG")
    write_paths(open_dataset(folder), Path("paths.pdf"))
    assert Path("paths.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(InputError, match=r"found 'paths\.jpg'"):
        write_paths(open_dataset(folder), Path("paths.jpg"))
    assert Path("table.json").stat().st_size > 100


def test_incidents_are_the_same_by_pair_and_time() -> None:
    known = [Event(EventKind.NEAR_MISS, 20.0, 1, 2), Event(EventKind.RED_RUN, 21.0, 1)]
    again = Event(EventKind.NEAR_MISS, 22.0, 2, 1)
    later = Event(EventKind.NEAR_MISS, 26.0, 1, 2)
    crash = Event(EventKind.COLLISION, 20.0, 1, 2)
    assert new_incidents([again, later, crash, known[1]], known) == [later, crash]


def moving(speeds: dict[int, list[float]], since: int = 0) -> Tracks:
    """Vehicles along x, a second a frame, by the speed in each second; NaN: not there yet."""
    frames = []
    for t in range(since, len(next(iter(speeds.values()))) + 1):
        here = {i: v for i, v in speeds.items() if np.isfinite(v[: max(t, 1)]).all() or t == 0}
        here = {i: v for i, v in here.items() if np.isfinite(v[0])}
        n = len(here)
        frames.append(
            Frame(
                time_s=float(t), ids=np.array(list(here)),
                xy=np.array([[sum(v[:t]), 0.0] for v in here.values()]), heading=np.zeros(n),
                speed=np.zeros(n), length=np.full(n, 4.0), width=np.full(n, 2.0), kind=np.zeros(n),
            )
        )  # fmt: skip
    return Tracks.from_frames(frames)


def test_a_delay_is_when_the_same_point_is_reached() -> None:
    factual = moving({1: [10.0] * 6, 2: [5.0] * 6, 3: [10.0] * 6})
    changed = moving({1: [10, 10, 5, 5, 5, 5], 2: [5.0] * 6, 3: [10, 10, 20, 20, 20, 20]}, since=3)
    found = delays(factual, changed, since_s=2.0)
    # 1 reaches 40 m at 6 s, not 4 s; 3 reaches 60 m at 4 s, not 6 s
    assert found == pytest.approx({1: 2.0, 2: 0.0, 3: -2.0})


def test_ghosts_stand_where_the_factual_episode_differs() -> None:
    factual = moving({1: [10.0] * 6, 2: [5.0] * 6, 3: [1.0] * 6})
    changed = moving({1: [10, 10, 5, 5, 5, 5], 2: [5.0] * 6}, since=3)
    ghosts = find_ghosts(factual, changed)
    assert ghosts.length.tolist() == [4.0, 4.0]  # of 1, who falls back, and of 3, who is not there
    first = ghosts.index.at(0)
    assert ghosts.index.agent[first].tolist() == [0, 1]
    assert ghosts.row_xy[first].tolist() == [[30.0, 0.0], [3.0, 0.0]]
    assert ghosts.index.agent[ghosts.index.at(3)].size == 2
