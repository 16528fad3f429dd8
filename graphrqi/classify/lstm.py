"""Long short-term memory over the entries of a feature vector, the paper's ablation, in PyTorch.

The vector is read as a sequence of one entry a step: a row of eigenvectors is read from the largest
eigenvalue down. The last hidden state goes through a linear layer; the loss is cross-entropy.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from graphrqi.classify.checks import of_trained_classes, saved
from graphrqi.classify.contract import CodeArray, FloatArray, HeldOut
from graphrqi.classify.standardisation import Standardisation
from graphrqi.portable_torch import adamw, one_thread


class _Network(nn.Module):
    def __init__(self, hidden: int, num_classes: int) -> None:
        super().__init__()
        self.memory = nn.LSTM(1, hidden, batch_first=True)
        self.head = nn.Linear(hidden, num_classes)

    def forward(self, x: Tensor) -> Tensor:
        _, (last, _) = self.memory(x[..., None])
        out: Tensor = self.head(last[0])
        return out


class LstmClassifier:
    """Long short-term memory, a recurrent network (Hochreiter and Schmidhuber 1997).

    Args:
        num_classes: C.
        hidden: width of the memory.
        epochs: passes over the training data; with validation data the best weights are kept.
        learning_rate: Adam's.
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
        self._num_classes = num_classes
        self._hidden = hidden
        self._epochs = epochs
        self._learning_rate = learning_rate
        self._batch = batch
        self._inputs = Standardisation(np.zeros(0), np.ones(0))
        self._network = _Network(hidden, num_classes)

    def _tensor(self, features: FloatArray) -> Tensor:
        return torch.from_numpy(self._inputs.apply(features).astype(np.float32))

    def fit(self, features: FloatArray, codes: CodeArray, validation: HeldOut, seed: int) -> None:
        """Learn; see `graphrqi.classify.contract.Classifier.fit`."""
        validation = of_trained_classes(validation, codes)
        self._inputs = Standardisation.of(features)
        x, y = self._tensor(features), torch.from_numpy(codes.astype(np.int64))
        with torch.random.fork_rng(devices=[]), one_thread():
            torch.manual_seed(seed)
            network = _Network(self._hidden, self._num_classes)
            optimizer = adamw(network.parameters(), self._learning_rate)
            best, best_loss = network.state_dict(), float("inf")
            for _ in range(self._epochs):
                order = torch.randperm(len(x))
                for first in range(0, len(x), self._batch):
                    rows = order[first : first + self._batch]
                    optimizer.zero_grad()
                    loss = nn.functional.cross_entropy(network(x[rows]), y[rows])
                    loss.backward()  # type: ignore[no-untyped-call]
                    optimizer.step()
                held_loss = -1.0 if validation is None else self._loss(network, *validation)
                if held_loss < best_loss or validation is None:
                    best_loss = held_loss
                    best = {k: v.clone() for k, v in network.state_dict().items()}
        network.load_state_dict(best)
        self._network = network.eval()

    @torch.inference_mode()
    def _loss(self, network: _Network, features: FloatArray, codes: CodeArray) -> float:
        truth = torch.from_numpy(codes.astype(np.int64))
        return float(nn.functional.cross_entropy(network(self._tensor(features)), truth))

    @torch.inference_mode()
    def posterior(self, features: FloatArray) -> FloatArray:
        """(n, C) probabilities."""
        with one_thread():
            logits = self._network(self._tensor(features))
            return np.asarray(logits.double().softmax(dim=1).numpy(), dtype=np.float64)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Standardisation and weights."""
        weights = {f"network.{k}": v.numpy() for k, v in self._network.state_dict().items()}
        return {**self._inputs.arrays(), **weights}

    def restore(self, arrays: dict[str, NDArray[Any]], num_features: int) -> None:
        """See `graphrqi.classify.contract.Classifier.restore`."""
        self._inputs = Standardisation.restored(arrays, num_features)
        self._network.load_state_dict(
            {
                name.removeprefix("network."): torch.from_numpy(saved(arrays, name).copy())
                for name in arrays
                if name.startswith("network.")
            }
        )
        self._network.eval()
