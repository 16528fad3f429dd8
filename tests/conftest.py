"""How the tests share a machine.

Those that take long come first, so that no process ends long after. Processes that test at the same
time share the processors: each starts as many workers as it has processors for itself.
"""

from __future__ import annotations

import os

import pytest

if "PYTEST_XDIST_WORKER_COUNT" in os.environ:
    testing = int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
    share = max((os.cpu_count() or 1) // testing, 1)
    os.environ.setdefault("LOKY_MAX_CPU_COUNT", str(share))

SLOWEST = ("test_docs.py", "test_benches.py", "test_examples.py")
"""Files with tests of a minute; the others follow in their own order."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    def order(item: pytest.Item) -> int:
        return SLOWEST.index(item.path.name) if item.path.name in SLOWEST else len(SLOWEST)

    items.sort(key=order)
