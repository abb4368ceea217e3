"""Pickles as data: what they name is noted, nothing is imported, and nothing is called.

A pickle is a program that names functions and calls them, so that one from a stranger runs
anything. Here its instructions only put together numbers, texts, lists and notes of what would have
been made of what (`Made`), of which `array` takes the numbers of NumPy's arrays.

Source: Python, `Lib/pickletools.py`, which describes each instruction.
"""

import math
import pickletools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from maidenflight import budget


@dataclass(frozen=True)
class Name:
    """A class or function that a pickle names, by its module and its own name."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"


@dataclass(eq=False)
class Made:
    """What a pickle would have made: a call of what it names, and what it put into the result."""

    of: Any
    """A `Name`, of what pickles hold that are sound."""
    arguments: Any
    state: Any = None
    entries: dict[Any, Any] = field(default_factory=dict)
    """Of a dictionary, such as an `OrderedDict`."""

    @property
    def name(self) -> str:
        """Returns what was to be called, as MODULE.NAME."""
        return str(self.of)


_MARK: Any = object()
_LITERALS = {
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
    *("STRING", "BINSTRING", "SHORT_BINSTRING", "UNICODE", "BINUNICODE", "SHORT_BINUNICODE"),
    *("BINUNICODE8", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
}
"""Instructions that put their own argument on the stack."""
_VALUES: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_LIST": list,
    "EMPTY_TUPLE": tuple,
    "EMPTY_DICT": dict,
    "EMPTY_SET": list,
}
_OF_MARKED: dict[str, Callable[[list[Any]], Any]] = {
    "LIST": list,
    "TUPLE": tuple,
    "FROZENSET": list,
    "DICT": lambda items: dict(zip(items[::2], items[1::2], strict=True)),
    "OBJ": lambda items: Made(items[0], tuple(items[1:])),
}
"""What is made of all above the last mark."""
_OF_COUNT: dict[str, tuple[int, Callable[..., Any]]] = {
    "TUPLE1": (1, lambda *items: items),
    "TUPLE2": (2, lambda *items: items),
    "TUPLE3": (3, lambda *items: items),
    "STACK_GLOBAL": (2, lambda module, name: Name(str(module), str(name))),
    "REDUCE": (2, Made),
    "NEWOBJ": (2, Made),
    "NEWOBJ_EX": (3, lambda of, arguments, _: Made(of, arguments)),
    "BINPERSID": (1, lambda key: Made(Name("pickle", "persistent_load"), key)),
}
"""What is made of so many, the newest last."""


class _Reader:
    """A stack of values, and what was memorised of them."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.memory: dict[int, Any] = {}

    def pop(self, count: int) -> list[Any]:
        """Takes the newest values."""
        if len(self.stack) < count:
            raise ValueError("a value is missing")
        taken = self.stack[-count:]
        del self.stack[-count:]
        return taken

    def pop_marked(self) -> list[Any]:
        """Takes what lies above the last mark."""
        start = len(self.stack) - 1
        while self.stack[start] is not _MARK:
            start -= 1
        taken = self.stack[start + 1 :]
        del self.stack[start:]
        return taken

    def put_in(self, items: list[Any], pairs: bool) -> None:
        """Puts items into the list, or pairs into the dictionary, that is the newest value."""
        container = self.stack[-1]
        entries = container.entries if isinstance(container, Made) else container
        if pairs and isinstance(entries, dict):
            entries.update(zip(items[::2], items[1::2], strict=True))
        elif not pairs and isinstance(entries, list):
            entries.extend(items)
        elif pairs or not isinstance(container, Made):
            raise ValueError("items for what holds none")

    def follow(self, code: str, argument: Any) -> None:
        """Follows one instruction.

        Raises:
            ValueError: no file that is read here has such an instruction.
        """
        stack = self.stack
        if code in _LITERALS:
            stack.append(argument)
        elif code in _VALUES:
            stack.append(_VALUES[code]())
        elif code in _OF_MARKED:
            stack.append(_OF_MARKED[code](self.pop_marked()))
        elif code in _OF_COUNT:
            count, make = _OF_COUNT[code]
            stack.append(make(*self.pop(count)))
        elif code in ("GLOBAL", "INST"):
            made = Name(*argument.split(" ", 1))
            stack.append(made if code == "GLOBAL" else Made(made, tuple(self.pop_marked())))
        elif code == "MARK":
            stack.append(_MARK)
        elif code in ("APPEND", "SETITEM"):
            self.put_in(self.pop(1 + (code == "SETITEM")), code == "SETITEM")
        elif code in ("APPENDS", "ADDITEMS", "SETITEMS"):
            self.put_in(self.pop_marked(), code == "SETITEMS")
        elif code == "BUILD":
            (state,) = self.pop(1)
            if not isinstance(stack[-1], Made):
                raise ValueError("a state for what has none")
            stack[-1].state = state
        elif code in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
            self.memory[len(self.memory) if code == "MEMOIZE" else argument] = stack[-1]
        elif code in ("GET", "BINGET", "LONG_BINGET"):
            stack.append(self.memory[argument])
        elif code not in ("PROTO", "FRAME", "STOP"):
            raise ValueError(f"the instruction {code}")


def read_pickle(content: bytes) -> Any:
    """Returns what a pickle holds: numbers, texts, lists, tuples, dictionaries and `Made`.

    Raises:
        ValueError: it is damaged, or has more instructions than `budget.PICKLE` allows.
    """
    reader = _Reader()
    try:
        instructions = pickletools.genops(budget.PICKLE.allow(content))
        for count, (code, argument, _) in enumerate(instructions):
            budget.PICKLE.check("instructions", count)
            reader.follow(code.name, argument)
        (value,) = reader.stack
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"not a pickle that is read ({error!s:.120})") from error
    return value


_ARRAYS = ("numpy._core.multiarray._reconstruct", "numpy.core.multiarray._reconstruct")
_BUFFERS = ("numpy._core.numeric._frombuffer", "numpy.core.numeric._frombuffer")
_SCALARS = ("numpy._core.multiarray.scalar", "numpy.core.multiarray.scalar")
_KINDS = {"f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "b1"}


def array(value: Any) -> np.ndarray:
    """Returns the array, or the number, that a pickle of NumPy's holds.

    Raises:
        ValueError: it is none of numbers, or is damaged.
    """
    if isinstance(value, int | float):
        return np.asarray(value)
    try:
        if value.name in _ARRAYS:
            _, shape, kind, fortran, raw = value.state
            order = "F" if fortran else "C"
        elif value.name in _BUFFERS:
            raw, kind, shape, order = value.arguments
        elif value.name in _SCALARS:
            (kind, raw), shape, order = value.arguments, (), "C"
        else:
            raise ValueError(value.name)
        flat = np.frombuffer(_bytes(raw), _dtype(kind))
        if order not in ("C", "F") or math.prod(map(int, shape)) != len(flat):
            raise ValueError("its shape is another")
        return flat.reshape(shape, order=order)
    except (ValueError, TypeError, AttributeError, LookupError) as error:
        raise ValueError(f"no array of numbers ({error!s:.80})") from error


def _bytes(value: Any) -> bytes:
    """Bytes, which old pickles hold as a text and its encoding."""
    if isinstance(value, Made) and value.name == "_codecs.encode":
        value = value.arguments[0]
    elif isinstance(value, Made) and value.name == "__builtin__.bytes":
        value = "".join(value.arguments)
    if isinstance(value, str):
        return value.encode("latin1")
    if not isinstance(value, bytes | bytearray):
        raise ValueError("no bytes")
    return bytes(value)


def _dtype(kind: Made) -> np.dtype:
    """The kind of an array's numbers."""
    (name, *_), (_, order, *_) = kind.arguments, kind.state
    if kind.name != "numpy.dtype" or name not in _KINDS or order not in ("<", ">", "|"):
        raise ValueError(f"numbers of kind {name!r:.20}")
    return np.dtype(f"{order}{name}")
