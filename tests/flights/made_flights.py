"""Flights made for tests: a calm one in our format, and the authors' 22 columns written from their definition."""

import numpy as np

from maidenflight.flights.log import Flight


def calm(rows=120, seed=0, **changes):
    """A flight that has nothing to complain about: one metre up, tilts of a few degrees, half thrust."""
    generator = np.random.default_rng(seed)
    wave = np.sin(np.arange(rows)[:, None] * [0.11, 0.07, 0.05] + generator.uniform(0, 6, 3))
    values = {
        "name": "calm",
        "period": 0.01,
        "position": wave * 0.2 + [0.0, 0.0, 1.0],
        "velocity": wave * 0.1,
        "attitude": wave * 0.3,
        "body_rates": wave * 3.0,
        "command": generator.uniform(0.4, 0.8, (rows, 4)),
        "battery": np.full(rows, 3.7),
        "setpoint": np.tile([0.0, 0.0, 1.0], (rows, 1)),
    }
    arrays = {name: np.float32(value) if isinstance(value, np.ndarray) else value for name, value in values.items()}
    return Flight(**{"held": True, **arrays, **changes})


def same(one, other):
    """Whether two flights hold the same rows."""
    groups = ("position", "velocity", "attitude", "body_rates", "command", "battery", "setpoint")
    return all(np.array_equal(getattr(one, group), getattr(other, group), equal_nan=True) for group in groups)


AUTHORS = "x,y,z,x_dot,y_dot,z_dot,roll,pitch,yaw,roll_dot,pitch_dot,yaw_dot,n0,n1,n2,n3,mot0,mot1,mot2,mot3,bat,time"


def volts(u):
    """Motor voltage that the firmware asks for at a thrust command u (PWM 60000 of 65536, 60 g at full)."""
    grams = 60 * (60000 / 65536) * u
    return -0.0006239 * grams**2 + 0.088 * grams


def motors(u, battery):
    """The logged motor counts: floor256(min(volts / battery, 1) * 65535)."""
    return np.floor(np.minimum(volts(u) / battery[:, None], 1.0) * 65535 / 256) * 256


def authors_columns(rows=400, seed=0, begins=0.021, commanded=None):
    """Columns of a file as the authors' radio logged it; `commanded` replaces what the motors were told [u]."""
    generator = np.random.default_rng(seed)

    def half(values):
        return np.asarray(values).astype(np.float16).astype(np.float64)

    network = half(generator.uniform(-1.3, 1.3, (rows, 4)))
    battery = half(generator.uniform(3.2, 4.1, rows))
    u = (np.clip(network, -1, 1) + 1) / 2 if commanded is None else commanded
    states = half(generator.uniform(-0.3, 0.3, (rows, 12)) + np.eye(12)[2])
    time = half(begins + 0.01 * np.arange(rows))
    return np.concatenate([states, network, half(motors(u, battery)), battery[:, None], time[:, None]], axis=1)


def authors_text(columns):
    """The text of such a file."""
    return AUTHORS + "\n" + "".join(",".join(f"{value:.18e}" for value in row) + "\n" for row in columns)
