"""Flights made for tests: a calm one in our format, and the authors' 22 columns written from their
definition."""

from dataclasses import replace

import numpy as np

from maidenflight.flights.log import Flight


def waves(rows, seed=0, period=0.01):
    """Position, velocity, attitude and body rates that are true to each other: a drone that swings
    about a point one metre up.

    A turn about fixed axes in each of x, y and z; body rates follow from roll, pitch and yaw
    exactly, the tilt pushes sideways.
    """
    generator = np.random.default_rng(seed)
    time = np.arange(rows)[:, None] * period
    speed, phase = np.array([5.1, 3.7, 2.9]), generator.uniform(0, 6, 3)
    size = np.array([0.07, 0.09, 0.08])
    position = size * np.sin(speed * time + phase) + [0.0, 0.0, 1.0]
    velocity = size * speed * np.cos(speed * time + phase)
    push = -size * speed**2 * np.sin(speed * time + phase)
    turn = -size * speed**3 * np.cos(speed * time + phase)
    roll, pitch, yaw = -push[:, 1] / 9.81, push[:, 0] / 9.81, 0.3 * np.sin(2.3 * time[:, 0])
    rolled, pitched, yawed = -turn[:, 1] / 9.81, turn[:, 0] / 9.81, 0.69 * np.cos(2.3 * time[:, 0])
    rates = [
        rolled - yawed * np.sin(pitch),
        pitched * np.cos(roll) + yawed * np.cos(pitch) * np.sin(roll),
        -pitched * np.sin(roll) + yawed * np.cos(pitch) * np.cos(roll),
    ]
    return position, velocity, np.stack([roll, pitch, yaw], axis=1), np.stack(rates, axis=1)


def calm(rows=120, seed=0, **changes):
    """A flight that has nothing to complain about: one metre up, tilts of a few degrees, half
    thrust."""
    generator = np.random.default_rng(seed)
    position, velocity, attitude, rates = waves(rows, seed)
    values = {
        "name": "calm",
        "period": 0.01,
        "position": position,
        "velocity": velocity,
        "attitude": attitude,
        "body_rates": rates,
        "command": generator.uniform(0.4, 0.8, (rows, 4)),
        "battery": np.full(rows, 3.7),
        "setpoint": np.tile([0.0, 0.0, 1.0], (rows, 1)),
    }
    arrays = {
        name: np.float32(value) if isinstance(value, np.ndarray) else value
        for name, value in values.items()
    }
    return Flight(**{"zero_order_hold": True, **arrays, **changes})


def driven(rows=900, seed=0):
    """A calm flight whose motors turn it: 40 ms after a command the body accelerates by its
    torques, as on a Crazyflie."""
    flight = calm(rows, seed)
    acceleration = np.gradient(flight.body_rates, flight.period, axis=0)
    torque = np.concatenate([acceleration[4:], np.repeat(acceleration[-1:], 4, axis=0)]) / 150
    signs = np.array([[-1, -1, 1, 1], [-1, 1, 1, -1], [-1, 1, -1, 1]])
    noise = np.random.default_rng(seed).normal(0, 0.01, (rows, 4))
    return replace(
        flight,
        command=np.clip(0.6 + torque @ signs / 4 + noise, 0, 1).astype(np.float32),
        zero_order_hold=False,
    )


def sensed(rows=600, seed=0, **changes):
    """A flight of `driven` with an accelerometer and rotor speeds."""
    flight = driven(rows, seed)
    force = np.random.default_rng(1).normal([0.0, 0.0, 9.81], 0.3, (rows, 3))
    speed = 2000 * np.sqrt(flight.command)
    measured = {"accelerometer": np.float32(force), "rotor_speed": np.float32(speed)}
    return replace(flight, **measured, **changes)


def same(one, other):
    """Whether two flights hold the same rows."""
    groups = ("position", "velocity", "attitude", "body_rates", "command", "battery", "setpoint")
    return all(
        np.array_equal(getattr(one, group), getattr(other, group), equal_nan=True)
        for group in groups
    )


AUTHORS = (
    "x,y,z,x_dot,y_dot,z_dot,roll,pitch,yaw,roll_dot,pitch_dot,yaw_dot,"
    "n0,n1,n2,n3,mot0,mot1,mot2,mot3,bat,time"
)


def volts(u):
    """Motor voltage that the firmware asks for at a thrust command u (PWM 60000 of 65536, 60 g at
    full)."""
    grams = 60 * (60000 / 65536) * u
    return -0.0006239 * grams**2 + 0.088 * grams


def motors(u, battery):
    """The logged motor counts: floor256(min(volts / battery, 1) * 65535)."""
    return np.floor(np.minimum(volts(u) / battery[:, None], 1.0) * 65535 / 256) * 256


def authors_columns(rows=400, seed=0, begins=0.021, commanded=None):
    """Columns of a file as the authors' radio logged it; `commanded` replaces what the motors were
    told [u]."""
    generator = np.random.default_rng(seed)

    def half(values):
        return np.asarray(values).astype(np.float16).astype(np.float64)

    network = half(generator.uniform(-1.3, 1.3, (rows, 4)))
    battery = half(generator.uniform(3.2, 4.1, rows))
    u = (np.clip(network, -1, 1) + 1) / 2 if commanded is None else commanded
    states = half(np.concatenate(waves(rows, seed), axis=1))
    time = half(begins + 0.01 * np.arange(rows))
    return np.concatenate(
        [states, network, half(motors(u, battery)), battery[:, None], time[:, None]], axis=1
    )


def authors_text(columns):
    """The text of such a file."""
    return (
        AUTHORS
        + "\n"
        + "".join(",".join(f"{value:.18e}" for value in row) + "\n" for row in columns)
    )
