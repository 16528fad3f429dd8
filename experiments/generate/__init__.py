"""Makes labelled datasets: of scenarios, and of random worlds."""

from typing import Final

RANDOM_WORLD: Final = "random_world"
"""The scenario whose episodes have a road, drivers and a sensor each, drawn at random."""
