"""The battery and the firmware's compensation for it: from thrust command to motor ratio and back.

A Crazyflie raises the motor ratio as the battery voltage falls, so that a thrust command gives the
same thrust until the ratio reaches one. Logs hold the ratio after compensation; the inverse of the
same law recovers the command.

Source: Crazyflie firmware 2021.10, src/drivers/src/motors.c, motorsCompensateBatteryVoltage; the
scales were verified on the authors' flight logs (97 % of 617,316 samples exact, all within one
8-bit step).

These functions take NumPy arrays as well as JAX arrays, because logs are read without compiling
anything.
"""

from typing import TypeVar

import jax
import numpy as np
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters

Numbers = TypeVar("Numbers", jax.Array, np.ndarray)
"""A NumPy or a JAX array."""

COUNTS = 60000.0
"""The firmware's thrust counts that are u = 1 here, as in the authors' code and flights."""
MOST_COUNTS = 65535.0
"""The largest count; u = 1 in logs of the firmware's own share of full thrust (`flights.cflib`, and
our own logs of a real drone)."""
_GRAMS = 60.0 * COUNTS / 65536.0
"""Thrust [g] of four motors that the firmware expects at u = 1."""
_SQUARE, _LINEAR = -0.0006239, 0.088
"""Motor voltage per thrust: volts = _SQUARE grams^2 + _LINEAR grams."""
_STEPS = 256
"""The motors' timers count to 8 bit."""


def motor_ratio(command: Numbers, voltage: Numbers) -> Numbers:
    """Motor ratio that the firmware sets for a thrust command, in steps of 1/256.

    Args:
        command: u, in [0, 1], any shape.
        voltage: battery voltage [V], of a shape that broadcasts.

    Returns:
        Ratio in [0, 255/256], rounded down to the timer's resolution.
    """
    xp = command.__array_namespace__()
    grams = _GRAMS * command
    volts = _SQUARE * grams**2 + _LINEAR * grams
    return xp.floor(xp.clip(volts / voltage, 0.0, 1.0) * (MOST_COUNTS / _STEPS)) / _STEPS


def thrust_command(ratio: Numbers, voltage: Numbers) -> Numbers:
    """Thrust command of a motor ratio: the inverse of `motor_ratio` at the middle of its step.

    Args:
        ratio: motor ratio after compensation; zero means that the motor is off.
        voltage: battery voltage [V], of a shape that broadcasts.

    Returns:
        u, in [0, 1].
    """
    xp = ratio.__array_namespace__()
    volts = xp.where(ratio > 0, ratio + 0.5 / _STEPS, 0.0) * voltage
    # Above the parabola's top the firmware's own law has no thrust to give; the top is far beyond u
    # = 1.
    discriminant = xp.maximum(_LINEAR**2 + 4 * _SQUARE * volts, 0.0)
    grams = (_LINEAR - xp.sqrt(discriminant)) / (-2 * _SQUARE)
    return xp.clip(grams / _GRAMS, 0.0, 1.0)


def voltage(
    charge_drawn: Float[Array, ""], ratio: Float[Array, "4"], parameters: Parameters
) -> Float[Array, ""]:
    """Battery voltage under load: V = V_0 - (dV/dt) drawn - R mean(ratio) [V].

    A linear model of the middle range of a LiPo cell; ours.

    Args:
        charge_drawn: time at full ratio that the motors have run for [s].
        ratio: motor ratio of the four motors.
        parameters: uses the `battery` fields.
    """
    return (
        parameters.battery_voltage
        - parameters.battery_discharge * charge_drawn
        - parameters.battery_resistance * ratio.mean()
    )
