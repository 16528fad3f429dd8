"""The colours of numbers: viridis, made for colour-blind people too, without its darkest end."""

from __future__ import annotations

from typing import Final

from matplotlib import colormaps
from matplotlib.colors import to_hex

BEGIN: Final = 0.12
"""Where in viridis the ramp begins (darker colours could not be seen on a dark road)."""


def ramp_color(share: float) -> str:
    """The colour of a share, as in HTML.

    Args:
        share: 0 for the lowest to 1 for the highest number; what is outside counts as the end.

    Returns:
        sRGB.

    Examples:
        >>> ramp_color(1.0), ramp_color(7.0)
        ('#fde725', '#fde725')
    """
    return str(to_hex(colormaps["viridis"](BEGIN + (1.0 - BEGIN) * min(max(share, 0.0), 1.0))))
