"""How the tests share a machine.

Those that take long come first, so that no process ends long after. Processes that test at the same
time share the processors: each starts as many workers as it has processors for itself.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("fixed", derandomize=True)
settings.load_profile("fixed")

if "PYTEST_XDIST_WORKER_COUNT" in os.environ:
    testing = int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
    share = max((os.cpu_count() or 1) // testing, 1)
    os.environ.setdefault("LOKY_MAX_CPU_COUNT", str(share))

SLOWEST = ("test_docs.py", "test_examples.py")
"""Files with tests of a minute; the others follow in their own order."""


SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Recordings that lie beside the checkout."""


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recordings; a test that asks for it has the marker ``data``."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"no recordings in {SHARED_DATA}")
    return SHARED_DATA


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if "shared_data" in getattr(item, "fixturenames", ()):
            item.add_marker("data")

    def order(item: pytest.Item) -> int:
        return SLOWEST.index(item.path.name) if item.path.name in SLOWEST else len(SLOWEST)

    items.sort(key=order)
