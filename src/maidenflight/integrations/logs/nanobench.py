"""NanoBench logs: 51 columns of a Crazyflie 2.1 under motion capture, at 100 Hz.

Each stream was logged by its own clock. Measured on its 26 flights, of which 25 leave the ground:

- The drone's own streams agree in time in every file: the estimated attitude follows the gyro by
  6 ms (quartiles 5 to 8); roll, pitch and yaw acceleration follow the motors' torque by 44, 40 and
  61 ms (correlations 0.41, 0.35, 0.40, all positive).
- Vicon's clock drifts against them within a flight by tens of ms, in five files by -200 to +190 ms.
  Its angular rates are matched to the gyro in segments of 1.5 s. Over 0.2 s the gyro then predicts
  Vicon's roll and pitch to 0.83 deg instead of 1.02 (better in 25 of 25 flights), and the
  accelerometer, which was not used, its vertical velocity to 9.0 mm/s instead of 10.0 (better in
  22).
- Vicon's velocity is the change of its position (correlation 1.00, 0 ms); the estimator's is 30 to
  50 ms late (0.80 to 0.94), and its position jumps. So position, velocity and attitude are Vicon's,
  moved onto the drone's clock; body rates are the gyro's.
- Signs are ours: Vicon's Euler angles are those of its quaternion, rad, nose down positive (the
  estimator's pitch is the legacy one, -0.94); the gyro is in rad/s. PWM is after battery
  compensation, by two laws: 21 files by that of the 2.1+ propellers, three (B2_circle_fast_rep2,
  B2_circle_medium_rep3, B3_figure8_medium_rep2) by that of the legacy ones. The logged thrust
  command decides; see `compensation`.

Source: Ullah and Baca 2026, arXiv 2603.09908, github syediu/nanobench-iros2026.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from maidenflight.flights import compensation, tables
from maidenflight.flights.formats import LoggedFlights, TableFormat
from maidenflight.flights.log import flight_of
from maidenflight.flights.streams import attitudes
from maidenflight.flights.tables import Table
from maidenflight.simulator.physics.battery import MOST_COUNTS

VICON = ("px", "py", "pz", "vx", "vy", "vz", "roll", "pitch", "yaw")
GYRO = ("imu_gyro_x", "imu_gyro_y", "imu_gyro_z")
MOTORS = ("motor_motor_m1", "motor_motor_m2", "motor_motor_m3", "motor_motor_m4")
SETPOINT = ("sp_ctrltarget_x", "sp_ctrltarget_y", "sp_ctrltarget_z")
COLUMNS = ("t", *VICON, *GYRO, *MOTORS, *SETPOINT, "pwr_pm_vbat", "pid_controller_cmd_thrust")
"""The columns that are used."""

PERIOD = 0.01
"""Time between two rows [s]."""
MAX_SHIFT_ROWS = 25
"""Largest shift of Vicon's clock that is tried, either way."""
EVERY = 25
"""Rows between two matches."""
HALF = 75
"""Half the rows of a match."""


def flights(table: Table) -> LoggedFlights:
    """Returns a table's flight, unchecked, the time of its rows [s], and a note on its commands.

    Raises:
        InputError: a column is missing or not numeric, or its battery law is not known.
    """
    column = tables.numbers(table, COLUMNS)

    def columns(*names: str) -> np.ndarray:
        return np.stack([column[name] for name in names], axis=-1)

    rates, volts, pwm = columns(*GYRO), column["pwr_pm_vbat"], columns(*MOTORS)
    thrust = column["pid_controller_cmd_thrust"]
    law, law_choice = compensation.choose_law(
        table.head, table.name, pwm, volts, thrust, compensation.PLUS
    )
    vicon = columns(*VICON)
    vicon[np.isinf(vicon)] = np.nan
    vicon[:, 6:] = np.unwrap(vicon[:, 6:], axis=0)
    rows = np.arange(len(rates))
    moved = rows - lag(rates, vicon[:, 6:])
    pose = np.stack([np.interp(moved, rows, values) for values in vicon.T], axis=1)
    flight = flight_of(
        table.name,
        PERIOD,
        position=pose[:, :3],
        velocity=pose[:, 3:6],
        attitude=attitudes.wrapped(pose[:, 6:]),
        body_rates=rates,
        command=compensation.thrust_command(pwm, volts, law),
        battery=volts,
        setpoint=columns(*SETPOINT),
        zero_order_hold=False,
        full_scale_counts=MOST_COUNTS,
        assumed_law=law if law_choice == compensation.BY_VOLTAGE else None,
    )
    with np.errstate(invalid="ignore"):  # what is not finite is refused by checking
        time = column["t"] - column["t"][0]
    return [(flight, time)], [compensation.note(table.name, law, law_choice)]


def lag(
    rates: Float[np.ndarray, "N 3"], attitude: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "N"]:
    """Returns rows by which gyro is later than an attitude logged by another clock, for each row.

    Every `EVERY` rows the correlation of roll and pitch rate over `HALF` rows on either side is
    taken at all whole lags. Dynamic programming finds the smooth path of largest correlation, and a
    parabola refines it.

    Args:
        rates: body rates [rad/s].
        attitude: roll, pitch, yaw by the other clock [rad].
    """
    rows = np.arange(len(rates))
    if len(rates) <= 2 * (MAX_SHIFT_ROWS + HALF):
        return np.zeros(len(rates))
    turned = Rotation.from_euler("ZYX", np.nan_to_num(attitude)[:, ::-1])
    turns = (turned[:-2].inv() * turned[2:]).as_rotvec() / (2 * PERIOD)
    gyro = _band_passed(np.nan_to_num(rates[:, :2]))
    turn_rates = _band_passed(np.pad(turns, ((1, 1), (0, 0)))[:, :2])
    lags = np.arange(-MAX_SHIFT_ROWS, MAX_SHIFT_ROWS + 1)
    matched = rows[::EVERY]
    power = _windows_at((gyro**2).sum(axis=1), HALF, matched)
    power_series = (turn_rates**2).sum(axis=1)
    match = np.empty((len(matched), len(lags)))
    for number, shift in enumerate(lags):
        moved = np.clip(rows - shift, 0, rows[-1])
        both = _windows_at((gyro * turn_rates[moved]).sum(axis=1), HALF, matched)
        size = np.sqrt(power * _windows_at(power_series[moved], HALF, matched))
        match[:, number] = both / np.maximum(size, 1e-6)
    path = _smoothest_path(match)
    inner = np.clip(path, 1, len(lags) - 2)
    before, at, after = (match[np.arange(len(matched)), inner + step] for step in (-1, 0, 1))
    bend = np.minimum(before - 2 * at + after, -1e-6)
    refined = lags[inner] + np.clip((before - after) / (2 * bend), -0.5, 0.5)
    return np.interp(rows, matched, refined)


def _band_passed(values: np.ndarray) -> np.ndarray:
    """Without noise shorter than 0.07 s and drift longer than 1 s."""
    return _smooth(values, 3) - _smooth(values, 50)


def _smooth(values: np.ndarray, half: int) -> np.ndarray:
    rows = np.arange(len(values))
    sums = np.stack([_windows_at(column, half, rows) for column in values.T], axis=1)
    return sums / (2 * half + 1)


def _windows_at(values: np.ndarray, half: int, rows: np.ndarray) -> np.ndarray:
    """Sum over `half` rows on either side of some."""
    summed = np.concatenate([[0.0], np.cumsum(values)])
    return summed[np.minimum(rows + half + 1, len(values))] - summed[np.maximum(rows - half, 0)]


def _smoothest_path(match: np.ndarray, penalty: float = 0.02, farthest: int = 3) -> np.ndarray:
    """Path of columns through the rows of a matrix with the largest sum.

    A change of column costs `penalty` for each column, `farthest` at most.
    """
    columns = np.arange(match.shape[1])
    moves = np.arange(-farthest, farthest + 1)
    came = columns - moves[:, None]
    reachable = (came >= 0) & (came < len(columns))
    came = np.clip(came, 0, len(columns) - 1)
    total, back = match[0], []
    for row in match[1:]:
        options = np.where(reachable, total[came] - penalty * np.abs(moves)[:, None], -np.inf)
        choice = options.argmax(axis=0)
        back.append(came[choice, columns])
        total = options[choice, columns] + row
    path = [int(total.argmax())]
    for step in reversed(back):
        path.append(int(step[path[-1]]))
    return np.array(path[::-1])


FORMAT = TableFormat(
    "NanoBench's 51 columns", lambda table: table.has_most_of(COLUMNS), flights, compensated=True
)
