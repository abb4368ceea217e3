"""A long random course: what policies that follow any reference are trained on.

One trajectory of hovers, circles, figure-eights and ways through random points, each from rest to
rest. Episodes start anywhere on it, so that a course of minutes is many references.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from jaxtyping import Float

from maidenflight.simulator.tasks.trajectories import START_S, Trajectory, cached_by_arguments
from maidenflight.simulator.tasks.waypoints import piecewise, snap_spline, timed

STEP_S = 0.1
"""Between two knots of the course [s]; a cubic then is within 0.1 mm of the circle."""
COURSE_S = 400.0
"""How long the course is [s]; ours."""
SPEEDS = (0.2, 1.4)
"""Range of the speeds of its parts [m/s]: the paper's circle has 0.52, a figure-eight of 5.5 s up
to 1.14."""
MOST_ACCELERATION = 4.0
"""Of its parts [m/s^2]: 22 degrees of tilt, and 5 more than the figure-eight."""

Places = Float[np.ndarray, "n 3"]


def _draw_hover(random: np.random.Generator) -> Places:
    """A stay of 1 to 3 s."""
    return np.zeros((round(random.uniform(1.0, 3.0) / STEP_S), 3))


def _draw_points(random: np.random.Generator) -> Places:
    """A way of least snap through 3 to 6 points, 0.2 to 0.8 m apart on average."""
    steps = random.normal(0.0, random.uniform(0.15, 0.5), (random.integers(3, 7), 3))
    places = np.cumsum(np.concatenate([np.zeros((1, 3)), steps * [1.0, 1.0, 0.5]]), axis=0)
    times = timed(places)
    times *= random.uniform(0.7, 2.0)
    return snap_spline(times, places)(np.arange(0.0, times[-1], STEP_S))


def _draw_curve(
    random: np.random.Generator, curve: Callable[[Places], Places], bend: float
) -> Places:
    """Draws two rounds of a closed curve of unit size, turned and tilted, at a smooth speed.

    `bend` is its greatest curvature.
    """
    size = random.uniform(0.15, 0.8) if bend == 1.0 else random.uniform(0.4, 1.2)
    speed = min(random.uniform(*SPEEDS), np.sqrt(MOST_ACCELERATION * size / bend))
    rate = speed / size
    turns = 2.0 * np.pi * 2.0 / rate
    time = np.arange(0.0, turns + START_S, STEP_S)
    ramps = np.clip(np.stack([time, turns + START_S - time]) / START_S, 0.0, 1.0)
    share = np.prod(ramps**2 * (3.0 - 2.0 * ramps), axis=0)
    angle = np.concatenate([[0.0], np.cumsum((share[1:] + share[:-1]) / 2.0 * STEP_S * rate)])
    heading, tilt = random.uniform(0.0, 2.0 * np.pi), random.normal(0.0, 0.25)
    x, y = curve(random.choice([-1.0, 1.0]) * angle).T * size
    level = np.stack([x, y * np.cos(tilt), y * np.sin(tilt)], axis=1)
    cosine, sine = np.cos(heading), np.sin(heading)
    return level @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _circle(angle: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 2"]:
    return np.stack([1.0 - np.cos(angle), np.sin(angle)], axis=1)


def _eight(angle: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 2"]:
    """A lemniscate whose greatest speed is 1 for a rate of 1."""
    x = np.sin(angle) / (1.0 + np.cos(angle) ** 2)
    return np.stack([x, x * np.cos(angle)], axis=1)


_PARTS: tuple[Callable[[np.random.Generator], Places], ...] = (
    _draw_hover,
    _draw_points,
    partial(_draw_curve, curve=_circle, bend=1.0),
    partial(_draw_curve, curve=_eight, bend=3.0),
)
"""Hovers, ways through points, circles and figure-eights, drawn in turn."""


@cached_by_arguments
def random_course(duration: float = COURSE_S, seed: int = 0, height: float = 1.0) -> Trajectory:
    """Returns a course of random parts that starts at rest at (0, 0, height).

    Where a part ends, the next begins.

    Args:
        duration: of the course at least [s]; its last part is whole.
        seed: of the parts.
        height: of its start [m].
    """
    from scipy.interpolate import make_interp_spline

    random = np.random.default_rng(seed)
    places, number = [np.zeros((round(1.0 / STEP_S), 3))], 0
    while sum(map(len, places)) * STEP_S < duration:
        part = _PARTS[number % len(_PARTS)](random)
        end = places[-1][-1]
        places.append(end + part - part[0])
        number += 1
    path = np.concatenate(places) + np.array([0.0, 0.0, height])
    times = np.arange(len(path)) * STEP_S
    spline = make_interp_spline(times, path, k=3, bc_type="clamped")
    factorials = np.array([1.0, 1.0, 2.0, 6.0])
    powers = [
        spline(times[:-1], nu=power) * STEP_S**power / factorials[power] for power in range(4)
    ]
    return piecewise(times, np.stack(powers))
