"""Betaflight blackbox logs, through `orangebox`: accelerometer, gyro and motors of flights by hand.

Betaflight's body axes are ours: x forward, y left, z up. In its mixer a positive roll command
speeds up the left motors, a positive pitch command the back ones and so turns the nose down, and
the gyro has the signs of the commands; its accelerometer reads +1 g along z at rest.

The logged motor is what is sent to the ESC, behind `thrust_linear`, throttle compensation and
`motor_output_limit`. Rotor speed is taken to follow it from the ESC's zero, DShot 48 or the PWM of
`mincommand`, to the greatest output, and thrust is the square of that.

Source: Betaflight 4.5, src/main/blackbox/blackbox.c (fields, headers), blackbox_encoding.c,
src/main/flight/mixer.c (motor order, mixer, thrust linearization), src/main/sensors/gyro.c,
acceleration.c; docs of the blackbox format.
"""

import contextlib
import logging
from collections.abc import Iterator, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from maidenflight.errors import InputError, optional
from maidenflight.flights.formats import LoggedFlights, Recording
from maidenflight.flights.log import GRAVITY, LONGEST_DELAY, Flight, flight_of
from maidenflight.flights.streams import joining, rates, streams
from maidenflight.integrations.logs import blackbox_header

DSHOT_ZERO = 48
"""DShot value of a motor that just does not turn (dshot.h)."""
_ORDER = (1, 0, 2, 3)
"""Betaflight's numbers, from 0, of our motors: back right, front right, back left, front left (its
firmware's flight/mixer.c)."""
_VARIABLE = 10
"""Number of the encoding TAG2_3SVARIABLE (blackbox_fielddefs.h), which `orangebox` lacks."""
SLOW_FILTER_S = 0.01
"""Delay of the accelerometer's filter beyond which a note is made [s]."""
REMEDY = (
    "Set blackbox_sample_rate so that 500 rows a second or more are logged, with accelerometer and "
    "motors among the fields."
)


def flights(path: Path, name: str) -> LoggedFlights:
    """Returns flights in a file, unchecked, with the times of their rows [s], and what was assumed.

    Args:
        path: of the file, which may hold several logs.
        name: by which errors and notes call it.

    Raises:
        InputError: no log in it can be used; or `orangebox` is lacking.
    """
    with optional("orangebox", "blackbox", "reading a blackbox log"):
        from orangebox import decoders
        from orangebox.parser import Parser
        from orangebox.reader import Reader
    decoders.decoder_map[_VARIABLE] = _tag2_3svariable
    try:
        blackbox_header.check_fields(path)
        count = Reader(str(path)).log_count
    except Exception as error:
        raise InputError(f"{name}: {_unreadable(error)}") from error
    logs, notes, refused = [], [], []
    for number in range(1, count + 1):
        title = name if count == 1 else f"{name}, log {number}"
        try:
            flight, time, log_notes = _of_log(Parser, path, number, title)
        except InputError as error:
            refused.append(str(error))
            continue
        logs.append((flight, time))
        notes += log_notes
    if not logs:
        more = f" And so in {len(refused) - 1} more logs of it." if len(refused) > 1 else ""
        raise InputError(f"{refused[0] if refused else f'{name}: no log in it.'}{more}")
    return logs, [*notes, *(f"not used: {reason}" for reason in refused)]


def _unreadable(error: Exception) -> str:
    reason = " ".join(str(error).split())[:100] or type(error).__name__
    return f"not a readable blackbox log ({reason}). Copy it again."


def _of_log(
    decoder: Any, path: Path, number: int, name: str
) -> tuple[Flight, Float[np.ndarray, "N"], list[str]]:
    try:
        with _silent():
            parser = decoder.load(str(path), number, allow_invalid_header=True)
            headers, fields = parser.headers, parser.field_names
    except Exception as error:
        raise InputError(f"{name}: {_unreadable(error)}") from error
    blackbox_header.check_intervals(name, headers)
    blackbox_header.check_airframe(name, headers)
    groups = _groups(name, fields)
    columns = [column for names in groups.values() for column in names]
    with _silent():
        rows, broken = _rows(parser, [fields.index(column) for column in columns])
    if len(rows) < 2:
        raise InputError(f"{name}: no rows in it. Leave it out.")
    notes = [f"{name}: damaged after {len(rows)} rows ({broken})"] if broken else []
    time, first = np.unique(rows[:, 0] * 1e-6, return_index=True)
    ends = np.cumsum([len(names) for names in groups.values()])
    parts = np.split(rows[first], ends[:-1], axis=1)
    values = dict(zip(groups, parts, strict=True))
    flight, log_notes = _flight(name, time, values, groups, headers)
    return flight, time - time[0], [*notes, *log_notes]


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Without what `orangebox` logs of frames that are damaged."""
    logger = logging.getLogger("orangebox")
    before, logger.disabled = logger.level, True
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(before)
        logger.disabled = False


def _groups(name: str, fields: list[str]) -> dict[str, list[str]]:
    """Columns of each signal that is used."""
    counts = dict.fromkeys(("gyroUnfilt", "gyroADC", "accSmooth"), 3)
    counts |= dict.fromkeys(("motor", "eRPM", "omega", "omegaUnfiltered"), 4)
    logs = {"time": ["time"]} if "time" in fields else {}
    for signal, count in counts.items():
        columns = [f"{signal}[{number}]" for number in range(count)]
        if set(columns) <= set(fields):
            logs[signal] = columns
    if "gyroUnfilt" in logs:
        logs.pop("gyroADC", None)
    if "omegaUnfiltered" in logs:
        # The filter is late by half a motor's lag.
        logs["omega"] = logs.pop("omegaUnfiltered")
    for signal in ("vbatLatest", "vbat"):
        if signal in fields:
            logs["battery"] = [signal]
            break
    lacking = {"time", "accSmooth", "motor"} - set(logs)
    lacking |= set() if {"gyroUnfilt", "gyroADC"} & set(logs) else {"gyroADC"}
    if "motor[4]" in fields:
        raise InputError(f"{name}: more than four motors; expected a quadrotor in X.")
    if lacking:
        raise InputError(f"{name}: missing {', '.join(sorted(lacking))}. {REMEDY}")
    return logs


def _rows(parser: Any, places: list[int]) -> tuple[Float[np.ndarray, "N c"], str]:
    """Columns of all frames that can be decoded, and what stopped it if it was not their end."""
    pick, rows, broken = itemgetter(*places), [], ""
    try:
        for frame in parser.frames():
            rows.append(pick(frame.data))
    except Exception as error:
        # Power that is cut ends a log in the middle of a frame, or without its last event.
        left = len(parser.reader) - parser.reader.tell()
        broken = "" if left <= 1 else type(error).__name__
    try:
        return np.array(rows, float).reshape(len(rows), len(places)), broken
    except (ValueError, TypeError, OverflowError):
        return np.zeros((0, len(places))), "values that are no numbers"


def _flight(
    name: str,
    time: Float[np.ndarray, "N"],
    values: Mapping[str, np.ndarray],
    groups: Mapping[str, list[str]],
    headers: Mapping[str, Any],
) -> tuple[Flight, list[str]]:
    period = streams.period(time)
    rate = 1.0 / period if period > 0 else 0.0
    needed = dict.fromkeys(rates.NEEDED, rate)
    rates.refuse_too_slow(name, needed, REMEDY)
    one_g, scale_notes = blackbox_header.counts_of_1_g(name, values["accSmooth"], headers)
    unfiltered = "gyroUnfilt" in groups
    gyro = values["gyroUnfilt" if unfiltered else "gyroADC"] * blackbox_header.gyro_scale(headers)
    command, notes = _command(name, values["motor"], headers)
    notes += scale_notes
    accelerometer_delay = blackbox_header.force_delay(headers)
    gyro_delay = 0.0 if unfiltered else blackbox_header.gyro_delay(headers)
    notes.append(
        f"{name}: {'gyroUnfilt' if unfiltered else 'gyroADC'} at {rate:.0f} Hz; delays of filters "
        f"that are undone: accelerometer {1e3 * accelerometer_delay:.2g} ms (acc_lpf_hz), gyro "
        f"{1e3 * gyro_delay:.2g} ms"
    )
    if accelerometer_delay > SLOW_FILTER_S:
        notes.append(
            f"{name}: the accelerometer's filter hides the motors' lag; set acc_lpf_hz = 100 for "
            "flights to identify from"
        )
    speed = None
    if "eRPM" in values:
        poles = blackbox_header.number(headers, "motor_poles", 0.0)
        if poles >= 2:
            turns = values["eRPM"][:, list(_ORDER)] * 100 / (poles / 2)
            speed = turns * 2 * np.pi / 60
            notes.append(f"{name}: rotor speeds of eRPM with {poles:g} magnet poles")
    elif "omega" in values:
        speed = values["omega"][:, list(_ORDER)]
        notes.append(f"{name}: rotor speeds of {groups['omega'][0].partition('[')[0]}")
    volts, log_notes = _battery(name, len(time), values.get("battery"), headers)
    loop = 1e-6 * blackbox_header.number(headers, "looptime", 125.0)
    loop *= blackbox_header.number(headers, "pid_process_denom", 1.0)
    return flight_of(
        name,
        period,
        body_rates=np.radians(gyro),
        command=command,
        battery=volts,
        zero_order_hold=period < 1.25 * loop,
        by_battery_law=False,
        accelerometer_delay=min(accelerometer_delay, LONGEST_DELAY),
        gyro_delay=min(gyro_delay, LONGEST_DELAY),
        accelerometer=values["accSmooth"] / one_g * GRAVITY,
        rotor_speed=speed,
    ), [*notes, *log_notes, *rates.notes(name, needed, REMEDY)]


def _command(
    name: str, motor: Float[np.ndarray, "N 4"], headers: Mapping[str, Any]
) -> tuple[Float[np.ndarray, "N 4"], list[str]]:
    """Thrust commands of our motors, and how they were read."""
    older = [headers.get("minthrottle"), headers.get("maxthrottle")]
    bounds = headers.get("motorOutput", older)
    sound = isinstance(bounds, list) and all(isinstance(bound, int | float) for bound in bounds)
    bounds = bounds if isinstance(bounds, list) else []
    if not sound or len(bounds) != 2 or not 0 <= bounds[0] < bounds[1] <= 2500:
        raise InputError(
            f"{name}: its header says motorOutput {headers.get('motorOutput')!r} and minthrottle, "
            f"maxthrottle {older}; expected the least and the greatest output of the motors, of "
            f"which one pair stands in Betaflight's logs "
            f"({headers.get('Firmware revision', 'firmware unknown')}). Copy the log again."
        )
    digital = bounds[0] < 900
    still = blackbox_header.number(headers, "mincommand", 1000.0)
    zero = DSHOT_ZERO if digital else min(still, bounds[0])
    most = float(bounds[1])
    share = np.clip((motor[:, list(_ORDER)] - zero) / (most - zero), 0.0, None)
    notes = [
        f"{name}: motors from {zero:g} to {most:g} ({'DShot' if digital else 'PWM'}, motorOutput "
        f"{bounds[0]:g} to {bounds[1]:g}); thrust by the square"
    ]
    limit = blackbox_header.number(headers, "motor_output_limit", 100.0)
    if limit < 100:
        notes.append(f"{name}: motor_output_limit {limit:g} %: u = 1 is the thrust at that limit")
    linear = blackbox_header.number(headers, "thrust_linear", 0.0)
    if linear:
        notes.append(
            f"{name}: thrust_linear {linear:g} % acts before what is logged and needs no inversion"
        )
    if headers.get("yaw_motors_reversed") == 1:
        notes.append(joining.note_reversed_rotors(name, "yaw_motors_reversed"))
    return share**2, notes


def _battery(
    name: str, rows: int, counts: Float[np.ndarray, "N 1"] | None, headers: Mapping[str, Any]
) -> tuple[Float[np.ndarray, "N"], list[str]]:
    """Voltage [V], in 0.01 V where the header tells the cells' in such, else in 0.1 V."""
    if counts is None:
        return np.full(rows, np.nan), []
    cell = headers.get("vbatcellvoltage")
    fine = isinstance(cell, list) and all(isinstance(volts, int) and volts > 100 for volts in cell)
    volts = counts[:, 0] * (0.01 if fine else 0.1)
    sound = (volts > 1.0) & (volts < 100.0)
    if sound.mean() < 0.5:
        return np.full(len(volts), np.nan), [f"{name}: battery voltage not understood"]
    return np.where(sound, volts, np.nan), []


def _tag2_3svariable(data: Iterator[int], _: Any = None) -> tuple[int, int, int]:
    """Three signed numbers of 2, of 5, 5 and 4, of 8, 7 and 7, or of 8 to 32 bits each.

    Source: Betaflight, src/main/blackbox/blackbox_encoding.c, blackboxWriteTag2_3SVariable.
    """
    lead = next(data)
    kind = lead >> 6
    if kind == 0:
        return _signed(lead >> 4, 2), _signed(lead >> 2, 2), _signed(lead, 2)
    if kind == 1:
        bits = lead << 8 | next(data)
        return _signed(bits >> 9, 5), _signed(bits >> 4, 5), _signed(bits, 4)
    if kind == 2:
        bits = lead << 16 | next(data) << 8 | next(data)
        return _signed(bits >> 14, 8), _signed(bits >> 7, 7), _signed(bits, 7)
    numbers = []
    for index in range(3):
        size = (lead >> 2 * index & 3) + 1
        raw = bytes(next(data) for _ in range(size))
        numbers.append(int.from_bytes(raw, "little", signed=True))
    return numbers[0], numbers[1], numbers[2]


def _signed(bits: int, width: int) -> int:
    """The two's complement in the lowest bits of a number."""
    value = bits & ((1 << width) - 1)
    return value - (1 << width) if value >> (width - 1) else value


FORMAT = Recording(
    *("Betaflight blackbox log", (".bbl", ".bfl"), b"H Product:Blackbox", flights, (".txt",)),
    setting="Betaflight: blackbox_sample_rate for 500 Hz or more, acc_lpf_hz = 100, "
    "dshot_bidir = ON for rotor speeds",
)
