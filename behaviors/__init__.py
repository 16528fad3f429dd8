"""Driver behaviours: labels, traits, profiles, and the driver models they parameterise."""

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, TRAITS, Behavior, Style, Trait
from behaviors.profiles import PROFILES, Profile, sample_profile

__all__ = [
    "BEHAVIORS",
    "PROFILES",
    "TRAITS",
    "Behavior",
    "InputError",
    "Profile",
    "Style",
    "Trait",
    "sample_profile",
]
