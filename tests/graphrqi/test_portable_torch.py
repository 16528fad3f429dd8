"""Arithmetic of PyTorch that is the same on every processor."""

from __future__ import annotations

import numpy as np
import torch

from graphrqi.networks.portable_torch import adamw, one_thread, root


def test_roots_are_those_of_numpy_but_for_the_last_bit() -> None:
    numbers = np.random.default_rng(0).uniform(1e-6, 1e6, 10_000).astype(np.float32)

    found = root(torch.from_numpy(numbers)).numpy()

    np.testing.assert_allclose(found, np.sqrt(numbers.astype(np.float64)), rtol=2e-7)


def test_a_step_of_the_optimiser_is_the_one_of_its_paper() -> None:
    """Loshchilov and Hutter 2019, algorithm 2, with PyTorch's usual moments."""
    weight = torch.nn.Parameter(torch.tensor([1.0, -2.0, 3.0]))
    slope = np.array([0.5, -1.0, 2.0])
    optimizer = adamw([weight], learning_rate=0.1, weight_decay=0.01)

    expected, first, second = np.array([1.0, -2.0, 3.0]), np.zeros(3), np.zeros(3)
    for step in range(1, 4):
        weight.grad = torch.tensor(slope, dtype=torch.float32)
        optimizer.step()
        first = 0.9 * first + 0.1 * slope
        second = 0.999 * second + 0.001 * slope**2
        ahead = (first / (1 - 0.9**step)) / (np.sqrt(second / (1 - 0.999**step)) + 1e-8)
        expected = expected * (1 - 0.1 * 0.01) - 0.1 * ahead

    np.testing.assert_allclose(weight.detach().numpy(), expected, rtol=1e-5)


def test_one_thread_is_used_inside_and_as_many_as_before_after() -> None:
    before = torch.get_num_threads()

    with one_thread():
        inside = torch.get_num_threads()

    assert (inside, torch.get_num_threads()) == (1, before)
