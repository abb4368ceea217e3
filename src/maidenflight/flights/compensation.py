"""From the motors' PWM back to the thrust command, by the laws of several Crazyflie firmwares.

A Crazyflie logs PWM after battery compensation. PWM times battery voltage is the motors' voltage,
and the firmware's law gives the thrust command that it stands for. The laws differ by some
hundredths of the thrust and in their slope, so a log's own `controller.cmd_thrust`, the mean
command of the four motors, decides between them where it is there.

A command may exceed 1: the firmware caps PWM, after compensation, and by the thrust law full PWM
from 3.9 V is 1.87 times what 65535 counts stand for (2.1+ propellers).

Source: Crazyflie firmware 2021.10 and 2025.12, src/drivers/src/motors.c and its platform defaults.
Of 24 NanoBench flights (2025.12.1) with a logged thrust, 21 follow the law of the 2.1+ propellers
(median error -0.008 to 0.002 of full thrust; the legacy law is off by 0.02 to 0.06) and three the
legacy law (0.002 to 0.004; the other is off by -0.055).
"""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from jaxtyping import Float

from maidenflight import names
from maidenflight.errors import InputError
from maidenflight.simulator.physics import battery
from maidenflight.simulator.physics.battery import MOST_COUNTS

PLUS = battery.PLUS.name
"""The law of today's Crazyflie, taken where a log cannot decide."""
NONE = names.UNCOMPENSATED_2021
"""`motor.m1` of that firmware is the command itself."""


BRUSHLESS = names.BRUSHLESS
"""Its firmware maps forces to PWM without the battery, so that thrust falls with it. Here u is what
the motors' voltage gives: by the measured speeds of 16 flights (15,012 rpm at 1.534 V, 16,290 rpm
at 1.690 V) the rotor speed is affine in it, (volts + 0.30 V) / 2.85 V of the 23,200 rpm that a
thrust stand shows at full PWM (IMRCLab 2026, cf21bl_guards)."""
UNKNOWN = names.UNKNOWN_LAW
"""Where the battery was not logged: rotor speed proportional to PWM."""
HOVER_VOLTS, _UNSURE = 2.0, 0.07
"""Mean voltage of the motors in flight [V] below which they are taken for brushless, and about it a
width of doubt: those hover at 1.5 to 1.7 V, brushed ones at 2.3 V and more."""
OF_DRONE: Mapping[str, str] = {"crazyflie_brushless": BRUSHLESS}
"""Law of a named drone, taken where its log names none; brushed ones have been sold with three."""
USUAL = {PLUS: 0.7, battery.FIRMWARE_2021.name: 0.15, names.LEGACY_PROPELLERS: 0.15}
"""How usual laws of brushed Crazyflies are: 21 of 24 NanoBench flights have the first."""


def _share(
    law: battery.ThrustLaw, ratio: Float[np.ndarray, "N 4"], volts: Float[np.ndarray, "N 4"]
) -> Float[np.ndarray, "N 4"]:
    return law.counts(ratio * volts) / MOST_COUNTS


LAWS: Mapping[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    **{
        name: partial(_share, law)
        for name, law in battery.LAWS.items()
        if law is not battery.FIRMWARE_2021
    },
    battery.FIRMWARE_2021.name: lambda ratio, volts: battery.thrust_command(
        ratio, volts, battery.AUTHORS._replace(full_scale_counts=MOST_COUNTS)
    ),
    BRUSHLESS: lambda ratio, volts: np.where(
        ratio <= 0, 0.0, np.clip((ratio * volts + 0.30) / 2.85, 0.0, 1.0) ** 2
    ),
    NONE: lambda ratio, volts: ratio + 0.0 * volts,
    UNKNOWN: lambda ratio, volts: ratio**2 + 0.0 * np.nan_to_num(volts),
}
"""In order of preference: (motor ratio, battery [V]) to the share of the firmware's full thrust,
65535 counts; both of one shape."""


def thrust_command(
    pwm: Float[np.ndarray, "N 4"], volts: Float[np.ndarray, "N"], law: str = PLUS
) -> Float[np.ndarray, "N 4"]:
    """Returns the thrust command u of logged PWM counts; NaN where a count is impossible.

    Args:
        pwm: 0 to 65535, after battery compensation.
        volts: battery voltage [V].
        law: a key of `LAWS`.
    """
    possible = np.where((pwm >= 0) & (pwm <= MOST_COUNTS), pwm, np.nan)
    wide = np.broadcast_to(volts[:, None], pwm.shape)
    with np.errstate(invalid="ignore"):  # not a number in, not a number out; checking drops it
        return LAWS[law](possible / MOST_COUNTS, wide).astype(np.float32)


def reread(
    command: Float[np.ndarray, "N 4"], volts: Float[np.ndarray, "N"], law: str, other: str
) -> Float[np.ndarray, "N 4"]:
    """Returns thrust commands that another law gives for the same voltages of the motors.

    Args:
        command: u, read by `law`.
        volts: battery voltage [V].
        law: a key of `LAWS`, of which the motors' voltage is known.
        other: likewise.
    """
    wide = np.broadcast_to(volts[:, None].astype(float), command.shape)
    return LAWS[other](motor_volts(command, law) / wide, wide).astype(np.float32)


def motor_volts(command: Float[np.ndarray, "..."], law: str) -> Float[np.ndarray, "..."]:
    """Returns the motors' voltage [V] that u stands for, by a law of which it is known."""
    if law == BRUSHLESS:
        return np.maximum(2.85 * np.sqrt(np.maximum(command, 0.0)) - 0.30, 0.0)
    return battery.LAWS[law].volts(MOST_COUNTS * command.astype(float))


def usual_laws(
    command: Float[np.ndarray, "N 4"], volts: Float[np.ndarray, "N"], law: str
) -> dict[str, float]:
    """Returns how probable laws are by the motors' voltage in flight; the one taken comes first.

    Args:
        command: u in flight, read by `law`.
        volts: battery voltage [V].
        law: the one taken.
    """
    if law not in (*USUAL, BRUSHLESS):
        return {law: 1.0}
    # Of the laws of 2021 and today all take about the same voltage for a command.
    own = reread(command, volts, law, BRUSHLESS)
    hover = float(np.median(motor_volts(own, BRUSHLESS).mean(axis=1)))
    brushless = float(1 / (1 + np.exp((hover - HOVER_VOLTS) / _UNSURE)))
    chances = {BRUSHLESS: brushless}
    chances |= {name: (1 - brushless) * share for name, share in USUAL.items()}
    return {law: chances.pop(law), **chances}


def law_of(
    pwm: Float[np.ndarray, "N 4"], volts: Float[np.ndarray, "N"], thrust: Float[np.ndarray, "N"]
) -> str | None:
    """Returns the law that gives a logged thrust command back, or None where none does to 1.2 %.

    Args:
        pwm: as in `thrust_command`.
        volts: battery voltage [V].
        thrust: mean command of the four motors, 0 to 65535 counts; `controller.cmd_thrust`.
    """
    rows = np.isfinite(thrust) & np.isfinite(volts) & (thrust > 10000)
    rows &= ((pwm > 0) & (pwm < 0.99 * MOST_COUNTS)).all(axis=1)
    miss = {
        law: _miss(thrust_command(pwm[rows], volts[rows], law), thrust[rows] / MOST_COUNTS)
        for law in LAWS
    }
    if miss[NONE] < 0.001:
        return NONE  # Exact where it is so; elsewhere it may come as near as one percent by chance.
    return next((law for law in LAWS if miss[law] < 0.012), None)


def _miss(command: np.ndarray, thrust: np.ndarray) -> float:
    """Median error; infinite of too few rows."""
    return float(np.median(np.abs(command.mean(axis=1) - thrust))) if len(thrust) >= 50 else np.inf


def assumed(pwm: Float[np.ndarray, "N 4"], volts: Float[np.ndarray, "N"]) -> str:
    """Returns the law that is taken where a log's thrust command does not decide.

    By the motors' voltage.

    Args:
        pwm: as in `thrust_command`.
        volts: battery voltage [V]; NaN where it is unknown.
    """
    if not np.isfinite(volts).any():
        return UNKNOWN
    is_row = np.isfinite(pwm).any(axis=1)
    at_motors = np.nanmean(pwm[is_row] / MOST_COUNTS, axis=1) * volts[is_row]
    flying = at_motors[np.isfinite(at_motors) & (at_motors > 0.5)]
    return BRUSHLESS if len(flying) and np.median(flying) < HOVER_VOLTS else PLUS


def logged_law(head: Mapping[str, str], name: str) -> str | None:
    """Returns the law that a table's head names, if it does.

    Raises:
        InputError: it names one that is not known.
    """
    law = head.get(LAW_OF_THE_HEAD)
    if law not in (*LAWS, None):
        raise InputError(
            f"{name}: {LAW_OF_THE_HEAD} {law[:60]!r}; known are {', '.join(map(repr, LAWS))}."
        )
    return law


def choose_law(
    head: Mapping[str, str],
    name: str,
    pwm: Float[np.ndarray, "N 4"],
    volts: Float[np.ndarray, "N"],
    thrust: Float[np.ndarray, "N"] | None,
    usual: str | None = None,
) -> tuple[str, str]:
    """Returns the law by which a table's motors are read, and why by it.

    Its head may name it, else its logged thrust decides; else it is `usual`, that of the
    drone, or `assumed`.

    Raises:
        InputError: the head names one that is not known.
    """
    if law := logged_law(head, name):
        return law, AS_LOGGED
    if thrust is not None and (law := law_of(pwm, volts, thrust)):
        return law, BY_THRUST
    if law := head.get(LAW_OF_THE_DRONE):
        return law, BY_DRONE
    return usual or assumed(pwm, volts), BY_VOLTAGE


def note(name: str, law: str, law_choice: str) -> str:
    """Returns a note for the user: the law that a file's commands were read by, and why."""
    return f"{name}: battery compensation of the {law} ({law_choice})"


BY_THRUST = "by its logged thrust command"
BY_VOLTAGE = "assumed; log controller.cmd_thrust beside the motors, or give --battery-law"
AS_LOGGED = "as said"
BY_DRONE = "that of the drone to start with"
LAW_OF_THE_DRONE = "battery law of the drone"
"""Key by which a table's head holds the law of the drone that a user named."""
LAW_OF_THE_HEAD = "battery law"
"""Key by which a table's head, such as a comment line of a CSV, says the law."""
