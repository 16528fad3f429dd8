"""Everything that is registered: scenarios, engines, methods, predictors, formats and so on."""

from __future__ import annotations

import importlib
import inspect
import platform
from contextlib import suppress
from importlib import metadata
from typing import Any, Final

from behaviors.errors import InputError, lookup
from behaviors.populations import POPULATIONS, read_population
from behaviors.registry import Registry, loaded
from experiments.generate import RANDOM_WORLD
from experiments.score.rows import Row

REGISTRIES: Final[dict[str, str]] = {
    "scenario": "scenarios:SCENARIOS",
    "engine": "sim.engines:ENGINES",
    "method": "graphrqi.methods:METHODS",
    "solver": "graphrqi.spectrum:SOLVERS",
    "predictor": "graphrqi.predict:PREDICTORS",
    "classifier": "graphrqi.classify:CLASSIFIERS",
    "format": "sim.formats:FORMATS",
}
"""The registries, as "module:attribute", by what they hold."""


def names_of(what: str) -> list[str]:
    """The registered names of one kind of thing, in the registry's order."""
    if what == "population":
        return list(POPULATIONS)
    return [*_registry(what), *([RANDOM_WORLD] if what == "scenario" else [])]


def registered_names() -> list[Row]:
    """Every registered name: what it names, where it comes from, and one line on what it is."""
    found = [
        (what, name, registry.origin(name), _about(registry, name, what))
        for what, registry in ((what, _registry(what)) for what in REGISTRIES)
        for name in registry
    ]
    drawn = "A road, drivers and a sensor of each episode's own, drawn at random; for generate."
    found.append(("scenario", RANDOM_WORLD, "graphrqi", drawn))
    found += [("population", n, "graphrqi", read_population(n).source) for n in POPULATIONS]
    return [dict(zip(("what", "name", "from", "about"), row, strict=True)) for row in found]


def _registry(what: str) -> Registry[object]:
    registry: Registry[object] = loaded(lookup(REGISTRIES, what, "registry"))
    return registry


def _about(registry: Registry[Any], name: str, what: str) -> str:
    """One line on an entry: its summary, or the first line of a docstring without its marks."""
    source = registry.source(name)
    if what == "format" and registry.origin(name) == "graphrqi":
        source = registry[name].reader or registry[name].writer
    try:
        if what == "format" and source is not None:  # the reader's module says what it reads
            return _first_line(importlib.import_module(source.split(":")[0]).__doc__)
        entry = registry[name]
    except InputError as error:  # a plugin that does not load
        return str(error)
    if hasattr(entry, "summary"):
        return str(entry.summary)
    made_by = getattr(entry, "function", getattr(entry, "find", entry))
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
