"""The user's cache folder: compiled programs, and tables of contents of Crazyflies."""

import os
import platform
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
        for status, entry in sorted(entries, key=lambda one: one[0].st_mtime):
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
