"""A map of a table's columns, proposed from their names and from what their numbers can be.

Names say which signal a column is, up to spelling. Numbers say the rest: a clock's steps its unit,
a force of 1 or 9.81 at hover the accelerometer's, and its sign whether the body's z points up or
down; the change of roll, pitch and yaw against the gyro their units and signs; the body's angular
acceleration on the motors which corner each of them is in. What remains open the check-up judges.
"""

import re
from collections.abc import Iterable, Mapping
from contextlib import suppress

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from maidenflight.errors import InputError
from maidenflight.flights.maps import column_map
from maidenflight.flights.maps.column_map import TIME, ColumnMap, Source
from maidenflight.flights.maps.signal_map import COUNTS, Motors
from maidenflight.flights.tables import Table

_AXES = ("x", "y", "z")
_CLOCKS = (
    *("time", "timestamp", "t", "ts", "stamp", "times", "timeus", "timems", "timens"),
    *("sec", "seconds", "timestampus", "timestampms", "timestampns", "elapsed"),
)
_UNITS = "rad_?s|deg_?s|dps|rad|deg|m_?s2|mps2|mss|m_?s|mps|mg?|g|m?v"
"""Ends of columns' names that tell units."""


def _axes(*patterns: str) -> tuple[tuple[str, ...], ...]:
    """Names of three columns by letters, and by numbers."""
    letters = (tuple(pattern + axis for axis in _AXES) for pattern in patterns)
    return *letters, *(tuple(pattern + axis for axis in "012") for pattern in patterns if pattern)


def _four(*patterns: str, ends: tuple[str, ...] = ("",)) -> tuple[tuple[str, ...], ...]:
    """Names of four columns, numbered from 1 or from 0."""
    return tuple(
        tuple(f"{pattern}{first + number}{end}" for number in range(4))
        for pattern in patterns
        for first in (1, 0)
        for end in ends
    )


_SPELLINGS: dict[str, tuple[tuple[str, ...], ...]] = {
    "position": _axes("position", "pos", "p", ""),
    "velocity": (*_axes("velocity", "vel", "v"), ("xdot", "ydot", "zdot")),
    "attitude": (
        *(
            tuple(pattern + part for part in parts)
            for parts in ("xyzw", "1230")
            for pattern in ("quaternion", "orientation", "quat", "q")
        ),
        ("roll", "pitch", "yaw"),
        ("phi", "theta", "psi"),
    ),
    "body_rates": (
        *_axes("angularvelocity", "bodyrates", "bodyrate", "angvel", "gyroadc", "gyro", "gyr"),
        *_axes("omega", "rates", "rate", "w", "g"),
        ("rollrate", "pitchrate", "yawrate"),
        ("rateroll", "ratepitch", "rateyaw"),
        ("rolldot", "pitchdot", "yawdot"),
        ("p", "q", "r"),
    ),
    "accelerometer": (
        *_axes("linearacceleration", "specificforce", "accelerometer", "acceleration"),
        *_axes("accsmooth", "accel", "acc", "a"),
    ),
    "motors": (
        *_four("motorcommand", "motorcmd", "motoroutput", "motorpwm", "motors", "actuator"),
        *_four("motor", "mot", ends=("", "pwm", "cmd")),
        *_four("command", "throttle", "output", "thrust", "cmd", "pwm", "act", "esc"),
        *_four("cmdm", "pwmm", "m", "u", ends=("", "pwm", "cmd")),
    ),
    "rotor_speed": (
        *_four("rotorspeed", "motorspeed", "escrpm", "erpm", "rpm", "omega"),
        *_four("rotor", "motor", "m", ends=("rpm",)),
    ),
    "battery": tuple(
        (name,) for name in ("batteryvoltage", "voltage", "vbattery", "vbat", "battery", "bat")
    ),
}
"""Names of columns by signal, the surest first, in small letters and digits alone."""
_SHORT = 2
"""Letters up to which a name must be the column's whole name, not its end."""
_RANGES = (
    *((0.0, 1.0), (0.0, 100.0), (0.0, 255.0)),
    *((1000.0, 2000.0), (48.0, 2047.0), (0.0, 65535.0)),
)
"""Numbers of motors at rest and at full throttle, as they are usual: shares, percent, bytes, PWM
[us], DShot, counts."""
_FASTEST, _HALF_TURN = 35.0, 3.5
"""Range of a gyro, 2000 deg/s [rad/s], and half a turn [rad], beyond which they are degrees."""
_TURN, _SMOOTHED = 0.1, 0.05
"""Times over which a turn is compared with the gyro, and vibration is averaged out [s]."""
_LEAST_ROWS, _LEAST_SHARE = 200, 0.1
"""Rows, and share of the angular acceleration that motors explain, that show their order."""
_CORNERS = ((-1, -1), (-1, 1), (1, 1), (1, -1))
"""Signs of what our motors 1 to 4 do to roll and pitch rate, for x forward, y left, z up."""
_LAGS = np.arange(0.0, 0.12, 0.01)
"""Times by which motion may follow the motors [s]."""


def propose(table: Table) -> ColumnMap | None:
    """Proposes a map; none where names show no time, body rates and motors."""
    names = {}
    for column in reversed(table.frame.columns):
        if table.frame[column].dtype.is_numeric():
            plain = re.sub(r"[\[(]\D[^\])]*[\])]?|_(" + _UNITS + ")$", "", column.strip().lower())
            names[re.sub(r"[^a-z0-9]", "", plain)] = column
    used_columns: set[str] = set()
    result: dict[str, tuple[str, ...]] = {}
    clock = next((names[name] for name in _CLOCKS if name in names), None)
    if clock is None:
        return None
    for signal in ("rotor_speed", "body_rates", *_SPELLINGS):
        columns = None if signal in result else _columns(_SPELLINGS[signal], names, used_columns)
        if columns:
            result[signal] = columns
            used_columns.update(columns)
    if not {"body_rates", "motors"} <= set(result):
        return None
    with suppress(InputError), np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return _judged(table, clock, result)
    return None


def _columns(
    spellings: Iterable[tuple[str, ...]], names: Mapping[str, str], used_columns: set[str]
) -> tuple[str, ...] | None:
    """Columns whose names end as one spelling says, with the same beginning."""
    for spelling in spellings:
        short = max(map(len, spelling)) <= _SHORT
        ends = [name for name in names if name.endswith(spelling[0])]
        for begin in sorted({name.removesuffix(spelling[0]) for name in ends}, key=len):
            there = [names.get(begin + name, "") for name in spelling]
            if all(there) and not (begin and short) and not used_columns.intersection(there):
                return tuple(there)
    return None


def _judged(table: Table, clock: str, result: Mapping[str, tuple[str, ...]]) -> ColumnMap:
    """The map of columns whose signals are known, with units, signs and the motors' order."""
    rows = {signal: column_map.values(table, Source(names)) for signal, names in result.items()}
    time = column_map.values(table, Source((clock,)))[:, 0]
    step = _typical(np.diff(time))
    unit = "s" if step < 0.5 else "ms" if step < 500 else "us" if step < 5e5 else "ns"
    time, signs, units = time * column_map.UNITS[unit], {}, {TIME: unit}
    force = _typical(rows["accelerometer"][:, 2]) if "accelerometer" in result else 0.0
    below = "position" in result and _typical(rows["position"][:, 2]) < 0
    down = force < 0 if force else below
    units["accelerometer"] = "g" if abs(force) < 3 else "mg" if abs(force) > 300 else "m/s2"
    signs["accelerometer"] = signs["body_rates"] = (1, -1, -1) if down else (1, 1, 1)
    gyro = rows["body_rates"] * signs["body_rates"]
    degrees = _most(gyro) > _FASTEST
    if "attitude" in result:
        angles = rows["attitude"]
        if angles.shape[1] == len(_AXES):
            units["attitude"] = "deg" if _most(angles) > _HALF_TURN else "rad"
            angles = angles * column_map.UNITS[units["attitude"]]
        ratio = _compared(time, angles, gyro)
        degrees = bool(np.median(np.abs(ratio)) > 8.0) if np.isfinite(ratio).all() else degrees
        signs["attitude"] = tuple(-1 if one < 0 else 1 for one in ratio)
    units["body_rates"] = "deg/s" if degrees else "rad/s"
    if below:
        signs["position"] = signs["velocity"] = (1, -1, -1)
    order = _order(time, gyro, rows["motors"])
    columns = dict(result)
    for signal in ("motors", "rotor_speed"):
        if signal in result:
            columns[signal] = tuple(result[signal][number] for number in order)
    if "rotor_speed" in result:
        units["rotor_speed"] = "rpm" if "rpm" in result["rotor_speed"][0].lower() else "rad/s"
    if "battery" in result:
        units["battery"] = "mV" if _typical(rows["battery"]) > 500 else "V"
    sources = {TIME: Source((clock,), unit)}
    for signal in COUNTS:
        if signal in columns:
            turned = (*signs.get(signal, ()), *(1,) * len(columns[signal]))
            names = ("-" * (sign < 0) + name for sign, name in zip(turned, columns[signal]))  # noqa: B905
            sources[signal] = Source(tuple(names), units.get(signal, ""))
    return ColumnMap(sources, _range(rows["motors"], result["motors"]))


def _typical(values: np.ndarray) -> float:
    """The median of what is finite; 0 of nothing."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else 0.0


def _most(values: np.ndarray) -> float:
    """The largest size of what is finite; 0 of nothing."""
    return float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def _compared(
    time: Float[np.ndarray, "N"], attitude: np.ndarray, gyro: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "3"]:
    """Compares what the gyro counts about x, y, z with what the attitude turns, over `_TURN` each.

    The gyro is in its own unit, the attitude quaternions x, y, z, w, or roll, pitch, yaw [rad].
    """
    sound = np.isfinite(np.concatenate([time[:, None], attitude, gyro], axis=1)).all(axis=1)
    time, attitude, gyro = time[sound], attitude[sound], gyro[sound]
    if attitude.shape[1] > len(_AXES):
        norm = np.linalg.norm(attitude, axis=1)
        time, attitude, gyro = time[norm > 0.5], attitude[norm > 0.5], gyro[norm > 0.5]
    step = _typical(np.diff(time))
    some = int(np.clip(_TURN / step, 1, len(time))) if step > 0 else len(time)
    if len(time) <= 4 * some:
        return np.full(3, np.nan)
    if attitude.shape[1] > len(_AXES):
        turned = Rotation.from_quat(attitude)
        change = (turned[:-some].inv() * turned[some:]).as_rotvec()
    else:
        change = np.unwrap(attitude, axis=0)
        change = change[some:] - change[:-some]
    summed = np.cumsum(gyro * np.gradient(time)[:, None], axis=0)
    counted = summed[some:] - summed[:-some]
    return (change * counted).sum(axis=0) / (change**2).sum(axis=0)


def _order(
    time: Float[np.ndarray, "N"], gyro: Float[np.ndarray, "N 3"], motors: Float[np.ndarray, "N 4"]
) -> tuple[int, ...]:
    """Returns which columns are our motors 1 to 4, by how roll and pitch rate change after them.

    As they are numbered where that does not show four different corners.
    """
    sound = np.isfinite(np.concatenate([time[:, None], gyro, motors], axis=1)).all(axis=1)
    time, gyro, motors = time[sound], gyro[sound, :2], motors[sound]
    if len(time) < _LEAST_ROWS or np.diff(time).min() <= 0:
        return 0, 1, 2, 3
    few = int(np.clip(_SMOOTHED / _typical(np.diff(time)), 1, len(time)))
    rates = uniform_filter1d(gyro, few, axis=0)
    turns = np.gradient(rates, axis=0) / np.gradient(time)[:, None]
    smooth = uniform_filter1d(motors, few, axis=0)
    best, signs = 0.0, np.zeros((2, 4))
    for lag in _LAGS:
        lagged = np.stack([np.interp(time - lag, time, one) for one in smooth.T], axis=1)
        lagged = np.column_stack([lagged, np.ones(len(lagged))])
        weights = np.linalg.lstsq(lagged, turns, rcond=None)[0]
        share = 1.0 - np.var(turns - lagged @ weights, axis=0) / np.var(turns, axis=0)
        if share.min() > best:
            best, signs = float(share.min()), np.sign(weights[:4].T)
    corners = [tuple(one.astype(int)) for one in signs.T]
    if best < _LEAST_SHARE or set(corners) != set(_CORNERS):
        return 0, 1, 2, 3
    return tuple(corners.index(corner) for corner in _CORNERS)


def _range(motors: Float[np.ndarray, "N 4"], names: tuple[str, ...]) -> Motors:
    """What the motors' numbers mean: the narrowest usual range that holds them."""
    numbers = motors[np.isfinite(motors)]
    least, most = (float(numbers.min()), float(numbers.max())) if len(numbers) else (0.0, 1.0)
    square = "thrust" not in names[0].lower()
    if least < 0:
        return Motors(-1.0, 1.0, square)
    turning = numbers[numbers > 0]
    pwm = len(turning) and np.quantile(turning, 0.05) >= 900 and most <= 2200
    for low, high in _RANGES:
        if most <= 1.05 * high and (low < 1000 or pwm) and (most > 1.05 or high == 1.0):
            return Motors(low, high, square)
    return Motors(0.0, most, square)
