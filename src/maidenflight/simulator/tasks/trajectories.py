"""Reference trajectories: position as a function of time.

Time, not step counts, so that every control rate sees the same reference. Each shape starts at
(0, 0, height). The same arguments give the same object, so that a trajectory can be a static
argument of compiled programs.
"""

from collections.abc import Callable
from functools import cache, wraps
from inspect import signature
from math import pi
from typing import ParamSpec, TypeVar

import jax.numpy as jnp
from jaxtyping import Array, Float

Trajectory = Callable[[Float[Array, ""]], Float[Array, "3"]]
"""Time [s] to set-point [m], world."""

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
def between_rests(
    trajectory: Trajectory, duration: float, first: float, last: float
) -> tuple[Trajectory, float]:
    """Returns the same path from rest to rest, and its duration [s].

    Its speed is a share of the trajectory's own: 10 u^3 - 15 u^4 + 6 u^5 with u = t / first in the
    beginning, likewise backwards in the end, so that its jerk has no jump.

    Args:
        trajectory: the trajectory.
        duration: of it [s].
        first: time in which it comes to its own speed [s]; at most its duration.
        last: time in which it comes to rest [s]; likewise.

    Source: the shape from rest to rest with the least jerk, Flash and Hogan 1985, as a speed.
    """
    whole = duration + (first + last) / 2.0

    def advance(time: Float[Array, ""], ramp: float) -> Float[Array, ""]:
        early = jnp.clip(time, 0.0, ramp)
        u = early / ramp
        return early * u**3 * (2.5 - 3.0 * u + u * u) + jnp.maximum(time - ramp, 0.0)

    def reference(time: Float[Array, ""]) -> Float[Array, "3"]:
        ending = duration - advance(whole - time, last)
        return trajectory(jnp.where(time < whole - last, advance(time, first), ending))

    return reference, whole


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
