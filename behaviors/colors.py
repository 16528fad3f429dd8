"""One colour per behaviour, wherever behaviours are drawn: warm aggressive, cool conservative.

The palette of Okabe and Ito (2008), which people with any common colour blindness can tell apart.
"""

from __future__ import annotations

from typing import Final

from behaviors.labels import BEHAVIORS

COLORS: Final[dict[str, str]] = {str(one): one.color for one in BEHAVIORS}
"""Those of the six by name; sRGB, as in HTML."""

UNKNOWN_COLOR: Final = "#8C8C8C"
"""The colour of agents without a behaviour: pedestrians, and drivers not yet classified."""


def rgb(color: str) -> tuple[int, int, int]:
    """A colour of HTML as red, green and blue, 0 to 255.

    Examples:
        >>> rgb("#E69F00")
        (230, 159, 0)
    """
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue
