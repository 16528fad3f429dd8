"""The notebooks of ``examples/`` are well-formed, run from first to last cell, and become pages."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
IDS = [path.stem for path in NOTEBOOKS]


def cells(path: Path) -> list[dict[str, Any]]:
    return list(json.loads(path.read_text())["cells"])


def test_there_are_six() -> None:
    assert len(NOTEBOOKS) == 6


@pytest.mark.parametrize("path", NOTEBOOKS, ids=IDS)
def test_a_notebook_is_clean_and_says_what_it_is_for(path: Path) -> None:
    notebook = json.loads(path.read_text())
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert len({cell["id"] for cell in notebook["cells"]}) == len(notebook["cells"])
    first = "".join(notebook["cells"][0]["source"])
    assert first.startswith("# ")
    assert "This notebook is for" in first
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None


@pytest.mark.parametrize("path", NOTEBOOKS, ids=IDS)
def test_a_notebook_runs_and_becomes_a_page(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "stable_baselines3" in path.read_text():
        pytest.importorskip("stable_baselines3", reason="pip install graphrqi[train]")
        pytest.importorskip("tensorboard", reason="pip install graphrqi[train]")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    pages = runpy.run_path(str(ROOT / "docs" / "notebook_pages.py"))
    outputs = pages["outputs"](path)
    assert any(outputs)
    page = pages["as_page"](path, outputs)
    source = [line for cell in cells(path) for line in "".join(cell["source"]).splitlines()]
    assert [line for line in source if line not in page.splitlines()] == []
    drawn = sum("plt.show()" in code for code in pages["code_cells"](path))
    assert page.count("<img") == drawn
    assert f"examples/{path.stem}.md" in (ROOT / "mkdocs.yml").read_text()
