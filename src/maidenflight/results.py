"""Result files: written whole or not at all, with a record of how they were made.

A record never holds the time of day, a host name or an absolute path, so the same seed gives the
same bytes.
"""

import hashlib
import json
import os
import re
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from maidenflight import __version__, cache, inputs
from maidenflight.errors import InputError, WriteError, printable
from maidenflight.inputs import StrPath

_LEFTOVER = re.compile(r"\..+\.[a-z0-9_]{8}\.part")
_RECORD = "# record: "
"""How the comment line begins by which a text file holds its record."""
_LOCK_TIMEOUT = 0.2
"""Longest wait for a lock that is just being released [s]."""


def write(path: StrPath, content: str | bytes) -> Path:
    """Writes a file atomically: even after a power cut it has its old content or the new.

    Args:
        path: where to write; missing folders are made.
        content: text (UTF-8, newlines as they are) or bytes.

    Returns:
        The path.

    Raises:
        WriteError: the folder or the file cannot be written; its former content stays.
    """
    path = Path(path)
    # Names of files need not be UTF-8; what is written always is.
    payload = content.encode(errors="replace") if isinstance(content, str) else content
    temporary: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, temporary = tempfile.mkstemp(
            prefix=f".{path.name}.", suffix=".part", dir=path.parent
        )
        with os.fdopen(descriptor, "wb") as file:
            file.write(payload)
            # Without this a power cut could leave the new name with none of the new content.
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        raise WriteError(path, error) from error
    finally:
        if temporary is not None:
            with suppress(OSError):
                os.unlink(temporary)
    return path


def claim(path: StrPath, timeout: float = _LOCK_TIMEOUT) -> Callable[[], None]:
    """Locks a place against other processes of this computer and user.

    Args:
        path: a file or a folder; it need not exist, and nothing is written to it.
        timeout: longest wait for another process [s].

    Returns:
        A function that releases the lock. The end of the process releases it too, even a kill.

    Raises:
        InputError: another process holds the lock.
    """
    from filelock import FileLock, Timeout

    folder = cache.find_private_folder("locks")
    if folder is None:
        return lambda: None
    file = folder / f"{hashlib.sha256(os.fsencode(Path(path).resolve())).hexdigest()[:16]}.lock"
    lock = FileLock(file, timeout, mode=0o600, thread_local=False, fallback_to_soft=False)
    try:
        lock.acquire()
    except Timeout:
        raise InputError(
            f"{path}: another maidenflight is writing there. Wait for it, or choose another place "
            "with -o."
        ) from None
    except (OSError, NotImplementedError):  # no file system for locks
        return lambda: None

    def release() -> None:
        # Removed while it is locked: who waits for the old file finds it gone and tries again.
        with suppress(OSError):
            file.unlink()
        lock.release()

    return release


def remove_older(written: Sequence[StrPath], record: Mapping[str, Any]) -> None:
    """Removes tables that an earlier run of the same kind left beside those just written.

    Args:
        written: CSV files of one folder.
        record: how they were made; what an earlier run wrote has a record that names the same
            settings.
    """
    new_files = {Path(path) for path in written}
    folders = {path.parent for path in new_files}
    for path in {table for folder in folders for table in folder.glob("*.csv")} - new_files:
        settings = read_record(path).get("settings")
        if isinstance(settings, dict) and settings.keys() == record["settings"].keys():
            path.unlink()


def leftovers(folder: StrPath) -> list[Path]:
    """Returns files in a folder that `write` was killed over; nothing will ever read them."""
    return [path for path in Path(folder).glob(".*") if _LEFTOVER.fullmatch(path.name)]


def digest(path: StrPath) -> str:
    """Returns the first 16 hexadecimal digits of a file's SHA-256."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def record(
    *, seed: int | None, inputs: Sequence[StrPath], settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Returns how a result was made, as its file records it.

    Args:
        seed: the random seed, `None` where no randomness was used.
        inputs: the files read; recorded by name and hash, not by place.
        settings: every setting that shapes the result, plain values only.

    Returns:
        Plain dictionaries, ready for TOML or JSON: `version`, `seed`, `inputs` (name and hash),
        `settings`.
    """
    content: dict[str, Any] = {"version": __version__}
    if seed is not None:
        content["seed"] = seed
    if inputs:
        content["inputs"] = [f"{Path(path).name} sha256:{digest(path)}" for path in inputs]
    content["settings"] = {name: value for name, value in settings.items() if value is not None}
    return _printable(content)


def _printable(value: Any) -> Any:
    """Replaces bytes of names that are no UTF-8, which no file in UTF-8 can hold."""
    if isinstance(value, Mapping):
        return {name: _printable(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_printable(entry) for entry in value]
    return printable(value) if isinstance(value, str) else value


def recorded_inputs(record: Mapping[str, Any], source: str) -> dict[str, str]:
    """Returns the files that a record names: their names by the digest of their content.

    Args:
        record: as `record` made it.
        source: the file that holds it, for errors.

    Raises:
        InputError: its `inputs` are no list of names with digests.
    """
    entries = record.get("inputs", [])
    if not isinstance(entries, list):
        entries = [entries]
    digests = {}
    for entry in entries:
        name, mark, digest = str(entry).rpartition(" sha256:")
        if not isinstance(entry, str) or not mark:
            raise InputError(
                f"{source}: its record names the input {str(entry)[:40]!r}, expected 'NAME "
                "sha256:DIGEST'. Write the file again, or remove its record."
            )
        digests[digest] = name
    return digests


def record_line(record: Mapping[str, Any] | None) -> str:
    """Returns the comment line by which a text file holds its record; `parse_record` reads it."""
    return f"{_RECORD}{json.dumps(dict(record or {}))}"


def table_text(heading: str, record: Mapping[str, Any], rows: str) -> str:
    """Returns the text of a table with comments above it: what it is, and its record.

    Args:
        heading: what the table is, beginning with "# ".
        record: how it was made.
        rows: the CSV's text.
    """
    return f"{heading}\n{record_line(record)}\n{rows}"


def parse_record(lines: Iterable[str], path: StrPath) -> dict[str, Any]:
    """Returns the record in the comment lines of a file; empty where there is none.

    Raises:
        InputError: it is no JSON object; `path` is the file.
    """
    line = next((line for line in lines if line.startswith(_RECORD)), f"{_RECORD}{{}}")
    with suppress(ValueError):
        record = inputs.from_json(line.removeprefix(_RECORD))
        if isinstance(record, dict):
            return record
    raise InputError(f"{path}: the line {line[:40]!r} holds no valid JSON. Write '{_RECORD}{{}}'.")


def read_record(path: StrPath) -> dict[str, Any]:
    """Returns the record in the comments of a CSV file; empty where it cannot be read."""
    with suppress(OSError, ValueError):
        return parse_record(inputs.comments(path), path)
    return {}
