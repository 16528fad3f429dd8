"""The learned rival without labels: recurrent encoder and decoder with neighbour pooling.

It is given the same road, past, neighbours, signals, crossings and pedestrians as the default
predictor, but neither beliefs about the drivers nor rollouts of a driver model: its bases are the
lanes themselves, driven at constant speed. Same data, loss, futures and epochs.

References:
    Alahi et al. (2016), "Social LSTM", CVPR; Deo, Trivedi (2018), CVPR Workshops.
"""

from __future__ import annotations

import functools
import json
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from behaviors.errors import InputError
from graphrqi.posterior import Posterior
from graphrqi.predict.learned.anchors import BASES, KNOTS, PredictorInputs, unlabelled
from graphrqi.predict.learned.features import AROUND, NEIGHBORS, PAST, PAST_S, PER_NEIGHBOR
from graphrqi.predict.learned.networks import (
    MODES,
    PER_MODE,
    SCHEMA_VERSION,
    FloatArray,
    Futures,
    decode,
    on_known_roads,
    to_prediction,
)
from graphrqi.predict.prediction import Prediction
from graphrqi.predict.scene.scene import Scene

if TYPE_CHECKING:
    import torch

WEIGHTS: Final = "lstm.safetensors"
"""The trained network that ships beside this module."""

ENCODED, POOLED, MIXED, DECODED = 32, 48, 256, 48
"""Widths of the encoder, the pooled neighbours, what joins them and the decoder (our choice)."""


def make_module(inputs: int) -> torch.nn.Module:
    """The network, untrained.

    Args:
        inputs: how many numbers it gets per driver.

    Returns:
        A module from (m, inputs) to (m, MODES PER_MODE).
    """
    import torch

    class Recurrent(torch.nn.Module):
        """See the module's docstring."""

        def __init__(self) -> None:
            super().__init__()
            self.encoder = torch.nn.LSTM(3, ENCODED, batch_first=True)
            self.neighbor = torch.nn.Sequential(
                torch.nn.Linear(PER_NEIGHBOR + NEIGHBORS, POOLED), torch.nn.SiLU(),
                torch.nn.Linear(POOLED, POOLED), torch.nn.SiLU(),
            )  # fmt: skip
            self.mix = torch.nn.Sequential(
                torch.nn.Linear(inputs + ENCODED + 2 * POOLED, MIXED), torch.nn.SiLU(),
                torch.nn.Linear(MIXED, MIXED), torch.nn.SiLU(),
            )  # fmt: skip
            self.narrow = torch.nn.Linear(MIXED, DECODED)
            self.decoder = torch.nn.LSTM(DECODED, DECODED, batch_first=True)
            self.step = torch.nn.Linear(DECODED, 3 * MODES)
            self.direct = torch.nn.Linear(MIXED, MODES * PER_MODE)
            with torch.no_grad():  # begin as the likeliest base
                for linear in (self.step, self.direct):
                    linear.weight.mul_(0.05)
                    linear.bias.zero_()
                self.direct.bias.view(MODES, PER_MODE)[:, 0] = 2.0

        def forward(self, x: torch.Tensor) -> torch.Tensor:
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
            b = len(BASES)
            parts = [
                whole[..., :b],
                whole[..., b : b + 2 * KNOTS] + steps[..., :2].reshape(n, MODES, 2 * KNOTS),
                whole[..., b + 2 * KNOTS : -1] + steps[..., 2],
                whole[..., -1:],
            ]
            return torch.cat(parts, dim=-1).reshape(n, MODES * PER_MODE)

    return Recurrent()


class Lstm:
    """A trained network.

    Args:
        module: from `make_module`.
        mean: (F,) of the training inputs.
        scale: (F,) their standard deviations.
        spread_scale: see `graphrqi.predict.learned.networks.decode`.
    """

    def __init__(
        self, module: torch.nn.Module, mean: FloatArray, scale: FloatArray, spread_scale: float
    ) -> None:
        self.module, self.mean, self.scale = module.eval(), mean, scale
        self.spread_scale = spread_scale

    def __call__(self, data: PredictorInputs) -> Futures:
        """The futures of every row."""
        import torch

        inputs = np.clip((data.inputs - self.mean) / self.scale, -8.0, 8.0).astype(np.float32)
        with torch.no_grad():
            raw = self.module(torch.from_numpy(inputs)).numpy().astype(np.float64)
        return decode(raw, data.bases, self.spread_scale)

    def save(self, path: Path, card: dict[str, Any]) -> None:
        """Write it with its card (data, split, scores) in the file's metadata."""
        import torch
        from safetensors.torch import save_file

        tensors = {f"net.{k}": v.contiguous() for k, v in self.module.state_dict().items()}
        tensors["mean"] = torch.from_numpy(self.mean.astype(np.float32))
        tensors["scale"] = torch.from_numpy(self.scale.astype(np.float32))
        about = {"schema_version": SCHEMA_VERSION, "spread_scale": self.spread_scale, "card": card}
        save_file(tensors, path, {"about": json.dumps(about, sort_keys=True)})


def load_lstm(path: Path) -> Lstm:
    """Read a network.

    Raises:
        InputError: if the file is missing, broken or newer than this version reads.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, "pt") as file:
            about = json.loads((file.metadata() or {})["about"])
            if about["schema_version"] != SCHEMA_VERSION:
                raise InputError(
                    f"{path}: schema_version: found {about['schema_version']}, "
                    f"expected {SCHEMA_VERSION}"
                )
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except FileNotFoundError:
        raise InputError(f"{path}: found no file, expected a trained predictor") from None
    except (SafetensorError, KeyError, json.JSONDecodeError) as error:
        raise InputError(f"{path}: expected a trained predictor, found: {error}") from None
    mean = cast(FloatArray, tensors.pop("mean").numpy().astype(np.float64))
    scale = cast(FloatArray, tensors.pop("scale").numpy().astype(np.float64))
    module = make_module(mean.size)
    module.load_state_dict({k.removeprefix("net."): v for k, v in tensors.items()})
    return Lstm(module, mean, scale, float(about["spread_scale"]))


@functools.cache
def default_lstm() -> Lstm:
    """The network that ships in the package."""
    with resources.as_file(
        resources.files("graphrqi.predict").joinpath("weights", WEIGHTS)
    ) as path:
        return load_lstm(path)


@on_known_roads
def lstm(scene: Scene, posterior: Posterior) -> Prediction:
    """What a learned predictor foresees that knows nothing of who drives how."""
    return to_prediction(scene, default_lstm()(unlabelled(scene)))
