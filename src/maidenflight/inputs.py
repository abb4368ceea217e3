"""Reading files: their bytes, text, JSON and TOML, and tables whose entries are checked.

The functions have the exceptions of the standard library. Unlike it they refuse pipes and devices
instead of waiting for them, and a key that an object has twice instead of taking the last one;
brackets a thousand deep are an error of the text like any other.
"""

import errno
import gzip
import json
import os
import re
import tomllib
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from maidenflight import budget
from maidenflight.budget import Budget
from maidenflight.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from jax import Array

LARGEST = 3.4e38
"""What no number of a file exceeds; float32 reaches a little further."""
GZIP = b"\x1f\x8b"
"""How a gzip file begins."""
_DOTTED = re.compile(
    r"""(?<![\w".'-])(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
    r"""(?:[ \t]*+\.[ \t]*+(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')){16,}+"""
)
"""A key of many names, which Python's `tomllib` takes the square of their number for."""
StrPath = str | os.PathLike[str]
"""A path as a user gives it."""
PATHS = (str, os.PathLike)
"""The types of one, for `isinstance`."""


def content(path: StrPath, limits: Budget) -> bytes:
    """Returns the bytes of a file of a kind.

    Raises:
        OSError: it cannot be read, or is a pipe, a socket or a device.
        ValueError: it is longer than such files may be.
    """
    with _ordinary(path).open("rb") as file:
        limits.check("bytes", os.fstat(file.fileno()).st_size)
        return file.read()


def blocks(path: StrPath, size: int) -> Iterator[bytes]:
    """Reads the bytes of a file, decompressed if it is a gzip file, some at a time.

    Args:
        path: the file.
        size: bytes at a time, at most.

    Raises:
        ValueError: it is longer than a log, or grows more than one does.
        EOFError: it is cut off.
        OSError, zlib.error: it is damaged, or see `content`.
    """
    with _ordinary(path).open("rb") as file:
        packed = file.read(len(GZIP)) == GZIP
        file.seek(0)
        length = os.fstat(file.fileno()).st_size
        budget.LOG.check("bytes", length)
        if packed:
            yield from _unpack(file, length, size)
        else:
            yield from iter(lambda: file.read(size), b"")


def _unpack(file: BinaryIO, packed: int, size: int) -> Iterator[bytes]:
    plain = 0
    with gzip.GzipFile(fileobj=file) as unpacked:
        for block in iter(lambda: unpacked.read(size), b""):
            plain += len(block)
            budget.LOG.check_growth(packed, plain)
            yield block


def beginning(path: StrPath, count: int) -> bytes:
    """Returns the first bytes of a file.

    Args:
        path: of the file.
        count: bytes to read at most.

    Raises:
        OSError: see `content`.
    """
    with _ordinary(path).open("rb") as file:
        return file.read(count)


def _ordinary(path: StrPath) -> Path:
    path = Path(path)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise OSError(errno.EINVAL, "neither a file nor a link to one")
    return path


def text(path: StrPath, limits: Budget) -> str:
    """Returns the text of a file in UTF-8, lines ended by a line feed.

    Raises:
        OSError, ValueError: see `content`.
        UnicodeDecodeError: not UTF-8.
    """
    return content(path, limits).decode("utf-8").replace("\r\n", "\n")


def readable(path: StrPath, limits: Budget, kind: str = "text") -> str:
    """Returns the text of a file that a user gives.

    Args:
        path: the file.
        limits: of such files.
        kind: what it should be, for the error.

    Raises:
        InputError: it cannot be read.
    """
    try:
        return text(path, limits)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as {kind} ({error}).") from error


def toml_file(path: StrPath, kind: str, cure: str) -> dict[str, Any]:
    """Returns the content of a TOML file that a user gives.

    Args:
        path: the file.
        kind: what it should be, for the error.
        cure: what to do where it is not, as a sentence.

    Raises:
        InputError: it cannot be read, or is not TOML.
    """
    try:
        return from_toml(text(path, budget.TOML))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as {kind} ({error}). {cure}") from error


def json_file(path: StrPath, cure: str) -> Any:
    """Returns the content of a JSON file of ours; the error has a cure.

    Raises:
        InputError: it cannot be read, or is not JSON.
    """
    content = readable(path, budget.JSON)
    try:
        return from_json(content)
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON ({error}). {cure}") from error


def comments(path: StrPath) -> list[str]:
    """Returns the lines that a file in UTF-8 begins with, each with a "#" before it.

    The rest is not read.

    Raises:
        OSError: see `content`.
        ValueError: not UTF-8, or longer than comments are.
    """
    lines: list[str] = []
    most, total = budget.COMMENTS.limits["bytes"], 0
    with _ordinary(path).open(encoding="utf-8") as file:
        while (line := file.readline(most + 1)).startswith("#"):
            lines.append(line.rstrip("\n"))
            total += len(line)
            budget.COMMENTS.check("bytes", total)
    return lines


def from_json(text: str) -> Any:
    """Returns the content of a JSON text.

    Raises:
        ValueError: not JSON, a key stands twice in an object, or nested too deep.
    """
    try:
        return json.loads(text, object_pairs_hook=_once)
    except RecursionError as error:
        raise ValueError("nested too deep") from error


def numbers(nested: Any) -> "np.ndarray":
    """Converts nested lists to an array, in which true and false do not pass for 1 and 0.

    Raises:
        ValueError: a list holds one of them, or lists of different lengths.
    """
    import numpy as np

    array = np.asarray(nested)
    if array.dtype.kind in "fiu" and any(
        type(entry) is bool for entry in np.asarray(nested, object).flat
    ):
        raise ValueError("expected numbers, not true or false")
    return array


def from_toml(text: str) -> dict[str, Any]:
    """Returns the content of a TOML text.

    Raises:
        ValueError: not TOML, nested too deep, or with a key of too many names.
    """
    budget.TOML.check("bytes", len(text))
    dots = max((key.group().count(".") for key in _DOTTED.finditer(text)), default=0)
    budget.TOML.check("names in a dotted key", dots + 1)
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deep") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        twice = Counter(name for name, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"{twice[:40]!r} is there twice in one object")
    return content


class Fields:
    """Entries of a TOML table or a JSON object, taken and checked one by one.

    Every method that takes an entry raises InputError where it is missing or of another kind.
    """

    def __init__(self, content: Any, source: str, title: str, cure: str):
        """Begins with the content of a file's table of that title; errors have the cure.

        Raises:
            InputError: it is no table.
        """
        self.content: dict[str, Any] = content
        self._where, self._title, self._cure = source, title, cure
        self._taken: set[str] = set()
        if not isinstance(content, dict):
            raise InputError(
                f"{source}: {title} is {str(content)[:40]!r}, expected a table [{title}]. {cure}"
            )

    def refused(self, name: str, expected: str) -> InputError:
        """Returns the error of an entry."""
        value = str(self.content[name])[:40] if name in self.content else "missing"
        return InputError(
            f"{self._where}: [{self._title}] {name} is {value}, expected {expected}. {self._cure}"
        )

    def get(self, name: str, usual: Any = None) -> Any:
        """Returns an entry as it is, the usual one where there is none."""
        self._taken.add(name)
        return self.content.get(name, usual)

    def table(self, name: str) -> "Fields":
        """Returns a table in it."""
        if name not in self.content:
            raise self.refused(name, "a table")
        return Fields(self.get(name), self._where, f"{self._title}.{name}", self._cure)

    def tables(self, name: str) -> list["Fields"]:
        """Returns the tables of an array in it; none where it is missing."""
        entries = [] if name not in self.content else self.get(name)
        if not isinstance(entries, list):
            raise self.refused(name, f"tables [[{self._title}.{name}]]")
        return [Fields(each, self._where, f"{self._title}.{name}", self._cure) for each in entries]

    def text(self, name: str) -> str:
        """Returns a text."""
        value = self.get(name)
        if not isinstance(value, str):
            raise self.refused(name, "a text")
        return value

    def texts(self, name: str, counts: Collection[int]) -> tuple[str, ...]:
        """Returns a list of texts, of one of some lengths."""
        value = self.get(name)
        sound = isinstance(value, list) and len(value) in counts
        if not sound or not all(isinstance(text, str) for text in value):
            raise self.refused(name, f"a list of {' or '.join(map(str, counts))} texts")
        return tuple(value)

    def choice(self, name: str, known: Collection[str], usual: str | None = None) -> str:
        """Returns one of some texts; the usual one where it is missing, if there is one."""
        value = self.get(name, usual)
        if not isinstance(value, str) or value not in (*known, usual):
            raise self.refused(name, " or ".join(map(repr, known)))
        return value

    def flag(self, name: str) -> bool:
        """Reads true or false."""
        value = self.get(name)
        if not isinstance(value, bool):
            raise self.refused(name, "true or false")
        return value

    def count(self, name: str) -> int:
        """Returns a whole number from 1 to a billion."""
        value = self.get(name)
        if type(value) is not int or not 1 <= value <= 10**9:
            raise self.refused(name, "a whole number from 1 on")
        return value

    def number(
        self,
        name: str,
        low: float = -LARGEST,
        high: float = LARGEST,
        usual: float | None = None,
    ) -> float:
        """Returns a finite number within two others; the usual one where it is missing, if any."""
        value = self.get(name, usual)
        if not is_number(value) or not low <= value <= high:
            raise self.refused(name, "a number" if low == -LARGEST else f"{low:g} to {high:g}")
        return float(value)

    def numbers(self, name: str, count: int | None = None) -> tuple[float, ...]:
        """Reads finite numbers, at least one, or so many."""
        value = self.get(name)
        if not isinstance(value, list) or not value or not all(map(is_number, value)):
            raise self.refused(name, "a list of numbers")
        if count not in (None, len(value)):
            raise self.refused(name, f"{count} numbers")
        return tuple(map(float, value))

    def ends(self, name: str) -> tuple[float, float]:
        """Returns a lower and an upper number."""
        value = self.numbers(name)
        if len(value) != 2 or value[0] > value[1]:
            raise self.refused(name, "[lower, upper]")
        return value[0], value[1]

    def end(self) -> None:
        """Refuses entries that nobody took, such as a misspelt one."""
        for name in self.content:
            if name not in self._taken:
                raise self.refused(name, "no such entry")


def is_number(value: Any) -> bool:
    """Returns whether a value is a finite number that float32 can hold."""
    return type(value) in (int, float) and -LARGEST <= value <= LARGEST


def random_key(key: "Array | int | None") -> "Array":
    """Returns JAX's random key of a whole number, 0 by default; a key as it is."""
    import jax

    return jax.random.key(key or 0) if key is None or isinstance(key, int) else key
