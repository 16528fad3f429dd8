"""The agents' places in the factual episode, for the replay of a counterfactual one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from behaviors.errors import InputError
from experiments.what_if.branches import branch_of, change_of
from experiments.what_if.outcomes import factual_of
from sim.frames import CodeArray, FloatArray, IntArray, Tracks
from sim.store.dataset import Dataset
from sim.store.schema import EpisodeEntry

APART_M: Final = 0.5
"""A ghost is shown where an agent is farther than this from where it was, m (less does not
show)."""


@dataclass(frozen=True, slots=True, eq=False)
class Ghosts:
    """The factual places that differ from the counterfactual ones.

    Attributes:
        kind: (G,) code of each ghost.
        length: (G,) m.
        width: (G,) m.
        ghost: (k,) which ghost a place belongs to; its places follow each other in time.
        step: (k,) index of the time among those shown.
        xy: (k, 2) m.
        heading: (k,) rad.
    """

    kind: CodeArray
    length: FloatArray
    width: FloatArray
    ghost: IntArray
    step: IntArray
    xy: FloatArray
    heading: FloatArray

    def at(self, step: int) -> NDArray[np.int64]:
        """Indices of the places at one of the times shown."""
        return np.flatnonzero(self.step == step)


def find_ghosts(factual: Tracks, shown: Tracks) -> Ghosts:
    """The places of the factual agents wherever they differ.

    Args:
        factual: what happened.
        shown: the counterfactual episode; its times are among the factual ones.

    Returns:
        The ghosts of everyone who is ever `APART_M` away from its counterfactual self, or without
        one.
    """
    columns = np.searchsorted(factual.time_s, shown.time_s - 1e-6)
    columns = np.minimum(columns, factual.time_s.size - 1)
    there = factual.valid[:, columns]
    xy = factual.xy[:, columns]
    rows = np.minimum(np.searchsorted(shown.ids, factual.ids), max(shown.ids.size - 1, 0))
    same = shown.ids[rows] == factual.ids
    both = there & same[:, None] & shown.valid[rows]
    apart = np.hypot(*np.moveaxis(np.where(both[..., None], xy - shown.xy[rows], 0.0), 2, 0))
    agent, step = np.nonzero(there & (~both | (apart > APART_M)))
    some, ghost = np.unique(agent, return_inverse=True)
    return Ghosts(
        kind=factual.kind[some], length=factual.length[some], width=factual.width[some],
        ghost=ghost.astype(np.int64), step=step.astype(np.int64), xy=xy[agent, step],
        heading=factual.heading[:, columns][agent, step],
    )  # fmt: skip


def ghosts_of(
    dataset: Dataset, entry: EpisodeEntry, shown: Tracks
) -> tuple[Ghosts | None, tuple[str, ...]]:
    """The ghosts of an episode, and a note for its reader.

    Args:
        dataset: where the episode is.
        entry: the episode.
        shown: its tracks at the times that are shown.

    Returns:
        None and nothing for an episode in which nothing was changed.
    """
    branch = branch_of(entry)
    if branch is None:
        return None, ()
    said = f"what if driver {branch['agent']} had changed at {branch['at_s']} s: {change_of(entry)}"
    try:
        factual = dataset.read(factual_of(dataset, entry)).tracks
    except InputError:
        return None, (f"{said}; the factual episode is not in this dataset",)
    return find_ghosts(factual, shown), (f"{said}; dashed outlines: where everyone factually was",)
