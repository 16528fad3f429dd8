"""PyTorch arithmetic that gives the same bits on processors of different makers.

Elementary operations are rounded alike everywhere. The square root that PyTorch takes from Intel's
MKL starts from an estimate that differs between processors. This module avoids it. Products of
matrices are left to MKL, which ``make model`` asks for the same results everywhere, and to oneDNN,
which can only be left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread.

    Sums then do not depend on the number of cores, and on small layers more threads would cost more
    time than they save.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def root(x: torch.Tensor) -> torch.Tensor:
    """The square root of positive numbers, of the same shape.

    PyTorch divides by the processor's own root for ``rsqrt``, which is exactly rounded.

    >>> root(torch.tensor([0.25, 9.0]))
    tensor([0.5000, 3.0000])
    """
    return x * x.rsqrt()


def adamw(
    parameters: Iterable[torch.nn.Parameter], learning_rate: float, weight_decay: float = 0.0
) -> torch.optim.AdamW:
    """The optimiser AdamW (Loshchilov and Hutter 2019) of PyTorch, its fused version.

    The fused version takes exactly rounded roots; the usual one takes MKL's. Without weight decay
    it is Adam.
    """
    return torch.optim.AdamW(parameters, lr=learning_rate, weight_decay=weight_decay, fused=True)


class Descent:
    """Steps of AdamW, whose rate rises and falls in one cycle (Smith 2018).

    ``rising`` is the share of steps with a rising rate, ``longest`` the largest gradient norm.
    """

    def __init__(
        self,
        module: torch.nn.Module,
        steps: int,
        learning_rate: float,
        weight_decay: float,
        rising: float = 0.3,
        longest: float | None = None,
    ) -> None:
        self._module, self._longest = module, longest
        self._optimizer = adamw(module.parameters(), learning_rate, weight_decay)
        self._schedule = torch.optim.lr_scheduler.OneCycleLR(
            self._optimizer, learning_rate, total_steps=steps, pct_start=rising
        )

    def step(self, loss: torch.Tensor) -> None:
        """Change the module's weights so that the loss falls."""
        self._optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        if self._longest is not None:
            torch.nn.utils.clip_grad_norm_(self._module.parameters(), self._longest)
        self._optimizer.step()
        self._schedule.step()


def leave_onednn_out() -> None:
    """Let PyTorch compute without oneDNN in this process: it adds up as suits the processor."""
    torch.backends.mkldnn.set_flags(False)  # type: ignore[no-untyped-call]
