"""ASAM's formats for other simulators; they need ``pip install graphrqi[asam]``."""

from behaviors.errors import InputError

try:
    import scenariogeneration  # noqa: F401
except ImportError:
    raise InputError(
        "openscenario: scenariogeneration not found, expected it: pip install graphrqi[asam]"
    ) from None
