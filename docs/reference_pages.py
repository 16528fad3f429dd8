"""Makes the reference, a page for each part of the packages: a hook of mkdocs.

A page shows every public name of the modules in its part, as their docstrings describe it, so a
new module has its place in the reference without anybody writing it down.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("behaviors", "sim", "graphrqi", "scenarios", "experiments")
Part = tuple[str, list[Path]]
"""A part's dotted name, and the files of the modules that its page describes."""


def parts(package: str) -> list[Part]:
    """The package itself with the modules right in it, then each of the packages under it, whole.

    >>> [name for name, _ in parts("behaviors")]
    ['behaviors']
    """
    top = ROOT / package
    folders = sorted(path.parent for path in top.glob("*/__init__.py"))
    whole = [(f"{package}.{folder.name}", public(folder.rglob("*.py"))) for folder in folders]
    return [(package, public(top.glob("*.py"))), *whole]


def public(files: Any) -> list[Path]:
    """The modules that are not private, those of a package after the package itself."""
    names = [path for path in files if not path.stem.startswith("_") or path.stem == "__init__"]
    return sorted(names, key=lambda path: (module_name(path).split("."), path))


def module_name(path: Path) -> str:
    """The dotted name of a module's file.

    >>> module_name(ROOT / "sim" / "road" / "__init__.py"), module_name(ROOT / "sim" / "frames.py")
    ('sim.road', 'sim.frames')
    """
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def page(part: Part) -> str:
    """The Markdown of a part's page: what it is for, and one entry of mkdocstrings per module."""
    name, files = part
    entries = "\n".join(f"::: {module_name(path)}" for path in files)
    return f"# {name}\n\nThis page is for looking up the public names of `{name}`.\n\n{entries}\n"


def file_name(name: str) -> str:
    """Where a part's page lies.

    >>> file_name("sim.road")
    'reference/sim/road.md'
    """
    return f"reference/{name.replace('.', '/')}.md"


def on_config(config: Any) -> Any:
    """Put the pages under the heading Reference, which ``mkdocs.yml`` leaves empty."""
    pages = [
        {package: [{name: file_name(name)} for name, _ in parts(package)]} for package in PACKAGES
    ]
    for entry in config["nav"]:
        if "Reference" in entry:
            entry["Reference"] = pages
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the pages."""
    from mkdocs.structure.files import File

    for package in PACKAGES:
        for part in parts(package):
            files.append(File.generated(config, file_name(part[0]), content=page(part)))
    return files
