import numpy as np
import pytest

from sim.episode.collisions import contacts
from sim.frames import Tracks


def scene(xy, heading=None, **changes):
    """Boxes of 4 m by 2 m at (N, T, 2) places."""
    xy = np.asarray(xy, dtype=float)
    n, t = xy.shape[:2]
    tracks = Tracks.of_dense(
        ids=np.arange(n),
        names=tuple(map(str, range(n))),
        kind=np.zeros(n),
        length=np.full(n, 4.0),
        width=np.full(n, 2.0),
        time_s=np.arange(1, t + 1) * 0.1,
        xy=xy,
        heading=np.zeros((n, t)) if heading is None else np.asarray(heading, dtype=float),
        speed=np.zeros((n, t)),
        valid=np.ones((n, t), dtype=bool),
        signals=np.zeros((0, t)),
    )
    return tracks.with_dense(**changes)


@pytest.mark.parametrize(
    ("xy", "heading", "touch"),
    [
        ((3.8, 0.0), 0.0, True),
        ((3.95, 0.0), 0.0, False),
        ((0.0, 1.8), 0.0, True),
        ((0.0, 2.1), 0.0, False),
        ((0.0, 2.5), np.pi / 2, True),  # across: half its length reaches over
        ((3.3, 0.0), np.pi / 2, False),
        ((3.4, 2.6), np.pi / 4, False),  # boxes about the boxes meet, the boxes do not
        ((2.5, 1.5), np.pi / 4, True),
    ],
)
def test_two_boxes(xy, heading, touch):
    steps = scene([[(0.0, 0.0)] * 2, [xy] * 2], [[0.0] * 2, [heading] * 2])
    assert list(contacts(steps)) == ([(0, 1, 0), (0, 1, 1)] if touch else [])


@pytest.mark.parametrize("far_m", [0.0, 5000.0])
def test_as_many_as_by_looking_at_every_pair(far_m):
    rng = np.random.default_rng(0)
    n, t = 30, 8
    xy, heading = rng.uniform(0, 40, (n, t, 2)), rng.uniform(-3, 3, (n, t))
    xy[::2] += far_m  # two crowds a city apart
    found = set(contacts(scene(xy, heading)))
    alone = {
        (i, j, k)
        for i in range(n)
        for j in range(i + 1, n)
        for k in range(t)
        if list(contacts(scene(xy[[i, j]][:, [k, k]], heading[[i, j]][:, [k, k]])))
    }
    assert found == alone
