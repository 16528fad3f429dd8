"""The learned rival without labels: recurrent encoder and decoder with neighbour pooling.

Its inputs are those of the default predictor without beliefs about the drivers and without rollouts
of a driver model. Its anchor trajectories follow the lanes at constant speed. Data, loss, number of
futures and epochs are the same.

References:
    Alahi et al. (2016), "Social LSTM", CVPR; Deo, Trivedi (2018), CVPR Workshops.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from graphrqi.arrays import FloatArray
from graphrqi.networks.weights import Arrays
from graphrqi.predict.learned.inputs import AROUND, NEIGHBORS, PAST, PAST_S, PER_NEIGHBOR
from graphrqi.predict.networks import ANCHORS, KNOTS, MODES, PER_MODE, standardized

ENCODED, POOLED, MIXED, DECODED = 32, 48, 256, 48
"""Widths of the encoder, the pooled neighbours, what joins them and the decoder."""


class Recurrent(torch.nn.Module):
    """From (m, features) to (m, MODES PER_MODE); see the module's docstring."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.encoder = torch.nn.LSTM(3, ENCODED, batch_first=True)
        self.neighbor = torch.nn.Sequential(
            torch.nn.Linear(PER_NEIGHBOR + NEIGHBORS, POOLED), torch.nn.SiLU(),
            torch.nn.Linear(POOLED, POOLED), torch.nn.SiLU(),
        )  # fmt: skip
        self.mix = torch.nn.Sequential(
            torch.nn.Linear(features + ENCODED + 2 * POOLED, MIXED), torch.nn.SiLU(),
            torch.nn.Linear(MIXED, MIXED), torch.nn.SiLU(),
        )  # fmt: skip
        self.narrow = torch.nn.Linear(MIXED, DECODED)
        self.decoder = torch.nn.LSTM(DECODED, DECODED, batch_first=True)
        self.step = torch.nn.Linear(DECODED, 3 * MODES)
        self.direct = torch.nn.Linear(MIXED, MODES * PER_MODE)
        with torch.no_grad():  # start as the likeliest anchor trajectory
            for linear in (self.step, self.direct):
                linear.weight.mul_(0.05)
                linear.bias.zero_()
            self.direct.bias.view(MODES, PER_MODE)[:, 0] = 2.0

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """The raw numbers of standardised features."""
        n = x.shape[0]
        past = x[:, PAST].view(n, len(PAST_S), 3).flip(1)
        _, (encoded, _) = self.encoder(past)
        around = x[:, AROUND].view(n, NEIGHBORS, PER_NEIGHBOR)
        who = torch.eye(NEIGHBORS).expand(n, NEIGHBORS, NEIGHBORS)
        each = self.neighbor(torch.cat([around, who], dim=-1))
        pooled = torch.cat([each.max(dim=1).values, each.mean(dim=1)], dim=-1)
        mixed = self.mix(torch.cat([x, encoded[-1], pooled], dim=-1))
        hidden = self.narrow(mixed)[:, None].expand(n, KNOTS, DECODED)
        steps = self.step(self.decoder(hidden)[0]).view(n, KNOTS, MODES, 3).transpose(1, 2)
        whole = self.direct(mixed).view(n, MODES, PER_MODE)
        b = ANCHORS
        parts = [
            whole[..., :b],
            whole[..., b : b + 2 * KNOTS] + steps[..., :2].reshape(n, MODES, 2 * KNOTS),
            whole[..., b + 2 * KNOTS : -1] + steps[..., 2],
            whole[..., -1:],
        ]
        return torch.cat(parts, dim=-1).reshape(n, MODES * PER_MODE)


class TrajectoryLstm:
    """A trained network; features (n, F) in, (n, MODES PER_MODE) raw numbers out."""

    def __init__(self, module: torch.nn.Module, mean: FloatArray, scale: FloatArray) -> None:
        self.module, self.mean, self.scale = module.eval(), mean, scale

    def __call__(self, features: NDArray[np.floating]) -> NDArray[np.float32]:
        """The raw numbers of every row."""
        inputs = torch.from_numpy(standardized(features, self.mean, self.scale))
        with torch.no_grad():
            return np.asarray(self.module(inputs).numpy())

    def arrays(self) -> dict[str, NDArray[np.float32]]:
        """The arrays of a file, in single precision."""
        found = {f"net.{name}": value.numpy() for name, value in self.module.state_dict().items()}
        return {**found, "mean": self.mean.astype(np.float32), "scale": self.scale.astype("f4")}

    @classmethod
    def read(cls, arrays: Arrays) -> TrajectoryLstm:
        """The network in a file's arrays."""
        module = Recurrent(arrays["mean"].size)
        module.load_state_dict(
            {name: torch.from_numpy(arrays[f"net.{name}"]) for name in module.state_dict()}
        )
        return cls(module, *(arrays[name].astype(np.float64) for name in ("mean", "scale")))
