"""What a recording may do to its reader: databases that compute, chunks that grow, names in code.

`rosbags` asks a database what is in its tables, unpacks chunks as far as they go, and makes Python
code of the definitions of messages.

Source: rosbags 0.11, `rosbag2/storage_mcap.py`, `rosbag2/storage_sqlite3.py`, `typesys/codegen.py`;
SQLite, documentation of generated columns and of `sqlite_schema`.
"""

import re
import sqlite3
import sys
from collections.abc import Mapping
from contextlib import closing
from importlib import import_module
from pathlib import Path
from typing import Any

from maidenflight import budget

_COMPUTED = re.compile(r"\b(as|virtual|generated|trigger|view)\b", re.IGNORECASE)
"""In the text of a table, what makes its content a computation without end."""
_TABLES = 100
_TYPE = re.compile(r"[A-Za-z]\w*(/[A-Za-z]\w*){1,3}", re.ASCII)
_FIELD = re.compile(r"[A-Za-z]\w*", re.ASCII)


def check_database(path: Path) -> None:
    """Refuses a database with more than tables of what was written into them.

    Raises:
        ValueError: it has.
        sqlite3.Error: it is damaged.
    """
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?immutable=1", uri=True)) as database:
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, budget.MESSAGE.limits["bytes"])
        parts = database.execute("SELECT type, name, sql FROM sqlite_schema").fetchmany(_TABLES)
    for kind, name, text in parts:
        if kind not in ("table", "index") or _COMPUTED.search(text or ""):
            raise ValueError(f"it computes {name}, as no recorder does")
    if len(parts) == _TABLES:
        raise ValueError(f"it has {_TABLES} tables or more")


def limit_chunks(path: Path) -> None:
    """Lets `rosbags` unpack a chunk as far as its head says, and that no further than a log."""
    del path
    reader: Any = import_module("rosbags.rosbag2.storage_mcap")
    reader.DECOMPRESSORS |= {"lz4": _lz4, "zstd": _zstd}


def _lz4(raw: bytes, size: int) -> bytes:
    budget.LOG.check_growth(len(raw), size)
    return import_module("lz4.frame").LZ4FrameDecompressor().decompress(raw, size + 1)


def _zstd(raw: bytes, size: int) -> bytes:
    budget.LOG.check_growth(len(raw), size)
    return _zstd_reader().decompress(raw, size + 1)


def _zstd_reader() -> Any:
    module = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
    return import_module(module).ZstdDecompressor()


def unpack_message(raw: bytes) -> bytes:
    """Returns a message of a bag that was compressed message by message.

    Raises:
        ValueError: it grows more than any does.
    """
    most = budget.MESSAGE.limits["bytes"]
    return budget.MESSAGE.allow(_zstd_reader().decompress(bytes(raw), most + 1))


def check_names(types: Mapping[str, Any]) -> None:
    """Refuses names of messages and fields that are more than names.

    Raises:
        ValueError: one is.
    """
    for name, (constants, fields) in types.items():
        names = [name for name, *_ in (*constants, *fields)]
        if not _TYPE.fullmatch(name) or not all(map(_FIELD.fullmatch, names)):
            raise ValueError(f"a definition of {name!r:.60} with names that are none")
