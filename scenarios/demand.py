"""How much traffic and whose: flows and mixes as a user writes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from behaviors.errors import InputError
from behaviors.labels import Behavior
from sim.scenario import EQUAL_MIX

FLOW_LEVELS: Final[tuple[str, ...]] = ("light", "medium", "dense")
"""The named flows; what they mean in vehicles per hour is each scenario's own."""


def parse_flow(flow: str | float, levels: Mapping[str, float]) -> float:
    """Vehicles per hour.

    Args:
        flow: a level's name or a number, possibly written as text.
        levels: vehicles per hour of each named level.

    Returns:
        Vehicles per hour over all entries of the road together.

    Raises:
        InputError: if it is neither a level nor a number >= 0.

    Example:
        >>> parse_flow("medium", {"medium": 2400.0}), parse_flow("900", {})
        (2400.0, 900.0)
    """
    if isinstance(flow, str) and flow in levels:
        return levels[flow]
    expected = f"{', '.join(levels)} or vehicles per hour >= 0"
    try:
        value = float(flow)
    except ValueError:
        raise InputError(f"flow: found {flow!r}, expected {expected}") from None
    if not math.isfinite(value) or value < 0:
        raise InputError(f"flow: found {flow!r}, expected {expected}")
    return value


def parse_mix(
    mix: str | Mapping[Behavior, float] | Mapping[str, float] | None,
) -> dict[Behavior, float]:
    """The share of each behaviour among drivers.

    Args:
        mix: None for equal shares, a mapping, or text like ``"impatient=.2,timid=.8"``.
            Behaviours that are not named have no share.

    Returns:
        Shares by behaviour.

    Raises:
        InputError: if a behaviour is unknown or named twice, a share is negative or no number, or
            the shares do not add to 1.

    Example:
        >>> parse_mix("reckless=.25, timid=.75")
        {<Behavior.RECKLESS: 'reckless'>: 0.25, <Behavior.TIMID: 'timid'>: 0.75}
    """
    if mix is None:
        return dict(EQUAL_MIX)
    pairs = _split(mix) if isinstance(mix, str) else [(str(k), v) for k, v in mix.items()]
    shares: dict[Behavior, float] = {}
    for name, value in pairs:
        try:
            behavior = Behavior(name)
        except ValueError:
            raise InputError(
                f"mix: found behaviour {name!r}, expected one of {', '.join(Behavior)}"
            ) from None
        if behavior in shares:
            raise InputError(f"mix: found {name!r} twice, expected each behaviour once")
        try:
            share = float(value)
        except ValueError:
            raise InputError(f"mix: found {name}={value!r}, expected a share >= 0") from None
        if not math.isfinite(share) or share < 0:
            raise InputError(f"mix: found {name}={share:g}, expected a share >= 0")
        shares[behavior] = share
    total = sum(shares.values())
    if abs(total - 1.0) > 1e-6:
        raise InputError(f"mix: found shares adding to {total:g}, expected 1")
    return shares


def _split(text: str) -> list[tuple[str, str | float]]:
    pairs: list[tuple[str, str | float]] = []
    for part in text.split(","):
        name, equals, value = part.partition("=")
        if not equals:
            raise InputError(f"mix: found {part.strip()!r}, expected behaviour=share")
        pairs.append((name.strip(), value.strip()))
    return pairs
