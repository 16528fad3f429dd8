"""The answer of a classifier: a probability for each behaviour of each driver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from behaviors.errors import InputError
from behaviors.labels import BEHAVIORS, Behavior, Style
from behaviors.row_index import find_sorted
from graphrqi.arrays import BoolArray, FloatArray, IntArray, read_only

if TYPE_CHECKING:
    import pandas as pd

LABEL_PROBABILITY: Final = 0.8
"""Least probability of a style for which a driver gets a label."""

AGGRESSIVE: Final = np.array([behavior.style is Style.AGGRESSIVE for behavior in BEHAVIORS])
"""(6,) which behaviours are of the aggressive style."""

_COMPUTED: Final = np.empty(0)
"""Stands for values that follow from the probabilities."""


def aggressive_share(
    probability: FloatArray, classes: Sequence[Behavior] = BEHAVIORS
) -> FloatArray:
    """(...) probability of the aggressive style, from those of the behaviours (..., k).

    Examples:
        >>> aggressive_share(np.array([[0.25, 0.25, 0.0, 0.5, 0.0, 0.0]])).tolist()
        [0.5]
    """
    aggressive = [behavior.style is Style.AGGRESSIVE for behavior in classes]
    return np.asarray(probability[..., aggressive].sum(axis=-1))


def of_the_six(probability: FloatArray, classes: Sequence[Behavior]) -> FloatArray:
    """(n, 6) probabilities of the six, from those (n, k) of the classes.

    A class of one's own counts for the one that it is like.
    """
    if len(classes) == len(BEHAVIORS):
        return probability
    return np.asarray(probability @ np.eye(len(BEHAVIORS))[[one.base.code for one in classes]])


@dataclass(frozen=True, slots=True, repr=False)
class Posterior:
    """Probabilities of the behaviours of the drivers that were observed long enough.

    Attributes:
        ids: (n,) agent ids, ascending.
        probability: (n, k) in the order of ``classes``; rows sum to 1.
        domain: distance of the traffic from the training, 0 to 1.
        unknown: (n,) probability that the style is only guessed: twice that of the less likely
            style. It is 1 where the frames are not plausible as a scene. It follows from
            ``probability`` where it is not given.
        classes: the k behaviours that the model knows: the six, then those of one's own.

    Examples:
        >>> p = Posterior(ids=[7], probability=[[0.1, 0.7, 0.1, 0.1, 0.0, 0.0]])
        >>> p.most_likely.tolist()
        [1]
        >>> p
        Posterior(1 driver, most likely: 1 reckless)
        >>> p.unknown.round(1), p.behaviors
        (array([0.2]), (<Behavior.RECKLESS: 'reckless'>,))
    """

    ids: IntArray
    probability: FloatArray
    domain: float = 0.0
    unknown: FloatArray = field(default_factory=lambda: _COMPUTED)
    classes: tuple[Behavior, ...] = BEHAVIORS

    def __post_init__(self) -> None:
        """Check ids and probabilities, and make the arrays read-only.

        Raises:
            InputError: if ids are not ascending whole numbers, or rows, the domain or the unknown
                shares are not probabilities.
        """
        ids = np.asarray(self.ids)
        if ids.size and ids.dtype.kind not in "iu":
            raise InputError(f"Posterior.ids: found {ids.dtype} values, expected whole numbers")
        ids = ids.astype(np.int64, copy=False)
        if ids.ndim != 1 or not (ids[1:] > ids[:-1]).all():
            raise InputError("Posterior.ids: found ids that do not ascend, expected each once")
        probability = np.asarray(self.probability, dtype=np.float64)
        expected = (ids.size, len(self.classes))
        if probability.shape != expected:
            raise InputError(
                f"Posterior.probability: found shape {probability.shape}, expected {expected}"
            )
        possible = (probability >= 0.0).all(axis=1) & (abs(probability.sum(axis=1) - 1.0) <= 1e-5)
        if not possible.all():
            row = int(np.flatnonzero(~possible)[0])
            raise InputError(
                f"Posterior.probability: found {probability[row].tolist()} for agent {ids[row]}, "
                "expected numbers that are not negative and sum to 1"
            )
        unknown = np.asarray(self.unknown, dtype=np.float64)
        if self.unknown is _COMPUTED:
            unknown = 1.0 - np.abs(2.0 * aggressive_share(probability, self.classes) - 1.0)
            unknown = np.clip(unknown, 0.0, 1.0)
        if unknown.shape != ids.shape or not ((unknown >= 0.0) & (unknown <= 1.0)).all():
            raise InputError(
                f"Posterior.unknown: found {unknown.tolist()}, expected {ids.size} probabilities"
            )
        if not 0.0 <= self.domain <= 1.0:
            raise InputError(f"Posterior.domain: found {self.domain}, expected 0 to 1")
        for name, array in (("ids", ids), ("probability", probability), ("unknown", unknown)):
            object.__setattr__(self, name, read_only(array))

    @property
    def most_likely(self) -> IntArray:
        """(n,) code of each agent's most likely behaviour."""
        return np.asarray(self.probability.argmax(axis=1), dtype=np.int64)

    @property
    def labelled(self) -> BoolArray:
        """(n,) whether a driver gets a label: its style reaches `LABEL_PROBABILITY`."""
        return np.asarray(self.unknown <= 2.0 * (1.0 - LABEL_PROBABILITY) + 1e-9)

    @property
    def behaviors(self) -> tuple[Behavior | None, ...]:
        """Each agent's most likely behaviour; None where it gets no label."""
        return tuple(
            self.classes[code] if labelled else None
            for code, labelled in zip(
                self.most_likely.tolist(), self.labelled.tolist(), strict=True
            )
        )

    def discounted(self, ids: IntArray) -> FloatArray:
        """(m, 6) probabilities of the given agents, discounted by their reliability.

        Distance of the traffic from training, and unknown style, move them towards equal
        probabilities. Agents without an answer get equal probabilities.
        """
        row, known = find_sorted(self.ids, ids)
        doubt = np.full(ids.size, self.domain)
        doubt[known] *= self.unknown[row[known]]
        return (1.0 - doubt)[:, None] * self.of(ids) + doubt[:, None] / len(BEHAVIORS)

    def of(self, ids: IntArray) -> FloatArray:
        """(m, 6) probabilities of the six for the given agents; uniform without an answer."""
        out = np.full((ids.size, len(BEHAVIORS)), 1.0 / len(BEHAVIORS))
        row, known = find_sorted(self.ids, ids)
        out[known] = of_the_six(self.probability[row[known]], self.classes)
        return out

    def __repr__(self) -> str:
        """The number of drivers, of each most likely behaviour, and of drivers without a label."""
        n = self.ids.size
        counts = np.bincount(self.most_likely, minlength=len(self.classes)).tolist()
        found = [f"{k} {name}" for k, name in zip(counts, self.classes, strict=True) if k]
        said = f", most likely: {', '.join(found)}" if n else ""
        if n and self.domain > 0.0:
            said += f", {self.domain:.0%} foreign"
        if not self.labelled.all():
            said += f", {(~self.labelled).mean():.0%} unknown"
        return f"Posterior({n} driver{'s' * (n != 1)}{said})"

    def to_pandas(self) -> pd.DataFrame:
        """Table of the probabilities: a row per driver, a column per behaviour.

        Returns:
            Rows indexed by agent id (``agent``); last columns ``most_likely``, ``unknown`` and
            ``labelled``.
        """
        import pandas as pd

        names = [str(behavior) for behavior in self.classes]
        index = pd.Index(np.array(self.ids), name="agent")
        table = pd.DataFrame(np.array(self.probability), index=index, columns=names)
        return table.assign(
            most_likely=[names[code] for code in self.most_likely],
            unknown=np.array(self.unknown),
            labelled=np.array(self.labelled),
        )
