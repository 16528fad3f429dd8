"""Generated datasets: the same bytes every time, only what is missing, one writer at a time."""

from __future__ import annotations

import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from behaviors import InputError
from experiments.data.verify import verify_dataset
from experiments.generate.configuration import GenerateConfig, read_config
from experiments.generate.dataset import generate, sole_writer
from experiments.generate.episode import Task
from scenarios import SCENARIOS
from sim.files import place_of
from sim.store.dataset import open_dataset
from sim.store.schema import EpisodeEntry
from sim.store.writing import EpisodeWriter
from tests.experiments.shared import content, heed_signals

CONFIG = GenerateConfig(
    scenarios=("straight_road", "four_way_intersection"), episodes=1, seed=7, duration_s=12.0
)


def shards(folder: Path, table: str) -> list[Path]:
    return sorted((folder / table).rglob("*.parquet"))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("generate") / "data"
    generate(CONFIG, folder, jobs=1, quiet=True)
    return folder


def test_the_dataset_opens_and_is_labelled(made: Path) -> None:
    dataset = open_dataset(made)
    assert dataset.scenarios == ("four_way_intersection", "straight_road")
    for entry in dataset.episodes():
        episode = dataset.read(entry)
        assert episode.tracks.time_s[-1] == pytest.approx(12.0)
        assert episode.tracks.behavior is not None
        road = dataset.road(entry)
        assert road is not None
        assert road.name == entry.scenario
    assert not (made / ".lock").exists()


def test_same_bytes_for_two_jobs_and_another_order(made: Path, tmp_path: Path) -> None:
    generate(CONFIG, tmp_path / "again", jobs=2, quiet=True)
    assert content(tmp_path / "again") == content(made)


def test_only_what_is_missing_is_made_again(made: Path, tmp_path: Path) -> None:
    folder = tmp_path / "data"
    shutil.copytree(made, folder)
    kept, lost = shards(folder, "steps")
    before = kept.stat().st_ino
    lost.write_bytes(b"altered")
    (folder / "episodes.parquet").unlink()
    (folder / ".partial-left-behind").mkdir()
    generate(CONFIG, folder, jobs=1, quiet=True)
    assert content(folder) == content(made)
    assert kept.stat().st_ino == before
    shards(folder, "agents")[0].unlink()  # also where the catalogue is there
    generate(CONFIG, folder, jobs=1, quiet=True)
    assert content(folder) == content(made)
    before = (folder / "episodes.parquet").stat().st_mtime_ns
    generate(CONFIG, folder, jobs=1, quiet=True)
    assert (folder / "episodes.parquet").stat().st_mtime_ns == before


def test_a_dataset_grows_but_is_never_mixed(made: Path, tmp_path: Path) -> None:
    folder = tmp_path / "data"
    shutil.copytree(made, folder)
    old = {e.id for e in open_dataset(folder).episodes()}
    more = CONFIG.model_copy(update={"episodes": 2})
    grown = generate(more, folder, jobs=1, quiet=True)
    assert old < {e.id for e in grown.episodes}
    assert [e.split for e in open_dataset(folder).episodes(scenario="straight_road")] == [
        "train",
        "validation",
    ]
    with pytest.raises(InputError, match="expected at least as many"):
        generate(CONFIG, folder, quiet=True)
    with pytest.raises(InputError, match="was made with seed 7, now 8"):
        generate(more.model_copy(update={"seed": 8}), folder, quiet=True)
    (folder / "episodes.parquet").unlink()
    with pytest.raises(InputError, match="unfinished episodes of another configuration"):
        generate(more.model_copy(update={"duration_s": 13.0}), folder, quiet=True)
    for name in ("thesis.tex", "README.md"):
        (tmp_path / name).mkdir()
        (tmp_path / name / name).write_text("a year's work")
        with pytest.raises(InputError, match=f"found {name}"):
            generate(CONFIG, tmp_path / name, quiet=True)


def test_a_map_that_was_changed_is_another_configuration(tmp_path: Path) -> None:
    net = tmp_path / "own.net.xml"
    shutil.copy(SCENARIOS["straight_road"]().road.source, net)
    config = GenerateConfig(scenarios=(str(net),), episodes=1, duration_s=2.0)
    generate(config, tmp_path / "data", jobs=1, quiet=True)
    net.write_text(net.read_text().replace("13.89", "10.00"))
    with pytest.raises(InputError, match="was made with own_roads"):
        generate(config, tmp_path / "data", jobs=1, quiet=True)


def test_seeds_differ_and_depend_on_nothing_else() -> None:
    tasks = [Task(CONFIG, name, i) for name in CONFIG.scenarios for i in range(50)]
    assert len({t.seed for t in tasks}) == 100
    alone = CONFIG.model_copy(update={"scenarios": ("straight_road",), "episodes": 99})
    assert Task(alone, "straight_road", 3).seed == Task(CONFIG, "straight_road", 3).seed


# --- interruptions ------------------------------------------------------------------------------


_HOLDER = """
import sys, time
from experiments.generate.dataset import sole_writer
from sim.files import place_of
with sole_writer(place_of(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_second_run_is_refused_while_the_first_lives(tmp_path: Path) -> None:
    command = [sys.executable, "-c", _HOLDER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        try:
            assert holder.stdout.readline() == "held\n"
            with pytest.raises(InputError, match="another run is writing to it"):
                generate(CONFIG, tmp_path, quiet=True)
        finally:
            holder.kill()
    with sole_writer(place_of(tmp_path)):  # the dead holder's lock is gone with it
        assert (tmp_path / ".lock").exists()
    assert list(tmp_path.iterdir()) == []


EPISODES = 24
GIVEN = {"scenarios": ["straight_road"], "duration_s": 20.0, "flow": "light", "seed": 3}


def _command(folder: Path, episodes: int = EPISODES, *more: str) -> list[str]:
    return [
        *(sys.executable, "-m", "experiments.cli", "generate", "--out", str(folder)),
        *("--scenario", "straight_road", "--episodes", str(episodes), "--jobs", "2"),
        *("--duration-s", "20", "--flow", "light", "--seed", "3", *more),
    ]


def _workers(parent: int) -> list[psutil.Process]:
    try:
        found = psutil.Process(parent).children()
        return [one for one in found if "resource_tracker" not in " ".join(one.cmdline())]
    except psutil.NoSuchProcess:
        return []


def _until(condition: object, seconds: float = 60.0) -> None:
    assert callable(condition)
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.05)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("undisturbed") / "data"
    generate(read_config(None, episodes=EPISODES, **GIVEN), folder, jobs=1, quiet=True)
    return content(folder)


def test_stopped_and_killed_runs_go_on_to_the_same_bytes(
    undisturbed: dict[str, bytes], tmp_path: Path
) -> None:
    folder = tmp_path / "data"
    run = subprocess.Popen(
        _command(folder), stderr=subprocess.PIPE, text=True, preexec_fn=heed_signals
    )
    _until(lambda: shards(folder, "agents"))
    run.send_signal(signal.SIGINT)
    _, said = run.communicate(timeout=60)
    assert run.returncode == 130
    assert "run the same command again to go on" in said
    assert "Traceback" not in said
    assert not list(folder.glob(".partial*"))

    run = subprocess.Popen(_command(folder), stderr=subprocess.DEVNULL)
    _until(lambda: len(_workers(run.pid)) >= 2)
    orphans = _workers(run.pid)
    run.kill()
    run.wait()
    _until(lambda: not any(orphan.is_running() for orphan in orphans), 10.0)

    run = subprocess.Popen(_command(folder), stderr=subprocess.DEVNULL)
    _until(lambda: len(_workers(run.pid)) >= 2)
    time.sleep(1.0)
    for worker in _workers(run.pid)[-1:]:
        worker.kill()
    assert run.wait(timeout=120) == 0
    assert content(folder) == undisturbed


@pytest.mark.slow
def test_twenty_kills_change_nothing(undisturbed: dict[str, bytes], tmp_path: Path) -> None:
    """Runs and workers are killed at random moments until the dataset is there."""
    rng = random.Random(1)
    kills = number = 0
    while kills < KILLS:
        folder = tmp_path / str(number)
        run = subprocess.Popen(_command(folder, EPISODES, "--quiet"), stderr=subprocess.PIPE)
        try:
            run.wait(rng.uniform(1.0, 6.0))
        except subprocess.TimeoutExpired:
            workers = _workers(run.pid)
            victim = rng.choice(workers) if workers and rng.random() < 0.5 else run
            victim.kill()
            kills += 1
            run.wait(120 if victim is not run else 10)
        if run.returncode == 0:
            assert content(folder) == undisturbed
            number += 1
        else:
            assert run.returncode == -signal.SIGKILL, run.stderr.read()
    generate(read_config(None, episodes=EPISODES, **GIVEN), tmp_path / str(number), 1, quiet=True)
    assert content(tmp_path / str(number)) == undisturbed


KILLS = 20


def test_a_full_disk_is_one_clear_error_and_leaves_nothing_half_written(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    command = [*_command(folder, 1), "--quiet", "--duration-s", "100", "--flow", "dense"]
    limited = ["bash", "-c", 'ulimit -f 60; exec "$@"', "-", *command]  # KiB per file
    run = subprocess.run(limited, capture_output=True, text=True, check=False)
    assert run.returncode == 2, run.stderr
    assert run.stderr.startswith("graphrqi: error: ")
    assert run.stderr.endswith("File too large\n")
    assert run.stderr.count("\n") == 1
    assert {p.suffix for p in folder.rglob("*") if p.is_file()} <= {".xml"}


def test_an_episode_that_cannot_be_made_is_named_and_all_others_are_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = Task.write

    def failing(task: Task, out: EpisodeWriter) -> EpisodeEntry:
        if task.index in failed:
            raise InputError("engine: fell over")
        return write(task, out)

    monkeypatch.setattr(Task, "write", failing)
    config = CONFIG.model_copy(update={"scenarios": ("straight_road",), "episodes": 4})
    seed = Task(config, "straight_road", 1).seed
    failed = {0, 1, 2, 3}
    with pytest.raises(InputError, match=r"4 of 4 episodes could not be made: .* fell over"):
        generate(config, tmp_path / "data", jobs=1, quiet=True)
    assert list(tmp_path.iterdir()) == []
    failed = {1}
    with pytest.raises(InputError, match=rf"1 of 4 .* episode 1 \(seed {seed}\): engine: fell"):
        generate(config, tmp_path, jobs=1, quiet=True)
    assert [e.index for e in open_dataset(tmp_path).episodes()] == [0, 2, 3]
    failed = set()
    generate(config, tmp_path, jobs=1, quiet=True)
    assert [e.index for e in open_dataset(tmp_path).episodes()] == [0, 1, 2, 3]


# --- verify -------------------------------------------------------------------------------------


def test_verify_finds_what_is_wrong_and_generate_mends_it(made: Path, tmp_path: Path) -> None:
    folder = tmp_path / "data"
    shutil.copytree(made, folder)
    assert verify_dataset(folder) == []
    first, second = shards(folder, "steps")
    (road, _) = sorted((folder / "roads").iterdir())
    content_of = bytearray(first.read_bytes())
    content_of[100] ^= 1
    first.write_bytes(content_of)
    shards(folder, "events")[1].unlink()
    (folder / "notes.txt").touch()
    good = road.read_bytes()
    road.write_text("<net/>")
    flaws = {str(f.path): f.state for f in verify_dataset(folder)}
    assert flaws == {
        str(first.relative_to(folder)): "altered",
        f"events/{second.relative_to(folder / 'steps')}": "missing",
        "notes.txt": "foreign",
        f"roads/{road.name}": "altered",
    }
    (folder / "notes.txt").unlink()
    first.unlink()
    road.write_bytes(good)
    generate(CONFIG, folder, jobs=1, quiet=True)
    assert content(folder) == content(made)


# --- configuration ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("episodes = ", "study.toml: Invalid value"),
        (
            'scenarios = ["straight_road"]\nepisodes = 1\ncolour = 2',
            "study.toml: colour: found an unknown key",
        ),
        ('scenarios = ["straight_road"]\nepisodes = "many"', "study.toml: episodes: "),
        ("scenarios = []\nepisodes = 1", "study.toml: scenarios: "),
    ],
)
def test_broken_configuration_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "study.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_config(path)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenarios": ("straight_raod",)}, "did you mean 'straight_road'"),
        ({"engine": "sumoo"}, "did you mean 'sumo'"),
        ({"mix": "timid=2"}, "mix: found shares adding to 2"),
        ({"mix": {"angry": 1.0}}, "mix: found 'angry', expected one of impatient"),
        ({"flow": -5.0}, "flow: found"),
        ({"duration_s": 0.0}, "duration_s: found 0"),
        ({"spread": -1.0}, "spread: found -1"),
        ({"scenarios": ("straight_road", "straight_road")}, "expected each once"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_written(
    tmp_path: Path, change: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        generate(CONFIG.model_copy(update=change), tmp_path / "data", quiet=True)
    assert not (tmp_path / "data").exists()
