"""The training losses of the networks for recordings, in torch.

The winner takes all: only the future nearest to the truth is trained. The scores name it, and its
spread maximises the likelihood of the truth.

Where there are paths along lanes, the path that a vehicle stayed nearest to is the true one, unless
it was farther than `OFF_PATH_M` from all of them: then it left them. The scores name the true path,
and its futures are trained as those without a map. The weighted mean of all best guesses is trained
on its distance to the truth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphrqi.predict.networks.futures import TIME_S
from graphrqi.predict.recorded.along_lanes import beginnings
from graphrqi.predict.recorded.lanes_ahead import MOST, LanesAhead
from graphrqi.predict.recorded.network import (
    HORIZON_S,
    MODES,
    PER_MODE,
    PER_PATH,
    POWERS,
    lane_inputs,
    powers,
)

if TYPE_CHECKING:
    import torch

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

RELAXATION: Final = 0.05
"""Share of the loss that also pulls on futures that did not win."""

WINNER_WEIGHT, SCORE_WEIGHT, SPREAD_WEIGHT = 0.5, 0.1, 0.03
"""Weights of the losses against the best guess's error over constant velocity's."""


OFF_PATH_M: Final = 1.75
"""A vehicle that is farther than this from every path, on average over the second half of the
horizon, follows none, m (half a lane's width)."""

PATH_WEIGHT, MEAN_WEIGHT = 0.5, 1.0
"""Weights of the scores of the paths and of the mean's error over constant velocity's (chosen on
datasets left out)."""

CHUNK: Final = 2_000
"""Examples whose true paths are found at once."""


class PathExamples(NamedTuple):
    """Paths of m examples as tensors.

    Attributes:
        inputs: (m, MOST + 1, PATH_FEATURES) standardised, without the agent's own.
        exists: (m, MOST) which there are.
        points: (m, MOST, POINTS, 2) m.
        spacing: (m,) m.
        kept: (m, MOST) distance to the left that is kept, m.
        fading: (m, MOST, KNOTS, 2) how vehicles come to their paths, m.
        true: (m,) the path that was followed, MOST for none.
    """

    inputs: torch.Tensor
    exists: torch.Tensor
    points: torch.Tensor
    spacing: torch.Tensor
    kept: torch.Tensor
    fading: torch.Tensor
    true: torch.Tensor

    def of(self, batch: torch.Tensor) -> PathExamples:
        """Some of them."""
        return PathExamples(*(column[batch] for column in self))


def bends(raw: torch.Tensor) -> torch.Tensor:
    """(..., KNOTS, 2) corrections over their size, from a network's numbers (..., PER_MODE)."""
    import torch

    ways = torch.from_numpy(powers(TIME_S).astype(np.float32))
    bend = raw[..., : 2 * POWERS].reshape(*raw.shape[:-1], POWERS, 2)
    return torch.einsum("...pc,pt->...tc", bend, ways)


def futures_of(raw: torch.Tensor, base: torch.Tensor, size: torch.Tensor) -> torch.Tensor:
    """(m, MODES, KNOTS, 2) futures, m, of outputs (m, MODES PER_MODE)."""
    each = raw.view(len(raw), MODES, PER_MODE)
    return base[:, None] + size[:, None, None, None] * bends(each)


def free_loss(
    raw: torch.Tensor, own: torch.Tensor, truth: torch.Tensor, size: torch.Tensor,
    weight: torch.Tensor,
) -> torch.Tensor:  # fmt: skip
    """The loss of a batch of the network without a map.

    Args:
        raw: (m, MODES PER_MODE) outputs.
        own: (m, MODES, KNOTS, 2) their futures, m.
        truth: (m, KNOTS, 2) m.
        size: (m,) `scale_of` the speeds, m.
        weight: (m,) by which each counts, 1/m.
    """
    apart = distances(own, truth)
    covering = covering_loss(raw.view(len(raw), MODES, PER_MODE), apart, size, weight)
    return covering + (weight * apart[:, 0].mean(-1)).mean()


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


def path_examples(
    ahead: LanesAhead, truth: NDArray[np.floating], speed: NDArray[np.floating],
    mean: FloatArray, scale: FloatArray,
) -> PathExamples:  # fmt: skip
    """The paths of training examples, who went to ``truth`` (m, KNOTS, 2), m."""
    import torch

    arrays = (
        lane_inputs(np.empty((len(truth), 0)), ahead, mean, scale), ahead.exists, ahead.points,
        ahead.spacing_m, *beginnings(ahead, speed, TIME_S.astype(np.float32)),
        true_paths(ahead, truth),
    )  # fmt: skip
    return PathExamples(*(torch.from_numpy(np.ascontiguousarray(array)) for array in arrays))


def lane_loss(
    module: torch.nn.Module, features: torch.Tensor, paths: PathExamples, guess: torch.Tensor,
    truth: torch.Tensor, size: torch.Tensor, weight: torch.Tensor,
) -> torch.Tensor:  # fmt: skip
    """The loss of a batch of the network that looks at paths.

    Args:
        module: the network.
        features: (m, F) standardised features of the agents.
        paths: theirs.
        guess: (m, KNOTS, 2) the best guess without a map, m.
        truth: (m, KNOTS, 2) what happened, m.
        size: (m,) of the corrections, m.
        weight: (m,) by which each counts, 1/m.
    """
    import torch

    some = torch.nonzero(paths.exists.any(dim=1))[:, 0]
    if not len(some):
        return guess.sum() * 0.0
    features, paths, guess = features[some], paths.of(some), guess[some]
    truth, size, weight = truth[some], size[some], weight[some]
    agent = features[:, None].expand(-1, MOST + 1, -1)
    raw = module(torch.cat([agent, paths.inputs], dim=2))
    each = raw[:, :-1, :-1].reshape(len(some), MOST, PER_PATH, PER_MODE)
    own = along_paths(each, paths, guess.detach(), size)
    there = torch.cat([paths.exists, torch.ones_like(paths.exists[:, :1])], dim=1)
    score = raw[..., -1].masked_fill(~there, -1e4)
    named = torch.nn.functional.cross_entropy(score, paths.true)
    chance = torch.softmax(score, dim=1)[..., None, None]
    mean = (chance[:, :-1] * own[:, :, 0]).sum(1) + chance[:, -1] * guess
    off_mean = (weight * distances(mean[:, None], truth).mean((1, 2))).sum()
    on = torch.nonzero(paths.true < MOST)[:, 0]
    true = paths.true[on]
    apart = distances(own[on, true], truth[on])
    first = (weight[on] * apart[:, 0].mean(-1)).sum()
    followed = covering_loss(each[on, true], apart, size[on], weight[on]) * len(on)
    total = MEAN_WEIGHT * off_mean + first + followed + PATH_WEIGHT * named * len(some)
    return total / len(some)


def along_paths(
    each: torch.Tensor, paths: PathExamples, guess: torch.Tensor, size: torch.Tensor
) -> torch.Tensor:
    """(m, MOST, PER_PATH, KNOTS, 2) futures along paths, m.

    It is `graphrqi.predict.recorded.along_lanes.beside_paths` in torch.

    Args:
        each: (m, MOST, PER_PATH, PER_MODE) the network's numbers.
        paths: the paths.
        guess: (m, KNOTS, 2) the best guess without a map, m: how far the agent gets.
        size: (m,) of the corrections, m.
    """
    import torch

    before = torch.cat([torch.zeros_like(guess[:, :1]), guess[:, :-1]], dim=1)
    gone = torch.cumsum((guess - before).norm(dim=-1), dim=1)
    moved = size[:, None, None, None, None] * bends(each)
    along = (gone[:, None, None] + moved[..., 0]).clamp(min=0.0)
    along = along / paths.spacing[:, None, None, None]
    piece = along.detach().long().clamp(max=paths.points.shape[2] - 2)
    m, most, futures, knots = piece.shape
    index = piece.reshape(m, most, futures * knots, 1).expand(-1, -1, -1, 2)
    begin, end = (
        torch.gather(paths.points, 2, at).reshape(m, most, futures, knots, 2)
        for at in (index, index + 1)
    )
    step = end - begin
    unit = step / step.norm(dim=-1, keepdim=True).clamp(min=1e-3)
    aside = paths.kept[:, :, None, None] + moved[..., 1]
    left = torch.stack([-unit[..., 1], unit[..., 0]], dim=-1)
    along_lane = begin + (along - piece)[..., None] * step + aside[..., None] * left
    return along_lane + paths.fading[:, :, None]


def true_paths(ahead: LanesAhead, truth: NDArray[np.floating]) -> IntArray:
    """(m,) the path that each vehicle stayed nearest to, MOST where it left them all.

    Args:
        ahead: the paths.
        truth: (m, KNOTS, 2) where the vehicles went, in their own frames, m.
    """
    late = truth[:, truth.shape[1] // 2 :].astype(np.float64)
    found = np.full(len(truth), MOST)
    for begin in range(0, len(truth), CHUNK):
        rows = slice(begin, begin + CHUNK)
        points = ahead.points[rows].astype(np.float64)
        start, step = points[:, :, :-1], np.diff(points, axis=2)
        size = np.maximum((step**2).sum(axis=-1), 1e-9)
        apart = late[rows][:, None, :, None] - start[:, :, None]
        along = np.clip((apart * step[:, :, None]).sum(axis=-1) / size[:, :, None], 0.0, 1.0)
        off = np.linalg.norm(apart - along[..., None] * step[:, :, None], axis=-1).min(axis=-1)
        mean = np.where(ahead.exists[rows], off.mean(axis=-1), np.inf)
        nearest = mean.argmin(axis=1)
        followed = mean[np.arange(len(mean)), nearest] < OFF_PATH_M
        found[rows] = np.where(followed, nearest, MOST)
    return found
