"""Reading of text, JSON and TOML that users give.

The functions raise the exceptions of the standard library. Unlike it, they refuse pipes and
devices, which may never end, refuse a key that occurs twice in an object, and report text that is
nested too deep as any other error of the text.
"""

import errno
import json
import os
import tomllib
from itertools import takewhile
from pathlib import Path
from typing import Any

StrPath = str | os.PathLike[str]
"""A path as a user gives it."""


def content(path: StrPath) -> bytes:
    """The bytes of a file.

    Raises:
        OSError: it cannot be read, or is a pipe, a socket or a device.
    """
    return _ordinary(path).read_bytes()


def _ordinary(path: StrPath) -> Path:
    path = Path(path)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise OSError(errno.EINVAL, "neither a file nor a link to one")
    return path


def text(path: StrPath) -> str:
    """Text of a file in UTF-8, lines ended by a line feed.

    Raises:
        OSError: see `content`.
        UnicodeDecodeError: not UTF-8.
    """
    return content(path).decode("utf-8").replace("\r\n", "\n")


def comments(path: StrPath) -> list[str]:
    """The lines that a file in UTF-8 begins with, each with a "#" before it; the rest is not read.

    Raises:
        OSError: see `content`.
        UnicodeDecodeError: not UTF-8.
    """
    path = _ordinary(path)
    with path.open(encoding="utf-8") as file:
        return [line.rstrip("\n") for line in takewhile(lambda line: line.startswith("#"), file)]


def from_json(text: str) -> Any:
    """The content of a JSON text.

    Raises:
        ValueError: not JSON, a key stands twice in an object, or nested too deep.
    """
    try:
        return json.loads(text, object_pairs_hook=_once)
    except RecursionError as error:
        raise ValueError("nested too deep") from error


def from_toml(text: str) -> dict[str, Any]:
    """The content of a TOML text.

    Raises:
        ValueError: not TOML, or nested too deep.
    """
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deep") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{twice[:40]!r} is there twice in one object")
    return found
