"""The two kinds of episodes that datasets are generated from: of scenarios and of worlds."""

from __future__ import annotations

from typing import TypeVar

from experiments.data.episode import Task
from experiments.data.worlds.episode import WorldTask

T = TypeVar("T", Task, WorldTask)
"""A task, as `make_episode` or `make_world` takes it."""
