import numpy as np
import pytest

from behaviors.errors import InputError
from experiments.scoring.annotators import cohen_kappa, fleiss_kappa


def test_the_published_example():
    """Table 1 of Fleiss (1971) as reprinted: 14 raters, 10 subjects, 5 answers, kappa 0.210."""
    counts = [
        [0, 0, 0, 0, 14], [0, 2, 6, 4, 2], [0, 0, 3, 5, 6], [0, 3, 9, 2, 0], [2, 2, 8, 1, 1],
        [7, 7, 0, 0, 0], [3, 2, 6, 3, 0], [2, 5, 3, 2, 2], [6, 5, 2, 1, 0], [0, 2, 2, 3, 7],
    ]  # fmt: skip
    assert fleiss_kappa(np.array(counts)) == pytest.approx(0.210, abs=0.001)


@pytest.mark.parametrize("counts", [[[1, 1], [3, 0]], [[1, 0]], [[-1, 3], [1, 1]], [3, 1]])
def test_what_cannot_be_compared_is_refused(counts):
    with pytest.raises(InputError, match="counts: found"):
        fleiss_kappa(np.array(counts))


def test_one_answer_only_says_nothing():
    assert np.isnan(fleiss_kappa(np.array([[3, 0], [3, 0]])))


def test_kappa_of_a_worked_example():
    """20 yes-yes, 5 yes-no, 10 no-yes, 15 no-no: agreement .7, by chance .5."""
    first = "y" * 25 + "n" * 25
    second = "y" * 20 + "n" * 5 + "y" * 10 + "n" * 15
    assert cohen_kappa(first, second) == pytest.approx(0.4)


@pytest.mark.parametrize(("first", "second"), [("a", "ab"), ("", "")])
def test_answers_that_do_not_pair_up_are_refused(first, second):
    with pytest.raises(InputError, match=f"found {len(first)} and {len(second)} answers"):
        cohen_kappa(first, second)


def test_one_answer_of_both_says_nothing():
    assert np.isnan(cohen_kappa("aaa", "aaa"))
    assert np.isnan(cohen_kappa("a", "a"))
    assert cohen_kappa("aaa", "bbb") == 0.0
