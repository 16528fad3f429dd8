"""Pickled numbers, words, containers and arrays, read without running anything.

A pickle is a program for a small machine whose instructions may call any function. Here only its
instructions are listed (`pickletools.genops`), and the ones that build data are carried out by
ours. The few names that data need (numpy's arrays and types, dictionaries of ``collections``) stand
for functions of ours; every other name becomes an `Opaque`, which is never called.

References:
    Python's ``pickletools``, which documents each instruction.
"""

from __future__ import annotations

import pickle
import pickletools
from collections.abc import Callable
from dataclasses import dataclass
from types import UnionType
from typing import Any, Final

import numpy as np

MAX_INSTRUCTIONS: Final = 5_000_000
"""Most instructions of a file (a large scenario has some 100,000)."""

FRAME_BYTES: Final = 9
"""Bytes of the instruction that begins a frame."""

ARRAY_VERSION: Final = 1
"""How numpy writes the state of an array, by its own count."""

TYPE_VERSIONS: Final = {3: 8, 4: 9}
"""How numpy writes the state of a type, by its own count, and of how many parts."""

BYTE_ORDERS: Final = ("<", ">", "=", "|")
"""How numpy writes the order of a type's bytes."""

PLAIN_KINDS: Final = "biufUS"
"""Kinds of numpy types whose bytes are data: numbers and words."""


class NotPlainError(ValueError):
    """Raised for a file that is no pickle of plain data; says why."""


@dataclass(frozen=True, slots=True)
class Opaque:
    """Something that is not plain data: an object of a class that is not known here."""

    name: str


@dataclass(slots=True)
class _Array:
    """An array before its state is known."""


@dataclass(slots=True)
class _Type:
    """A numpy type before its byte order is known."""

    code: str


_MARK: Final = object()


def loads(data: bytes) -> Any:
    """The value that a pickle describes.

    Args:
        data: the whole pickle.

    Returns:
        Plain Python values and numpy arrays; `Opaque` for everything else.

    Raises:
        NotPlainError: if it is no pickle, is broken, or is longer than any scenario.

    Examples:
        >>> import pickle
        >>> loads(pickle.dumps({"x": np.arange(3.0), "name": ("a", 1)}))
        {'x': array([0., 1., 2.]), 'name': ('a', 1)}
        >>> loads(pickle.dumps(print))
        Opaque(name='builtins print')
    """
    machine, frame_end = _Machine(), 0
    try:
        for number, (instruction, argument, at) in enumerate(pickletools.genops(data)):
            begin = at or 0
            if number >= MAX_INSTRUCTIONS:
                raise NotPlainError(f"found more than {MAX_INSTRUCTIONS} instructions")
            if frame_end and begin >= frame_end:
                if begin > frame_end:
                    raise NotPlainError("found a pickle whose frames are cut off")
                frame_end = 0
            if instruction.name == "FRAME":
                frame_end = begin + FRAME_BYTES + (argument or 0)
                if frame_end > len(data):
                    raise NotPlainError("found a pickle that is cut off")
            if instruction.name == "PROTO" and not 0 <= (argument or 0) <= pickle.HIGHEST_PROTOCOL:
                raise NotPlainError(f"found a pickle of protocol {argument}")
            if instruction.name == "STOP":
                return machine.finished()
            machine.carry_out(instruction.name, argument)
    except NotPlainError:
        raise
    except (ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise NotPlainError(
            f"found a broken pickle: {' '.join(str(error).split())[:100]}"
        ) from None
    raise NotPlainError("found a pickle without an end")


class _Machine:
    """The stack and the memory of a pickle's machine."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.memory: dict[int, Any] = {}

    def finished(self) -> Any:
        """The value that is left at the end."""
        return _complete(self.stack.pop())

    def carry_out(self, name: str, argument: Any) -> None:
        """One instruction."""
        if name in _PUSHED:
            self.stack.append(argument)
        elif name in _CONSTANTS:
            self.stack.append(_CONSTANTS[name]())
        elif name in ("PUT", "BINPUT", "LONG_BINPUT"):
            self.memory[int(argument)] = self.stack[-1]
        elif name == "MEMOIZE":
            self.memory[len(self.memory)] = self.stack[-1]
        elif name in ("GET", "BINGET", "LONG_BINGET"):
            self.stack.append(self.memory[int(argument)])
        elif name not in ("PROTO", "FRAME"):
            found: Callable[[], None] | None = getattr(self, f"_{name.lower()}", None)
            if found is not None:
                found()
            elif name == "GLOBAL":
                self.stack.append(_named(*argument.split(" ", 1)))
            else:
                raise NotPlainError(f"found the instruction {name}, which data do not need")

    def _since_mark(self) -> list[Any]:
        """Take what was put on the stack since the last mark, and the mark, too."""
        at = len(self.stack) - 1
        while self.stack[at] is not _MARK:
            at -= 1
            if at < 0:
                raise NotPlainError("found a broken pickle: a mark is missing")
        found = [_complete(value) for value in self.stack[at + 1 :]]
        del self.stack[at:]
        return found

    def _pop_value(self) -> Any:
        return _complete(self.stack.pop())

    def _mark(self) -> None:
        self.stack.append(_MARK)

    def _pop(self) -> None:
        self.stack.pop()

    def _pop_mark(self) -> None:
        self._since_mark()

    def _dup(self) -> None:
        self.stack.append(self.stack[-1])

    def _tuple(self) -> None:
        self.stack.append(tuple(self._since_mark()))

    def _tuple1(self) -> None:
        self.stack.append((self._pop_value(),))

    def _tuple2(self) -> None:
        two, one = self._pop_value(), self._pop_value()
        self.stack.append((one, two))

    def _tuple3(self) -> None:
        three, two, one = self._pop_value(), self._pop_value(), self._pop_value()
        self.stack.append((one, two, three))

    def _list(self) -> None:
        self.stack.append(self._since_mark())

    def _dict(self) -> None:
        found = self._since_mark()
        self.stack.append(_dictionary(found))

    def _frozenset(self) -> None:
        self.stack.append(frozenset(map(_key, self._since_mark())))

    def _append(self) -> None:
        value = self._pop_value()
        _own(self.stack[-1], list).append(value)

    def _appends(self) -> None:
        found = self._since_mark()
        if not isinstance(self.stack[-1], Opaque):
            _own(self.stack[-1], list).extend(found)

    def _additems(self) -> None:
        found = self._since_mark()
        _own(self.stack[-1], set).update(map(_key, found))

    def _setitem(self) -> None:
        value, key = self._pop_value(), self._pop_value()
        if not isinstance(self.stack[-1], Opaque):
            _own(self.stack[-1], dict).update(_dictionary([key, value]))

    def _setitems(self) -> None:
        found = self._since_mark()
        if not isinstance(self.stack[-1], Opaque):
            _own(self.stack[-1], dict).update(_dictionary(found))

    def _stack_global(self) -> None:
        name, module = self._pop_value(), self._pop_value()
        self.stack.append(_named(module, name))

    def _reduce(self) -> None:
        given = _own(self._pop_value(), tuple)
        self.stack.append(_made(self.stack.pop(), given))

    def _newobj(self) -> None:
        self._reduce()

    def _newobj_ex(self) -> None:
        self._pop_value()
        self._reduce()

    def _build(self) -> None:
        state = self._pop_value()
        unfinished = self.stack[-1]
        if isinstance(unfinished, _Array):
            if state[0] != ARRAY_VERSION:
                raise NotPlainError(f"found arrays of version {state[0]!r:.20}, expected 1")
            built = _array_of(*state[1:])
        elif isinstance(unfinished, _Type):
            if state[0] not in TYPE_VERSIONS:
                raise NotPlainError(f"found types of version {state[0]!r:.20}, expected 3 or 4")
            built = _type_of(unfinished.code, state[1])
            # Numpy takes a number with forged flags for a reference, and breaks.
            own = np.dtype(unfinished.code).__reduce__()[2]
            whole = len(state) == TYPE_VERSIONS[state[0]] and state[1] in BYTE_ORDERS
            if not whole or tuple(state[2:8]) != own[2:8]:
                raise NotPlainError(f"found a type {unfinished.code} that is not numpy's own")
        elif isinstance(unfinished, Opaque):
            return  # it stays what it is
        else:
            raise NotPlainError(f"found a state of a {type(unfinished).__name__}, which has none")
        # The memory holds the same unfinished object, and must hold the finished one.
        self.stack[-1] = built
        for number, kept in self.memory.items():
            if kept is unfinished:
                self.memory[number] = built


_PUSHED: Final = frozenset(
    {"INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "STRING", "BINSTRING",
     "SHORT_BINSTRING", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8", "UNICODE",
     "SHORT_BINUNICODE", "BINUNICODE", "BINUNICODE8", "FLOAT", "BINFLOAT"}
)  # fmt: skip
"""Instructions that put their argument on the stack."""

_CONSTANTS: Final[dict[str, Callable[[], Any]]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_LIST": list,
    "EMPTY_TUPLE": tuple,
    "EMPTY_DICT": dict,
    "EMPTY_SET": set,
}


def _own(value: Any, kind: type | UnionType) -> Any:
    """A container of the machine's own, which its instructions may change."""
    if not isinstance(value, kind):
        name = getattr(kind, "__name__", str(kind))
        raise NotPlainError(f"found {type(value).__name__} where data have a {name}")
    return value


def _key(value: Any) -> Any:
    """A key or member: tuples in tuples would take for ever to hash where a pickle repeats them."""
    plain = value if isinstance(value, tuple) else (value,)
    if not all(isinstance(part, str | bytes | int | float | None) for part in plain):
        raise NotPlainError(f"found a {type(value).__name__} as a key, expected a word or a number")
    return value


def _dictionary(found: list[Any]) -> dict[Any, Any]:
    """A dictionary from keys and values in turn."""
    return {_key(k): value for k, value in zip(found[::2], found[1::2], strict=True)}


def _named(module: Any, name: Any) -> Any:
    """The value of a name: a word for the few names that data need, else an `Opaque`."""
    if not isinstance(module, str) or not isinstance(name, str):
        raise NotPlainError("found a name that is no word")
    plain = f"{'builtins' if module == '__builtin__' else module} {name}"
    return plain if plain in _MAKERS else Opaque(plain)


def _made(name: Any, given: tuple[Any, ...]) -> Any:
    """The value of a call in the pickle."""
    if isinstance(name, Opaque):
        return name
    if not isinstance(name, str) or name not in _MAKERS:
        raise NotPlainError("found a call of something that is no name")
    return _MAKERS[name](*given)


def _complete(value: Any) -> Any:
    """A value that is whole: types that were never given a byte order are the machine's own."""
    if isinstance(value, _Type):
        return _type_of(value.code, "=")
    if isinstance(value, _Array):
        raise NotPlainError("found an array without values")
    return value


def _type_of(code: str, order: str) -> np.dtype[Any]:
    """A numpy type of plain data."""
    if code == "O8":
        return np.dtype(object)
    found = np.dtype(code)
    if found.kind not in PLAIN_KINDS or found.itemsize == 0:
        raise NotPlainError(f"found an array of {code}, expected numbers or words")
    return found.newbyteorder(">") if order == ">" else found


def _array_of(shape: Any, kind: Any, by_columns: Any, values: Any) -> Any:
    """An array from its bytes, or from a list of plain values."""
    sizes = _own(shape, tuple)
    if not all(isinstance(size, int) and size >= 0 for size in sizes):
        raise NotPlainError("found an array with a side that is no number or negative")
    if kind.kind == "O":
        return list(_own(values, list))
    flat = np.frombuffer(_bytes(values), dtype=kind)
    return flat.reshape(sizes, order="F" if by_columns else "C").copy()


def _bytes(values: Any) -> bytes:
    if isinstance(values, bytearray):
        return bytes(values)
    return bytes(_own(values, bytes))


def _unfinished(kind: Any, shape: Any, code: Any) -> _Array:
    """What an array's state is told to; numpy begins with no bytes."""
    if kind != "numpy ndarray" or shape != (0,) or code not in ("b", b"b"):
        raise NotPlainError("found an array that does not begin as numpy's do")
    return _Array()


def _unordered(code: Any) -> _Type:
    """A type of which the byte order comes later."""
    _type_of(_own(code, str), "=")
    return _Type(code)


def _scalar(kind: Any, values: Any = b"") -> Any:
    """A numpy number as Python's own."""
    if kind.kind == "O":
        raise NotPlainError("found a number of unknown type")
    return np.frombuffer(_bytes(values), dtype=kind)[0].item()


def _encoded(text: Any, how: Any = "latin1") -> bytes:
    """Bytes as old pickles have them: as words in Latin-1."""
    if how not in ("latin1", "latin-1"):
        raise NotPlainError(f"found words in {how!r}, expected latin1")
    return str(_own(text, str)).encode("latin1")


def _values(*given: Any) -> list[Any]:
    return list(given[0]) if given else []


def _pairs(*given: Any) -> dict[Any, Any]:
    return _dictionary([part for pair in _values(*given) for part in _own(pair, list | tuple)[:2]])


_MAKERS: Final[dict[str, Callable[..., Any]]] = {
    "_codecs encode": _encoded,
    "builtins set": lambda *given: set(map(_key, _values(*given))),
    "builtins frozenset": lambda *given: frozenset(map(_key, _values(*given))),
    "builtins list": _values,
    "builtins tuple": lambda *given: tuple(_values(*given)),
    "builtins dict": _pairs,
    "builtins bytes": lambda *given: _bytes(given[0]) if given else b"",
    "builtins bytearray": lambda *given: bytearray(_bytes(given[0]) if given else b""),
    "collections OrderedDict": _pairs,
    "collections defaultdict": lambda *given: {},
    "numpy ndarray": lambda *given: _Array(),
    "numpy dtype": lambda code, align=False, copy=True: _unordered(code),
}
"""What calls of these names make."""

for _core in ("numpy.core", "numpy._core"):
    _MAKERS[f"{_core}.multiarray _reconstruct"] = _unfinished
    _MAKERS[f"{_core}.multiarray scalar"] = _scalar
    _MAKERS[f"{_core}.numeric _frombuffer"] = lambda values, kind, shape, order: _array_of(
        shape, kind, order == "F", values
    )
