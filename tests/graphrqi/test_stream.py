"""Samples, models on disk, and the stream that classifies while a simulation runs."""

from __future__ import annotations

import dataclasses
import itertools
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from behaviors.errors import InputError
from graphrqi.features.drivers import DriverObserver
from graphrqi.features.observer import Observer
from graphrqi.features.smooth_motion import EVERY_S
from graphrqi.features.spectral import SpectrumObserver
from graphrqi.methods import train
from graphrqi.model_files import FILE, load_model, save_model
from graphrqi.posterior import Posterior
from graphrqi.samples import collect
from graphrqi.stream import BehaviorStream, load_stream
from scenarios import SCENARIOS
from sim.engines import get_engine
from sim.frames import Frame, Tracks
from sim.scenario import sample_agents


@pytest.fixture(scope="module")
def tracks():
    scenario = SCENARIOS["straight_road"](duration_s=40.0, flow="dense")
    agents = sample_agents(scenario, seed=5)
    frames = list(get_engine("sumo")(scenario, agents, 5))
    return Tracks.from_frames(frames, {a.id: a.behavior for a in agents})


@pytest.fixture(scope="module")
def model(tracks):
    samples = collect(tracks, DriverObserver("raw", "eigh"), every_s=10.0, per_moment=1)
    return train("graphrqi-plus", samples, solver="eigh")


def test_a_window_is_the_difference_of_two_moments(tracks):
    """What is cut out of a long observation equals what a fresh observer sees in it."""
    whole = collect(tracks, SpectrumObserver("eigh"), windows_s=(float("inf"),), every_s=10.0)
    young = whole.where((whole.seconds > 9.95) & (whole.seconds < 10.05))
    cut = collect(tracks, SpectrumObserver("eigh"), windows_s=(10.0,), every_s=10.0)
    keys = {(a, t): f for a, t, f in zip(cut.agent, cut.time_s, cut.features, strict=True)}
    same = [(a, t) for a, t in zip(young.agent, young.time_s, strict=True) if (a, t) in keys]
    assert all(len(keys[k]) == whole.features.shape[1] for k in same)
    assert set(cut.seconds.round(6)) == {10.0}


def test_samples_are_of_labelled_drivers_only(tracks):
    samples = collect(tracks, Observer(), windows_s=(5.0,))
    driving = set(tracks.ids[tracks.behavior >= 0].tolist())
    assert set(samples.agent.tolist()) <= driving
    code = dict(zip(tracks.ids.tolist(), tracks.behavior.tolist(), strict=True))
    assert [code[a] for a in samples.agent.tolist()] == samples.codes.tolist()


def test_stream_answers_after_a_second_for_drivers_only(tracks, model):
    stream = BehaviorStream(model)
    for frame in tracks.frames():
        posterior = stream.update(frame)
        assert posterior.probability.sum(axis=1) == pytest.approx(np.ones(posterior.ids.size))
        assert set(posterior.ids.tolist()) <= set(frame.ids[frame.driving].tolist())
        if frame.time_s < float(tracks.time_s[0]) + 0.95:
            assert posterior.ids.size == 0
    assert posterior.ids.size > 5
    assert stream.history.ids.tolist() == frame.ids.tolist()
    assert stream.history.xy[:, -1] == pytest.approx(frame.xy)


def test_where_sizes_show_no_scene_everybody_is_unknown(tracks, model):
    trusted, doubting = BehaviorStream(model), BehaviorStream(model, is_scene=False)
    for frame in tracks.frames():
        believed, doubted = trusted.update(frame), doubting.update(frame)
    assert doubted.ids.tolist() == believed.ids.tolist() != []
    assert (doubted.unknown == 1.0).all()
    assert not doubted.labelled.any()
    assert (believed.unknown < 1.0).any()


def test_stream_uses_positions_only(tracks, model):
    honest, blinded = BehaviorStream(model), BehaviorStream(model)
    for frame in tracks.window(150, 150).frames():
        lie = dataclasses.replace(
            frame, speed=frame.speed * 0, heading=frame.heading * 0, length=frame.length * 0 + 9
        )
        a, b = honest.update(frame), blinded.update(lie)
    assert np.array_equal(a.probability, b.probability)


def test_stream_refuses_to_go_back_in_time(tracks, model):
    stream = BehaviorStream(model)
    stream.update(tracks.frame(3))
    with pytest.raises(InputError, match=r"frame\.time_s"):
        stream.update(tracks.frame(3))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"time_s": np.nan}, r"frame\.time_s: found nan"),
        ({"time_s": np.inf}, r"frame\.time_s: found inf"),
        ({"time_s": 1e308}, r"frame\.time_s: found 1e\+308, expected seconds up to 1e\+09"),
        ({"xy": np.nan}, r"frame\.xy: found no finite place"),
        ({"xy": 1e12}, r"frame\.xy: found agent \d+ beyond"),
        ({"ids": 0}, r"frame\.ids: found ids that do not ascend"),
        ({"kind": 77}, r"frame\.kind: found other codes"),
        ({"signals": np.zeros(9, np.int8)}, r"frame\.signals: found 9"),
    ],
)
def test_a_refused_frame_leaves_the_stream_as_it_was(tracks, model, changed, message):
    streams = BehaviorStream(model), BehaviorStream(model)
    for frame in tracks.window(250, 60).frames():
        if len(frame) > 1 and len(streams[0].history.time_s) == 30:
            wrong = {
                name: value if name in ("time_s", "signals") else np.full_like(old, value)
                for name, value in changed.items()
                for old in (getattr(frame, name),)
            }
            with pytest.raises(InputError, match=message):
                streams[0].push(dataclasses.replace(frame, **wrong))
        for stream in streams:
            stream.push(frame)
    a, b = (stream.posterior() for stream in streams)
    assert np.array_equal(a.probability, b.probability)
    assert np.array_equal(streams[0].history.xy, streams[1].history.xy, equal_nan=True)


def test_beliefs_do_not_depend_on_when_they_are_asked_for(tracks, model):
    asked, silent = BehaviorStream(model), BehaviorStream(model)
    for frame in tracks.window(250, 250).frames():
        asked.update(frame)
        silent.push(frame)
    assert np.array_equal(asked.posterior().probability, silent.posterior().probability)


def test_beliefs_are_the_models_under_the_mix_of_the_scene(tracks):
    """Every driver's odds against the model's own answer are shifted alike."""
    model = load_model("graphrqi-plus")
    stream, observer = BehaviorStream(model), DriverObserver()
    for frame in tracks.window(250, 250).frames():
        posterior = stream.update(frame)
        observer.update(frame.time_s, frame.ids, frame.xy, frame.driving)
    seen = observer.observation()
    ready = seen.seconds >= 1.0 - 1e-6
    alone = model.classifier.posterior(observer.features(*(x[ready] for x in (
        seen.seconds, seen.sums, seen.instant))))  # fmt: skip
    ratio = np.log(posterior.probability / alone)
    shift = ratio - ratio[:, :1]
    np.testing.assert_allclose(shift, np.tile(shift[0], (len(shift), 1)), atol=1e-6)
    assert np.abs(shift[0]).max() > 1e-3


def test_stream_survives_an_empty_frame(model):
    none = np.empty(0)
    empty = Frame(1.0, none.astype(int), np.empty((0, 2)), none, none, none, none, none.astype(int))
    assert BehaviorStream(model).update(empty).ids.size == 0


def test_model_on_disk_is_the_model(tmp_path, tracks, model):
    save_model(model, tmp_path / "model")
    again = load_stream(tmp_path / "model")
    first = BehaviorStream(model)
    for frame in tracks.window(120, 120).frames():
        a, b = first.update(frame), again.update(frame)
    assert np.array_equal(a.probability, b.probability)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["model"]
    assert [p.name for p in (tmp_path / "model").iterdir()] == [FILE]


def broken(folder: Path, **changes) -> Path:
    with safe_open(folder / FILE, "np") as file:
        about = json.loads(file.metadata()["about"])
    arrays = load_file(folder / FILE)
    save_file(arrays, folder / FILE, {"about": json.dumps(about | changes)})
    return folder


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"schema_version": 99}, "schema_version: found 99"),
        ({"method": "graphrqi-pluss"}, "did you mean 'graphrqi-plus'"),
        ({"features": ["x"]}, "another version"),
        ({"shares": [1.0]}, "shares: found .*expected 6"),
        ({"classes": ["timid"]}, "classes: found"),
    ],
)
def test_broken_model_files_are_refused_by_name(tmp_path, model, changes, said):
    save_model(model, tmp_path / "model")
    with pytest.raises(InputError, match=said):
        load_model(broken(tmp_path / "model", **changes))


def test_posterior_checks_and_looks_up():
    with pytest.raises(InputError, match=r"Posterior\.probability"):
        Posterior(ids=[1], probability=[[1.0]])
    known = Posterior(ids=[2, 5], probability=np.eye(6)[:2])
    found = known.of(np.array([5, 3]))
    assert found[0].argmax() == 1
    assert found[1] == pytest.approx(np.full(6, 1 / 6))


def test_importing_the_stream_loads_nothing_heavy():
    heavy = ("numba", "torch", "sklearn", "pandas", "pyarrow")
    code = f"import graphrqi.stream, sys; print([m for m in {heavy!r} if m in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


def platoon(time_s: float, noise_m: float, rng: np.random.Generator) -> Frame:
    """Eight cars behind one another at 12 to 15 m/s."""
    n, ones = np.arange(8), np.ones(8)
    xy = np.stack([40.0 * n + (12.0 + 3.0 * n / 7.0) * time_s, np.zeros(8)], axis=1)
    xy = xy + noise_m * rng.normal(0.0, 1.0, xy.shape)
    return Frame(time_s, n, xy, 0 * ones, 12 * ones, 4.5 * ones, 1.8 * ones, np.zeros(8, np.int8))


@pytest.mark.parametrize("traffic", ["recorded", "other"])
def test_answers_of_networks_are_kept_between_measurements(traffic):
    stream, rng, found = load_stream(traffic=traffic), np.random.default_rng(0), []
    for step in range(60):
        posterior = stream.update(platoon(0.1 * step, 0.0, rng))
        if step >= 20:
            assert posterior.ids.tolist() == list(range(8))
            assert posterior.domain == 1.0
            found.append(posterior.probability)
    changes = [not np.array_equal(a, b) for a, b in itertools.pairwise(found)]
    assert 0 < sum(changes) <= 4.0 / EVERY_S + 1


@pytest.mark.parametrize(
    ("noise_m", "step_s", "is_noisy"), [(0.0, 0.1, False), (0.02, 0.1, True), (0.0, 0.04, True)]
)
def test_the_classifier_answers_in_exact_simulated_traffic_alone(noise_m, step_s, is_noisy):
    stream = load_stream()
    plain = BehaviorStream(dataclasses.replace(stream.model, other=None))
    rng = np.random.default_rng(0)
    for step in range(round(4.0 / step_s)):
        frame = platoon(step_s * step, noise_m, rng)
        answers = [each.update(frame).probability for each in (stream, plain)]
    assert stream.is_noisy is is_noisy
    assert np.array_equal(*answers) is not is_noisy
