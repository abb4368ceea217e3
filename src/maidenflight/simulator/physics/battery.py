"""The battery and the firmware's compensation for it: from thrust command to motor ratio and back.

A Crazyflie raises the motor ratio as the battery voltage falls, so that a thrust command gives the
same thrust until the ratio reaches one. Logs hold the ratio after compensation; the inverse of the
same law recovers the command. Today's firmware limits nothing before: a command above full scale is
flown where the battery's voltage allows it.

Source: Crazyflie firmware 2021.10, src/drivers/src/motors.c, motorsCompensateBatteryVoltage; the
scales were verified on the authors' flight logs (97 % of 617,316 samples exact, all within one
8-bit step). 2026.08 (2a18fc299d7b), motors.c, platform_defaults_cf2.h and stabilizer.c: mix,
compensate, then cap.

These functions take NumPy arrays as well as JAX arrays, because logs are read without compiling
anything.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np
from jaxtyping import Array, Float

from maidenflight import names
from maidenflight.parameters import Parameters

Numbers = TypeVar("Numbers", jax.Array, np.ndarray)
"""A NumPy or a JAX array."""

COUNTS = 60000.0
"""The firmware's thrust counts that are u = 1 here, as in the authors' code and flights."""
MOST_COUNTS = 65535.0
"""Full PWM; u = 1 in logs of the firmware's own share of full thrust (`cflib`, and our own
logs of a real drone)."""
NOMINAL_VOLTS = 3.7
"""Battery voltage in flight [V] where none is simulated."""
LARGEST_COMMAND = 3.0
"""More than any law gives at full PWM: u = 2.7 of 65,535 counts at 4.3 V."""
_STEPS = 256
"""The motors' timers count to 8 bit."""


class ThrustLaw(NamedTuple):
    """What motor voltage a firmware takes for a thrust command. Hashable, for static arguments."""

    name: str
    volts: Callable[[Any], Any]
    """Motor voltage [V] of a thrust command [counts]."""
    counts: Callable[[Any], Any]
    """The inverse; counts that the firmware never asks for are cut off."""
    least_counts: float
    """Thrust command below which a motor is off [counts] (THRUST_MIN)."""
    capped_together: bool
    """Whether all four motors are lowered by what one lacks, after compensation; else each is cut
    off by itself."""


_SQUARE, _LINEAR = -0.0006239, 0.088
"""Motor voltage per thrust in 2021: volts = _SQUARE grams^2 + _LINEAR grams, of four motors."""
_GRAMS = 60.0 / 65536.0
"""Thrust [g] of four motors that the firmware of 2021 expects of a count."""


def _volts_of_2021(counts: Numbers) -> Numbers:
    grams = _GRAMS * counts
    return _SQUARE * grams**2 + _LINEAR * grams


def _counts_of_2021(volts: Numbers) -> Numbers:
    xp = volts.__array_namespace__()
    # Above the parabola's top the law has no thrust to give; the top is far beyond full PWM.
    discriminant = xp.maximum(_LINEAR**2 + 4 * _SQUARE * volts, 0.0)
    grams = (_LINEAR - xp.sqrt(discriminant)) / (-2 * _SQUARE)
    return xp.clip(grams / _GRAMS, 0.0, MOST_COUNTS)


def _cubic_counts(volts: Numbers, force: tuple[float, ...], full: float) -> Numbers:
    """Thrust [counts] of a motor voltage, from a polynomial of its force [N]."""
    xp = volts.__array_namespace__()
    constant, linear, square, cube = force
    newtons = constant + volts * (linear + volts * (square + volts * cube))
    return xp.where(volts <= 0, 0.0, xp.maximum(newtons * (MOST_COUNTS / full), 0.0))


_ITERATIONS = 5
"""Of Newton's method; three leave an error of 1e-3 V, five none in float32."""


def _cubic_volts(counts: Numbers, force: tuple[float, ...], full: float) -> Numbers:
    """The inverse of `_cubic_counts`, by Newton's method; the polynomials rise everywhere."""
    xp = counts.__array_namespace__()
    constant, linear, square, cube = force
    newtons = xp.maximum(counts, 0.0) * (full / MOST_COUNTS)
    volts = 1.0 + 2.0 * xp.sqrt(newtons / full)
    for _ in range(_ITERATIONS):
        here = constant + volts * (linear + volts * (square + volts * cube))
        volts = volts - (here - newtons) / (linear + volts * (2 * square + volts * 3 * cube))
    return xp.where(counts > 0, volts, 0.0)


def _cubic(name: str, force: tuple[float, ...], full: float) -> ThrustLaw:
    """Returns a law of today's firmware, by the name of the propellers.

    `force` are coefficients of a motor's force by its voltage [N/V^k], `full` is the force that
    65535 counts stand for (THRUST_MAX) [N].
    """
    return ThrustLaw(
        name,
        partial(_cubic_volts, force=force, full=full),
        partial(_cubic_counts, force=force, full=full),
        7000.0,
        capped_together=True,
    )


FIRMWARE_2021 = ThrustLaw(
    names.FIRMWARE_2021, _volts_of_2021, _counts_of_2021, 0.0, capped_together=False
)
"""The authors' flights."""
PLUS = _cubic(names.PLUS_PROPELLERS, (-0.024765379, 0.065237935, -0.026792505, 0.006776789), 0.12)
"""Today's Crazyflie, unless its configuration says otherwise."""
LAWS: Mapping[str, ThrustLaw] = {
    law.name: law
    for law in (
        PLUS,
        _cubic(
            names.LEGACY_PROPELLERS, (-0.014830745, 0.047244652, -0.018473644, 0.005960924), 0.12
        ),
        _cubic(names.THRUST_UPGRADE, (0.006728128, 0.010115576, 0.010263198, 0.002835864), 0.18),
        FIRMWARE_2021,
    )
}
"""By name."""


def law_for(full_scale_counts: float | None) -> ThrustLaw:
    """Returns the law of the firmware that made a drone's logs; the authors' where there are none.

    It is today's where u = 1 is full PWM in them.
    """
    return PLUS if full_scale_counts == MOST_COUNTS else FIRMWARE_2021


class Supply(NamedTuple):
    """What becomes of thrust commands before the motors. Hashable, for static arguments."""

    law: ThrustLaw | None = None
    """By which the firmware compensates for the battery; None: it does not, and u ends at 1."""
    full_scale_counts: float = COUNTS
    """Counts that u = 1 stands for."""
    battery: bool = False
    """Whether commands pass through the law, 8-bit PWM and a battery that sags; else they pass as
    they are, up to what the law gives at `NOMINAL_VOLTS`."""

    @property
    def most(self) -> float:
        """Thrust command at which the motors get all of a battery's nominal voltage."""
        if self.law is None:
            return 1.0
        return float(self.law.counts(np.float64(NOMINAL_VOLTS))) / self.full_scale_counts


AUTHORS = Supply(FIRMWARE_2021, COUNTS, battery=True)
"""That of the authors' drone."""


def motor_ratio(command: Numbers, voltage: Numbers, supply: Supply) -> Numbers:
    """Returns the motor ratio that the firmware sets for a thrust command, in steps of 1/256.

    Args:
        command: u from 0, (..., 4).
        voltage: battery voltage [V], of a shape that broadcasts.
        supply: law and scale.

    Returns:
        Ratio in [0, 255/256], rounded down to the timer's resolution; the command, up to the most,
        where no battery is simulated.
    """
    xp = command.__array_namespace__()
    if supply.law is not None and supply.law.least_counts:
        least = supply.law.least_counts / supply.full_scale_counts
        command = xp.where(command < least, 0.0, command)
    if supply.law is None or not supply.battery:
        return xp.clip(command, 0.0, supply.most)
    ratio = supply.law.volts(supply.full_scale_counts * command) / voltage
    if supply.law.capped_together:
        ratio = ratio - xp.maximum(xp.max(ratio, axis=-1, keepdims=True) - 1.0, 0.0)
    return timer_ratio(ratio)


def timer_ratio(ratio: Numbers) -> Numbers:
    """Returns what the motors' 8-bit timer makes of a motor ratio."""
    xp = ratio.__array_namespace__()
    return xp.floor(xp.clip(ratio, 0.0, 1.0) * (MOST_COUNTS / _STEPS)) / _STEPS


def thrust_command(ratio: Numbers, voltage: Numbers, supply: Supply) -> Numbers:
    """Returns the thrust command of a motor ratio.

    The inverse of `motor_ratio` at the middle of its step.

    Args:
        ratio: motor ratio after compensation; zero means that the motor is off.
        voltage: battery voltage [V], of a shape that broadcasts.
        supply: law and scale.

    Returns:
        u, from 0 to what the voltage allows; the ratio where no battery is simulated.
    """
    xp = ratio.__array_namespace__()
    if supply.law is None or not supply.battery:
        return ratio
    volts = xp.where(ratio > 0, ratio + 0.5 / _STEPS, 0.0) * voltage
    return supply.law.counts(volts) / supply.full_scale_counts


def voltage(
    charge_drawn: Float[Array, ""], ratio: Float[Array, "4"], parameters: Parameters
) -> Float[Array, ""]:
    """Returns the voltage under load: V = V_0 - (dV/dt) drawn - R mean(ratio) [V].

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
