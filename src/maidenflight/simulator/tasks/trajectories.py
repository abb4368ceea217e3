"""Reference trajectories: position as a function of time, and way-points from files.

Time, not step counts, so that every control rate sees the same reference. Each shape starts at
(0, 0, height). The same arguments give the same object, so that a trajectory can be a static
argument of compiled programs; way-points are therefore tuples.
"""

import csv
import io
from collections.abc import Callable
from functools import cache, wraps
from inspect import signature
from math import cos, factorial, pi, sin
from typing import ParamSpec, TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight import inputs
from maidenflight.errors import InputError
from maidenflight.inputs import StrPath

Trajectory = Callable[[Float[Array, ""]], Float[Array, "3"]]
"""Time [s] to set-point [m], world."""

Waypoints = tuple[tuple[float, float, float, float], ...]
"""Rows of time [s], x, y, z [m], world."""

COLUMNS = ("time", "x", "y", "z")
"""Columns of a way-point file."""

RAMP_DURATION_S = 30.0
"""Time in which a accelerating reference comes to its fastest [s]."""
START_S = 1.5
"""Time in which a curve that starts from rest comes to its own speed [s]; ours. On the paper's
circle its acceleration then stays within 1.2 m/s^2, 7 degrees of tilt."""
SLOW, NORMAL, FAST = 15.0, 5.5, 3.5
"""Periods of a figure-eight [s] (SimpleFlight, second-hand)."""


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def cached_by_arguments(make: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Caches a function by its arguments, by position, by name or by default."""
    cached, known = cache(make), signature(make)

    @wraps(make)
    def call_cached(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        bound = known.bind(*args, **kwargs)
        bound.apply_defaults()
        return cached(*bound.args)

    return call_cached


@cached_by_arguments
def circle(diameter: float = 0.5, period: float = 3.0, height: float = 1.0) -> Trajectory:
    """Returns a level circle, clock-wise from above, with its centre on the x axis.

    It starts at (0, 0, height) towards +y.

    Args:
        diameter: [m].
        period: [s].
        height: [m].

    Source: Gronauer et al. 2022, sec. Experimental Setup; start point from the authors' code.
    """
    radius = diameter / 2

    def reference(time: Float[Array, ""]) -> Float[Array, "3"]:
        angle = 2 * jnp.pi * time / period
        return jnp.stack(
            [radius * (1 - jnp.cos(angle)), radius * jnp.sin(angle), jnp.full_like(angle, height)]
        )

    return reference


@cached_by_arguments
def hold(position: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Trajectory:
    """Returns a constant point [m]."""
    return lambda time: jnp.stack([jnp.full_like(time, coordinate) for coordinate in position])


@cached_by_arguments
def climb(height: float = 1.0, duration: float = 1.5) -> Trajectory:
    """Returns the way straight up from the origin to a height [m] within a duration [s], then hold.

    From rest to rest with the least jerk.

    Source: height and duration from the authors' code (its ramp is linear, so its velocity jumps);
    the shape is from Flash and Hogan 1985.
    """

    def reference(time: Float[Array, ""]) -> Float[Array, "3"]:
        s = jnp.clip(time / duration, 0.0, 1.0)
        return jnp.stack(
            [jnp.zeros_like(s), jnp.zeros_like(s), height * s**3 * (10 - 15 * s + 6 * s**2)]
        )

    return reference


@cached_by_arguments
def figure_eight(period: float = NORMAL, width: float = 2.0, height: float = 1.0) -> Trajectory:
    """Returns a level lemniscate of Bernoulli along the x axis.

    It starts at its crossing towards +x and +y.

    Args:
        period: [s]; `SLOW`, `NORMAL` and `FAST` are SimpleFlight's.
        width: from tip to tip [m]; source unknown: a unit lemniscate, of our choice.
        height: [m].
    """
    half = width / 2

    def reference(time: Float[Array, ""]) -> Float[Array, "3"]:
        sine, cosine = jnp.sin(2 * jnp.pi * time / period), jnp.cos(2 * jnp.pi * time / period)
        x = half * sine / (1 + cosine**2)
        return jnp.stack([x, x * cosine, jnp.full_like(x, height)])

    return reference


@cached_by_arguments
def accelerating(
    trajectory: Trajectory, duration: float = RAMP_DURATION_S, smooth: bool = False
) -> Trajectory:
    """Returns the same path, from rest.

    Its speed is a growing share of the trajectory's own, and all of it at the end.

    Args:
        trajectory: the trajectory, for ever.
        duration: time until it runs at its own speed [s]; 0: at once.
        smooth: the share grows as 3 u^2 - 2 u^3 with u = time / duration, so that the acceleration
            has no jump; else as u.
    """
    if duration == 0.0:
        return trajectory

    def reference(time: Float[Array, ""]) -> Float[Array, "3"]:
        early = jnp.minimum(time, duration)
        u = early / duration
        mean_share = u * u * (1.0 - u / 2.0) if smooth else u / 2.0
        return trajectory(early * mean_share + jnp.maximum(time - duration, 0.0))

    return reference


@cached_by_arguments
def hastening(trajectory: Trajectory, fastest: float) -> Trajectory:
    """Returns the same path, faster: its speed grows evenly to `fastest` times its own.

    Args:
        trajectory: the trajectory, for ever.
        fastest: of its own speed, after `RAMP_DURATION_S` [-].
    """

    def reference(time: Float[Array, ""]) -> Float[Array, "3"]:
        early = jnp.minimum(time, RAMP_DURATION_S)
        gained = (fastest - 1.0) * early * early / (2.0 * RAMP_DURATION_S)
        return trajectory(early + gained + fastest * jnp.maximum(time - RAMP_DURATION_S, 0.0))

    return reference


@cached_by_arguments
def accelerating_circle(fastest: float, diameter: float = 1.0) -> Trajectory:
    """Returns a `circle` of a diameter [m] whose speed grows to fastest [m/s]."""
    return accelerating(circle(diameter, pi * diameter / fastest))


@cached_by_arguments
def accelerating_figure_eight(fastest: float, width: float = 2.0) -> Trajectory:
    """Returns a `figure_eight` whose top speed, at its tips, grows to the fastest [m/s].

    A lemniscate of half width h and period P has a speed of 2 pi h / P there.
    """
    return accelerating(figure_eight(pi * width / fastest, width))


@cached_by_arguments
def pentagram(diameter: float = 0.5, period: float = 5.0, height: float = 1.0) -> Trajectory:
    """Returns a level five-pointed star, edge by edge at constant speed.

    Its corners lie on `circle`.

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
    return _piecewise(table[:, 0], np.stack([table[:-1, 1:], np.diff(table[:, 1:], axis=0)]))


@cached_by_arguments
def polynomial(points: Waypoints) -> Trajectory:
    """Returns the minimum-jerk curve from rest to rest through all way-points.

    Quintic pieces with four continuous derivatives; it may overshoot between points whose distances
    in time are very unequal. Holds the first point
    before and the last after.

    Args:
        points: such as `read_waypoints(file)`.

    Raises:
        InputError: as of `zigzag`.

    Source: Flash and Hogan 1985 for one piece; through more points, the natural generalisation to a
    quintic spline.
    """
    # Imported here, since it takes longer than the import of the rest of the simulator.
    from scipy.interpolate import make_interp_spline

    table = _checked(points)
    times, lengths = table[:, 0], np.diff(table[:, 0])[:, None]
    rest = [(1, np.zeros(3)), (2, np.zeros(3))]
    spline = make_interp_spline(times, table[:, 1:], k=5, bc_type=(rest, rest))
    powers = [
        spline(times[:-1], nu=power) * lengths**power / factorial(power) for power in range(6)
    ]
    return _piecewise(times, np.stack(powers))


def waypoints(file: StrPath, smooth: bool = False, fastest: float = 5.0) -> Trajectory:
    """Returns the trajectory through the way-points of a CSV file.

    The same rows give the same object.

    Args:
        file: as of `read_waypoints`.
        smooth: `polynomial` instead of `zigzag`.
        fastest: highest mean speed between two points [m/s].

    Raises:
        InputError: as of `read_waypoints`.
    """
    points = read_waypoints(file, fastest)
    return polynomial(points) if smooth else zigzag(points)


def read_waypoints(file: StrPath, fastest: float = 5.0) -> Waypoints:
    """Reads and checks way-points; their clock starts at the first one.

    Args:
        file: CSV with a header line and at least the columns time [s], x, y, z [m].
        fastest: highest mean speed between two points [m/s], against a wrong unit or a lost row; of
            our choice.

    Returns:
        The way-points; the last one's time is the duration.

    Raises:
        InputError: not readable, a missing column, fewer than two points, a value that is not
            finite, time that does not increase, or a jump.
    """
    try:
        reader = csv.DictReader(
            io.StringIO(inputs.content(file).decode("utf-8-sig"), newline=""), skipinitialspace=True
        )
        header = reader.fieldnames or ()
        wrong = [name for name in COLUMNS if list(header).count(name) != 1]
        if wrong:
            problem = "missing column" if set(wrong) - set(header) else "twice column"
            raise InputError(
                f"{file}: {problem} {', '.join(wrong)}; expected a header line with "
                f"{','.join(COLUMNS)}."
            )
        rows = [
            (f"line {reader.line_num}", [*(row[name] for name in COLUMNS), *row.get(None, ())])
            for row in reader
        ]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(
            f"{file}: not a readable CSV file ({error}). Give a text file with the columns "
            f"{','.join(COLUMNS)}."
        ) from error
    for name, row in rows:
        if len(row) > len(COLUMNS):
            raise InputError(f"{file}: {name} has more cells than the header. Correct or drop it.")
    points = [
        tuple(
            _number(text, f"{file}: {name}: {column}")
            for text, column in zip(row, COLUMNS, strict=True)
        )
        for name, row in rows
    ]
    table = _checked(points, f"{file}: ", [name for name, _ in rows], fastest)
    return tuple((time, x, y, z) for time, x, y, z in table.tolist())


def _number(text: str | None, place: str) -> float:
    try:
        return float(text or "")
    except ValueError:
        raise InputError(
            f"{place} is {text!r}; expected a number. Write it, or leave the row out."
        ) from None


def _checked(
    points: Waypoints | list[tuple[float, ...]],
    place: str = "",
    names: list[str] | None = None,
    fastest: float = np.inf,
) -> Float[np.ndarray, "n 4"]:
    """Way-points as a table whose time starts at zero, in numbers that float32 can hold."""
    names = names or [f"way-point {number}" for number in range(1, len(points) + 1)]
    if len(points) < 2:
        raise InputError(
            f"{place}{len(points)} way-points; expected two or more. Add rows of "
            f"{','.join(COLUMNS)}."
        )
    for name, row in zip(names, points, strict=True):
        if len(row) != len(COLUMNS) or not np.all(np.abs(row) < np.finfo(np.float32).max):
            raise InputError(
                f"{place}{name} is {row}; expected four finite numbers, {','.join(COLUMNS)}."
            )
    table = np.array(points, np.float64)
    table[:, 0] -= table[0, 0]
    gaps = np.diff(table[:, 0].astype(np.float32))
    for number in np.flatnonzero(gaps <= 0)[:1]:
        before, after = points[number][0], points[number + 1][0]
        raise InputError(
            f"{place}{names[number + 1]}: time goes from {before} to {after} s; expected it to "
            "increase. Sort the rows."
        )
    speeds = np.linalg.norm(np.diff(table[:, 1:], axis=0), axis=1) / gaps
    for number in np.flatnonzero(speeds > fastest)[:1]:
        raise InputError(
            f"{place}{names[number + 1]}: {speeds[number]:.1f} m/s from the point before it, but "
            f"at most {fastest:g} m/s are allowed. "
            "Check the units (s, m) and for lost rows, or allow more with fastest."
        )
    return table


def _piecewise(
    times: Float[np.ndarray, "n"], powers: Float[np.ndarray, "degree m 3"]
) -> Trajectory:
    """Polynomials between times, constant beyond its ends.

    Piece i is the sum of `powers[k, i]` s^k, where s goes from 0 to 1. At a time where two pieces
    meet, the slope is that of the later one.
    """
    knots = times.astype(np.float32)
    lengths, table = np.diff(knots), powers.astype(np.float32)

    def reference(time: Float[Array, ""]) -> Float[Array, "3"]:
        index = jnp.clip(
            jnp.searchsorted(jnp.asarray(knots), time, side="right") - 1, 0, len(lengths) - 1
        )
        s = (time - jnp.asarray(knots)[index]) / jnp.asarray(lengths)[index]
        s = jnp.where(time < knots[0], 0.0, jnp.where(time < knots[-1], s, 1.0))
        coefficients = jnp.asarray(table)[:, index]
        point = coefficients[-1]
        for coefficient in coefficients[-2::-1]:
            point = point * s + coefficient
        return point

    return reference
