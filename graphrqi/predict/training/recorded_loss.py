"""The training loss of the networks for recordings, in torch.

The winner takes all: only the future nearest to the truth is trained. The scores name it, and its
spread maximises the likelihood of the truth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from graphrqi.predict.networks.futures import TIME_S
from graphrqi.predict.recorded.network import HORIZON_S, MODES, PER_MODE, POWERS, powers

if TYPE_CHECKING:
    import torch

RELAXATION: Final = 0.05
"""Share of the loss that also pulls on futures that did not win."""

WINNER_WEIGHT, SCORE_WEIGHT, SPREAD_WEIGHT = 0.5, 0.1, 0.03
"""Weights of the losses against the best guess's error over constant velocity's."""


def bends(raw: torch.Tensor) -> torch.Tensor:
    """(..., KNOTS, 2) corrections over their size, from a network's numbers (..., PER_MODE)."""
    import torch

    ways = torch.from_numpy(powers(TIME_S).astype(np.float32))
    bend = raw[..., : 2 * POWERS].reshape(*raw.shape[:-1], POWERS, 2)
    return torch.einsum("...pc,pt->...tc", bend, ways)


def futures_of(raw: torch.Tensor, base: torch.Tensor, size: torch.Tensor) -> torch.Tensor:
    """(m, MODES, KNOTS, 2) futures, m, of outputs (m, MODES PER_MODE); see `recorded_loss`."""
    each = raw.view(len(raw), MODES, PER_MODE)
    return base[:, None] + size[:, None, None, None] * bends(each)


def distances(own: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """(m, K, KNOTS) from futures (m, K, KNOTS, 2) to what happened (m, KNOTS, 2), m."""
    from graphrqi.networks.portable_torch import root

    return root(((own - truth[:, None]) ** 2).sum(-1) + 1e-3)


def covering_loss(
    each: torch.Tensor, apart: torch.Tensor, size: torch.Tensor, weight: torch.Tensor
) -> torch.Tensor:
    """The loss of all futures but the first, of the scores, and of the spreads.

    Args:
        each: (m, K, PER_MODE) a network's numbers.
        apart: (m, K, KNOTS) distances to what happened, m.
        size: (m,) of the corrections, m.
        weight: (m,) by which each counts, 1/m.
    """
    import torch

    if not len(each):
        return each.sum()
    mean = apart.mean(-1)
    others = mean[:, 1:]
    winner = (1 - RELAXATION) * others.min(dim=1).values + RELAXATION * others.mean(dim=1)
    score = torch.nn.functional.cross_entropy(each[:, 1:, -1], others.argmin(dim=1))
    row, nearest = torch.arange(len(each)), mean.argmin(dim=1)
    log_time = torch.log(torch.from_numpy(TIME_S.astype(np.float32)) / HORIZON_S)
    slope = (1.2 + each[row, nearest, -2]).clamp(0.3, 3.0)[:, None]
    log_spread = each[row, nearest, -3].clamp(-4.0, 4.0)[:, None] + slope * log_time
    log_spread = log_spread + torch.log(size)[:, None]
    squared = apart.detach()[row, nearest] ** 2
    spread = (2 * log_spread + 0.5 * squared * torch.exp(-2 * log_spread)).mean()
    return WINNER_WEIGHT * (weight * winner).mean() + SCORE_WEIGHT * score + SPREAD_WEIGHT * spread
