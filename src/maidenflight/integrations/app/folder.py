"""Files of the run folder as the page takes and gives them: nothing outside of it."""

import hashlib
import io
import os
import re
import tempfile
import zipfile
from collections.abc import AsyncIterator
from pathlib import Path

from maidenflight import results
from maidenflight.errors import InputError, WriteError

LOGS = "logs"
"""Where logs go that are dropped."""
LARGEST, MOST = 2**30, 1000
"""Bytes of a log, and logs, at most; ours."""
_JOINTS = re.compile(r"[:@+=,|;\s]")
"""What texts of settings join names and paths by."""


def confine(folder: Path, text: str) -> Path:
    """Returns the place in a folder that a text names; InputError where a part may be outside."""
    home = folder.resolve()
    for part in (*_JOINTS.split(text), text):
        # A name that cannot be printed may end where the system reads a zero.
        path = Path(os.path.realpath(home / part)) if part.isprintable() else home.parent
        if not path.is_relative_to(home):
            raise InputError(f"{part}: outside of this run folder. Copy it in, or name another.")
    return Path(os.path.realpath(home / text))


def find_file(folder: Path, name: str) -> Path:
    """Returns a file to download; InputError where it is none, hidden or outside."""
    path = confine(folder, name)
    if not path.is_file() or re.search(r"(^|/)\.", name):
        raise InputError(f"{name}: no such file in this run folder.")
    return path


def clean(name: str) -> str:
    """Returns a name with letters, digits and few signs; InputError where nothing is left."""
    plain = re.sub(r"[^\w. ()-]", "_", re.split(r"[/\\]", name)[-1]).strip(". ").lstrip("-")
    plain = plain if len(plain) < 80 else plain[:60] + plain[-12:]  # systems take 255 bytes
    if not plain.strip("_"):
        raise InputError(f"{name!r}: no name for a log. Rename it.")
    return plain


def find_logs(folder: Path) -> list[str]:
    """Lists the names of the logs that were dropped."""
    logs_folder = folder / LOGS
    entries = sorted(logs_folder.iterdir()) if logs_folder.is_dir() else []
    return [entry.name for entry in entries if entry.is_file() and not entry.name.startswith(".")]


async def receive(folder: Path, name: str, content: AsyncIterator[bytes], size: int) -> str:
    """Writes a log that is dropped, of `size` bytes as it says; one that is there stays.

    Returns its name; InputError where it is too large, one too many, or cannot be written.
    """
    plain, logs_folder = clean(name), confine(folder, LOGS)
    too_large = InputError(f"{plain}: larger than {LARGEST // 2**20} MiB, which no log is.")
    if len(find_logs(folder)) >= MOST:
        raise InputError(f"{plain}: {MOST} logs are here, which is the most. Remove some.")
    if size > LARGEST:
        raise too_large
    try:
        logs_folder.mkdir(exist_ok=True)
        # Named as what `results.write` is killed over, so that nothing reads what is not whole.
        parts = {"prefix": f".{plain}.", "suffix": ".part", "dir": logs_folder}
        with tempfile.NamedTemporaryFile(**parts) as file:
            count, digest = 0, hashlib.sha256()
            async for part in content:
                count += len(part)
                if count > LARGEST:
                    raise too_large
                digest.update(part)
                file.write(part)
            file.flush()
            os.chmod(file.name, 0o644)
            return _keep(file.name, logs_folder / plain, digest.hexdigest())
    except OSError as error:
        refused = WriteError(f"{LOGS}/{plain}", error)
        raise InputError(f"{refused.wrong} {refused.remedy}, then drop it again.") from error


def _keep(temporary: str, wished: Path, digest: str) -> str:
    """Gives a file its name, or a longer one where another log has it."""
    for path in (wished, wished.with_stem(f"{wished.stem}-{digest[:16]}")):
        if not os.path.lexists(path):
            os.link(temporary, path)
        if path.is_file() and digest.startswith(results.digest(path)):
            break
    return path.name


def remove_log(folder: Path, name: str) -> None:
    """Removes a log that was dropped; InputError where there is none of this name."""
    if name not in find_logs(folder):
        raise InputError(f"{name}: no such log here.")
    (confine(folder, LOGS) / name).unlink()


def pack(folder: Path, names: list[str]) -> bytes:
    """Returns a zip file of files and folders; InputError where none is there or one outside."""
    packed, home = io.BytesIO(), folder.resolve()
    places = [confine(folder, name) for name in names]
    inner = [path for root in places for path in (root, *root.rglob("*")) if path.is_file()]
    if not inner:
        raise InputError("Nothing was written there.")
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in inner:
            name = path.relative_to(home).as_posix()
            archive.write(find_file(folder, name), name)
    return packed.getvalue()
