"""A flight of signals that were logged each at a rate of its own.

Rows are the samples of the body rates, or of the state estimate where that is rarer. The others are
joined as physics needs them: what is measured lies on straight lines between its samples, and of
the motors each row holds what they were told until the next. Without a state estimate rows are as
frequent as the motors where those are rarer, and what is measured is a mean over the step about
each: more rows would only repeat the commands between which they lie, and single samples alias
vibration.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from maidenflight.errors import InputError
from maidenflight.flights.log import Flight, flight_of
from maidenflight.flights.streams import attitudes, rates, streams
from maidenflight.flights.streams.streams import Stream

ALONE = "read as accelerometer, gyro and motors alone"
MORE = 1.5
"""Samples a row from which a signal counts as more frequent than the rows."""


@dataclass(frozen=True)
class Signals:
    """What a drone's log holds, in SI units, our axes and our order of the motors."""

    body_rates: Stream
    motors: Stream
    """sqrt(u), the commanded rotor speeds."""
    accelerometer: Stream | None = None
    state: Stream | None = None
    """Position, velocity, and roll, pitch, yaw without jumps of a turn; see `state`."""
    rotor_speed: Stream | None = None
    battery: Stream | None = None
    whole: bool = False
    """Whether the motors are all commands, so that each holds until the next."""
    accelerometer_delay: float = 0.0
    """[s]; see `Flight`."""
    gyro_delay: float | None = None
    """[s]."""


def note_reversed_rotors(name: str, setting: str) -> str:
    """Returns a note on rotors that turn the other way than the simulated ones.

    Args:
        name: of the file.
        setting: of the autopilot that says so.
    """
    return (
        f"{name}: its rotors do not turn as the simulated ones, of which front right and back left "
        f"turn counter-clockwise ({setting}): torque_to_thrust and inertia_z are worth nothing, "
        "and a policy for it would control yaw the wrong way round"
    )


def everywhere(at: Float[np.ndarray, "N"]) -> tuple[Bool[np.ndarray, "N"], list[str]]:
    """Returns all rows, and no notes."""
    return np.ones(len(at), bool), []


def state(name: str, position: Stream, quaternion: Stream) -> tuple[Stream | None, list[str]]:
    """Returns position, velocity and attitude in the rarer one's samples.

    None where they are too rare.

    Args:
        name: of the file, for notes.
        position: position [m] and velocity [m/s] in the world.
        quaternion: x, y, z, w, body to world.
    """
    angles = attitudes.of_quaternions(quaternion.values)
    is_finite = np.isfinite(angles).all(axis=1)
    attitude = Stream(quaternion.time[is_finite], np.unwrap(angles[is_finite], axis=0))
    if min(position.rate, attitude.rate) < 0.97 * rates.LEAST_HZ:
        logged = f"position logged at {position.rate:.3g} Hz and attitude at {attitude.rate:.3g} Hz"
        return None, [f"{name}: {logged}, below {rates.LEAST_HZ:g} Hz: {ALONE}"]
    at = position.time if position.step >= attitude.step else attitude.time
    rows = np.concatenate([streams.between(at, position), streams.between(at, attitude)], axis=1)
    return Stream(at, rows), []


def flight(
    name: str,
    signals: Signals,
    remedy: str,
    usable_rows: Callable[
        [Float[np.ndarray, "N"]], tuple[Bool[np.ndarray, "N"], list[str]]
    ] = everywhere,
) -> tuple[Flight, Float[np.ndarray, "N"], list[str]]:
    """Returns the flight in some signals, unchecked.

    Args:
        name: of the file, for errors and notes.
        signals: as logged.
        remedy: a sentence that says what makes the drone log faster.
        usable_rows: of the times of rows, which are of the flight, and notes on the others.

    Returns:
        The flight, the time of its rows [s] and what was left out or is known less well.

    Raises:
        InputError: a signal is missing or logged too rarely.
    """
    body_rates, motors, force = signals.body_rates, signals.motors, signals.accelerometer
    needed = {"body rates": body_rates.rate, "motors": motors.rate}
    if signals.state is None:
        needed["specific force"] = force.rate if force else 0.0
    rates.refuse_too_slow(name, needed, remedy, _list_rates(signals))
    rarer = signals.state is not None and signals.state.step > body_rates.step
    at = signals.state.time if signals.state is not None and rarer else body_rates.time
    sensed: Callable[[np.ndarray, Stream], np.ndarray] = streams.between
    if signals.state is None and motors.rate < body_rates.rate / MORE:
        # Loggers pick samples of a faster loop at uneven steps; rows lie at even ones about them.
        step = streams.period(motors.time)
        since = np.unique(np.round((motors.time - motors.time[0]) / step))
        at, sensed = motors.time[0] + step * since, _mean_about
    times, notes = usable_rows(at)
    at = at[times]
    if len(at) < 2:
        raise InputError(f"{name}: never in the air with armed motors. Leave it out.")
    speed, means = _note_rows(at, motors, signals.whole)
    groups: dict[str, Any] = {}
    if signals.state is not None:
        rows = streams.between(at, signals.state)
        groups = {
            "position": rows[:, :3],
            "velocity": rows[:, 3:6],
            "attitude": attitudes.wrapped(rows[:, 6:9]),
        }
    if force is not None and force.rate >= 0.97 * rates.LEAST_HZ:
        groups["accelerometer"] = sensed(at, force)
    turns = signals.rotor_speed
    if turns is not None and turns.rate >= 0.5 / streams.period(at):
        groups["rotor_speed"] = streams.between(at, turns)
        notes = [*notes, f"{name}: measured rotor speeds, {turns.rate:.0f} Hz"]
    elif turns is not None:
        rare = f"too rare for rows at {1 / streams.period(at):.4g} Hz"
        notes = [*notes, f"{name}: rotor speeds at {turns.rate:.3g} Hz are {rare} and passed over"]
    volts = np.full(len(at), np.nan)
    if signals.battery is not None:
        volts = streams.hold_last(at, signals.battery)[:, 0]
    logged = flight_of(
        name,
        streams.period(at),
        body_rates=sensed(at, body_rates),
        command=np.square(speed),
        battery=np.where(volts > 0.5, volts, np.nan),
        zero_order_hold=means,
        by_battery_law=False,
        accelerometer_delay=signals.accelerometer_delay,
        gyro_delay=signals.gyro_delay or 0.0,
        gyro_delay_known=signals.gyro_delay is not None,
        **groups,
    )
    return logged, at - at[0], [*notes, *rates.notes(name, needed, remedy)]


def _list_rates(signals: Signals) -> dict[str, float]:
    """Returns the rate of each signal that was logged [Hz]."""
    logged = {
        "body rates": signals.body_rates,
        "motors": signals.motors,
        "specific force": signals.accelerometer,
        "position, velocity and attitude": signals.state,
        "rotor speeds": signals.rotor_speed,
        "battery": signals.battery,
    }
    return {
        name: stream.rate
        for name, stream in logged.items()
        if stream is not None and stream.rate > 0
    }


def _note_rows(
    at: Float[np.ndarray, "N"], speeds: Stream, whole: bool
) -> tuple[Float[np.ndarray, "N 4"], bool]:
    """Returns commanded rotor speeds in rows, and whether they are means until the next row.

    Where every command was logged, each holds until the next. Of a faster loop's, each stands for
    the step about it, and rows that are as frequent lie between two of them.
    """
    if whole:
        return streams.mean_until_next(at, speeds), True
    if speeds.rate > MORE / streams.period(at):
        about = Stream(speeds.time - speeds.step / 2, speeds.values)
        return streams.mean_until_next(at, about), True
    return streams.between(at, speeds), False


def _mean_about(at: Float[np.ndarray, "N"], signal: Stream) -> Float[np.ndarray, "N K"]:
    """The mean of a measured signal over a step about each row, if it is more frequent."""
    step = streams.period(at)
    if signal.rate <= MORE / step:
        return streams.between(at, signal)
    about = Stream(signal.time - signal.step / 2, signal.values)
    return streams.mean_until_next(at - step / 2, about)
