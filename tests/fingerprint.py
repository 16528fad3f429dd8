"""Hashes of everything that a seed decides: run it before and after a change that changes nothing.

``python tests/fingerprint.py [PART ...]`` prints one JSON object: a SHA-256 for each piece of
output. Two checkouts that print the same object on the same machine simulate, classify, predict and
write the same bytes. The parts are the functions of ``PARTS``; without a name all of them run.
Hashes differ between processors and library versions, so none is kept in the repository.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import runpy
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

Named = Iterator[tuple[str, str]]

SCENARIOS = ("straight_road", "four_way_intersection", "two_way_road", "priority_intersection")


def command(*words: str | Path) -> None:
    """Run a ``graphrqi`` command in this process; its printed tables are dropped."""
    sys.argv = ["graphrqi", *(str(word) for word in words)]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        runpy.run_module("experiments.cli", run_name="__main__")


def of_rows(path: Path) -> str:
    """Rows without what says how they were made."""
    made = ("bench", "command", "version", "seed", "dataset")
    rows = json.loads(path.read_bytes())
    figures = [{key: value for key, value in row.items() if key not in made} for row in rows]
    return of_bytes((json.dumps(figures, indent=1) + "\n").encode())


def of_bytes(data: bytes) -> str:
    """The first 16 digits of a SHA-256."""
    return hashlib.sha256(data).hexdigest()[:16]


def of_files(root: Path) -> Named:
    """Every file below a folder, by its path."""
    for path in sorted(root.rglob("*")):
        if path.is_file() and path.name != ".lock":
            yield path.relative_to(root).as_posix(), of_bytes(path.read_bytes())


def of_folder(root: Path) -> str:
    """All files below a folder as one hash."""
    return of_bytes(json.dumps(list(of_files(root))).encode())


def make_dataset(folder: Path, engine: str, *scenarios: str, seconds: int = 60) -> Path:
    """A small labelled dataset of one engine."""
    names = [word for name in scenarios for word in ("--scenario", name)]
    command("generate", *names, "--episodes", "1", "--duration-s", str(seconds), "--seed", "3",
            "--flow", "dense", "--engine", engine, "--quiet", "--jobs", "1",
            "--out", folder)  # fmt: skip
    return folder


def datasets(folder: Path) -> Named:
    """Generated datasets of all four engines: frames, events, traits and files."""
    for engine in ("sumo", "sumo-idm", "highway", "highway-krauss"):
        made = make_dataset(folder / engine, engine, *SCENARIOS)
        for name, value in of_files(made):
            if name.endswith((".parquet", ".json")):
                yield f"{engine}/{name}", value


def frames(_: Path) -> Named:
    """Raw frames of all four engines."""
    from scenarios import SCENARIOS as MAKERS
    from sim.engines import get_engine
    from sim.scenario import sample_agents

    for name in SCENARIOS:
        scenario = MAKERS[name](duration_s=60.0, flow="dense")
        for engine in ("sumo", "sumo-idm", "highway", "highway-krauss"):
            seen = hashlib.sha256()
            for frame in get_engine(engine)(scenario, sample_agents(scenario, seed=5), 5):
                for array in (frame.ids, frame.xy, frame.heading, frame.speed, frame.length,
                              frame.width, frame.kind, frame.signals):  # fmt: skip
                    seen.update(np.ascontiguousarray(array).tobytes())
                for event in frame.events:
                    seen.update(repr((str(event.kind), event.agent, event.other)).encode())
            yield f"{engine}/{name}", seen.hexdigest()[:16]


def answers(folder: Path) -> Named:
    """Labels, predictions, exports, imports and trained models from one small dataset."""
    data = make_dataset(folder / "data", "sumo", "straight_road", "four_way_intersection")
    many = folder / "many"
    command("generate", "--scenario", "straight_road", "--episodes", "8", "--duration-s", "30",
            "--seed", "4", "--out", many, "--quiet")  # fmt: skip
    command("classify", data, "--out", folder / "labels.parquet", "--quiet")
    yield "classify", of_bytes((folder / "labels.parquet").read_bytes())
    names = ("constant-velocity", "constant-acceleration", "kalman", "car-following-blind",
             "car-following", "lstm", "graphrqi-predict")  # fmt: skip
    for name in names:
        command("predict", data, "--predictors", name, "--json", folder / "rows.json", "--quiet",
                "--out", folder / "futures.parquet", "--jobs", "1")  # fmt: skip
        yield f"predict/{name}/rows", of_rows(folder / "rows.json")
        yield f"predict/{name}/futures", of_bytes((folder / "futures.parquet").read_bytes())
    for form in ("sumo-fcd", "argoverse1", "argoverse2", "scenarionet"):
        command("export", data, "--format", form, "--out", folder / form)
        yield f"export/{form}", of_folder(folder / form)
        command("import", folder / form, "--format", form, "--out", folder / f"{form}-in")
        yield f"import/{form}", of_folder(folder / f"{form}-in")
    command("predict", folder / "argoverse1-in", "--json", folder / "rows.json", "--quiet",
            "--horizon-s", "3")  # fmt: skip
    yield "predict/no-map", of_rows(folder / "rows.json")
    for method in ("graphrqi-plus", "graphrqi", "cheung", "dane", "svm", "forest", "lstm"):
        command("train", many, "--method", method, "--out", folder / method, "--quiet")
        weights = folder / method / "model.safetensors"
        yield f"train/{method}", of_bytes(weights.read_bytes()) if weights.exists() else "absent"
    shutil.rmtree(folder)


def spectra(_: Path) -> Named:
    """Eigenpairs of every solver along a sequence of traffic graphs."""
    from graphrqi.graph import TrafficGraph
    from graphrqi.spectrum import SOLVERS

    rng = np.random.default_rng(0)
    start, speed = rng.uniform(0, 300, (60, 2)), rng.normal(0, 12, (60, 2))
    for solver, solve in SOLVERS.items():
        for kind in ("accumulated", "instantaneous"):
            for end in ("largest", "smallest"):
                graph, spectrum = TrafficGraph.empty(kind=kind), None
                seen = hashlib.sha256()
                for step in range(12):
                    graph = graph.observe(np.arange(60), start + speed * 0.1 * step)
                    spectrum = solve(graph, 6, end, spectrum)
                    pairs = spectrum.eigenvalues.tobytes() + spectrum.eigenvectors.tobytes()
                    seen.update(pairs)
                yield f"{solver}/{kind}/{end}", seen.hexdigest()[:16]


def environments(_: Path) -> Named:
    """Observations and rewards of the gymnasium environments under fixed actions."""
    import gymnasium

    import scenarios  # noqa: F401

    names = [name for name in gymnasium.registry if name.lower().startswith("graphrqi")]
    for name in sorted(names):
        environment, seen = gymnasium.make(name), hashlib.sha256()
        state, _info = environment.reset(seed=1)
        for step in range(60):
            for key in sorted(state):
                seen.update(np.ascontiguousarray(state[key]).tobytes())
            action = environment.action_space
            action.seed(step)
            state, reward, over, out, _info = environment.step(action.sample())
            seen.update(np.float64(reward).tobytes())
            if over or out:
                state, _info = environment.reset(seed=step)
        environment.close()
        yield name, seen.hexdigest()[:16]


def quick(folder: Path) -> Named:
    """Frames of both engines, an import, a classification and a prediction, in some seconds."""
    from scenarios import SCENARIOS as MAKERS
    from sim.engines import get_engine
    from sim.scenario import sample_agents

    for name in ("straight_road", "four_way_intersection"):
        scenario = MAKERS[name](duration_s=12.0, flow="dense", pedestrians_per_h=600.0)
        for engine in ("sumo", "highway"):
            seen = hashlib.sha256()
            for frame in get_engine(engine)(scenario, sample_agents(scenario, seed=5), 5):
                for array in (frame.ids, frame.xy, frame.heading, frame.speed):
                    seen.update(np.ascontiguousarray(array).tobytes())
            yield f"frames/{engine}/{name}", seen.hexdigest()[:16]
    data = make_dataset(folder / "data", "sumo", "four_way_intersection", seconds=12)
    yield "dataset", of_folder(data)
    command("export", data, "--format", "sumo-fcd", "--out", folder / "fcd")
    command("import", folder / "fcd", "--format", "sumo-fcd", "--out", folder / "imported")
    yield "import", of_folder(folder / "imported")
    for name in ("data", "imported"):
        labels, rows = folder / f"{name}.parquet", folder / f"{name}.json"
        command("classify", folder / name, "--out", labels, "--quiet")
        yield f"classify/{name}", of_bytes(labels.read_bytes())
        command("predict", folder / name, "--json", rows, "--quiet", "--horizon-s", "3")
        yield f"predict/{name}", of_rows(rows)


PARTS: dict[str, Callable[[Path], Named]] = {
    "frames": frames,
    "datasets": datasets,
    "answers": answers,
    "spectra": spectra,
    "environments": environments,
    "quick": quick,
}


def main(parts: list[str]) -> None:
    """Print the hashes of the named parts, or of all."""
    said: dict[str, str] = {}
    for part in parts or PARTS:
        with tempfile.TemporaryDirectory() as folder:
            said |= {f"{part}/{name}": value for name, value in PARTS[part](Path(folder))}
            print(part, len(said), file=sys.stderr)
    print(json.dumps(said, indent=1))


if __name__ == "__main__":
    main(sys.argv[1:])
