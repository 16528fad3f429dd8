"""Numbers in the way that files write them.

Python's own ``float`` and ``int`` also read ``1_000`` and digits of other scripts, which no format
means and other programs refuse.
"""

from __future__ import annotations


def real(text: str | bytes) -> float:
    """A number: digits, a point, an exponent.

    Raises:
        ValueError: if it is none, or one that only Python reads: ``1_000``, full-width digits.

    Examples:
        >>> real("-1.5e3")
        -1500.0
    """
    return float(_checked(text))


def whole(text: str | bytes) -> int:
    """A whole number: digits.

    Raises:
        ValueError: as `real`.

    Examples:
        >>> whole(" 12")
        12
    """
    return int(_checked(text))


def _checked(text: str | bytes) -> str | bytes:
    if not text.isascii() or ("_" in text if isinstance(text, str) else b"_" in text):
        raise ValueError(f"found {text!r:.40}, expected a number")
    return text
