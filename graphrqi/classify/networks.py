"""The paper's networks, in PyTorch: a multi-layer perceptron, and long short-term memory.

Both standardise their inputs and are trained in one way. The loss is the paper's squared error on
one-hot labels (of the softmax, so that the outputs are probabilities: the Brier score) or
cross-entropy. With validation data, training keeps the weights of the best epoch.

References:
    Hochreiter, Schmidhuber (1997), Long short-term memory, Neural Computation 9, 1735.
"""

from __future__ import annotations

from typing import Any, Final, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from behaviors.errors import InputError
from graphrqi.arrays import CodeArray, FloatArray
from graphrqi.classify.contract import Classifier, HeldOut, Standardisation, part_of, saved
from graphrqi.networks.portable_torch import Descent, one_thread

Loss = Literal["squared-error", "cross-entropy"]

WEIGHT_DECAY: Final = 1e-3
"""AdamW's."""


class Mlp(Classifier):
    """Fully connected layers with ReLU and dropout.

    Args:
        num_classes: C.
        hidden: widths of the hidden layers.
        loss: the loss that is minimised.
        epochs: passes over the training data.
        dropout: share of hidden units silenced while training.
        learning_rate: peak of a one-cycle schedule (Smith 2018) for AdamW.
        batch: samples per step.
    """

    def __init__(
        self,
        num_classes: int,
        hidden: tuple[int, ...] = (128, 64),
        loss: Loss = "cross-entropy",
        epochs: int = 20,
        dropout: float = 0.2,
        learning_rate: float = 3e-3,
        batch: int = 512,
    ) -> None:
        if loss not in ("squared-error", "cross-entropy"):
            raise InputError(f"loss: found {loss!r}, expected squared-error or cross-entropy")
        super().__init__(num_classes)
        self._hidden, self._loss = tuple(hidden), loss
        self._epochs, self._batch, self._dropout = epochs, batch, dropout
        self._learning_rate = learning_rate
        self._inputs = Standardisation(np.zeros(0), np.ones(0))
        self._network: nn.Module = nn.Sequential()

    def _made(self, inputs: int) -> nn.Module:
        """A network that has not been trained."""
        layers: list[nn.Module] = []
        for width in self._hidden:
            layers += [nn.Linear(inputs, width), nn.ReLU(), nn.Dropout(self._dropout)]
            inputs = width
        return nn.Sequential(*layers, nn.Linear(inputs, self._num_classes))

    def _tensor(self, features: FloatArray) -> Tensor:
        return torch.from_numpy(self._inputs.apply(features).astype(np.float32))

    def _learn(self, features: FloatArray, codes: CodeArray, held: HeldOut, seed: int) -> None:
        self._inputs = Standardisation.of(features)
        with torch.random.fork_rng(devices=[]), one_thread():
            torch.manual_seed(seed)
            self._network = self._after_epochs(features, codes, held)

    def _objective(self, logits: Tensor, y: Tensor) -> Tensor:
        if self._loss == "cross-entropy":
            return nn.functional.cross_entropy(logits, y)
        one_hot = nn.functional.one_hot(y, self._num_classes).float()
        return ((logits.softmax(dim=1) - one_hot) ** 2).sum(dim=1).mean()

    def _after_epochs(self, features: FloatArray, codes: CodeArray, held: HeldOut) -> nn.Module:
        """A network after all epochs, with the weights of the best one."""
        x, y = self._tensor(features), torch.from_numpy(codes.astype(np.int64))
        network = self._made(x.shape[1])
        steps = self._epochs * max(1, -(-len(x) // self._batch))
        descent = Descent(network, steps, self._learning_rate, WEIGHT_DECAY)
        best, best_loss = None, float("inf")
        for _ in range(self._epochs):
            network.train()
            order = torch.randperm(len(x))
            for first in range(0, len(x), self._batch):
                rows = order[first : first + self._batch]
                descent.step(self._objective(network(x[rows]), y[rows]))
            if held is not None:
                network.eval()
                with torch.inference_mode():
                    truth = torch.from_numpy(held[1].astype(np.int64))
                    loss = float(self._objective(network(self._tensor(held[0])), truth))
                if loss < best_loss:
                    best_loss = loss
                    best = {k: v.clone() for k, v in network.state_dict().items()}
        if best is not None:
            network.load_state_dict(best)
        return network.eval()

    @torch.inference_mode()
    def _untempered(self, features: FloatArray) -> FloatArray:
        with one_thread():
            logits = self._network(self._tensor(features)).double()
        return np.asarray(logits.softmax(dim=1).numpy(), dtype=np.float64)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Weights, the standardisation and the temperature."""
        weights = {f"network.{k}": v.numpy() for k, v in self._network.state_dict().items()}
        return {**self._inputs.arrays(), **weights, **super().arrays()}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `Classifier.restore`."""
        super().restore(arrays, num_features)
        self._inputs = Standardisation.restored(arrays, num_features)
        self._network = self._made(num_features).eval()
        learned = {k: torch.from_numpy(saved(arrays, f"network.{k}").copy())
                   for k in part_of(arrays, "network")}  # fmt: skip
        self._network.load_state_dict(learned)


class LstmClassifier(Mlp):
    """Long short-term memory over the entries of a feature vector, the paper's ablation.

    The vector is read as a sequence of one entry a step: a row of eigenvectors is read from the
    largest eigenvalue down. The last hidden state goes through a linear layer.

    Args:
        num_classes: C.
        hidden: width of the memory.
        epochs: passes over the training data.
        learning_rate: peak of a one-cycle schedule for AdamW.
        batch: samples per step.
    """

    def __init__(
        self,
        num_classes: int,
        hidden: int = 32,
        epochs: int = 10,
        learning_rate: float = 3e-3,
        batch: int = 512,
    ) -> None:
        super().__init__(
            num_classes, (hidden,), epochs=epochs, learning_rate=learning_rate, batch=batch
        )
        self._network = self._made(0)

    def _made(self, inputs: int) -> nn.Module:
        return _Memory(self._hidden[0], self._num_classes)


class _Memory(nn.Module):
    """A recurrent layer and a linear one."""

    def __init__(self, hidden: int, num_classes: int) -> None:
        super().__init__()
        self.memory = nn.LSTM(1, hidden, batch_first=True)
        self.head = nn.Linear(hidden, num_classes)

    def forward(self, x: Tensor) -> Tensor:
        """(n, C) logits of vectors (n, F)."""
        _, (last, _) = self.memory(x[..., None])
        out: Tensor = self.head(last[0])
        return out
