"""ArduPilot DataFlash files, through `pymavlink`; `ardupilot` says what their messages mean.

A message type has fields by name and, of sensors of which there are several, one that numbers them.

Source: ArduPilot documentation, Onboard Message Log Messages; libraries/AP_Logger/LogStructure.h.
"""

import contextlib
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from maidenflight.errors import InputError, optional
from maidenflight.flights.formats import LoggedFlights, Recording
from maidenflight.integrations.logs import ardupilot
from maidenflight.integrations.logs.ardupilot import Messages

_OLDER = re.compile(r"^Ch(an)?(?=\d)")
"""Channels of RCOU before ArduCopter 3.5, Ch1, Ch2, ..., and in other vehicles."""
_NUMBERS = ("I", "Instance")
"""Fields that number sensors of one kind, in new logs and old ones."""


def flights(path: Path, name: str) -> LoggedFlights:
    """Returns the flight in a DataFlash log, unchecked, with the time of its rows [s], and notes.

    Args:
        path: of the file.
        name: by which errors and notes call it.

    Raises:
        InputError: it is damaged or lacks a signal, see `ardupilot.flight`; or `pymavlink` is
            lacking.
    """
    with optional("pymavlink", "ardupilot", "reading an ArduPilot log"):
        from pymavlink.DFReader import DFReader_binary, DFReader_text
    raw = path.read_bytes()[: len(FORMAT.begins)]
    read = DFReader_text if TEXT.begins.startswith(raw) else DFReader_binary
    damage: list[str] = []
    try:
        with _silence(damage):
            reader = read(str(path))
            with contextlib.closing(reader):
                messages, parameters = _read(reader)
    except Exception as error:
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise InputError(f"{name}: not a readable DataFlash log ({reason}). Copy it again.") from (
            error
        )
    flight, time, notes = ardupilot.flight(name, messages, parameters)
    note = f"{name}: damaged in places; what could be read of it is used"
    return [(flight, time)], [*([note] if damage else []), *notes]


@contextlib.contextmanager
def _silence(lines: list[str]) -> Iterator[None]:
    """Collects what the reader prints of damage: a line for each byte, in part by a C library."""
    with tempfile.TemporaryFile("w+") as file:
        sys.stderr.flush()
        own = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            with contextlib.redirect_stdout(file), contextlib.redirect_stderr(file):
                yield
        finally:
            file.flush()
            os.dup2(own, 2)
            os.close(own)
            file.seek(0)
            lines.extend(file)


def _read(reader: Any) -> tuple[Messages, dict[str, float]]:
    """Fields of the messages that are needed, by their type and sensor, and the parameters."""
    rows: dict[str, list[list[float]]] = {}
    fields: dict[str, list[str]] = {}
    parameters: dict[str, float] = {}
    kinds = {"PARM", *ardupilot.MESSAGES}
    while (message := reader.recv_match(type=kinds)) is not None:
        kind = message.get_type()
        if kind == "PARM":
            parameters[str(message.Name)] = float(message.Value)
            continue
        numbers = [int(getattr(message, name)) for name in _NUMBERS if hasattr(message, name)]
        if kind == "IMU" and any(numbers):
            continue  # The first is read, and others are as many rows again.
        logged = message.get_fieldnames()
        known = [field for field in logged if _OLDER.sub("C", field) in ardupilot.MESSAGES[kind]]
        key = f"{kind}[{numbers[0]}]" if numbers else kind
        if fields.setdefault(key, known) == known:
            rows.setdefault(key, []).append([float(getattr(message, field)) for field in known])
    return {key: _renamed(fields[key], np.array(table).T) for key, table in rows.items()}, {
        key: value for key, value in parameters.items() if np.isfinite(value)
    }


def _renamed(fields: list[str], columns: np.ndarray) -> dict[str, np.ndarray]:
    """Returns columns by the names of today's firmware."""
    by_name = {_OLDER.sub("C", name): column for name, column in zip(fields, columns, strict=True)}
    if "TimeMS" in by_name:
        by_name["TimeUS"] = 1e3 * by_name.pop("TimeMS")
    return by_name


FORMAT = Recording(
    *("ArduPilot DataFlash", (), b"\xa3\x95\x80", flights, (".bin",)),
    within=b"\xa3\x95\x80",
    setting="ArduPilot: LOG_BITMASK 438271, reboot; ESC telemetry for rotor speeds",
)
TEXT = Recording(
    "ArduPilot DataFlash as text", (), b"FMT", flights, (".log",), setting=FORMAT.setting
)
