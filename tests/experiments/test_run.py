"""What a run says of its classifier."""

from __future__ import annotations

from experiments.run import _Believed


def test_the_most_frequent_behaviour_stands_beside_the_accuracy() -> None:
    believed = _Believed(truth={1: 0, 2: 0, 3: 0, 4: 5}, latest={1: 0, 2: 5, 3: 1, 4: 5})
    rows = {row["what"]: row["value"] for row in believed.rows()}
    assert rows["accuracy"] == 0.5
    assert rows["accuracy of the most frequent behaviour"] == 0.75
    assert rows["balanced accuracy"] == (1 / 3 + 1.0) / 2
