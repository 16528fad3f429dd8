"""Driver behaviours: labels, traits, profiles, and the driver models they parameterise."""

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, PROFILES, TRAITS, Behavior, Style, Trait, read_behaviors
from behaviors.profiles import Profile, sample_profile

__all__ = [
    "BEHAVIORS",
    "PROFILES",
    "TRAITS",
    "Behavior",
    "InputError",
    "Profile",
    "Style",
    "Trait",
    "read_behaviors",
    "sample_profile",
]
