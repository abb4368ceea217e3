"""A map of a table's columns, proposed from their names and from what their numbers can be.

Names say which signal a column is, up to spelling. Numbers say the rest: a clock's steps its unit,
a force of 1 or 9.81 at hover the accelerometer's, and its sign whether the body's z points up or
down; the change of roll, pitch and yaw against the gyro their units and signs; the body's angular
acceleration on the motors which corner each of them is in. What remains open the check-up judges.
"""

import re
from collections.abc import Mapping
from contextlib import suppress

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from maidenflight.errors import InputError
from maidenflight.flights.checkup import in_flight
from maidenflight.flights.maps import column_map
from maidenflight.flights.maps.column_map import TIME, ColumnMap, Source
from maidenflight.flights.maps.names import Names, read_names
from maidenflight.flights.maps.signal_map import COUNTS, Motors
from maidenflight.flights.tables import Table

_AXES = ("x", "y", "z")
_FEWEST_SIGNALS, _FASTEST_ROTOR = 2, 6000.0
"""Signals without which a table is taken for no flight, and speed that no rotor reaches [rad/s];
chosen."""
_COMMANDED = re.compile("pwm|cmd|command|throttle|thrust|control|output")
"""Names of motors that are commands, whatever their numbers are."""
_RANGES = (
    *((0.0, 1.0), (0.0, 100.0), (0.0, 255.0)),
    *((1000.0, 2000.0), (48.0, 2047.0), (0.0, 65535.0)),
)
"""Numbers of motors at rest and at full throttle, by definition: shares, percent, bytes, PWM [us],
DShot, counts."""
_FASTEST, _HALF_TURN = 35.0, 3.5
"""Just above a gyro's range (`checking.py`) [rad/s] and half a turn [rad]: degrees are beyond."""
_TURN, _SMOOTHED = 0.1, 0.05
"""Times over which a turn is compared with the gyro, and vibration is averaged out [s]."""
_LEAST_ROWS, _LEAST_SHARE = 200, 0.1
"""Rows, and share of the angular acceleration that motors explain, that show their order."""
_CORNERS = ((-1, -1), (-1, 1), (1, 1), (1, -1))
"""Signs of what our motors 1 to 4 do to roll and pitch rate, for x forward, y left, z up."""
_LAGS = np.arange(0.0, 0.12, 0.01)
"""Times by which motion may follow the motors [s]."""


def propose(table: Table) -> ColumnMap | None:
    """Proposes a map; none where names show no time, or too few signals for a flight.

    A part that every map needs and no name shows is left out, for a person to fill in.
    """
    numeric = [name for name in table.frame.columns if table.frame[name].dtype.is_numeric()]
    names = read_names(numeric)
    clock = names.clock or next(iter(names.clocks.values()), "")
    if not clock or len(names.signals.keys() - {"battery"}) < _FEWEST_SIGNALS:
        return None
    with suppress(InputError), np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return _judge(table, clock, names)
    return None


def _judge(table: Table, clock: str, names: Names) -> ColumnMap:
    """The map of columns whose signals are known, with units, signs and the motors' order."""
    rows = {
        signal: column_map.values(table, Source(columns))
        for signal, columns in names.signals.items()
    }
    columns = dict(names.signals)
    if "motors" in rows and "rotor_speed" not in rows and _are_speeds(rows["motors"], columns):
        columns["rotor_speed"] = columns.pop("motors")
        rows["rotor_speed"] = rows.pop("motors")
    time = column_map.values(table, Source((clock,)))[:, 0]
    step = _typical(np.diff(time))
    unit = "s" if step < 0.5 else "ms" if step < 500 else "us" if step < 5e5 else "ns"
    time, signs, units = time * column_map.UNITS[unit], {}, {TIME: unit}
    force = _typical(rows["accelerometer"][:, 2]) if "accelerometer" in rows else 0.0
    below = "position" in rows and _typical(rows["position"][:, 2]) < 0
    down = force < 0 if force else below
    units["accelerometer"] = "g" if abs(force) < 3 else "mg" if abs(force) > 300 else "m/s2"
    signs["accelerometer"] = signs["body_rates"] = (1, -1, -1) if down else (1, 1, 1)
    gyro = rows.get("body_rates", np.zeros((len(time), 3))) * signs["body_rates"]
    degrees = _most(gyro) > _FASTEST
    if "attitude" in rows:
        angles = rows["attitude"]
        if angles.shape[1] == len(_AXES):
            units["attitude"] = "deg" if _most(angles) > _HALF_TURN else "rad"
            angles = angles * column_map.UNITS[units["attitude"]]
        ratio = _compared(time, angles, gyro)
        degrees = bool(np.median(np.abs(ratio)) > 8.0) if np.isfinite(ratio).all() else degrees
        signs["attitude"] = tuple(-1 if value < 0 else 1 for value in ratio)
    units["body_rates"] = "deg/s" if degrees else "rad/s"
    if below:
        signs["position"] = signs["velocity"] = (1, -1, -1)
    turning = rows.get("motors", rows.get("rotor_speed"))
    order = (0, 1, 2, 3) if turning is None else _order(time, gyro, turning)
    for signal in {"motors", "rotor_speed"} & set(columns):
        columns[signal] = tuple(columns[signal][number] for number in order)
    if "rotor_speed" in columns:
        word = columns["rotor_speed"][0].lower()
        units["rotor_speed"] = "erpm" if "erpm" in word else "rpm" if "rpm" in word else "rad/s"
    if "battery" in columns:
        units["battery"] = "mV" if _typical(rows["battery"]) > 500 else "V"
    sources = {TIME: Source((clock,), unit)}
    for signal in COUNTS:
        if signal in columns:
            turned = (*signs.get(signal, ()), *(1,) * len(columns[signal]))
            signed = ("-" * (sign < 0) + name for sign, name in zip(turned, columns[signal]))  # noqa: B905
            own = names.clocks.get("motors" if signal == "rotor_speed" else signal, "")
            own = "" if own == clock else own
            sources[signal] = Source(tuple(signed), units.get(signal, ""), own)
    if "motors" not in rows:
        return ColumnMap(sources)
    scale = _range(rows["motors"], names.signals["motors"])
    if "accelerometer" in rows:
        force = rows["accelerometer"][:, 2] * signs["accelerometer"][2]
    elif "velocity" in rows:
        climb = rows["velocity"][:, 2] * signs.get("velocity", (1, 1, 1))[2]
        force = in_flight.GRAVITY + np.gradient(climb, time)
    else:
        return ColumnMap(sources, scale)
    return ColumnMap(sources, _judge_law(scale, time, rows["motors"], force))


def _are_speeds(motors: np.ndarray, names: Mapping[str, tuple[str, ...]]) -> bool:
    """Returns whether numbers of motors are measured speeds: of no range of commands, and uneven.

    Commands are counts, or shares.
    """
    if _COMMANDED.search(names["motors"][0].lower()):
        return False
    numbers = motors[np.isfinite(motors)]
    uneven = np.mean(numbers != np.round(numbers)) > 0.5 if len(numbers) else False
    return bool(uneven and _RANGES[2][1] < _most(motors) < _FASTEST_ROTOR)


def _judge_law(
    scale: Motors, time: np.ndarray, motors: np.ndarray, force: Float[np.ndarray, "N"]
) -> Motors:
    """Returns the law by which the force along z follows the motors, by name where it does not.

    Thrust in proportion to the numbers changes by 1 % with them, its square by 2 %.
    """
    throttle = ((motors - scale.low) / (scale.high - scale.low)).mean(axis=1)
    step = _typical(np.diff(time))
    share, error = max(
        (
            in_flight.elasticity(
                [in_flight.changes(np.interp(time - lag, time, throttle), force, step)]
            )
            for lag in _LAGS
        ),
        key=lambda elasticity: elasticity[0] / max(elasticity[1], 1e-9),
    )
    if not 3 * error < share:
        return scale
    return scale._replace(square=bool(share > np.sqrt(2.0)))


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
        lagged = np.stack([np.interp(time - lag, time, column) for column in smooth.T], axis=1)
        lagged = np.column_stack([lagged, np.ones(len(lagged))])
        weights = np.linalg.lstsq(lagged, turns, rcond=None)[0]
        share = 1.0 - np.var(turns - lagged @ weights, axis=0) / np.var(turns, axis=0)
        if share.min() > best:
            best, signs = float(share.min()), np.sign(weights[:4].T)
    corners = [tuple(column.astype(int)) for column in signs.T]
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
