"""Driver behaviours as data: the six of the paper and those of one's own, with their traits.

Table I of the paper "GraphRQI: Classifying Driver Behaviors Using Graph Spectrums" (ICRA 2020)
assigns observable traits to behaviours; ``shipped/six.toml`` holds it, with the numbers of each
behaviour's median driver. Class codes are defined here and nowhere else: the position of a
behaviour in ``BEHAVIORS``. A file of one's own has a table for each behaviour.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar, Final

from behaviors.errors import InputError, in_file, lookup
from behaviors.profiles import PROFILE_FIELDS, Profile
from behaviors.toml_files import read_toml, shipped_or_path


class Style(StrEnum):
    """The two parent classes of the paper."""

    AGGRESSIVE = "aggressive"
    CONSERVATIVE = "conservative"


class Trait(StrEnum):
    """Observable actions of a road-agent (rows of the paper's trait table)."""

    OVERTAKING = "overtaking"
    OVER_SPEEDING = "over-speeding"
    TAILGATING = "tailgating"
    WEAVING = "weaving"
    CUTTING_IN = "cutting in front"
    DRIVING_CLOSE = "driving extremely close"
    WRONG_DIRECTION = "driving in the wrong direction"
    JAYWALKING = "jaywalking"
    BREAKING_RULES = "not following rules"
    KEEPING_NEIGHBORS = "maintaining neighbours"
    UNIFORM_SPEED = "uniform speed"
    FOLLOWING_RULES = "following rules"
    NOT_MOVING = "not moving"
    SLOWING = "slowing down or stopping"
    WAITING = "waiting for vehicles or pedestrians"


class Behavior(str):
    """How a driver drives: a name that carries what belongs to it.

    Attributes:
        style: the parent class.
        color: wherever it is drawn; sRGB, as in HTML.
        profile: its median driver.
        like: the behaviour whose numbers fill those left out; itself for the six.
        traits: that show it.
        source: where its numbers come from.

    Examples:
        >>> Behavior.TIMID.style, Behavior.RECKLESS.code
        (<Style.CONSERVATIVE: 'conservative'>, 1)
    """

    IMPATIENT: ClassVar[Behavior]
    RECKLESS: ClassVar[Behavior]
    THREATENING: ClassVar[Behavior]
    CAREFUL: ClassVar[Behavior]
    CAUTIOUS: ClassVar[Behavior]
    TIMID: ClassVar[Behavior]

    style: Style
    color: str
    profile: Profile
    like: str
    traits: tuple[Trait, ...]
    source: str

    def __new__(cls, name: str, **parts: Any) -> Behavior:
        """A behaviour of that name, with its attributes."""
        self = super().__new__(cls, name)
        vars(self).update(parts)
        return self

    def __repr__(self) -> str:
        """Its name, as that of a class attribute."""
        return f"<Behavior.{self.upper()}: {str(self)!r}>"

    @property
    def value(self) -> str:
        """Its name, as that of a style or trait."""
        return str(self)

    @property
    def base(self) -> Behavior:
        """The one of the six that it is like."""
        return next(one for one in BEHAVIORS if one == self.like)

    @property
    def code(self) -> int:
        """The class code among the six: position in ``BEHAVIORS``."""
        return BEHAVIORS.index(self)

    def table(self) -> dict[str, Any]:
        """What a file says of it, with every number; equal for equal behaviours."""
        return {
            "style": str(self.style),
            "color": self.color,
            "like": self.like,
            "traits": [str(trait) for trait in self.traits],
            "source": self.source,
            **{name: getattr(self.profile, name) for name in PROFILE_FIELDS},
        }


KEYS: Final = ("style", "color", "like", "traits", "source", *PROFILE_FIELDS)
"""Keys of a behaviour in a file."""

SHIPPED: Final = {
    path.stem: path for path in sorted(Path(__file__).with_name("shipped").glob("*.toml"))
}
"""The files of behaviours that ship, by name."""

OWN_COLOR: Final = "#000000"
"""The colour of a behaviour of one's own whose file names none."""


def _behavior(name: str, said: Mapping[str, Any], known: Mapping[str, Behavior]) -> Behavior:
    """A behaviour from its table; numbers left out are those of a known one."""
    if not isinstance(said, Mapping):
        raise InputError(f"{name:.60}: found {said!r:.60}, expected a table of a behaviour")
    if not re.fullmatch("[a-z][a-z0-9_-]{0,39}", name) or name in tuple(Style):
        raise InputError(f"{name!r:.60}: expected a name of small letters that is no style's")
    for key in said:
        lookup(dict.fromkeys(KEYS), key, f"key of {name}")
    if known and "like" not in said:
        raise InputError(f"{name}.like: found none, expected one of {', '.join(known)}")
    base = lookup(known, str(said["like"]), f"{name}.like") if known else None
    style = str(said.get("style", base and base.style))
    known_traits = {str(trait): trait for trait in Trait}
    color, traits = str(said.get("color", OWN_COLOR)), said.get("traits", [])
    if not re.fullmatch("#[0-9A-Fa-f]{6}", color):
        raise InputError(f"{name}.color: found {color!r:.60}, expected such as '#009E73'")
    if not isinstance(traits, list | tuple):
        raise InputError(f"{name}.traits: found {traits!r:.60}, expected a list")
    numbers = {} if base is None else dataclasses.asdict(base.profile)
    for key in PROFILE_FIELDS:
        if key in said:
            if not isinstance(said[key], int | float) or isinstance(said[key], bool):
                raise InputError(f"{name}.{key}: found {said[key]!r:.60}, expected a number")
            numbers[key] = float(said[key])
    with in_file(name):
        profile = Profile(**numbers)
    return Behavior(
        name,
        style=lookup({str(one): one for one in Style}, style, f"{name}.style"),
        color=color,
        profile=profile,
        like=name if base is None else base.like,
        traits=tuple(lookup(known_traits, str(t), f"trait of {name}") for t in traits),
        source=str(said.get("source", ""))[:1000],
    )


def _all_of(tables: Mapping[str, Any], known: Mapping[str, Behavior]) -> tuple[Behavior, ...]:
    """The behaviours of a file; each may be like one that stands before it."""
    found: dict[str, Behavior] = {}
    for name, said in tables.items():
        if name in known:
            raise InputError(f"{name}: found a behaviour of that name already, expected another")
        found[name] = _behavior(name, said, {**known, **found} if known else {})
    return tuple(found.values())


BEHAVIORS: Final[tuple[Behavior, ...]] = _all_of(read_toml(SHIPPED.pop("six")), {})
"""The class order of the six: code c means ``BEHAVIORS[c]``. Unknown is -1."""

for _one in BEHAVIORS:
    setattr(Behavior, _one.upper(), _one)

COLORS: Final[dict[str, str]] = {str(one): one.color for one in BEHAVIORS}
"""The colours of the six by name: warm aggressive, cool conservative; sRGB, as in HTML."""

UNKNOWN_COLOR: Final = "#8C8C8C"
"""The colour of agents without a behaviour: pedestrians, and drivers not yet classified."""

PROFILES: Final[dict[Behavior, Profile]] = {one: one.profile for one in BEHAVIORS}
"""The median driver of each behaviour."""

TRAITS: Final[dict[Trait, Behavior]] = {
    trait: next(one for one in BEHAVIORS if trait in one.traits) for trait in Trait
}
"""The paper's trait table: which behaviour each trait belongs to."""


def read_behaviors(
    source: str | Path | Mapping[str, Any] | tuple[()] | None,
) -> tuple[Behavior, ...]:
    """Behaviours of one's own, beside the six.

    Args:
        source: names of files that ship and paths of TOML files, separated by commas. Paths have a
            dot or a slash in them. A mapping is the content of such a file; None is none.

    Raises:
        InputError: if a file is missing or broken, or a value out of range; the message names it.

    Examples:
        >>> distracted, = read_behaviors("distracted")
        >>> distracted.style, distracted.like, distracted.profile.reaction_time_s
        (<Style.CONSERVATIVE: 'conservative'>, 'careful', 1.5)
    """
    known = {str(one): one for one in BEHAVIORS}
    if not source:
        return ()
    if isinstance(source, Mapping):
        return _all_of(source, known)
    found: dict[str, Behavior] = {}
    for one in [source] if isinstance(source, Path) else source.split(","):
        path = shipped_or_path(one, SHIPPED, "behaviour")
        with in_file(path):
            found |= {str(b): b for b in _all_of(read_toml(path), {**known, **found})}
    return tuple(found.values())


def tables_of(behaviors: tuple[Behavior, ...]) -> dict[str, Any]:
    """Behaviours as one table that `read_behaviors` reads back, equal."""
    return {str(one): one.table() for one in behaviors}
