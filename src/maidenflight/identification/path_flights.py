"""Simulated flights along the paths of logs, which log the same signals.

The commands of the log are fed forward and a linear-quadratic regulator holds the drone on the
logged path, so that the flights have the excitation of the logs, whatever controller flew them.

Source of the regulator: Anderson and Moore 1990, Optimal control: linear quadratic methods, ch. 2.
"""

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Float, Int

from maidenflight import compiler
from maidenflight.errors import InputError
from maidenflight.flights.log import GYRO_DELAY, Flight, thinned
from maidenflight.flying.engine import simulate
from maidenflight.flying.firmware_pilot import RATE
from maidenflight.flying.recording import flight_log
from maidenflight.flying.rows import Rows, SimulatedFlight
from maidenflight.identification.signals.spectra import HIGHEST
from maidenflight.parameters import Parameters, replace
from maidenflight.simulator.controllers import control
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics, rotations
from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.realities.virtual_drone import RANGES, VirtualDrone
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.failures import TIME_LIMIT, Guard

_LOST = Guard(tilt=float(np.radians(80.0)), position_error=1.5)
"""Excursion beyond which the regulator does not hold a drone on its path; harmless within a factor
of 1.4 (paper/identification/constants.py)."""
_GYRO_HZ = float(1 / (np.sqrt(2) * np.pi * GYRO_DELAY))
"""Cut-off of the gyro's filter, of second order as in the Crazyflie's sensors_bmi088_bmp3xx.c
[Hz]. One of first order that is as late blurs the reaction to rotors that spin up: their momentum
was then identified 11 % too small, and its intervals held the truth in 19 of 44 drones."""
_ALLOWED = np.repeat([0.1, 0.3, 0.1, 1.0, 0.2], [3, 3, 3, 3, 4])
"""Deviations that cost alike: position [m], velocity [m/s], attitude [rad], body rates [rad/s] and
rotor speeds [-]; ours."""
_ALLOWED_COMMANDS = (0.03, 0.1, 0.3)
"""Deviation of a command that costs as much [-]; ours. With the first the regulator answers noise
as weakly as the controllers of brushed and brushless Crazyflies did in their logs. The next one is
taken where that does not hold a drone: a strong one makes the lag come out 5 to 11 % too long."""


class _Path(NamedTuple):
    """What is followed, by the number of the command."""

    command: Float[Any, "K 4"]
    state: Float[Any, "K 12"]
    """Position [m], velocity [m/s], attitude [rad] and body rates [rad/s]."""
    rotor_speed: Float[Any, "K 4"]


class _Memory(NamedTuple):
    """What the regulator remembers."""

    number: Int[Array, ""]
    rotor_speed: Float[Array, "4"]
    """By its model of the motors [-]."""


def require_path(flight: Flight) -> None:
    """Refuses a log without a path to fly.

    Raises:
        InputError: it has no state.
    """
    if not flight.has_state:
        raise InputError(
            f"{flight.name}: no position, velocity and attitude in it, so that there is no path to "
            "fly. Calibrate on logs with a state."
        )


def fly_paths(
    drone: Parameters, design: Parameters, flights: Sequence[Flight], key: Array
) -> list[Flight] | None:
    """Flies the paths of logs and logs the same signals in as many rows.

    The drone's gyro is filtered as a Crazyflie's and its estimates are as late as those of virtual
    drones.

    Args:
        drone: what flies.
        design: the drone that the regulator is made for, and that the logs are of.
        flights: the logs, of one rate.
        key: random key.

    Returns:
        A log of each; None where the regulator loses the drone.
    """
    late = np.float32(np.mean(RANGES["estimator_delay"]))
    period, held = flights[0].period, flights[0].zero_order_hold
    every = 1 if held else max(1, round(period * RATE))
    rate = round(1 / period / 50) * 50 if held and period > 0.003 else RATE
    # Rows of a slow hold are too far apart for the filter; its delay is what they show of it.
    lag = 0.0 if rate == RATE else GYRO_DELAY
    drone = replace(
        drone,
        gyro_time_constant=np.float32(lag),
        estimator_delay=late,
        time_step=np.float32(0.5 / RATE),
    )
    steps = max(map(len, flights)) * every
    thrust = float(design.thrust_to_weight / drone.thrust_to_weight)
    paths = [_path(flight, design, rate, steps, thrust) for flight in flights]
    virtual = VirtualDrone("calibration", drone, thrust_law=None)
    counts = flights[0].full_scale_counts
    world = virtual.environment(tasks.hover(), control.pwm(rate, counts))
    keys = jax.random.split(key, len(flights))
    together: _Path = jax.tree.map(lambda *parts: np.stack(parts), *paths)
    for allowed in _ALLOWED_COMMANDS:
        gain = np.float32(_gain(design, rate, allowed))
        rows = jax.tree.map(np.asarray, _fly(world, drone, design, gain, together, keys))
        pieces = (
            Rows(*(values[index, : len(flight) * every] for values in rows))
            for index, flight in enumerate(flights)
        )
        simulated = [
            SimulatedFlight(own, rate, True, world.supply, virtual.name, drone=drone)
            for own in pieces
        ]
        if all(flight.rows.end(_LOST).reason == TIME_LIMIT for flight in simulated):
            return [
                _with_signals(flight, log, every, own_key)
                for flight, log, own_key in zip(simulated, flights, keys, strict=True)
            ]
    return None


def _with_signals(simulated: SimulatedFlight, original: Flight, every: int, key: Array) -> Flight:
    """Returns the log of a flight with the signals of another."""
    log = flight_log(simulated, original.name, simulated.rate, key)
    if simulated.rate == RATE:
        true = np.asarray(simulated.rows.true_body_rates, np.float64)
        sections = scipy.signal.butter(2, _GYRO_HZ, fs=RATE, output="sos")
        # Noise of the simulated gyro has gone through its filter already.
        change = scipy.signal.sosfilt(sections, true - true[0], axis=0) + true[0] - true
        late = (log.body_rates + change).astype(np.float32)
        log = dataclasses.replace(log, body_rates=late, gyro_delay=GYRO_DELAY)
    speeds = original.rotor_speed
    if speeds is not None:
        own = np.asarray(simulated.rows.rotor_speed, np.float64)
        full = np.nanmean(speeds, axis=0) / np.maximum(own.mean(axis=0), 1e-6)
        log = dataclasses.replace(log, rotor_speed=(full * own).astype(np.float32))
    if original.accelerometer is None:
        log = dataclasses.replace(log, accelerometer=None)
    return dataclasses.replace(thinned(log, every), lead=original.lead)


def _path(flight: Flight, design: Parameters, rate: int, steps: int, thrust: float) -> _Path:
    """Returns what a log says at each command; its last state lasts."""
    parts = [flight.position, flight.velocity, np.unwrap(flight.attitude, axis=0)]
    state = np.concatenate([*parts, flight.body_rates], axis=1).astype(float)
    # Above what counts a logged state is noise.
    if 1 / flight.period > 4 * HIGHEST:
        smooth = scipy.signal.butter(2, HIGHEST, fs=1 / flight.period, output="sos")
        state = scipy.signal.sosfiltfilt(smooth, state, axis=0)
    # As the regulator's own model of the motors.
    decay = np.exp(-flight.period / float(design.motor_time_constant))
    commanded = np.sqrt(np.maximum(flight.command.astype(float), 0.0))
    speed = scipy.signal.lfilter([1 - decay], [1, -decay], commanded, 0, decay * commanded[:1])[0]
    columns = np.column_stack([flight.command * thrust, state, speed * np.sqrt(thrust)])
    own = np.arange(len(flight)) * flight.period
    # A command of a zero-order hold is one of a row, else one of many between two rows.
    at = np.arange(steps) * (flight.period if flight.zero_order_hold else 1 / rate)
    table = np.column_stack([np.interp(at, own, column) for column in columns.T]).astype(np.float32)
    return _Path(table[:, :4], table[:, 4:16], table[:, 16:])


@partial(jax.jit, static_argnums=0)
def _fly(
    world: Environment,
    drone: Parameters,
    design: Parameters,
    gain: Float[Array, "4 16"],
    paths: _Path,
    keys: Array,
) -> Rows:
    period = 1.0 / world.controller.interface.rate

    def fly_path(path: _Path, key: Array) -> Rows:
        steps = len(path.command)

        def command(
            memory: _Memory, _: Array, measurement: Measurement, setpoint: Array
        ) -> tuple[_Memory, Array]:
            planned = path.state[memory.number]
            attitude = rotations.to_attitude(measurement.quaternion)
            turned = attitude - planned[6:9]
            turned = (turned + jnp.pi) % (2 * jnp.pi) - jnp.pi
            shift = _in_heading(measurement.position - planned[:3], attitude[2])
            velocity = _in_heading(measurement.velocity - planned[3:6], attitude[2])
            rates = measurement.body_rates - planned[9:]
            speeds = memory.rotor_speed - path.rotor_speed[memory.number]
            deviation = jnp.concatenate([shift, velocity, turned, rates, speeds])
            action = jnp.clip(path.command[memory.number] - gain @ deviation, 0.0, 1.0)
            decay = jnp.exp(-period / design.motor_time_constant)
            after = jnp.sqrt(action) + decay * (memory.rotor_speed - jnp.sqrt(action))
            return _Memory(jnp.minimum(memory.number + 1, steps - 1), after), action

        def reference(time: Float[Array, ""]) -> Float[Array, "3"]:
            number = jnp.floor(time / period + 0.01).astype(int)
            return path.state[jnp.clip(number, 0, steps - 1), :3]

        def init() -> _Memory:
            return _Memory(jnp.zeros((), jnp.int32), path.rotor_speed[0])

        own = dataclasses.replace(
            world,
            task=world.task._replace(reference=reference),
            controller=world.controller._replace(init=init, command=command),
        )
        return simulate(own, lambda *_: jnp.zeros(4), drone, key, steps)

    return jax.vmap(fly_path)(paths, keys)


def _in_heading(vector: Float[Array, "3"], yaw: Float[Array, ""]) -> Float[Array, "3"]:
    """Turns a vector of the world to a frame that has the drone's yaw."""
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)
    x, y, z = vector
    return jnp.stack([cos * x + sin * y, cos * y - sin * x, z])


def _gain(drone: Parameters, rate: int, allowed: float) -> Float[np.ndarray, "4 16"]:
    """Returns the regulator's gain of deviations from hover, in the order of `_ALLOWED`.

    Latency and half a period of the command count as lag of the motors.

    Args:
        drone: the drone to hold.
        rate: commands a second [Hz].
        allowed: see `_ALLOWED_COMMANDS`.
    """
    lag = drone.motor_time_constant + drone.latency + np.float32(0.5 / rate)
    slow = replace(drone, motor_time_constant=lag, torque_bias=np.zeros(3, np.float32))
    hover = np.float32(1 / np.sqrt(float(drone.thrust_to_weight)))

    def derivative(deviation: Float[Array, "20"]) -> Float[Array, "16"]:
        position, velocity, attitude, rates = deviation[:12].reshape(4, 3)
        speed, command = hover + deviation[12:16], hover**2 + deviation[16:]
        state = State(position, velocity, rotations.from_attitude(attitude), rates, speed)
        spin_up = dynamics.motor_derivative(speed, jnp.sqrt(command), slow)
        force = dynamics.linear_acceleration(state, slow)
        turning = dynamics.angular_acceleration(state, spin_up, slow)
        return jnp.concatenate([velocity, force, rates, turning, spin_up])

    slopes = jax.jit(jax.jacfwd(derivative), compiler_options=compiler.once())
    both = np.asarray(slopes(jnp.zeros(20)), np.float64)
    a, b, *_ = scipy.signal.cont2discrete(
        (both[:, :16], both[:, 16:], np.eye(16), np.zeros((16, 4))), 1.0 / rate
    )
    cost, effort = np.diag(_ALLOWED**-2.0), np.eye(4) * allowed**-2.0
    value = scipy.linalg.solve_discrete_are(a, b, cost, effort)
    return np.linalg.solve(effort + b.T @ value @ b, b.T @ value @ a)
