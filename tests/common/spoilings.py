"""Logs spoilt on purpose: one pure function of a flight each, and the tests that should name it."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from maidenflight.flights.checkup.kinematics import rotations
from maidenflight.flights.log import Flight

F = np.float32
Matrix = Float[np.ndarray, "3 3"]


class Spoiling(NamedTuple):
    """A fault, and what should name it."""

    apply: Callable[[Flight], Flight]
    tests: frozenset[str]
    """Names of the tests of which one should fail or warn."""
    needs: str = ""
    """A field of `Flight`, or "state", without which the fault is none."""
    whole: bool = False
    """Whether it is of the whole flight, not of each piece by itself."""


def _turn(group: str, matrix: Matrix, flight: Flight) -> Flight:
    values = getattr(flight, group)
    if values is None:
        return flight
    return replace(flight, **{group: (values.astype(float) @ matrix.T).astype(F)})


def _turn_sensors(matrix: Matrix, flight: Flight) -> Flight:
    return _turn("accelerometer", matrix, _turn("body_rates", matrix, flight))


def _shift(group: str, seconds: float, flight: Flight) -> Flight:
    """Returns the flight with a signal that is late by some seconds."""
    rows = round(abs(seconds) / flight.period)
    if not rows or len(flight) <= rows + 60:
        return flight
    values = getattr(flight, group)
    if seconds > 0:
        return replace(flight.part(rows, len(flight)), **{group: values[:-rows]})
    return replace(flight.part(0, len(flight) - rows), **{group: values[rows:]})


def _order(order: tuple[int, ...], flight: Flight) -> Flight:
    speed = None if flight.rotor_speed is None else flight.rotor_speed[:, list(order)]
    return replace(flight, command=flight.command[:, list(order)], rotor_speed=speed)


def _command(change: Callable[[np.ndarray], np.ndarray], flight: Flight) -> Flight:
    return replace(flight, command=change(flight.command).astype(F))


def _speeds(change: Callable[[np.ndarray], np.ndarray], flight: Flight) -> Flight:
    return replace(flight, rotor_speed=change(np.asarray(flight.rotor_speed)).astype(F))


def _angles(signs: tuple[float, float, float], flight: Flight) -> Flight:
    return replace(flight, attitude=(flight.attitude * np.array(signs)).astype(F))


def _mirror_yaw(flight: Flight) -> Flight:
    return _angles((1, 1, -1), _turn("body_rates", np.diag([1.0, 1, -1]), flight))


def _body_velocity(flight: Flight) -> Flight:
    return replace(
        flight, velocity=rotations(flight).inv().apply(flight.velocity.astype(float)).astype(F)
    )


def _world_force(flight: Flight) -> Flight:
    """Returns the flight with specific force along the world's axes, by state or by the gyro."""
    if np.isfinite(flight.attitude).all():
        attitude = rotations(flight)
    else:
        tilt = np.cumsum(flight.body_rates - flight.body_rates.mean(axis=0), axis=0) * flight.period
        tilt = tilt - np.linspace(0, 1, len(tilt))[:, None] * tilt[-1]
        attitude = Rotation.from_euler("ZYX", np.stack([0 * tilt[:, 2], tilt[:, 1], tilt[:, 0]], 1))
    return replace(
        flight, accelerometer=attitude.apply(np.asarray(flight.accelerometer, float)).astype(F)
    )


def _no_gravity(flight: Flight) -> Flight:
    force = np.asarray(flight.accelerometer) - np.array([0, 0, 9.81])
    return replace(flight, accelerometer=force.astype(F))


def _noise(command: np.ndarray) -> np.ndarray:
    generator = np.random.default_rng(3)
    drawn = command.mean(axis=0) + command.std(axis=0) * generator.normal(size=command.shape)
    return np.clip(drawn, 0, 1.3)


def _load(command: np.ndarray) -> np.ndarray:
    changed = command.copy()
    changed[len(changed) // 2 :] *= F(1.15)
    return changed


def _freeze(flight: Flight) -> Flight:
    """Returns the flight with a gyro that stands still for a third of it."""
    rates = flight.body_rates.copy()
    third = len(rates) // 3
    rates[third : 2 * third] = rates[third]
    return replace(flight, body_rates=rates)


def _bench(flight: Flight) -> Flight:
    """Returns the log of the same commands on a bench, without propellers: gravity and noise."""
    generator = np.random.default_rng(3)
    shape = len(flight), 3
    force = np.array([0.0, 0.0, 9.81]) + 0.2 * generator.normal(size=shape)
    rates = 0.02 * generator.normal(size=shape)
    throttle = 1 + 0.5 * np.sin(2.0 * flight.period * np.arange(len(flight)))
    return replace(
        flight,
        accelerometer=force.astype(F),
        body_rates=rates.astype(F),
        command=(flight.command * throttle[:, None]).astype(F),
        **dict.fromkeys(("position", "velocity", "attitude"), np.full(shape, np.nan, F)),
    )


def _roll(share: float, values: np.ndarray) -> np.ndarray:
    return np.roll(values, int(share * len(values)), axis=0)


def _diagonal(*signs: float) -> Matrix:
    return np.diag(np.array(signs, float))


SWAP = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]])
LEFT = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
_ORDERS = {
    "turned by 90 deg": (1, 2, 3, 0),
    "turned by 180 deg": (2, 3, 0, 1),
    "turned by -90 deg": (3, 0, 1, 2),
    "mirrored, left and right": (3, 2, 1, 0),
    "mirrored, front and back": (1, 0, 3, 2),
    "mirrored, one diagonal": (0, 3, 2, 1),
    "mirrored, the other diagonal": (2, 1, 0, 3),
    "as Betaflight's": (1, 0, 2, 3),
    "as PX4's": (0, 3, 1, 2),
}
_GYRO = frozenset({"body_rate", "motor order", "accelerometer axes"})
_FORCE, _AXES = frozenset({"accelerometer"}), frozenset({"accelerometer axes"})
_DELAY, _LATE = frozenset({"command delay"}), frozenset({"gyro delay", "command delay"})
_CLOCK = frozenset({"clock", "body_rate scale"})
_TENTH = frozenset({"clock"})
_CURVE = frozenset({"thrust curve", "thrust to weight"})
_SCALE, _SPEEDS = frozenset({"thrust to weight"}), frozenset({"rotor speeds"})
_TILT, _MOVE = frozenset({"tilt", "body_rate"}), frozenset({"velocity"})
_DRIVE = frozenset({"motors drive"})
_FRAME, _COLUMNS = frozenset({"velocity frame"}), frozenset({"columns"})

SPOILINGS: Mapping[str, Spoiling] = {
    **{
        f"motors {name}": Spoiling(partial(_order, order), frozenset({"motor order"}))
        for name, order in _ORDERS.items()
    },
    "gyro x negated": Spoiling(partial(_turn, "body_rates", _diagonal(-1, 1, 1)), _GYRO),
    "gyro y negated": Spoiling(partial(_turn, "body_rates", _diagonal(1, -1, 1)), _GYRO),
    "gyro z negated": Spoiling(
        partial(_turn, "body_rates", _diagonal(1, 1, -1)), frozenset({"body_rate", "yaw direction"})
    ),
    "gyro x and y swapped": Spoiling(partial(_turn, "body_rates", SWAP), _GYRO),
    "gyro forward, right, down": Spoiling(
        partial(_turn, "body_rates", _diagonal(1, -1, -1)), _GYRO
    ),
    "gyro halved": Spoiling(
        partial(_turn, "body_rates", 0.5 * np.eye(3)), frozenset({"body_rate scale"}), "state"
    ),
    "gyro 30 ms late": Spoiling(partial(_shift, "body_rates", 0.03), _LATE, "state"),
    "gyro 60 ms late": Spoiling(partial(_shift, "body_rates", 0.06), _LATE),
    "sensors turned by 90 deg": Spoiling(partial(_turn_sensors, LEFT), _GYRO),
    "sensors turned by 180 deg": Spoiling(partial(_turn_sensors, _diagonal(-1, -1, 1)), _GYRO),
    "force negated": Spoiling(partial(_turn, "accelerometer", -np.eye(3)), _FORCE, "accelerometer"),
    "force forward, right, down": Spoiling(
        partial(_turn, "accelerometer", _diagonal(1, -1, -1)), _FORCE, "accelerometer"
    ),
    "force in g": Spoiling(
        partial(_turn, "accelerometer", np.eye(3) / 9.81), _FORCE, "accelerometer"
    ),
    "force halved": Spoiling(
        partial(_turn, "accelerometer", 0.5 * np.eye(3)), _FORCE, "accelerometer"
    ),
    "gravity removed": Spoiling(_no_gravity, _FORCE, "accelerometer"),
    "force x and y swapped": Spoiling(
        partial(_turn, "accelerometer", SWAP), _AXES, "accelerometer"
    ),
    "force along the world's axes": Spoiling(_world_force, _AXES, "accelerometer"),
    "pitch negated": Spoiling(partial(_angles, (1, -1, 1)), _TILT, "state"),
    "roll negated": Spoiling(partial(_angles, (-1, 1, 1)), _TILT, "state"),
    "yaw mirrored, gyro too": Spoiling(_mirror_yaw, _TILT | {"yaw direction"}, "state"),
    "velocity along the body's axes": Spoiling(_body_velocity, _FRAME, "state"),
    "velocity in ft/s": Spoiling(
        partial(_turn, "velocity", 3.28 * np.eye(3)), frozenset({"velocity scale"}), "state"
    ),
    "position in feet of metres": Spoiling(
        partial(_turn, "position", 0.3048 * np.eye(3)), frozenset({"velocity scale"}), "state"
    ),
    "velocity times 1.5": Spoiling(
        partial(_turn, "velocity", 1.5 * np.eye(3)), frozenset({"velocity scale"}), "state"
    ),
    "velocity x and y swapped": Spoiling(partial(_turn, "velocity", SWAP), _MOVE, "state"),
    "velocity x negated": Spoiling(partial(_turn, "velocity", _diagonal(-1, 1, 1)), _MOVE, "state"),
    "velocity z negated": Spoiling(partial(_turn, "velocity", _diagonal(1, 1, -1)), _MOVE, "state"),
    "time times 1.25": Spoiling(
        lambda flight: replace(flight, period=1.25 * flight.period), _CLOCK, "state", True
    ),
    "time times 1.1": Spoiling(
        lambda flight: replace(flight, period=1.1 * flight.period), _TENTH, "state", True
    ),
    "time times 0.9": Spoiling(
        lambda flight: replace(flight, period=0.9 * flight.period), _TENTH, "state", True
    ),
    "time times 0.8": Spoiling(
        lambda flight: replace(flight, period=0.8 * flight.period), _CLOCK, "state", True
    ),
    "commands 20 ms late": Spoiling(partial(_shift, "command", 0.02), _DELAY),
    "commands 50 ms late": Spoiling(partial(_shift, "command", 0.05), _DELAY),
    "commands 100 ms late": Spoiling(partial(_shift, "command", 0.1), _DELAY),
    "commands 50 ms early": Spoiling(partial(_shift, "command", -0.05), _DELAY),
    "commands of another time": Spoiling(partial(_command, partial(_roll, 0.43)), _DRIVE),
    "commands noise": Spoiling(partial(_command, _noise), _DRIVE),
    "one motor logged twice": Spoiling(
        partial(_command, lambda u: u[:, [0, 1, 2, 1]]), _COLUMNS, whole=True
    ),
    "one motor 37 % weaker": Spoiling(
        partial(_command, lambda u: u / np.array([1, 0.63, 1, 1])),
        frozenset({"motor balance"}),
        whole=True,
    ),
    "gyro frozen for a third": Spoiling(_freeze, _COLUMNS),
    "on a bench without propellers": Spoiling(
        _bench, frozenset({"flight", "motors drive"}), "accelerometer"
    ),
    "sqrt(u) for u": Spoiling(
        partial(_command, lambda u: np.sqrt(np.maximum(u, 0))), _CURVE, "accelerometer"
    ),
    "u squared": Spoiling(partial(_command, np.square), _CURVE, "accelerometer"),
    "u halved": Spoiling(partial(_command, lambda u: 0.5 * u), _SCALE),
    "u times 1.25": Spoiling(partial(_command, lambda u: 1.25 * u), _SCALE),
    "rotor speeds zero": Spoiling(partial(_speeds, lambda s: 0 * s), _SPEEDS, "rotor_speed"),
    "one rotor speed zero": Spoiling(
        partial(_speeds, lambda s: s * [1, 0, 1, 1]), _SPEEDS, "rotor_speed"
    ),
    "rotor speeds of another time": Spoiling(
        partial(_speeds, partial(_roll, 0.37)), _SPEEDS, "rotor_speed"
    ),
    "a load of 15 % from the middle on": Spoiling(
        partial(_command, _load), frozenset({"one drone"})
    ),
}
"""Faults by name."""


def is_told(name: str, clean: Flight, spoilt: Flight) -> bool:
    """Whether a fault changes a signal by more than a fifth of its spread, so that it is one.

    Velocity along the body's axes is that along the world's where the nose points north.
    """
    groups = {"velocity along the body's axes": "velocity", "yaw mirrored, gyro too": "attitude"}
    if name not in groups or len(clean) != len(spoilt):
        return True
    one, other = (getattr(flight, groups[name]).astype(float) for flight in (clean, spoilt))
    return float(np.sqrt(np.mean((one - other) ** 2))) > 0.2 * float(one.std(axis=0).max())
