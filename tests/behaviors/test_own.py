"""Behaviours of one's own: files, perception, and what each may be."""

import pickle

import pytest

from behaviors import PROFILES, Behavior, InputError, read_behaviors
from behaviors.labels import SHIPPED, tables_of
from behaviors.profiles import PERCEPTION_FIELDS
from scenarios.demand import parse_mix


def test_the_six_perceive_everything_at_once():
    for profile in PROFILES.values():
        assert not any(getattr(profile, name) for name in PERCEPTION_FIELDS)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_behaviour_comes_back_equal_from_its_table_and_from_a_worker(name):
    (own,) = read_behaviors(name)
    (again,) = read_behaviors(tables_of((own,)))
    for other in (again, pickle.loads(pickle.dumps(own))):
        assert vars(other) == vars(own)
    assert own.source
    assert own.profile.reaction_time_s > 0


def test_a_behaviour_may_be_like_one_before_it(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('[tired]\nlike = "timid"\nlapse_s = 1\n[sleepy]\nlike = "tired"\nlapse_s = 3\n')
    tired, sleepy = read_behaviors(file)
    assert (sleepy.base, sleepy.style) == (Behavior.TIMID, Behavior.TIMID.style)
    assert (tired.profile.lapse_s, sleepy.profile.min_gap_m) == (1.0, 4.2)
    mix = parse_mix("aggressive=.3,conservative=.5,sleepy=.2", (tired, sleepy))
    assert mix[sleepy] == 0.2
    assert sum(mix.values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lapse_s = 3", "lapse_s: found 3, expected a table"),
        ("[tired]", "tired.like: found none"),
        ('[timid]\nlike = "careful"', "timid: found a behaviour of that name already"),
        ('[aggressive]\nlike = "timid"', "that is no style's"),
        ('[tired]\nlike = "timd"', "did you mean 'timid'"),
        ('[tired]\nlike = "timid"\nlapses = 3', "unknown key of tired 'lapses'"),
        ('[tired]\nlike = "timid"\nlapse_s = "3"', "tired.lapse_s: found '3'"),
        ('[tired]\nlike = "timid"\nreaction_time_s = 9', "found 9.0, expected 0 to 5"),
        ('[tired]\nlike = "timid"\ncolor = "red"', "tired.color: found 'red'"),
        ('[tired]\nlike = "timid"\ntraits = ["sleeping"]', "unknown trait of tired"),
        ("[tired", "mine.toml"),
    ],
)
def test_a_broken_file_is_refused_by_file_and_key(text, said, tmp_path):
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(InputError, match="mine") as refused:
        read_behaviors(tmp_path / "mine.toml")
    assert said in str(refused.value)
