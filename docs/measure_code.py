"""Prints the size of every Python file: lines, longest function, most parameters; and per folder.

Run ``python docs/measure_code.py``. The limits that ``tests/test_imports.py`` holds are at the top.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGES = ("behaviors", "sim", "graphrqi", "scenarios", "experiments")

MOST_LINES = 500
"""Of a file."""
MOST_MODULES = 15
"""Side by side in a folder."""
MOST_PARAMETERS = 12
"""Of a function, not counting ``self``; commands in `DECLARATIONS` may have more."""
DECLARATIONS = (
    "experiments/cli/commands.py",
    "experiments/cli/generate.py",
    "experiments/cli/what_if.py",
)
"""Files whose functions declare the command line's options, one parameter each."""


@dataclass(frozen=True)
class Function:
    """A function's name, its number of lines, and of parameters without ``self`` or ``cls``."""

    name: str = ""
    lines: int = 0
    parameters: int = 0


@dataclass(frozen=True)
class File:
    """A Python file, by its path below the root; its number of lines; its functions."""

    path: str
    lines: int
    functions: tuple[Function, ...]

    @property
    def longest(self) -> Function:
        """The longest function."""
        return max(self.functions, key=lambda f: f.lines, default=Function())

    @property
    def widest(self) -> Function:
        """The function with the most parameters."""
        return max(self.functions, key=lambda f: f.parameters, default=Function())


def measure(root: Path) -> list[File]:
    """Every Python file of the packages below a root."""
    paths = [path for package in PACKAGES for path in sorted((root / package).rglob("*.py"))]
    return [
        File(
            path.relative_to(root).as_posix(),
            len(path.read_text().splitlines()),
            tuple(_functions(ast.parse(path.read_text()))),
        )
        for path in paths
    ]


def modules_per_folder(files: Iterable[File]) -> dict[str, int]:
    """How many modules, not counting ``__init__``, lie side by side in each folder."""
    found: dict[str, int] = {}
    for file in files:
        folder, _, name = file.path.rpartition("/")
        found[folder] = found.get(folder, 0) + (name not in ("__init__.py", "__main__.py"))
    return found


def _functions(tree: ast.AST, prefix: str = "") -> Iterator[Function]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.ClassDef):
            yield from _functions(node, f"{prefix}{node.name}.")
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = node.args
            names = [a.arg for a in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
            count = sum(name not in ("self", "cls") for name in names)
            length = (node.end_lineno or node.lineno) - node.lineno + 1
            yield Function(prefix + node.name, length, count)
            yield from _functions(node, f"{prefix}{node.name}.")
        else:
            yield from _functions(node, prefix)


def main() -> None:
    """Print the tables."""
    files = measure(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1])
    print(f"{'file':60} {'lines':>6}  {'longest function':>40}  {'most parameters':>40}")
    for file in files:
        longest, widest = file.longest, file.widest
        print(
            f"{file.path:60} {file.lines:6}  {longest.lines:4} {longest.name[:35]:35}  "
            f"{widest.parameters:4} {widest.name[:35]:35}"
        )
    print(f"\n{'folder':60} {'modules':>7} {'lines':>6}")
    for folder, modules in modules_per_folder(files).items():
        lines = sum(file.lines for file in files if file.path.rpartition("/")[0] == folder)
        print(f"{folder:60} {modules:7} {lines:6}")
    print(f"\n{len(files)} files, {sum(file.lines for file in files)} lines")


if __name__ == "__main__":
    main()
