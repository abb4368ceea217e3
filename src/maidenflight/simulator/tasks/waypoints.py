"""Trajectories through way-points, and way-points of CSV files.

Way-points are tuples, so that a trajectory can be a static argument of compiled programs.
"""

import csv
import io
from math import cos, factorial, pi, sin
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight import budget, inputs
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.simulator.tasks.trajectories import (
    START_S,
    Trajectory,
    between_rests,
    cached_by_arguments,
)

Waypoints = tuple[tuple[float, float, float, float], ...]
"""Rows of time [s], x, y, z [m], world."""

COLUMNS = ("time", "x", "y", "z")
"""Columns of a way-point file; `t` is `time`, too."""
MOST_YAW = 0.02
"""Yaw [rad] that a reference may have: policies hold 0."""
CRUISE_M_S, CRUISE_M_S2 = 1.0, 2.5
"""Speed and acceleration that way-points without time are passed with at most; ours, 14 degrees of
tilt."""
MOST_M_S, MOST_M_S2 = 5.0, 9.8
"""Speed and acceleration of a reference at most, against a wrong unit or a lost row; ours: 45
degrees of tilt."""
MOST_TIMED = 40
"""Way-points whose times are searched for; of more, they are in proportion to distance."""


@cached_by_arguments
def pentagram(diameter: float = 0.5, period: float = 5.0, height: float = 1.0) -> Trajectory:
    """Returns a level five-pointed star, edge by edge at constant speed.

    Its corners lie on `trajectories.circle`.

    Args:
        diameter: of the circle through the corners [m], as that of the paper's circle.
        period: [s]; of our choice, 0.48 m/s at 0.5 m where the paper's circle has 0.52 m/s.
        height: [m].
    """
    radius, turn = diameter / 2, 4 * pi / 5
    corners = [
        (
            number * period / 5,
            radius * (1 - cos(number * turn)),
            radius * sin(number * turn),
            height,
        )
        for number in range(6)
    ]
    star = zigzag(tuple(corners))
    return lambda time: star(jnp.mod(time, period))


@cached_by_arguments
def zigzag(points: Waypoints) -> Trajectory:
    """Returns straight lines from way-point to way-point, each at constant speed.

    Holds the first point before and the last after.

    Args:
        points: such as `read_waypoints(file)`.

    Raises:
        InputError: fewer than two points, not four finite numbers each, or time that does not
            increase.
    """
    table = _checked(points)
    return piecewise(table[:, 0], np.stack([table[:-1, 1:], np.diff(table[:, 1:], axis=0)]))


@cached_by_arguments
def minimum_snap(points: Waypoints) -> Trajectory:
    """Returns the curve of least snap from rest to rest through all way-points.

    Pieces of degree 7 with six continuous derivatives; it may overshoot between points whose
    distances in time are very unequal. Holds the first point before and the last after.

    Args:
        points: such as `read_waypoints(file)`.

    Raises:
        InputError: as of `zigzag`.

    Source: Mellinger and Kumar 2011, "Minimum Snap Trajectory Generation and Control for
    Quadrotors". Without further constraints the least integral of the squared fourth derivative is
    the spline of degree 7.
    """
    table = _checked(points)
    return _pieces(snap_spline(table[:, 0], table[:, 1:]), table[:, 0], 7)


def _pieces(spline: Any, times: Float[np.ndarray, "n"], degree: int) -> Trajectory:
    """Returns a spline as a trajectory."""
    lengths = np.diff(times)[:, None]
    powers = [
        spline(times[:-1], nu=power) * lengths**power / factorial(power)
        for power in range(degree + 1)
    ]
    return piecewise(times, np.stack(powers))


def snap_spline(times: Float[np.ndarray, "n"], places: Float[np.ndarray, "n 3"]) -> Any:
    """Returns the spline of degree 7 through places, from rest to rest."""
    # Imported here, since it takes longer than the import of the rest of the simulator.
    from scipy.interpolate import make_interp_spline

    rest = [(order, np.zeros(3)) for order in (1, 2, 3)]
    return make_interp_spline(times, places, k=7, bc_type=(rest, rest))


def timed(places: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
    """Returns the times [s] at which places are passed with the least snap.

    The shares of the whole time are those of the least integral of the squared snap; the whole is
    such that speed and acceleration stay within `CRUISE_M_S` and `CRUISE_M_S2`.

    Args:
        places: way-points [m], no two neighbours equal.

    Source: Mellinger and Kumar 2011, sec. V: optimal segment times, and temporal scaling.
    """
    from scipy.optimize import minimize

    # At the nodes of Gauss and Legendre the square of a cubic is integrated exactly.
    nodes, weights = np.polynomial.legendre.leggauss(4)

    def knots(logs: Float[np.ndarray, "m"]) -> Float[np.ndarray, "n"]:
        shares = np.exp(logs - logs.max())
        return np.concatenate([[0.0], np.cumsum(shares / shares.sum())])

    def snap(logs: Float[np.ndarray, "m"]) -> float:
        times = knots(logs)
        lengths = np.diff(times)
        at = times[:-1, None] + lengths[:, None] * (nodes + 1.0) / 2.0
        fourth = snap_spline(times, places)(at, nu=4)
        return float(np.log(np.sum(fourth**2 * (weights * lengths[:, None] / 2.0)[..., None])))

    logs = np.log(np.linalg.norm(np.diff(places, axis=0), axis=1))
    if 2 < len(places) <= MOST_TIMED:
        logs = minimize(snap, logs, method="L-BFGS-B", options={"maxiter": 50}).x
    times = knots(logs)
    speed, acceleration = _fastest(times, places)
    return times * max(speed / CRUISE_M_S, np.sqrt(acceleration / CRUISE_M_S2))


def _fastest(
    times: Float[np.ndarray, "n"], places: Float[np.ndarray, "n 3"]
) -> tuple[float, float]:
    """Greatest speed and acceleration of the curve of least snap."""
    spline = snap_spline(times, places)
    at = (times[:-1, None] + np.diff(times)[:, None] * np.linspace(0.0, 1.0, 21)).ravel()
    speed, acceleration = (np.linalg.norm(spline(at, nu=order), axis=1).max() for order in (1, 2))
    return float(speed), float(acceleration)


def read_reference(file: StrPath) -> tuple[Trajectory, float]:
    """Reads what a drone is to follow: the curve of least snap through a file's way-points.

    Rows in motion, such as a circle sampled at constant speed, are flown up to from rest, and to
    rest behind them; for a while longer than they take.

    Args:
        file: as of `read_waypoints`.

    Returns:
        The trajectory, and its duration [s].

    Raises:
        InputError: as of `read_waypoints`; or the curve is below the ground, or faster than any
            small drone follows.
    """
    points = read_waypoints(file)
    table = np.array(points)
    if np.min(table[:, 3]) <= 0.0:
        raise InputError(
            f"{file}: a height of {np.min(table[:, 3]):g} m; expected z above the ground, such as "
            "1 m."
        )
    speed, acceleration = _fastest(table[:, 0], table[:, 1:])
    if speed <= MOST_M_S and acceleration <= MOST_M_S2:
        return minimum_snap(points), points[-1][0]
    if len(points) > 5:
        moving, duration, speed, acceleration = _run_up(points)
        if speed <= MOST_M_S and acceleration <= MOST_M_S2:
            return moving, duration
    raise InputError(
        f"{file}: the smooth curve through the rows has up to {speed:.1f} m/s and "
        f"{acceleration:.1f} m/s^2; expected at most {MOST_M_S:g} m/s and {MOST_M_S2:g} m/s^2. "
        "Give more time, fewer rows or none that jump; or leave the column t out."
    )


@cached_by_arguments
def _run_up(points: Waypoints, degree: int = 5) -> tuple[Trajectory, float, float, float]:
    """Curve through points in motion, from rest to rest; its duration, speed and acceleration.

    Ramps take at most `CRUISE_M_S2` of the speed at the ends along the path. The spline's jerk is
    continuous and its ends are free.
    """
    from scipy.interpolate import make_interp_spline

    table = np.array(points)
    times, duration = table[:, 0], table[-1, 0]
    spline = make_interp_spline(times, table[:, 1:], k=degree)
    ends = np.linalg.norm(spline(times[[0, -1]], nu=1), axis=1)
    first, last = np.clip(15 / 8 * ends / CRUISE_M_S2, START_S, duration).tolist()
    moving = _pieces(spline, times, degree)
    # Derivatives by the clock: p' s and p'' s^2 + p' ds/dt, with the share s of the own speed.
    u = np.linspace(0.0, 1.0, 400)[:, None]
    progress, share = u**4 * (2.5 - 3.0 * u + u**2), u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    gaining = 30.0 * u**2 * (1.0 - u) ** 2
    fine = np.linspace(times[:-1], times[1:], 21).T.ravel()
    middle = fine[(fine >= first / 2.0) & (fine <= duration - last / 2.0)]
    speeds, accelerations = [spline(middle, nu=1)], [spline(middle, nu=2)]
    for at, change in (
        (first * progress, gaining / first),
        (duration - last * progress, -gaining / last),
    ):
        slope, bend = (spline(at[:, 0], nu=order) for order in (1, 2))
        speeds.append(slope * share)
        accelerations.append(bend * share**2 + slope * change)
    speed, acceleration = (
        float(np.linalg.norm(np.concatenate(rows), axis=1).max())
        for rows in (speeds, accelerations)
    )
    return *between_rests(moving, float(duration), first, last), speed, acceleration


def waypoints(file: StrPath, smooth: bool = False, fastest: float = MOST_M_S) -> Trajectory:
    """Returns the trajectory through the way-points of a CSV file.

    The same rows give the same object.

    Args:
        file: as of `read_waypoints`.
        smooth: `minimum_snap` instead of `zigzag`.
        fastest: highest mean speed between two points [m/s].

    Raises:
        InputError: as of `read_waypoints`.
    """
    points = read_waypoints(file, fastest)
    return minimum_snap(points) if smooth else zigzag(points)


def read_waypoints(file: StrPath, fastest: float = MOST_M_S) -> Waypoints:
    """Reads and checks way-points; their clock starts at the first one.

    Args:
        file: CSV with a header line and at least the columns x, y, z [m]; with t or time [s], else
            the times are those of `timed`. A column yaw must be 0.
        fastest: highest mean speed between two points [m/s], against a wrong unit or a lost row; of
            our choice.

    Returns:
        The way-points; the last one's time is the duration.

    Raises:
        InputError: not readable, a missing column, fewer than two points, a value that is not
            finite, time that does not increase, a jump, or a yaw.
    """
    header, rows = _read_rows(file)
    yaw = "yaw" in header
    columns = [name for name in COLUMNS if name in header or name != "time"]
    columns += ["yaw"] if yaw else []
    points = [
        [_number(row[column], f"{file}: {name}: {column}") for column in columns]
        for name, row in rows
    ]
    names = [name for name, _ in rows]
    for name, point in zip(names, points, strict=True):
        if yaw and not abs(point.pop()) <= MOST_YAW:
            raise InputError(
                f"{file}: {name}: a yaw; policies hold the heading of their take-off. Leave the "
                "column yaw out, or turn the drone before."
            )
    if "time" not in header:
        untimed = [(float(number), *point) for number, point in enumerate(points)]
        places = _checked(untimed, f"{file}: ", names)[:, 1:]
        for number in np.flatnonzero(np.linalg.norm(np.diff(places, axis=0), axis=1) < 1e-3)[:1]:
            raise InputError(
                f"{file}: {names[number + 1]}: the same place as before. Leave it out, or give a "
                "column t to wait there."
            )
        points = [[time, *point] for time, point in zip(timed(places), points, strict=True)]
    table = _checked([tuple(point) for point in points], f"{file}: ", names, fastest)
    return tuple((time, x, y, z) for time, x, y, z in table.tolist())


def _read_rows(file: StrPath) -> tuple[list[str], list[tuple[str, dict[str, str | None]]]]:
    """Header of a file, and its rows with the line's number; a column `t` is called `time`."""
    try:
        reader = csv.reader(
            io.StringIO(inputs.content(file, budget.TABLE).decode("utf-8-sig"), newline=""),
            skipinitialspace=True,
        )
        header = ["time" if name == "t" else name for name in next(reader, ())]
        lines = [(reader.line_num, line) for line in reader if line]
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(
            f"{file}: not a readable CSV file ({error}). Give a text file with the columns "
            "t,x,y,z, or x,y,z."
        ) from error
    missing = [name for name in COLUMNS[1:] if name not in header]
    twice = [name for name in (*COLUMNS, "yaw") if header.count(name) > 1]
    if missing or twice:
        raise InputError(
            f"{file}: {'missing' if missing else 'twice'} column {', '.join(missing or twice)}; "
            "expected a header line with t,x,y,z, or x,y,z."
        )
    for number, line in lines:
        if len(line) > len(header):
            raise InputError(
                f"{file}: line {number} has more cells than the header. Correct or drop it."
            )
    padded = [(f"line {number}", [*line, *[None] * len(header)]) for number, line in lines]
    return header, [(name, dict(zip(header, line, strict=False))) for name, line in padded]


def _number(text: str | None, source: str) -> float:
    try:
        return float(text or "")
    except ValueError:
        raise InputError(
            f"{source} is {text!r}; expected a number. Write it, or leave the row out."
        ) from None


def _checked(
    points: Waypoints | list[tuple[float, ...]],
    source: str = "",
    names: list[str] | None = None,
    fastest: float = np.inf,
) -> Float[np.ndarray, "n 4"]:
    """Way-points as a table whose time starts at zero, in numbers that float32 can hold."""
    names = names or [f"way-point {number}" for number in range(1, len(points) + 1)]
    if len(points) < 2:
        raise InputError(f"{source}{len(points)} way-points; expected two or more. Add rows.")
    for name, row in zip(names, points, strict=True):
        if len(row) != len(COLUMNS) or not np.all(np.abs(row) < np.finfo(np.float32).max):
            raise InputError(
                f"{source}{name} is {row}; expected four finite numbers, {','.join(COLUMNS)}."
            )
    table = np.array(points, np.float64)
    table[:, 0] -= table[0, 0]
    gaps = np.diff(table[:, 0].astype(np.float32))
    for number in np.flatnonzero(gaps <= 0)[:1]:
        before, after = points[number][0], points[number + 1][0]
        raise InputError(
            f"{source}{names[number + 1]}: time goes from {before} to {after} s; expected it to "
            "increase. Sort the rows."
        )
    speeds = np.linalg.norm(np.diff(table[:, 1:], axis=0), axis=1) / gaps
    for number in np.flatnonzero(speeds > fastest)[:1]:
        raise InputError(
            f"{source}{names[number + 1]}: {speeds[number]:.1f} m/s from the point before it, but "
            f"at most {fastest:g} m/s are allowed. "
            "Check the units (s, m) and for lost rows, or allow more with fastest."
        )
    return table


def piecewise(times: Float[np.ndarray, "n"], powers: Float[np.ndarray, "degree m 3"]) -> Trajectory:
    """Polynomials between times, constant beyond its ends.

    Piece i is the sum of `powers[k, i]` s^k, where s goes from 0 to 1. At a time where two pieces
    meet, the slope is that of the later one.
    """
    knots = times.astype(np.float32)
    even = len(times) > 2 and np.allclose(np.diff(times), times[1] - times[0], rtol=1e-6)
    lengths, table = np.diff(knots), powers.astype(np.float32)

    def reference(time: Float[Array, ""]) -> Float[Array, "3"]:
        if even:  # faster for long tables
            piece = jnp.floor((time - knots[0]) * np.float32(1.0 / lengths[0])).astype(jnp.int32)
        else:
            piece = jnp.searchsorted(jnp.asarray(knots), time, side="right") - 1
        index = jnp.clip(piece, 0, len(lengths) - 1)
        s = (time - jnp.asarray(knots)[index]) / jnp.asarray(lengths)[index]
        s = jnp.where(time < knots[0], 0.0, jnp.where(time < knots[-1], s, 1.0))
        coefficients = jnp.asarray(table)[:, index]
        point = coefficients[-1]
        for coefficient in coefficients[-2::-1]:
            point = point * s + coefficient
        return point

    return reference
