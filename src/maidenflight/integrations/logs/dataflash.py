"""ArduPilot DataFlash files, through `pymavlink`; `ardupilot` says what their messages mean.

A message type has fields by name and, of sensors of which there are several, one that numbers them.

Source: ArduPilot documentation, Onboard Message Log Messages; libraries/AP_Logger/LogStructure.h.
"""

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np

from maidenflight.errors import InputError, optional
from maidenflight.flights.formats import LoggedFlights, Recording
from maidenflight.integrations.logs import ardupilot
from maidenflight.integrations.logs.ardupilot import Messages

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
        from pymavlink.DFReader import DFReader_binary
    silence = io.StringIO()  # It prints what is damaged.
    try:
        with contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence):
            reader = DFReader_binary(str(path))
            with contextlib.closing(reader):
                messages, parameters = _read(reader)
    except Exception as error:
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise InputError(f"{name}: not a readable DataFlash log ({reason}). Copy it again.") from (
            error
        )
    flight, time, notes = ardupilot.flight(name, messages, parameters)
    damage = [f"{name}: damaged in places; what could be read of it is used"]
    return [(flight, time)], [*(damage if silence.getvalue() else []), *notes]


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
        numbers = [int(getattr(message, one)) for one in _NUMBERS if hasattr(message, one)]
        if kind == "IMU" and any(numbers):
            continue  # The first is read, and others are as many rows again.
        known = [one for one in ardupilot.MESSAGES[kind] if one in message.get_fieldnames()]
        key = f"{kind}[{numbers[0]}]" if numbers else kind
        if fields.setdefault(key, known) == known:
            rows.setdefault(key, []).append([float(getattr(message, one)) for one in known])
    return {
        key: dict(zip(fields[key], np.array(table).T, strict=True)) for key, table in rows.items()
    }, {key: value for key, value in parameters.items() if np.isfinite(value)}


FORMAT = Recording("ArduPilot DataFlash", (), b"\xa3\x95\x80", flights, (".bin",))
