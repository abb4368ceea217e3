"""PX4 ULog files, through `pyulog`; `px4` says what their topics mean.

Source: PX4 user guide, ULog file format.
"""

import contextlib
import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from maidenflight.errors import InputError, optional
from maidenflight.flights.formats import LoggedFlights, Recording
from maidenflight.integrations.logs import px4, px4_motors
from maidenflight.integrations.logs.px4_topics import REMEDY, vector

_HEAD, _MESSAGE_HEAD = 16, 3
"""Bytes of the file's and of a message's head, by definition of the format."""


def flights(path: Path, name: str) -> LoggedFlights:
    """Returns the flight in a ULog, unchecked, with the time of its rows [s], and what was assumed.

    Only the topics that are needed stay in memory.

    Args:
        path: of the file.
        name: by which errors and notes call it.

    Raises:
        InputError: it is damaged or lacks a signal, see `px4.flight`; or `pyulog` is lacking.
    """
    with optional("pyulog", "ulog", "reading a PX4 ULog"):
        from pyulog import ULog
    try:
        # It prints what is damaged.
        with path.open("rb") as file, contextlib.redirect_stdout(io.StringIO()):
            read = ULog(file, list(px4.TOPICS))
            topics = _topics(read.data_list)
    except Exception as error:
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise InputError(f"{name}: not a readable ULog ({reason}). Copy it again.") from error
    if not topics:
        px4_motors.check_airframe(name, _numbers(read.initial_parameters))
        raise InputError(
            f"{name}: holds none of the topics that are read ({', '.join(px4.TOPICS[:7])}). "
            f"{REMEDY}"
        )
    parameters = _numbers(read.initial_parameters)
    notes = []
    if rest := _torn_bytes(path):
        notes.append(
            f"{name}: cut off in its last message ({rest} bytes of it are there), as by a loss of "
            "power; what is before it is used"
        )
    if read.file_corruption:
        notes.append(f"{name}: damaged in places; what could be read of it is used")
    if read.dropouts:
        lost = sum(dropout.duration for dropout in read.dropouts)
        notes.append(
            f"{name}: {len(read.dropouts)} dropouts of the logger, {lost / 1000:.2g} s altogether"
        )
    flight, time, log_notes = px4.flight(name, topics, parameters)
    return [(flight, time)], [*notes, *log_notes]


def _numbers(parameters: Mapping[str, Any]) -> dict[str, float]:
    return {
        key: float(value)
        for key, value in parameters.items()
        if isinstance(value, int | float) and np.isfinite(value)
    }


def _torn_bytes(path: Path) -> int:
    """Counts the bytes of a last message that is not whole; 0 if the file ends behind a message."""
    raw, at = path.read_bytes(), _HEAD
    while at + _MESSAGE_HEAD <= len(raw):
        after = at + _MESSAGE_HEAD + int.from_bytes(raw[at : at + 2], "little")
        if after > len(raw):
            return len(raw) - at
        at = after
    return len(raw) - at


def _topics(data: Iterable[Any]) -> dict[str, dict[str, np.ndarray]]:
    """Fields by topic; of several instances the first, of outputs the one that changes most."""
    topics: dict[str, dict[str, np.ndarray]] = {}
    for dataset in data:
        fields = {name: values for name, values in dataset.data.items() if values.ndim == 1}
        former = topics.get(dataset.name)
        if "timestamp" in fields and (former is None or _changes(fields) > _changes(former)):
            topics[dataset.name] = fields
    return topics


def _changes(fields: Mapping[str, np.ndarray]) -> float:
    """How much the outputs of a topic change; nothing of one that has no outputs."""
    outputs = [fields[name] for name in vector("output", 4) if name in fields]
    return float(sum(np.nanstd(values.astype(float)) for values in outputs))


FORMAT = Recording(
    *("PX4 ULog", (".ulg",), b"ULog", flights),
    setting="PX4: SDLOG_PROFILE 17, reboot; bidirectional DShot for rotor speeds",
)
