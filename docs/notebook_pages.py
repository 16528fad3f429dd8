"""Shows the notebooks of ``examples/`` as pages with their outputs: a hook of mkdocs.

``mkdocs.yml`` names it. Notebooks are stored without outputs and run when the pages are built.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


def code_cells(path: Path) -> list[str]:
    """The code of each cell of a notebook."""
    cells = json.loads(path.read_text())["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def run_cells(path: Path) -> Iterator[tuple[str, Any]]:
    """Run a notebook in the working folder.

    Yields:
        What each cell prints, and the value of its last expression (None if it has none).
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    for code in code_cells(path):
        tree = ast.parse(code, path.name)
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        value = None
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile(tree, path.name, "exec"), names)
            if isinstance(last, ast.Expr):
                value = eval(compile(ast.Expression(last.value), path.name, "eval"), names)
        yield printed.getvalue(), value


def shown(printed: str, value: Any) -> str:
    """The output of a cell as Markdown, with the pictures that it drew."""
    import matplotlib.pyplot as plt

    parts = [f"```text\n{printed.rstrip()}\n```"] if printed.strip() else []
    for number in plt.get_fignums():
        picture = io.BytesIO()
        plt.figure(number).savefig(picture, format="png", dpi=80, bbox_inches="tight")
        data = base64.b64encode(picture.getvalue()).decode()
        parts.append(f'<img alt="what the cell draws" src="data:image/png;base64,{data}">')
    plt.close("all")
    if hasattr(value, "_repr_html_"):
        parts.append("\n".join(line.strip() for line in value._repr_html_().splitlines()))
    elif value is not None:
        parts.append(f"```text\n{value!r}\n```")
    return "\n\n".join(parts)


def outputs(path: Path) -> list[str]:
    """The output of each code cell of a notebook, which is run in a folder of its own."""
    import matplotlib as mpl

    mpl.use("agg")
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            return [shown(*cell) for cell in run_cells(path)]
        finally:
            os.chdir(before)


def as_page(path: Path, outputs: list[str]) -> str:
    """A notebook as Markdown: its text, its code, and the output of each code cell."""
    parts, left = [], iter(outputs)
    for cell in json.loads(path.read_text())["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(text)
        else:
            parts += [f"```python\n{text}\n```", next(left)]
    parts.append(f"This page is the notebook `examples/{path.name}`.")
    return "\n\n".join(part for part in parts if part) + "\n"


def on_files(files: Any, config: Any) -> Any:
    """Run each notebook and add its page."""
    from mkdocs.structure.files import File

    for path in sorted(EXAMPLES.glob("*.ipynb")):
        content = as_page(path, outputs(path))
        files.append(File.generated(config, f"examples/{path.stem}.md", content=content))
    return files
