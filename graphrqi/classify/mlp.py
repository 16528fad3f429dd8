"""Multi-layer perceptron, the paper's classifier, in PyTorch.

The loss is the paper's squared error on one-hot labels (of the softmax, so that the outputs are
probabilities: the Brier score) or cross-entropy. An ensemble averages the probabilities of members
that differ in their random start and order. With validation data, training keeps the weights of
the best epoch and divides the logits by the temperature that fits best (Guo et al., ICML 2017).
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from behaviors.errors import InputError
from graphrqi.classify.checks import of_trained_classes, saved, saved_temperature
from graphrqi.classify.contract import CodeArray, FloatArray, HeldOut
from graphrqi.classify.standardisation import CLIP, Standardisation
from graphrqi.portable_torch import adamw, one_thread

Loss = Literal["squared-error", "cross-entropy"]


class Mlp:
    """Standardises its inputs, then fully connected layers with ReLU and dropout.

    Args:
        num_classes: C.
        hidden: widths of the hidden layers.
        loss: the loss that is minimised.
        epochs: passes over the training data.
        dropout: share of hidden units silenced while training.
        learning_rate: peak of a one-cycle schedule (Smith 2018) for AdamW.
        weight_decay: AdamW's.
        batch: samples per step.
        members: number of networks that are averaged.
    """

    def __init__(
        self,
        num_classes: int,
        hidden: tuple[int, ...] = (128, 64),
        loss: Loss = "cross-entropy",
        epochs: int = 20,
        dropout: float = 0.2,
        learning_rate: float = 3e-3,
        weight_decay: float = 1e-3,
        batch: int = 512,
        members: int = 1,
    ) -> None:
        if loss not in ("squared-error", "cross-entropy"):
            raise InputError(f"loss: found {loss!r}, expected squared-error or cross-entropy")
        self._num_classes = num_classes
        self._hidden = tuple(hidden)
        self._loss: Loss = loss
        self._epochs, self._batch = epochs, batch
        self._dropout, self._weight_decay = dropout, weight_decay
        self._learning_rate = learning_rate
        self._networks = [nn.Sequential() for _ in range(members)]
        self._mean = torch.zeros(0)
        self._scale = torch.ones(0)
        self._temperature = 1.0

    def _network(self, inputs: int) -> nn.Sequential:
        layers: list[nn.Module] = []
        for width in self._hidden:
            layers += [nn.Linear(inputs, width), nn.ReLU(), nn.Dropout(self._dropout)]
            inputs = width
        return nn.Sequential(*layers, nn.Linear(inputs, self._num_classes))

    def _standardise(self, features: FloatArray) -> Tensor:
        x = torch.from_numpy(np.ascontiguousarray(features, dtype=np.float32))
        return ((x - self._mean) / self._scale).clamp(-CLIP, CLIP)

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn; see `graphrqi.classify.contract.Classifier.fit`."""
        with torch.random.fork_rng(devices=[]), one_thread():
            torch.manual_seed(seed)
            raw = np.asarray(features, dtype=np.float32)
            self._mean = torch.from_numpy(raw.mean(axis=0))
            spread = raw.std(axis=0)
            self._scale = torch.from_numpy(np.where(spread > 1e-6, spread, 1.0).astype(np.float32))
            x, y = self._standardise(features), torch.from_numpy(codes.astype(np.int64))
            held = None
            validation = of_trained_classes(validation, codes)
            if validation is not None:
                held = (
                    self._standardise(validation[0]),
                    torch.from_numpy(validation[1].astype(np.int64)),
                )
            self._networks = [self._train_member(x, y, held) for _ in self._networks]
            if held is not None:
                self._temperature = self._best_temperature(*held)

    def _objective(self, logits: Tensor, y: Tensor) -> Tensor:
        if self._loss == "cross-entropy":
            return nn.functional.cross_entropy(logits, y)
        one_hot = nn.functional.one_hot(y, self._num_classes).float()
        return ((logits.softmax(dim=1) - one_hot) ** 2).sum(dim=1).mean()

    def _train_member(self, x: Tensor, y: Tensor, held: tuple[Tensor, Tensor] | None) -> Any:
        network = self._network(x.shape[1])
        optimizer = adamw(network.parameters(), self._learning_rate, self._weight_decay)
        steps = max(1, -(-len(x) // self._batch))
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimizer, self._learning_rate, total_steps=self._epochs * steps
        )
        best, best_loss = None, float("inf")
        for _ in range(self._epochs):
            network.train()
            order = torch.randperm(len(x))
            for first in range(0, len(x), self._batch):
                rows = order[first : first + self._batch]
                optimizer.zero_grad()
                self._objective(network(x[rows]), y[rows]).backward()  # type: ignore[no-untyped-call]
                optimizer.step()
                schedule.step()
            if held is not None:
                network.eval()
                with torch.inference_mode():
                    loss = float(self._objective(network(held[0]), held[1]))
                if loss < best_loss:
                    best_loss = loss
                    best = {k: v.clone() for k, v in network.state_dict().items()}
        if best is not None:
            network.load_state_dict(best)
        return network.eval()

    def _log_probability(self, x: Tensor) -> Tensor:
        """Log of the members' mean probability."""
        each = torch.stack([network(x).log_softmax(dim=1) for network in self._networks])
        return each.logsumexp(dim=0) - float(np.log(len(self._networks)))

    @torch.inference_mode()
    def _best_temperature(self, x: Tensor, y: Tensor) -> float:
        log_p = self._log_probability(x)
        grid = np.geomspace(0.5, 4.0, 61)
        losses = [float(nn.functional.cross_entropy(log_p / t, y)) for t in grid]
        return float(grid[int(np.argmin(losses))])

    @torch.inference_mode()
    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities."""
        with one_thread():
            log_p = self._log_probability(self._standardise(features))
            probability = (log_p / self._temperature).double().softmax(dim=1).numpy()
        return np.asarray(probability, dtype=np.float64)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Weights of every member, the standardisation and the temperature."""
        out: dict[str, NDArray[Any]] = {
            "mean": self._mean.numpy(),
            "scale": self._scale.numpy(),
            "temperature": np.array([self._temperature], dtype=np.float32),
        }
        for m, network in enumerate(self._networks):
            for name, value in network.state_dict().items():
                out[f"member{m}.{name}"] = value.numpy()
        return out

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        inputs = Standardisation.restored(arrays, num_features)
        self._mean = torch.from_numpy(inputs.mean.copy())
        self._scale = torch.from_numpy(inputs.scale.copy())
        self._temperature = saved_temperature(arrays)
        self._networks = []
        members = {name.split(".")[0] for name in arrays if name.startswith("member")}
        if not members:
            raise InputError("members: found none, expected at least one network")
        for m in range(len(members)):
            network = self._network(num_features)
            prefix = f"member{m}."
            network.load_state_dict(
                {
                    name.removeprefix(prefix): torch.from_numpy(saved(arrays, name).copy())
                    for name in arrays
                    if name.startswith(prefix)
                }
            )
            self._networks.append(network.eval())
