"""Registries: names without imports, plugins of other distributions, and what goes wrong."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from behaviors.errors import InputError
from behaviors.registry import Registry

ROOTS = {"square": "math:sqrt", "cube": "math:cbrt"}


def install(folder: Path, name: str, points: str, module: str = "", group: str = "roots") -> None:
    """A distribution as pip leaves it: a module and its entry points."""
    metadata = folder / f"{name}-1.2.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
    (metadata / "entry_points.txt").write_text(f"[graphrqi.{group}]\n{points}\n")
    (folder / f"{name}.py").write_text(module)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(tmp_path / "site")
    return tmp_path / "site"


def roots() -> Registry[object]:
    return Registry("root", "graphrqi.roots", ROOTS)


def test_a_plugin_is_found_by_name_and_loaded_when_asked_for(folder: Path) -> None:
    install(folder, "lazy_fourth", "fourth = lazy_fourth:root", "def root(x): return x**0.25")
    registry = roots()
    assert list(registry) == ["square", "cube", "fourth"]
    assert len(registry) == 3
    assert "fourth" in registry
    assert registry.origin("fourth") == "lazy_fourth 1.2"
    assert registry.origin("cube") == "graphrqi"
    assert "lazy_fourth" not in sys.modules
    assert registry["fourth"](16.0) == 2.0  # type: ignore[operator]
    assert "lazy_fourth" in sys.modules


def test_a_name_that_is_built_in_is_refused(folder: Path) -> None:
    install(folder, "clashing", "cube = clashing:root")
    with pytest.raises(
        InputError, match=r"'cube': found it in graphrqi and in the plugin clashing 1\.2"
    ):
        _ = roots()["cube"]


@pytest.mark.parametrize(
    ("module", "said"),
    [
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("1 / 0", "ZeroDivisionError"),
        ("", "AttributeError"),
    ],
    ids=["imports what is missing", "raises", "lacks the attribute"],
)
def test_a_plugin_that_does_not_load_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch, module: str, said: str
) -> None:
    monkeypatch.delitem(sys.modules, "broken_plugin", raising=False)
    install(folder, "broken_plugin", "fourth = broken_plugin:root", module)
    registry = roots()
    assert "fourth" in registry  # other names work
    assert registry["square"](9.0) == 3.0  # type: ignore[operator]
    with pytest.raises(InputError, match=rf"'fourth': .*broken_plugin 1\.2 .*{said}"):
        _ = registry["fourth"]


def test_an_entry_can_be_tried_out() -> None:
    registry = roots()
    assert registry["square"](9.0) == 3.0  # type: ignore[operator]
    registry["square"] = len
    assert registry["square"] is len
    del registry["square"]
    assert list(registry) == ["cube"]


def test_the_names_of_all_registries_load_nothing_heavy() -> None:
    heavy = "libsumo", "highway_env", "torch", "sklearn", "matplotlib", "pyarrow"
    script = (
        "import sys\n"
        "from experiments.cli.names import REGISTRIES, names_of\n"
        "assert sum(len(names_of(what)) for what in REGISTRIES) > 50\n"
        f"loaded = [name for name in {heavy} if name in sys.modules]\n"
        "assert not loaded, loaded\n"
    )
    root = str(Path(__file__).resolve().parents[2])
    subprocess.run([sys.executable, "-c", script], check=True, cwd=root)
