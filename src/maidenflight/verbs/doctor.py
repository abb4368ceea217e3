"""`Doctor`: which parts of this machine maidenflight can use, and which are missing."""

import json
import os
import platform
import re
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from shutil import disk_usage
from typing import Any, NamedTuple

from maidenflight import __version__, cache, compiler, results
from maidenflight.terminal import Table
from maidenflight.verb import Output, Progress, Result, Verb

_RADIO = ("1915", "7777")
"""USB vendor and product of a Crazyradio PA or 2.0 (Bitcraze, 99-bitcraze.rules)."""
_LEAST_DISK = 2e9
"""Room for a study's results [bytes]."""
_USB = Path("/sys/bus/usb/devices")


class Finding(NamedTuple):
    """A property of the machine, and the cure where something is wrong."""

    name: str
    value: str
    cure: str = ""
    fails: bool = False
    """Whether commands will fail for it."""


class Doctor(Verb):
    """Check this machine: versions, GPU, extras, disk and radio.

    Also processor, cache and permissions. A cure is named where something is missing.
    """

    in_studies = False
    output = Output(None, "JSON file to write too, to send along with a question.")

    def compute(self, output: Path | None, progress: Progress) -> Result:
        """Looks at the machine; imports nothing heavy."""
        findings = [*_versions(), _processor(), _gpu(), *_folders(), *_extras(), _radio()]
        failing = [finding.name for finding in findings if finding.fails]
        rows = [finding._asdict() for finding in findings]
        if output is not None:
            results.write(output, f"{json.dumps(rows, indent=2)}\n")
        columns = {"": "{name}", "this machine": "{value}", "to do": "{cure}"}
        return Result(
            content={"findings": rows, "output": None if output is None else str(output)},
            summary=[
                Table("maidenflight doctor", columns, rows),
                *([] if failing else ["Everything that maidenflight needs is here."]),
            ],
            error=f"{', '.join(failing)}: see the table." if failing else "",
            value=findings,
        )


def _versions() -> Iterator[Finding]:
    yield Finding("maidenflight", __version__)
    yield Finding("Python", platform.python_version())
    yield Finding("system", f"{platform.system()} {platform.release()}, {platform.machine()}")
    yield Finding("JAX", _version("jax") or "none", "", _version("jax") is None)


def _version(package: str) -> str | None:
    with suppress(metadata.PackageNotFoundError):
        return metadata.version(package)
    return None


def _processor() -> Finding:
    lines: dict[str, str] = {}
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            lines.setdefault(line.partition(":")[0].strip(), line.partition(":")[2].strip())
    flags = lines.get("flags", "").split()
    features = [feature for feature in ("avx2", "fma", "avx512f") if feature in flags]
    name = lines.get("model name") or platform.processor() or platform.machine()
    return Finding(
        "processor", f"{compiler.count_cores()} cores, {name}, {' '.join(features)}".rstrip(", ")
    )


def _gpu() -> Finding:
    names = ""
    with suppress(OSError, subprocess.SubprocessError):
        query = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
        names = subprocess.run(query, capture_output=True, text=True, timeout=20, check=True).stdout
    if not names:
        return Finding("GPU", "none of NVIDIA; the processor does everything")
    plugins = [f"jax-cuda{number}-plugin" for number in (12, 13)]
    cure = "" if any(map(_version, plugins)) else "pip install 'jax[cuda12]', for it to be used"
    return Finding("GPU", "; ".join(names.split("\n")).rstrip("; "), cure)


def _folders() -> Iterator[Finding]:
    folder = cache.folder()
    parent = next(path for path in (folder, *folder.parents) if path.exists())
    writable, size = os.access(parent, os.W_OK), 0
    with suppress(OSError):
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    cure = "" if writable else "make it writable, or commands compile anew each time"
    yield Finding("cache", f"{folder}, {size / 1e6:.0f} MB", cure)
    free = disk_usage(".").free
    cure = "" if free > _LEAST_DISK else "free some: results of studies take gigabytes"
    yield Finding("disk", f"{free / 1e9:.1f} GB free in this folder", cure, free < 1e7)
    if os.access(".", os.W_OK):
        yield Finding("this folder", "writable")
    else:
        yield Finding("this folder", "read-only", "go to another, or give -o")


def _extras() -> Iterator[Finding]:
    """Names the extras of which a package is missing."""
    missing: dict[str, list[str]] = {}
    for line in metadata.requires("maidenflight") or []:
        extra = re.search(r"extra == ['\"](\w+)['\"]", line)
        [package] = re.findall(r"^[\w.-]+", line)
        if extra and extra[1] not in ("dev", "docs") and _version(package) is None:
            missing.setdefault(extra[1], []).append(package)
    names = ", ".join(f"{extra} ({', '.join(packages)})" for extra, packages in missing.items())
    cure = f"pip install -e '.[{next(iter(missing))}]' and so on, if needed" if missing else ""
    yield Finding("extras not installed", names or "none", cure)


def _radio() -> Finding:
    def read(device: Path, name: str) -> str:
        with suppress(OSError):
            return (device / name).read_text().strip()
        return ""

    devices: list[Any] = [*_USB.iterdir()] if _USB.is_dir() else []
    for device in devices:
        if (read(device, "idVendor"), read(device, "idProduct")) == _RADIO:
            numbers = (int(read(device, name) or 0) for name in ("busnum", "devnum"))
            file = Path("/dev/bus/usb", *(f"{number:03d}" for number in numbers))
            cure = "" if os.access(file, os.W_OK) else "add Bitcraze's udev rules; plug it again"
            return Finding("Crazyradio", str(file), cure)
    return Finding("Crazyradio", "none plugged in")
