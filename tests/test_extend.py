"""The files of ``docs/extend.md`` keep the contracts, in the source tree and in a package outside.

Each file of the page is written where the page says, its line is added to its registry, and the
contract tests over the registries run over the new entries alone.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

from experiments.cli.names import REGISTRIES

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("behaviors", "sim", "graphrqi", "scenarios", "experiments")
PAGE = (ROOT / "docs" / "extend.md").read_text()
LINE = re.compile(r'line in `([\w.]+)\.([A-Z]+)`\s+is\s+`"([\w-]+)":\s"([\w.:]+)"`')
FILE = re.compile(r"```python\n# (\S+\.py)\n(.*?)```", re.DOTALL)
(PYPROJECT,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)


@dataclass(frozen=True)
class Entry:
    """A line in a registry.

    Attributes:
        module: of the registry.
        registry: its name there.
        name: of the entry.
        source: what it stands for, as "module:attribute".
    """

    module: str
    registry: str
    name: str
    source: str


FILES = dict(FILE.findall(PAGE))
ENTRIES = [Entry(*found) for found in LINE.findall(PAGE)]


def contract_tests() -> list[str]:
    """The test files that mention a registry."""
    registries = re.compile(rf"\b({'|'.join(entry.registry for entry in ENTRIES)})\b")
    return [
        path.relative_to(ROOT).as_posix()
        for path in sorted((ROOT / "tests").glob("*/test_*.py"))
        if registries.search(path.read_text())
    ]


def keeps_the_contracts(tree: Path, *paths: Path) -> None:
    """Run the contract tests over the page's entries alone, in a process of its own."""
    done = subprocess.run(
        [
            *(sys.executable, "-m", "pytest", "-v", "--no-header", "-p", "no:cacheprovider"),
            *("-k", " or ".join(f"{entry.name}" for entry in ENTRIES), *contract_tests()),
        ],
        cwd=tree,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join(map(str, (*paths, tree))),
            "OMP_NUM_THREADS": "1",
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr[-2000:]
    passed = [line for line in done.stdout.splitlines() if " PASSED" in line]
    for entry in ENTRIES:
        assert any(re.search(rf"[\[-]{entry.name}[\]-]", line) for line in passed), entry


def test_the_page_adds_to_every_registry() -> None:
    assert {f"{entry.module}:{entry.registry}" for entry in ENTRIES} == set(REGISTRIES.values())
    modules = {path.removesuffix(".py").replace("/", ".") for path in FILES}
    assert {entry.source.split(":")[0] for entry in ENTRIES} == modules


def test_in_the_source_tree(tmp_path: Path) -> None:
    for folder in (*PACKAGES, "tests"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for path, text in FILES.items():
        assert not (ROOT / path).exists()
        (tmp_path / path).write_text(text)
        os.utime(tmp_path / path, (0, 0))  # compiled kernels count as newer
    for entry in ENTRIES:
        file = tmp_path / entry.module.replace(".", "/")
        file = file / "__init__.py" if file.is_dir() else file.with_suffix(".py")
        head, name, rest = file.read_text().partition(f"\n{entry.registry}: ")
        before, brace, after = rest.partition("{\n")
        line = f'        "{entry.name}": "{entry.source}",\n'
        times = file.stat().st_atime_ns, file.stat().st_mtime_ns
        file.write_text(head + name + before + brace + line + after)
        os.utime(file, ns=times)
    keeps_the_contracts(tmp_path)


def test_from_another_package(tmp_path: Path) -> None:
    source, site = tmp_path / "source", tmp_path / "site"
    package = source / "my_traffic"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    for path, text in FILES.items():
        inside = re.sub(r"^from (\S+) import", _inside, text, flags=re.MULTILINE)
        (package / Path(path).name).write_text(inside)
    (source / "pyproject.toml").write_text(PYPROJECT)
    points = tomllib.loads(PYPROJECT)["project"]["entry-points"]
    assert [name for group in points.values() for name in group] == [e.name for e in ENTRIES]
    for command in (
        ["build", "--wheel", "--no-isolation", str(source)],
        ["pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(site),
         "--find-links", str(source / "dist"), "my-traffic"],
    ):  # fmt: skip
        subprocess.run([sys.executable, "-m", *command], check=True, capture_output=True)
    keeps_the_contracts(ROOT, site)


def _inside(found: re.Match[str]) -> str:
    """An import of a file of the page comes from the package instead."""
    path = found[1].replace(".", "/") + ".py"
    return f"from my_traffic.{Path(path).stem} import" if path in FILES else found[0]
