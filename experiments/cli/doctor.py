"""Looks over an installation: what is there, what is missing, and how to get it."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Final, Literal
from urllib.parse import unquote, urlsplit

from packaging.requirements import Requirement

from behaviors.errors import InputError, lookup
from behaviors.populations import POPULATIONS, read_population
from behaviors.registry import Registry, loaded
from experiments.rows import Row

START_LIMIT_S: Final = 120.0
"""Longest that a simulator may take to start, s (a slow disk takes tens of seconds)."""

EXTRAS: Final[dict[str, str]] = {
    "cluster": "only needed to generate on many machines",
    "networks": "only needed to build roads and read maps of your own",
    "store": "only needed for datasets in object stores",
    "multi": "only needed for environments with several agents",
    "train": "only needed to train drivers by reinforcement learning",
    "video": "only needed for films in MP4",
    "asam": "only needed to export OpenSCENARIO and OpenDRIVE",
    "docs": "only needed to build the documentation's pages",
    "dev": "only needed to test and change the code",
}
"""What each optional part is for."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        what: the thing.
        state: "ok", "optional" (missing, and not needed), or "broken".
        found: its version or what happened.
        fix: what to do, if something is to be done.
    """

    what: str
    state: Literal["ok", "optional", "broken"]
    found: str
    fix: str = ""

    @property
    def row(self) -> Row:
        """The finding as a table row."""
        return asdict(self)


REGISTRIES: Final[dict[str, str]] = {
    "scenario": "scenarios:SCENARIOS",
    "engine": "sim.engines:ENGINES",
    "method": "graphrqi.methods:METHODS",
    "solver": "graphrqi.spectrum:SOLVERS",
    "predictor": "graphrqi.predict:PREDICTORS",
    "classifier": "graphrqi.classify.registry:CLASSIFIERS",
    "format": "sim.formats:FORMATS",
}
"""The registries, as "module:attribute", by what they hold."""

SUMMARIES: Final[dict[str, Literal["entry", "function", "module"]]] = {
    "scenario": "entry",
    "engine": "function",
    "method": "entry",
    "solver": "module",
    "predictor": "function",
    "classifier": "function",
    "format": "module",
}
"""What says in one line what an entry of a registry is: the entry itself, which is imported; or the
docstring of its function (or class) or of its module, which is read without importing it."""


def names_of(what: str) -> list[str]:
    """The registered names of one kind of thing.

    Args:
        what: a key of ``REGISTRIES``.

    Returns:
        Its names, in the registry's order.

    Examples:
        >>> names_of("engine")
        ['sumo', 'sumo-idm', 'highway', 'highway-krauss']
    """
    return list(POPULATIONS if what == "population" else _registry(what))


def registered_names() -> list[Row]:
    """Every registered name: what it names, where it comes from, and one line on what it is."""
    found: list[Row] = [
        {
            "what": what,
            "name": name,
            "from": registry.origin(name),
            "about": _about(registry, name, SUMMARIES[what]),
        }
        for what in REGISTRIES
        for registry in (_registry(what),)
        for name in registry
    ]
    for name in POPULATIONS:
        about = read_population(name).source
        found.append({"what": "population", "name": name, "from": "graphrqi", "about": about})
    return found


def _registry(what: str) -> Registry[object]:
    registry: Registry[object] = loaded(lookup(REGISTRIES, what, "registry"))
    return registry


def _about(registry: Registry[Any], name: str, summary: str) -> str:
    """One line on an entry: its summary, or the first line of a docstring without its marks."""
    source = registry.source(name)
    if summary == "entry" or source is None:
        try:
            return _summary(registry[name])
        except InputError as error:  # a plugin that does not load
            return str(error)
    module, attribute = source.split(":")
    written = importlib.util.find_spec(module)
    assert written is not None, module
    assert written.origin is not None, module
    tree: ast.Module | ast.FunctionDef | ast.ClassDef = ast.parse(
        Path(written.origin).read_bytes(), written.origin
    )
    if summary == "function":
        tree = next(
            node
            for node in tree.body
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == attribute
        )
    return _first_line(ast.get_docstring(tree))


def _summary(entry: Any) -> str:
    """One line on an entry that has a summary or is, or is made by, a documented function."""
    if hasattr(entry, "summary"):
        return str(entry.summary)
    made_by = getattr(entry, "function", entry)
    about = _first_line(inspect.getdoc(getattr(made_by, "func", made_by)))
    fixed = ", ".join(f"{k}={v}" for k, v in getattr(made_by, "keywords", {}).items())
    return f"{about} Here {fixed}." if fixed else about


def _first_line(docstring: str | None) -> str:
    return (docstring or "").partition("\n")[0].replace("`", "")


def version_line() -> str:
    """Our version, and those of Python and the simulators."""
    found = [f"graphrqi {metadata.version('graphrqi')}", f"Python {platform.python_version()}"]
    for name in ("libsumo", "highway-env"):
        with suppress(metadata.PackageNotFoundError):
            found.append(f"{name} {metadata.version(name)}")
    return ", ".join(found)


def _requirements() -> Iterator[tuple[Requirement, str]]:
    """Everything that the package asks for here, and for which extra ("" for none)."""
    for line in metadata.requires("graphrqi") or []:
        requirement = Requirement(line)
        marker = requirement.marker
        if marker is None or marker.evaluate({"extra": ""}):
            yield requirement, ""
            continue
        for extra in EXTRAS:
            if marker.evaluate({"extra": extra}):
                yield requirement, extra


def _packages() -> Iterator[Finding]:
    for requirement, extra in _requirements():
        what = f"{requirement.name} ({extra})" if extra else requirement.name
        fix = f"pip install '{requirement.name}{requirement.specifier}'"
        try:
            found = metadata.version(requirement.name)
        except metadata.PackageNotFoundError:
            if extra:
                yield Finding(what, "optional", "missing", f"{fix} ({EXTRAS[extra]})")
            else:
                yield Finding(what, "broken", "missing", fix)
            continue
        if requirement.specifier.contains(found, prereleases=True):
            yield Finding(what, "ok", found)
        else:
            wrong = f"{found}, expected {requirement.specifier}"
            yield Finding(what, "optional" if extra else "broken", wrong, fix)


def _again() -> str:
    """How this installation is made again, from where it came."""
    origin = json.loads(metadata.distribution("graphrqi").read_text("direct_url.json") or "{}")
    where = origin.get("url", "")
    if where.startswith("file://"):
        where = f"'{unquote(urlsplit(where).path)}'"
    editable = "--editable " if origin.get("dir_info", {}).get("editable") else ""
    return (
        f"pip install --force-reinstall --no-deps {editable}{where}"
        if where
        else "install graphrqi again, from where you had it"
    )


def _scenarios() -> str:
    from scenarios import SCENARIOS

    lanes = {name: len(make().road.lanes) for name, make in SCENARIOS.items()}
    return ", ".join(f"{name} {count} lanes" for name, count in lanes.items())


_START_SUMO = """
from scenarios import SCENARIOS
from sim.engines import get_engine
from sim.scenario import sample_agents
scenario = SCENARIOS["straight_road"](duration_s=5.0)
print(sum(len(f) for f in get_engine("sumo")(scenario, sample_agents(scenario, 0), 0)))
"""


def _sumo() -> str:
    run = subprocess.run(
        [sys.executable, "-c", _START_SUMO],
        capture_output=True,
        text=True,
        timeout=START_LIMIT_S,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
    )
    if run.returncode != 0:
        said = run.stderr.strip().splitlines()
        raise InputError(said[-1] if said else f"ended with code {run.returncode}")
    return f"5 s simulated, {run.stdout.strip()} agent-steps"


def _model() -> str:
    from graphrqi.stream import DEFAULT_MODEL, load_stream

    load_stream(DEFAULT_MODEL)
    return DEFAULT_MODEL


def _tried(what: str, check: Callable[[], str], fix: str) -> Finding:
    try:
        return Finding(what, "ok", check())
    except (InputError, OSError, ImportError, subprocess.TimeoutExpired) as error:
        return Finding(what, "broken", " ".join(str(error).split()), fix)


def examine() -> list[Finding]:
    """Look at everything.

    Returns:
        What was found, in the order it was looked at.
    """
    version = ".".join(map(str, sys.version_info[:3]))
    supported = (3, 11) <= sys.version_info[:2] <= (3, 13)
    system = platform.system()
    again = _again()
    return [
        Finding(
            "python", "ok" if supported else "broken", version, "" if supported else "use 3.11-3.13"
        ),
        Finding("system", "ok", f"{system} {platform.machine()}"),
        Finding("graphrqi", "ok", metadata.version("graphrqi")),
        *_packages(),
        _tried("scenarios", _scenarios, again),
        _tried("sumo starts", _sumo, "pip install --force-reinstall libsumo"),
        _tried("default model", _model, again),
    ]
