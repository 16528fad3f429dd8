"""Imports: the contracts of ``pyproject.toml`` hold, and no module imports itself by a detour."""

from __future__ import annotations

import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest
from importlinter.cli import EXIT_STATUS_SUCCESS

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("behaviors", "sim", "graphrqi", "scenarios", "experiments")


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    return grimp.build_graph(*PACKAGES, include_external_packages=True, cache_dir=None)


def test_the_contracts_hold() -> None:
    # In a process of its own: what import-linter prints while it works goes past pytest's capture.
    command = "from importlinter.cli import lint_imports_command as lint; lint(['--no-cache'])"
    run = subprocess.run(
        [sys.executable, "-c", command], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert run.returncode == EXIT_STATUS_SUCCESS, run.stdout + run.stderr


def test_no_module_imports_itself_through_others(graph: grimp.ImportGraph) -> None:
    """A package's ``__init__`` counts as a module, which the contracts leave out."""
    own = {module for module in graph.modules if module.split(".")[0] in PACKAGES}
    imports = {m: graph.find_modules_directly_imported_by(m) & own for m in own}
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(reversed(error.args[1])))


def test_behaviors_needs_numpy_only(graph: grimp.ImportGraph) -> None:
    outside = {
        imported
        for module in ("behaviors", *graph.find_descendants("behaviors"))
        for imported in graph.find_modules_directly_imported_by(module)
        if imported.split(".")[0] != "behaviors"
    }
    assert outside - sys.stdlib_module_names <= {"numpy"}
