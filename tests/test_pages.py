"""What the pages say of the code is true: the drawing, the walk of a frame, names and terms."""

from __future__ import annotations

import ast
import importlib.util
import pkgutil
import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text()
GLOSSARY = (ROOT / "docs" / "glossary.md").read_text()
ROW = re.compile(r"^\| (?P<term>[^|]+) \| (?P<meaning>[^|]+) \| (?P<where>[^|]+) \|$", re.MULTILINE)
TERMS = [row for row in ROW.finditer(GLOSSARY) if row["term"] not in ("term", "---")]
STEPS = re.findall(r"^\d+\. `([\w.]+)` in `([\w/.]+)`", ARCHITECTURE, re.MULTILINE)


def test_the_drawing_is_up_to_date() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "draw_imports.py"))
    drawn, committed = script["draw"](), (ROOT / "docs" / "imports.svg").read_text()
    assert drawn == committed, "the imports changed: run python docs/draw_imports.py"


@pytest.mark.parametrize(("function", "file"), STEPS, ids=[name for name, _ in STEPS])
def test_a_step_of_the_walk_is_where_the_page_says(function: str, file: str) -> None:
    body: list[ast.stmt] = ast.parse((ROOT / file).read_text()).body
    for name in function.split("."):
        (found,) = [
            node
            for node in body
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name
        ]
        body = found.body
    assert isinstance(found, ast.FunctionDef)


def test_the_walk_has_at_most_twelve_steps() -> None:
    assert 8 <= len(STEPS) <= 12


@pytest.mark.parametrize("row", TERMS, ids=[row["term"] for row in TERMS])
def test_a_term_is_one_sentence_and_lives_somewhere(row: re.Match[str]) -> None:
    assert re.fullmatch(r"[A-Z].*[^.]\.", row["meaning"])
    assert ". " not in row["meaning"], "expected one sentence"
    assert importlib.util.find_spec(row["where"].strip("`")) is not None


def test_terms_are_explained_once() -> None:
    terms = [row["term"] for row in TERMS]
    assert len(terms) == len(set(terms)) > 50


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("page", PAGES[1:], ids=lambda p: p.relative_to(ROOT / "docs").as_posix())
def test_a_page_says_at_its_top_what_it_is_for(page: Path) -> None:
    assert re.match(r"# [^\n]+\n\nThis page is for [^\n]+", page.read_text())


@pytest.mark.parametrize("page", PAGES, ids=[p.relative_to(ROOT).as_posix() for p in PAGES])
def test_the_names_on_a_page_exist(page: Path) -> None:
    text = page.read_text()
    packages = "behaviors|sim|graphrqi|scenarios|experiments"
    for name in re.findall(rf"`((?:{packages})(?:\.[A-Za-z_]\w*)+)`", text):
        assert pkgutil.resolve_name(name) is not None
    for path in re.findall(rf"`((?:{packages}|docs)/[\w/.]+\.\w+)`", text):
        assert (ROOT / path).exists(), path
