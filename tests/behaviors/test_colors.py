"""The palette can be told apart, whatever one's colour vision, on light and on dark roads."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from behaviors.labels import BEHAVIORS, COLORS, UNKNOWN_COLOR

VISION = {
    "usual": np.eye(3),
    # Machado, Oliveira, Fernandes (2009), IEEE TVCG 15: severity 1.0, on linear RGB.
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
         [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
         [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
         [0.004733, 0.691367, 0.303900]]
    ),
}  # fmt: skip

ASPHALT = {"light": "#c6cbd2", "dark": "#303742"}
"""As the replay page paints roads."""

OUTLINE = {"light": "#18202b", "dark": "#f2f5f8"}

JUST_NOTICEABLE = 2.3
"""Distance in CIE Lab (Mahy et al. 1994)."""


def linear(color):
    v = np.array(to_rgb(color))
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def lab(color, vision):
    seen = np.clip(VISION[vision] @ linear(color), 0.0, 1.0)
    to_xyz = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    t = to_xyz @ seen / np.array([0.9505, 1.0, 1.089])
    f = np.where(t > 216 / 24389, np.cbrt(t), (24389 / 27 * t + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", VISION)
def test_every_two_colours_differ(vision):
    named = {**{str(b): COLORS[b] for b in BEHAVIORS}, "unknown": UNKNOWN_COLOR}
    for (one, a), (other, b) in combinations(named.items(), 2):
        away = np.linalg.norm(lab(a, vision) - lab(b, vision))
        assert away > 3 * JUST_NOTICEABLE, (one, other, away)
