"""Disturbances on hand-made tracks, and the protocols on a few short episodes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from behaviors.errors import InputError
from experiments.benches.classification.bench import BENCH, plot_classification
from experiments.benches.classification.controls import (
    ceiling,
    interpretability,
    leak_probe,
    random_rows,
)
from experiments.benches.classification.protocols import (
    ablation,
    across_scenarios,
    in_scenes,
    inductive,
    transductive,
)
from experiments.benches.classification.recordings import OURS, Disturbed, Recordings
from experiments.benches.classification.robustness import (
    LONG_TAIL,
    long_tailed,
    mislabelled,
    robustness,
)
from experiments.benches.classification.rows import difference_rows, score_rows
from experiments.benches.classification.speed import speed_rows
from experiments.benches.statistics import auc_within
from experiments.data.configuration import GenerateConfig
from experiments.data.disturbances import (
    DISTURBANCES,
    cut_tracks,
    dropped_frames,
    identity_switches,
    position_noise,
)
from experiments.data.generate import generate
from experiments.data.windows import places_of
from experiments.score.metrics import calibration_error, confusion, reliability
from graphrqi.methods import METHODS
from graphrqi.model_files import load_model
from graphrqi.samples import Samples
from sim.frames import Tracks
from sim.store.dataset import open_dataset


def convoy(n: int = 4, seconds: float = 20.0) -> Tracks:
    """Cars 8 m apart at the same speed, each of another behaviour."""
    time_s = np.arange(round(seconds * 10)) / 10.0
    x = np.arange(n)[:, None] * 8.0 + 10.0 * time_s
    return Tracks(
        ids=np.arange(n) * 2,
        names=tuple("abcdef"[:n]),
        kind=np.zeros(n, dtype=np.int8),
        length=np.full(n, 4.5),
        width=np.full(n, 1.8),
        time_s=time_s,
        xy=np.stack([x, np.zeros_like(x)], axis=2),
        heading=np.zeros_like(x),
        speed=np.full_like(x, 10.0),
        valid=np.ones_like(x, dtype=bool),
        signals=np.empty((0, time_s.size), dtype=np.int8),
        behavior=np.arange(n, dtype=np.int8),
    )


@pytest.mark.parametrize("name", sorted(DISTURBANCES))
def test_disturbances_are_repeatable_and_leave_their_argument(name):
    tracks = convoy()
    before = tracks.xy.copy()
    level = DISTURBANCES[name][1][-1]
    first, again = (Disturbed(name, level).applied(tracks, 5) for _ in range(2))
    np.testing.assert_array_equal(first.xy, again.xy)
    np.testing.assert_array_equal(tracks.xy, before)
    assert np.isnan(first.xy[~first.valid]).all()
    assert first.behavior.size == first.ids.size
    assert (np.diff(first.time_s) > 0).all()


def test_noise_has_the_deviation_asked_for():
    rng = np.random.default_rng(0)
    moved = position_noise(convoy(), 0.3, rng).xy - convoy().xy
    assert moved.std() == pytest.approx(0.3, rel=0.05)


def test_dropped_frames_leave_whole_frames():
    left = dropped_frames(convoy(), 0.3, np.random.default_rng(0))
    assert 0.6 < left.time_s.size / 200 < 0.8
    assert set(left.time_s) <= set(convoy().time_s)
    assert left.valid.all()


def test_switched_identities_follow_another_agent():
    tracks = convoy(seconds=120.0)
    switched = identity_switches(tracks, 2.0, np.random.default_rng(1))
    jumps = np.abs(np.diff(switched.xy[..., 0], axis=1)) > 3.0
    assert 4 <= jumps.sum() <= 40  # 4 agents, 2 minutes, 2 per agent and minute: 16 expected
    np.testing.assert_allclose(np.sort(switched.xy[..., 0], axis=0), tracks.xy[..., 0])
    assert (
        identity_switches(tracks, 0.0, np.random.default_rng(1)).xy.tolist() == tracks.xy.tolist()
    )


def test_switched_labels_are_of_the_agent_followed_longest():
    tracks = convoy(2, seconds=120.0)
    switched = identity_switches(tracks, 1.0, np.random.default_rng(3))
    for row in range(2):
        follows_own = (switched.xy[row, :, 0] == tracks.xy[row, :, 0]).mean() > 0.5
        assert switched.behavior[row] == (row if follows_own else 1 - row)


def test_cut_tracks_are_pieces_of_the_whole():
    tracks = convoy()
    pieces = cut_tracks(tracks, 5.0, np.random.default_rng(0))
    assert pieces.valid.sum() == tracks.valid.sum()
    assert pieces.valid.sum(axis=1).max() <= 50
    for letter in "abcd":
        rows = [i for i, name in enumerate(pieces.names) if name.startswith(letter)]
        assert pieces.valid[rows].sum(axis=0).tolist() == [1] * 200
        assert {int(pieces.behavior[i]) for i in rows} == {"abcd".index(letter)}


# --- metrics ------------------------------------------------------------------------------------


def test_calibration_of_answers_that_are_as_sure_as_right():
    rng = np.random.default_rng(0)
    p = rng.uniform(0.5, 1.0, 20000)
    truth = (rng.random(20000) > p).astype(np.int8)
    honest = np.stack([p, 1 - p], axis=1)
    assert float(calibration_error(reliability(truth, honest, np.zeros(20000)).sum(0))) < 0.02
    boastful = np.stack([p**0.1, 1 - p**0.1], axis=1)
    assert float(calibration_error(reliability(truth, boastful, np.zeros(20000)).sum(0))) > 0.15


def test_auc_compares_only_inside_groups():
    score = np.array([1.0, 2.0, 11.0, 12.0])
    truth = np.array([False, True, False, True])
    value, low, high = auc_within(score, truth, np.array([0, 0, 1, 1]))
    assert (value, low, high) == (1.0, 1.0, 1.0)
    assert auc_within(score, truth, np.zeros(4))[0] == 0.75
    assert np.isnan(auc_within(score, truth, np.arange(4))[0])


def test_confusion_of_fewer_classes():
    matrix = confusion(np.array([0, 1, 1], np.int8), np.array([0, 0, 1]), np.zeros(3), 2)
    assert matrix.tolist() == [[[1.0, 0.0], [1.0, 1.0]]]


# --- samples ------------------------------------------------------------------------------------


def samples(codes: np.ndarray, episodes: np.ndarray) -> Samples:
    n = codes.size
    return Samples(
        np.zeros((n, 1), np.float32), codes.astype(np.int8), episodes, np.arange(n) % 50,
        np.zeros(n), np.full(n, 10.0), np.full(n, 10.0), np.ones(n, dtype=bool),
    )  # fmt: skip


def test_a_long_tailed_mix_has_the_shares_of_traf():
    rng = np.random.default_rng(0)
    many = samples(rng.integers(0, 6, 12000), np.repeat(np.arange(240), 50))
    count = np.bincount(long_tailed(many, 0).codes, minlength=6)
    np.testing.assert_allclose(count / count.sum(), np.array(LONG_TAIL) / 392, atol=0.02)


def test_wrong_labels_are_wrong_for_all_windows_of_a_driver():
    one = samples(np.zeros(4000, int), np.repeat(np.arange(80), 50))
    twice = Samples.join([one, one])
    wrong = mislabelled(twice, 0.3, 0).codes
    assert (wrong != 0).mean() == pytest.approx(0.3, abs=0.03)
    np.testing.assert_array_equal(wrong[:4000], wrong[4000:])


def test_a_method_differs_from_itself_by_nothing():
    some = samples(np.arange(60) % 6, np.repeat(np.arange(6), 10))
    p = np.random.default_rng(0).dirichlet(np.ones(6), 60)
    perfect = np.eye(6)[some.codes]
    for row in difference_rows(some, p, p, {}):
        assert (row["value"], row["low"], row["high"]) == (0.0, 0.0, 0.0)
    assert all(row["low"] > 0 for row in difference_rows(some, perfect, p, {}))
    table = {row["metric"]: row["value"] for row in score_rows(some, perfect, 0, {})}
    assert table["macro_f1"] == table["recall_timid"] == 1.0
    assert table["majority_weighted_accuracy"] == pytest.approx(1 / 6)
    assert table["ece"] == 0.0


def test_scenes_are_corrected_one_by_one_and_in_order_of_time():
    """An episode of one careful driver after another; a second one without any."""
    careful, n = 3, 400
    some = dataclasses.replace(
        samples(np.full(n, careful), np.repeat([0, 1], n // 2)),
        agent=np.arange(n), time_s=np.tile(np.arange(n // 2) * 5.0, 2),
    )  # fmt: skip
    model = load_model(OURS)
    unsure = np.array(model.shares) * np.where(np.arange(6) == careful, 4.0, 1.0)
    answers = np.where(some.episode[:, None] == 0, unsure / unsure.sum(), np.full(6, 1 / 6))
    corrected = in_scenes(model, some, answers)[:, careful]
    assert (np.diff(corrected[: n // 2]) > 0).all()
    assert corrected[n // 2 - 1] > corrected[0] + 0.2
    order = np.random.default_rng(0).permutation(n)
    shuffled = some.where(order)
    np.testing.assert_allclose(
        in_scenes(model, shuffled, answers[order])[:, careful], corrected[order]
    )


# --- protocols ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> Recordings:
    folder = tmp_path_factory.mktemp("episodes") / "data"
    config = GenerateConfig(scenarios=("straight_road",), episodes=5, duration_s=45.0, seed=3)
    generate(config, folder, jobs=1, quiet=True)
    return Recordings(open_dataset(folder), jobs=1)


KEYS = {"protocol", "scenario", "method", "window_s", "variation", "metric", "value", "low",
        "high", "n"}  # fmt: skip


def test_no_episode_is_both_learned_and_scored(recordings):
    learned = set(recordings.training("majority").episode.tolist())
    scored = set(recordings.scored("majority").episode.tolist())
    assert learned
    assert scored
    assert not learned & scored


def test_columns_seen_before_are_not_looked_at_again(recordings):
    everything = recordings.scored("graphrqi-plus")
    for method in ("forest", "graphrqi-invariant"):
        part = recordings.scored(method)
        fresh = Recordings(recordings.dataset, jobs=1).scored(method)
        np.testing.assert_array_equal(part.features, fresh.features)
        assert part.features.shape[1] == len(METHODS[method].observer("eigh").feature_names)
    assert len(everything) == len(part)


def test_windows_of_one_length_are_those_among_others(recordings):
    several = Recordings(recordings.dataset, jobs=1)
    several.scored("majority", (2.0, 5.0, float("inf")))
    part = several.scored("majority", (5.0,))
    fresh = Recordings(recordings.dataset, jobs=1).scored("majority", (5.0,))
    for field in dataclasses.fields(Samples):
        np.testing.assert_array_equal(getattr(part, field.name), getattr(fresh, field.name))


def test_lives_end_with_the_last_look_at_each_driver(recordings):
    found = recordings.scored("majority", (5.0, float("inf")))
    whole = found.where(np.isinf(found.window_s))
    pairs = list(zip(whole.episode.tolist(), whole.agent.tolist(), strict=True))
    assert len(pairs) == len(set(pairs))
    short = found.where(np.isfinite(found.window_s))
    for (episode, agent), end in zip(pairs[:20], whole.time_s[:20], strict=True):
        own = (short.episode == episode) & (short.agent == agent)
        assert not own.any() or short.time_s[own].max() <= end


def test_places_name_the_engine_where_there_are_several(recordings, tmp_path):
    config = GenerateConfig(
        scenarios=("straight_road",), episodes=1, engine="sumo-idm", duration_s=5.0
    )
    generate(config, tmp_path / "idm", 1, quiet=True)
    other = open_dataset(tmp_path / "idm")
    assert places_of([other]) == ["straight_road"]
    together = places_of([recordings.dataset, other])
    assert set(together) == {
        *(f"{scenario}, sumo" for scenario in recordings.dataset.scenarios),
        "straight_road, sumo-idm",
    }
    assert together[-1] == "straight_road, sumo-idm"


@pytest.fixture
def few_rounds(monkeypatch):
    few = dataclasses.replace(METHODS[OURS], options={"rounds": 10})
    monkeypatch.setitem(METHODS, OURS, few)


def test_rows_of_every_protocol(recordings, few_rounds):
    methods = (OURS, "forest", "majority")
    rows = [
        *inductive(recordings, methods, (5.0, 10.0, float("inf"))),
        *leak_probe(recordings),
        *ceiling(recordings),
        *interpretability(recordings),
        *transductive(recordings, ("cheung",)),
        *speed_rows(recordings, ("majority",), (20,), frames=5),
        *random_rows(recordings, ("majority",)),
        *ablation(recordings),
    ]
    assert all(set(row) == KEYS for row in rows)
    signed = [r for r in rows if r["metric"].endswith("_difference")]
    assert {r["variation"] for r in signed if r["protocol"] == "inductive"} == {"minus forest"}
    ablated = {r["variation"] for r in rows if r["protocol"] == "ablation"}
    assert {"without spectrum", "minus without spectrum"} <= ablated
    for row in rows:
        if row["metric"] != "ms_per_frame" and row not in signed and row["value"] is not None:
            assert 0.0 <= row["value"] <= 1.0, row
    table = {
        (r["protocol"], r["method"], r["window_s"], r["variation"], r["metric"]): r["value"]
        for r in rows
    }
    ours = table["inductive", OURS, 10.0, "", "style_balanced_accuracy"]
    assert ours > table["inductive", "majority", 10.0, "", "style_balanced_accuracy"] == 0.5
    assert table["inductive", "ceiling", None, "whole life", "style_balanced_accuracy"] > 0.9
    for variation in ("", "first window"):
        assert table["leak-probe", "leak-probe", 10.0, variation, "macro_f1"] < 0.35
    sizes = {r["variation"]: r["n"] for r in rows if r["protocol"] == "leak-probe"}
    assert sizes["first window"] < sizes[""]


def test_each_scenario_is_scored_with_what_was_learned_on_the_other(tmp_path):
    names = ("straight_road", "two_way_road")
    config = GenerateConfig(scenarios=names, episodes=5, duration_s=30.0, seed=4)
    generate(config, tmp_path / "data", jobs=1, quiet=True)
    both = Recordings(open_dataset(tmp_path / "data"), jobs=1)
    rows = across_scenarios(both, ("cheung",))
    assert all(set(row) == KEYS for row in rows)
    assert {(r["scenario"], r["variation"]) for r in rows} == {
        (scenario, f"trained on {other}{moving}")
        for scenario, other in (names, names[::-1])
        for moving in ("", ", moving")
    }
    learned = {name: both.fitted("cheung", name)[0] for name in names}
    test = both.scored("cheung")
    for scenario, other in (names, names[::-1]):
        here = both.of(scenario, test)
        answers = learned[other].posterior(here.features.astype(np.float64)).argmax(axis=1)
        (row,) = [r for r in rows if r["variation"] == f"trained on {other}"
                  and r["metric"] == "weighted_accuracy"]  # fmt: skip
        assert row["value"] == pytest.approx((answers == here.codes).mean())
        assert row["n"] == len(here) > 0


def test_same_data_same_rows(recordings):
    one = inductive(recordings, ("cheung",), (10.0,))
    two = inductive(Recordings(recordings.dataset, jobs=1), ("cheung",), (10.0,))
    assert one == two


def test_robustness_names_what_was_done(recordings):
    rows = robustness(recordings, ("cheung",), levels=1)
    about = {row["variation"] for row in rows}
    assert {
        "position noise 0.1 m",
        "position noise 0.1 m, trained with it",
        "cut tracks 5 s, windows of 3 s",
        "long-tailed mix",
        "0.1 of training drivers mislabelled",
    } <= about


def test_training_with_noise_is_another_model(recordings):
    noisy = Disturbed("position noise", 1.0)
    clean, _ = recordings.fitted("cheung")
    used_to, _ = recordings.fitted("cheung", disturbed=noisy)
    test = recordings.scored("cheung", (10.0,), noisy).features.astype(np.float64)
    assert not np.allclose(clean.posterior(test), used_to.posterior(test))
    assert dataclasses.asdict(noisy) == {"name": "position noise", "level": 1.0}


def test_bench_of_one_protocol_and_its_picture(tmp_path):
    kept: list[int] = []
    settings = dataclasses.replace(BENCH.quick, protocols=("inductive", "across-engines"))
    rows = BENCH.run(settings, lambda rows: kept.append(len(rows)))
    assert len(kept) == 2
    assert 0 < kept[0] < kept[1] == len(rows)
    assert {row["protocol"] for row in rows} == {"inductive", "across-engines"}
    assert {row["variation"] for row in rows if row["protocol"] == "across-engines"} == {
        "trained on sumo, scored on highway",
        "trained on sumo with both laws, scored on highway",
        "trained on highway, scored on sumo",
        "trained on highway with both laws, scored on sumo",
    }
    plot_classification(rows, tmp_path / "rows.svg")
    assert (tmp_path / "rows.svg").read_text().rstrip().endswith("</svg>")
    with pytest.raises(InputError, match="did you mean 'inductive'"):
        BENCH.run(dataclasses.replace(BENCH.quick, protocols=("inductiv",)))
