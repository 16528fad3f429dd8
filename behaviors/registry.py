"""The registries: names of things, each of which is loaded when it is first asked for.

A registry is written as a dict of "module:attribute" strings. Other installed distributions add
entries through entry points, in the group that the registry names; see ``docs/extend.md``.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from behaviors.errors import InputError, lookup

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")


class Registry(Mapping[str, T], Generic[T]):
    """Things by name: those of this package, then those of installed plugins.

    Looking at the names loads nothing. Asking for an unknown name is an `InputError` that suggests
    the nearest one; `get` returns a default instead. Entries can be set and deleted to try
    something out in one process.

    Args:
        what: what the registry holds, in the singular ("solver"); used in messages.
        group: the group of entry points that adds to it ("graphrqi.solvers").
        entries: this package's entries; a string "module:attribute" is imported when asked for.
        made: builds the entry from its name and the imported object.

    Examples:
        >>> roots = Registry("root", "graphrqi.roots", {"square": "math:sqrt", "cube": "math:cbrt"})
        >>> list(roots)
        ['square', 'cube']
        >>> roots["square"](9.0)
        3.0
        >>> roots["cub"]
        Traceback (most recent call last):
        ...
        behaviors.errors.InputError: unknown root 'cub': did you mean 'cube'? (square, cube)
    """

    def __init__(
        self,
        what: str,
        group: str,
        entries: Mapping[str, str | T],
        made: Callable[[str, Any], T] | None = None,
    ) -> None:
        self._what = what
        self._group = group
        self._entries = dict(entries)
        self._made = made
        self._loaded: dict[str, T] = {}

    def __getitem__(self, name: str) -> T:
        """The entry of that name, imported if it is asked for the first time."""
        plugins = self._plugins()
        if name not in self._loaded:
            known: dict[str, str | T | EntryPoint] = {**self._entries, **plugins}
            entry = lookup(known, name, self._what)
            self._loaded[name] = self._load(name, plugins.get(name), entry)
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        """The names: those of this package, then those of plugins."""
        return iter((*self._entries, *self._plugins()))

    def __len__(self) -> int:
        """How many names there are."""
        return len(self._entries) + len(self._plugins())

    def __contains__(self, name: object) -> bool:
        """Whether there is an entry of that name; nothing is imported."""
        return name in self._entries or name in self._plugins()

    def get(self, name: str, default: Any = None) -> Any:
        """The entry of that name, or the default if there is none."""
        return self[name] if name in self else default  # noqa: SIM401  it would call itself

    def __setitem__(self, name: str, entry: T) -> None:
        """Set an entry in this process."""
        self._entries[name] = entry
        self._loaded.pop(name, None)

    def __delitem__(self, name: str) -> None:
        """Delete an entry in this process."""
        del self._entries[name]
        self._loaded.pop(name, None)

    def origin(self, name: str) -> str:
        """The distribution that an entry comes from: "graphrqi" or a plugin's name and version."""
        plugin = self._plugins().get(name)
        return "graphrqi" if plugin is None else _distribution(plugin)

    def source(self, name: str) -> str | None:
        """The "module:attribute" behind an entry of this package, with nothing imported.

        An entry with a ``reader`` or ``writer``, such as a format, gives that string. The result is
        None for a plugin's entry or an object.
        """
        entry = self._entries.get(name)
        if entry is not None and not isinstance(entry, str):
            entry = getattr(entry, "reader", None) or getattr(entry, "writer", None)
        return entry if isinstance(entry, str) else None

    def _plugins(self) -> Mapping[str, EntryPoint]:
        """The entries that other distributions add; no name stands twice."""
        found: dict[str, EntryPoint] = {}
        for plugin in _entry_points(tuple(sys.path)).get(self._group, ()):
            if plugin.name in self._entries or plugin.name in found:
                other = found.get(plugin.name)
                owner = "graphrqi" if other is None else _distribution(other)
                raise InputError(
                    f"{self._what} {plugin.name!r}: found it in {owner} and in the plugin "
                    f"{_distribution(plugin)} ({plugin.value}), expected it once; "
                    "uninstall or rename one"
                )
            found[plugin.name] = plugin
        return found

    def _load(self, name: str, plugin: EntryPoint | None, entry: object) -> T:
        """The entry itself, imported if need be."""
        if plugin is not None:
            try:
                entry = plugin.load()
            except Exception as error:  # a plugin's code may fail in any way
                raise InputError(
                    f"{self._what} {name!r}: found a plugin that does not load, "
                    f"{_distribution(plugin)} ({plugin.value}): {_reason(error)}"
                ) from error
        elif isinstance(entry, str):
            entry = loaded(entry)
        else:
            return cast(T, entry)
        return cast(T, entry) if self._made is None else self._made(name, entry)


def loaded(source: str) -> Any:
    """The object that a "module:attribute" string names; its module is imported."""
    module, attribute = source.split(":")
    return getattr(importlib.import_module(module), attribute)


def own_function(what: str, source: str) -> Callable[..., Any]:
    """The function of the user's own that "module:function" names.

    Its module runs, so no name that was read from a file may come here.

    Args:
        what: what the function is to be ("policy"); used in messages.
        source: the module is installed or lies in the working folder.

    Raises:
        InputError: if there is none, or its module does not load.

    Examples:
        >>> own_function("root", "math:sqrt")(9.0)
        3.0
        >>> own_function("root", "math:pi")
        Traceback (most recent call last):
        ...
        behaviors.errors.InputError: root: found 'math:pi', expected it to name a function
    """
    module, _, function = source.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # last: nothing in it stands in for an installed package
    try:
        found = getattr(importlib.import_module(module), function)
    except Exception as error:  # the user's code may fail in any way
        wanted = "'module:function' that exists"
        raise InputError(
            f"{what}: found {source!r}, expected {wanted} ({_reason(error)})"
        ) from error
    if not callable(found):
        raise InputError(f"{what}: found {source!r}, expected it to name a function")
    return cast(Callable[..., Any], found)


def _reason(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def _distribution(plugin: EntryPoint) -> str:
    made = plugin.dist
    return "an unknown distribution" if made is None else f"{made.name} {made.version}"


@lru_cache(maxsize=1)
def _entry_points(path: tuple[str, ...]) -> Mapping[str, tuple[EntryPoint, ...]]:
    """Every entry point of our groups, by group; looked for again when ``sys.path`` changes."""
    from importlib.metadata import entry_points

    installed = entry_points()
    groups = sorted(group for group in installed.groups if group.startswith("graphrqi."))
    return {group: tuple(installed.select(group=group)) for group in groups}
