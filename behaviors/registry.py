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
    the nearest one. Entries can be set and deleted to try something out in one process.

    Args:
        what: what the registry holds, in the singular ("solver"); used in messages.
        group: the group of entry points that adds to it ("graphrqi.solvers").
        entries: this package's entries; a string "module:attribute" is imported when asked for.
        made: builds the entry from its name and the imported object.

    Examples:
        >>> roots = Registry("root", "graphrqi.roots", {"square": "math:sqrt", "cube": "math:cbrt"})
        >>> list(roots), roots["square"](9.0)
        (['square', 'cube'], 3.0)
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
        made: Callable[[str, Any], T] = lambda _, found: cast(T, found),
    ) -> None:
        self._what, self._group, self._made = what, group, made
        self._entries, self._loaded = dict(entries), dict[str, T]()

    def __getitem__(self, name: str) -> T:
        """The entry of that name, imported if it is asked for the first time."""
        if name not in self._loaded:
            self._loaded[name] = self._load(name, lookup(self._all(), name, self._what))
        return self._loaded[name]

    def _load(self, name: str, entry: Any) -> T:
        """Import an entry of this package, or of a plugin."""
        if name in self._entries:
            return self._made(name, loaded(entry)) if isinstance(entry, str) else cast(T, entry)
        try:
            return self._made(name, entry.load())
        except Exception as error:  # a plugin's code may fail in any way
            raise InputError(
                f"{self._what} {name!r}: found a plugin that does not load, "
                f"{_distribution(entry)} ({entry.value}): {_reason(error)}"
            ) from error

    def get(self, name: str, default: Any = None) -> Any:
        """The entry of that name, or the default if there is none."""
        return self[name] if name in self else default  # noqa: SIM401  it would call itself

    def __iter__(self) -> Iterator[str]:
        """The names: those of this package, then those of plugins."""
        return iter(self._all())

    def __len__(self) -> int:
        """How many names there are."""
        return len(self._all())

    def __contains__(self, name: object) -> bool:
        """Whether there is an entry of that name; nothing is imported."""
        return name in self._all()

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
        return "graphrqi" if name in self._entries else _distribution(self._all()[name])

    def source(self, name: str) -> str | None:
        """The "module:attribute" behind an entry of this package, or None."""
        entry = self._entries.get(name)
        return entry if isinstance(entry, str) else None

    def _all(self) -> dict[str, Any]:
        """The entries of this package, then those that other distributions add; none twice."""
        found: dict[str, Any] = dict(self._entries)
        for plugin in _plugins(tuple(sys.path)).get(self._group, ()):
            if plugin.name in found:
                other = found[plugin.name]
                owner = "graphrqi" if plugin.name in self._entries else _distribution(other)
                raise InputError(
                    f"{self._what} {plugin.name!r}: found it in {owner} and in the plugin "
                    f"{_distribution(plugin)} ({plugin.value}), expected it once"
                )
            found[plugin.name] = plugin
        return found


def loaded(source: str) -> Any:
    """The object that a "module:attribute" string names; its module is imported."""
    module, attribute = source.split(":")
    return getattr(importlib.import_module(module), attribute)


def own_function(what: str, source: str) -> Callable[..., Any]:
    """The function of the user's own that "module:function" names; messages say ``what`` it is.

    The module is installed or lies in the working folder. It runs, so no name that was read from a
    file may come here. An `InputError` says that there is none, or that it does not load.
    """
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # last: nothing in it stands in for an installed package
    try:
        found = loaded(source)
    except Exception as error:  # the user's code may fail in any way
        raise InputError(
            f"{what}: found {source!r}, expected 'module:function' that exists ({_reason(error)})"
        ) from error
    if not callable(found):
        raise InputError(f"{what}: found {source!r}, expected it to name a function")
    return cast(Callable[..., Any], found)


def _reason(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def _distribution(plugin: EntryPoint) -> str:
    return f"{plugin.dist.name} {plugin.dist.version}" if plugin.dist else "an unknown distribution"


@lru_cache(maxsize=1)
def _plugins(path: tuple[str, ...]) -> Mapping[str, tuple[EntryPoint, ...]]:
    """The entry points of our groups, by group; looked for again when ``sys.path`` changes."""
    from importlib.metadata import entry_points

    installed = entry_points()
    groups = sorted(group for group in installed.groups if group.startswith("graphrqi."))
    return {group: tuple(installed.select(group=group)) for group in groups}
