"""The order of the tests: those that take long come first, so that no process ends long after."""

from __future__ import annotations

import pytest

SLOWEST = ("test_docs.py", "test_benches.py", "test_examples.py")
"""Files with tests of a minute; the others follow in their own order."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    def order(item: pytest.Item) -> int:
        return SLOWEST.index(item.path.name) if item.path.name in SLOWEST else len(SLOWEST)

    items.sort(key=order)
