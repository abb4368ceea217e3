"""The user's cache folder: compiled programs, tables of contents of Crazyflies, locks."""

import os
import platform
import stat
import tempfile
import warnings
import zlib
from contextlib import suppress
from pathlib import Path

import platformdirs

_CACHE_BYTES = 500_000_000
"""Bytes of compiled programs; a program has some hundred thousand."""


def folder() -> Path:
    """Returns the user's cache folder."""
    return platformdirs.user_cache_path("maidenflight", appauthor=False)


def find_private_folder(name: str) -> Path | None:
    """Makes a folder that is the user's alone, so that nobody else can fill or hold what is in it.

    It lies in the cache folder or, of a home that cannot be written to, in the temporary one.

    Returns:
        The folder; none where neither can be written to, or others may write to them.
    """
    owner = os.getuid() if hasattr(os, "getuid") else 0
    for parent in (folder(), Path(tempfile.gettempdir(), f"maidenflight-{owner}")):
        with suppress(OSError):
            for each in (parent, parent / name):
                each.mkdir(mode=0o700, parents=True, exist_ok=True)
                if not _is_own(each, owner):
                    break
            else:
                with tempfile.TemporaryFile(dir=parent / name):
                    return parent / name
    return None


def _is_own(path: Path, owner: int) -> bool:
    """Whether a folder is no link, and nobody but its owner may write to it."""
    status = path.lstat()
    is_private = status.st_uid == owner and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISDIR(status.st_mode) and (is_private or os.name == "nt")


def keep_compiled() -> None:
    """Keeps compiled programs in the user's cache folder, by processor.

    JAX's own variable names another folder; set to nothing it keeps none.
    """
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    programs = folder() / f"{platform.machine()}-{zlib.crc32(_processor().encode()):08x}"
    with suppress(OSError):
        entries = [(entry.stat(), entry) for entry in programs.glob("*-cache")]
        surplus = sum(status.st_size for status, _ in entries) - _CACHE_BYTES
        for status, entry in sorted(entries, key=lambda entry: entry[0].st_mtime):
            if surplus > 0:
                entry.unlink()
                surplus -= status.st_size
        programs.mkdir(parents=True, exist_ok=True)
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(programs)
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.05")
    # A file that a killed process or a full disk left incomplete only costs a compilation.
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache entry")


def _processor() -> str:
    """What compiled programs depend on: a home folder may be shared by different machines."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor()
    names = "model name", "flags", "Features", "CPU part"
    return "".join(sorted({line for line in text.splitlines() if line.startswith(names)}))
