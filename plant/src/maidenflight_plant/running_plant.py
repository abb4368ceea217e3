"""A drone as physics for a firmware that runs elsewhere: motor PWM in, sensors out, 1 ms a step.

The firmware does what is the firmware's: estimation, control, mixing and battery compensation. Here
are the motors' 8-bit PWM, the battery that sags under them, latency, motors, air, floor and
sensors. Sensors are as a Crazyflie's drivers deliver them, behind their low-pass filters.

Source: rates and filters of the firmware 2026.08, sensors_bmi088_bmp3xx.c and estimator_kalman.c.
"""

import dataclasses
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from maidenflight.experiments.drones import drone_of, find_reality
from maidenflight.parameters import Parameters, full_scale_counts, replace
from maidenflight.simulator.physics import actuators, battery, latency, motion, rotations, sensors
from maidenflight.simulator.physics.battery import Supply
from maidenflight.simulator.physics.dynamics import Integrator, State
from maidenflight.simulator.realities.virtual_drone import VirtualDrone, must_be_virtual
from maidenflight.simulator.tasks.tasks import STANDING_HEIGHT_M

STEP = 0.001
"""Time from a message to the next [s]: the firmware's main loop."""
POSE_EVERY = 10
"""Steps between two readings of pose, range and flow."""
RANGE_NOISE = 0.003
"""Standard deviation of the distance to the ground [m]; ours."""
FLOW_NOISE = 0.1
"""Standard deviation of the optical flow [rad/s]; ours."""
_NORMALS = 4 + 3 + 3 + sensors.NORMALS + 3 + 3


class Plant(NamedTuple):
    """What is simulated. Hashable, for static arguments."""

    integrator: Integrator
    supply: Supply


class Readings(NamedTuple):
    """What the sensors say."""

    gyro: Float[Array, "3"]
    """Body rates [rad/s]."""
    accelerometer: Float[Array, "3"]
    """Specific force along body x, y and z [m/s2]: at rest (0, 0, 9.81)."""
    position: Float[Array, "3"]
    """World [m], as a motion capture sees it."""
    quaternion: Float[Array, "4"]
    """Attitude, body to world (x, y, z, w)."""
    range: Float[Array, ""]
    """Distance from the ground along body z [m]."""
    flow: Float[Array, "2"]
    """Angular speed at which the ground passes below, (v_x / range - omega_y, v_y / range +
    omega_x) with velocities along body x and y [rad/s]."""
    battery: Float[Array, ""]
    """Voltage under load [V]."""


class PlantState(NamedTuple):
    """All that changes."""

    state: State
    delay_line: Float[Array, "slots 4"]
    actuators: actuators.Actuators
    gyro: Float[Array, "3"]
    gyro_bias: Float[Array, "3"]
    gyro_noise: Float[Array, "3"]
    filter: Float[Array, "2 3"]
    """Memory of the accelerometer's low-pass filter."""
    readings: Readings


def plant_of(drone: VirtualDrone, full_scale_counts: float) -> tuple[Plant, Parameters]:
    """Returns the plant and the parameters of a virtual drone.

    Args:
        drone: which.
        full_scale_counts: counts that its thrust command of 1 stands for. A drone without a thrust
            law takes PWM as thrust command.

    Raises:
        InputError: the drone changes in the course of a flight.
    """
    drone.must_not_change()
    plant = Plant(drone.integrator, drone.supply(full_scale_counts))
    return plant, replace(drone.parameters, time_step=np.float32(STEP))


@partial(jax.jit, static_argnums=0)
def begin(plant: Plant, parameters: Parameters, key: Array) -> PlantState:
    """Returns the drone on the floor at the origin, level, its motors off."""
    normal, uniform = sensors.draw_noise(key, 3 + _NORMALS, sensors.UNIFORMS)
    level = jnp.array([0.0, 0.0, 0.0, 1.0], jnp.float32)
    place = jnp.array([0.0, 0.0, STANDING_HEIGHT_M], jnp.float32)
    state = State(place, jnp.zeros(3), level, jnp.zeros(3), jnp.zeros(4))
    powered = actuators.switched_on(jnp.zeros(()), parameters, plant.supply)
    bias = sensors.turn_on_bias(parameters, normal[:3])
    force = jnp.array([0.0, 0.0, 1.0], jnp.float32) * parameters.gravity
    nothing = Readings(jnp.zeros(3), force, place, level, place[2], jnp.zeros(2), powered.voltage)
    initial = PlantState(
        state=state,
        delay_line=jnp.zeros((latency.slots(STEP), 4)),
        actuators=powered,
        gyro=jnp.zeros(3),
        gyro_bias=bias,
        gyro_noise=jnp.zeros(3),
        filter=_at_rest(force),
        readings=nothing,
    )
    readings = _read(initial, force, parameters, normal[3:], uniform, posed=True)
    return initial._replace(readings=readings[1])


@partial(jax.jit, static_argnums=1)
def draw(key: Array, steps: int) -> Float[Array, "steps N"]:
    """Returns random numbers of many steps, which each step would draw too slowly."""
    normal, uniform = sensors.draw_noise(key, steps * _NORMALS, steps * sensors.UNIFORMS)
    return jnp.concatenate([normal.reshape(steps, -1), uniform.reshape(steps, -1)], axis=1)


@partial(jax.jit, static_argnums=(0, 5))
def step(
    plant: Plant,
    before: PlantState,
    pwm: Float[Array, "4"],
    parameters: Parameters,
    drawn: Float[Array, "N"],
    posed: bool,
) -> PlantState:
    """Holds four motors' PWM for a step.

    Args:
        plant: what is simulated.
        before: the drone before.
        pwm: of motors 1 to 4 [counts, 0 to 65535], after the firmware's battery compensation.
        parameters: the drone; its time step is `STEP`.
        drawn: random numbers of `draw`.
        posed: whether pose, range and flow are read after it; static.
    """
    normal, uniform = drawn[:_NORMALS], drawn[_NORMALS:]
    powered, wanted = _power(plant, before.actuators, pwm, parameters, normal[:4])
    commands = latency.push(before.delay_line, actuators.rotor_speed_command(wanted))
    arriving, _ = latency.in_step(latency.DelayLine(commands), parameters, 1, 0)
    near = motion.near_ground(parameters, before.state.position[2])
    advanced = plant.integrator(before.state, arriving, near)
    state = motion.floor_reaction(advanced, STANDING_HEIGHT_M)
    time_step = jnp.float32(STEP)
    rates = before.state.body_rates, state.body_rates
    after = before._replace(
        state=state,
        delay_line=commands,
        actuators=powered,
        gyro=sensors.low_pass(before.gyro, *rates, time_step, parameters),
        gyro_bias=sensors.walk_bias(before.gyro_bias, time_step, parameters, normal[4:7]),
        gyro_noise=sensors.gyro_noise(before.gyro_noise, time_step, parameters, normal[19:22]),
    )
    change = (state.velocity - before.state.velocity) / STEP
    force = _turned_back(state.quaternion, change.at[2].add(parameters.gravity))
    next_filter, readings = _read(after, force, parameters, normal[4:], uniform, posed)
    return after._replace(filter=next_filter, readings=readings)


def _power(
    plant: Plant,
    before: actuators.Actuators,
    pwm: Float[Array, "4"],
    parameters: Parameters,
    normal: Float[Array, "4"],
) -> tuple[actuators.Actuators, Float[Array, "4"]]:
    """Battery, and the thrust command that PWM comes to."""
    counts, supply = jnp.clip(pwm, 0.0, battery.MOST_COUNTS), plant.supply
    wandered = actuators.ornstein_uhlenbeck(before.noise, jnp.float32(STEP), parameters, normal)
    if supply.battery:
        ratio = battery.timer_ratio(counts / battery.MOST_COUNTS)
        volts = battery.voltage(before.charge_drawn, ratio, parameters)
        command = battery.thrust_command(ratio, volts, supply)
    else:
        ratio = command = counts / supply.full_scale_counts
        volts = before.voltage
    drawn = before.charge_drawn + STEP * jnp.mean(ratio)
    noisy = jnp.where(counts > 0, jnp.maximum(command + wandered, 0.0), 0.0)
    return actuators.Actuators(wandered, drawn, ratio, volts), noisy


def _read(
    now: PlantState,
    force: Float[Array, "3"],
    parameters: Parameters,
    normal: Float[Array, "N"],
    uniform: Float[Array, "6"],
    posed: bool,
) -> tuple[Float[Array, "2 3"], Readings]:
    """The filter's memory, and the readings; those of the pose stay unless it is read."""
    shaken = force + sensors.ACCELEROMETER_NOISE * np.float32(np.sqrt(2)) * normal[3:6]
    next_filter, smooth = _filtered(now.filter, shaken)
    rates = now.gyro + now.gyro_bias + now.gyro_noise
    always = now.readings._replace(gyro=rates, accelerometer=smooth, battery=now.actuators.voltage)
    if not posed:
        return next_filter, always
    blurred = sensors.measure(now.state, parameters, normal[6:15], uniform)
    up = jnp.maximum(rotations.axes(now.state.quaternion)[2][2], 0.1)
    far = jnp.maximum(now.state.position[2] / up, 1e-2)
    along = _turned_back(now.state.quaternion, now.state.velocity)
    p, q, _ = now.state.body_rates
    flow = jnp.stack([along[0] / far - q, along[1] / far + p]) + FLOW_NOISE * normal[19:21]
    return next_filter, always._replace(
        position=blurred.position,
        quaternion=blurred.quaternion,
        range=far + RANGE_NOISE * normal[18],
        flow=flow,
    )


def _turned_back(quaternion: Float[Array, "4"], vector: Float[Array, "3"]) -> Float[Array, "3"]:
    """A vector of the world in body axes."""
    x, y, z = vector
    return jnp.stack([a * x + b * y + c * z for a, b, c in rotations.axes(quaternion)])


def _filtered(
    memory: Float[Array, "2 3"], value: Float[Array, "3"]
) -> tuple[Float[Array, "2 3"], Float[Array, "3"]]:
    """A Butterworth filter of second order, in transposed direct form II."""
    (b0, b1, b2), (a1, a2) = _coefficients()
    out = b0 * value + memory[0]
    return jnp.stack([b1 * value - a1 * out + memory[1], b2 * value - a2 * out]), out


def _at_rest(value: Float[Array, "3"]) -> Float[Array, "2 3"]:
    """The filter's memory after a constant value."""
    (b0, _, b2), (_, a2) = _coefficients()
    return jnp.stack([(1.0 - b0) * value, (b2 - a2) * value])


@cache
def _coefficients() -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Of the accelerometer's filter: b0, b1, b2, and a1, a2 over a0 = 1."""
    coefficients: Any = scipy.signal.butter(2, sensors.ACCELEROMETER_CUTOFF, fs=1 / STEP)
    b, a = ([float(one) for one in part] for part in coefficients)
    return tuple(b), tuple(a[1:])


DRAWN = 1000
"""Steps whose random numbers are drawn at once."""
SIZE = 17
"""Numbers in `Readings`."""


class RunningPlant:
    """A flight of the plant, a step at a time.

    Its state crosses to the compiled step as one vector: handing over many arrays one by one would
    take longer than the physics. The parameters are constants of that program, which saves a third
    of each step and costs another compilation for each drone.
    """

    def __init__(self, drone: VirtualDrone, seed: int, full_scale_counts: float) -> None:
        """The drone stands on the floor.

        Args:
            drone: see `plant_of`.
            seed: of the noise; the same seed and PWM give the same bytes.
            full_scale_counts: see `plant_of`.
        """
        self._plant, self._parameters = plant_of(drone, full_scale_counts)
        self._key = jax.random.key(seed)
        self._noise = np.empty((0, 0), np.float32)
        first = begin(self._plant, self._parameters, jax.random.fold_in(self._key, 1))
        self._state, self._state_of = ravel_pytree(first)
        self._advance = jax.jit(self._advanced, static_argnums=3)
        # Compiled now, so that the first answer need not wait.
        off, quiet = np.zeros(4, np.float32), np.zeros(_NORMALS + sensors.UNIFORMS, np.float32)
        for posed in (False, True):
            self._advance(self._state, off, quiet, posed)
        self.number = 0
        """Steps made."""
        self.readings: np.ndarray = np.asarray(_in_one(first.readings))
        """What the sensors say now, 17 numbers in the order of `Readings`."""

    def _advanced(
        self,
        state: Float[Array, "n"],
        pwm: Float[Array, "4"],
        drawn: Float[Array, "N"],
        posed: bool,
    ) -> tuple[Float[Array, "n"], Float[Array, "17"]]:
        before = self._state_of(state)
        after = step(self._plant, before, pwm, self._parameters, drawn, posed)
        return ravel_pytree(after)[0], _in_one(after.readings)

    def step(self, pwm: Float[np.ndarray, "4"]) -> Float[np.ndarray, "17"]:
        """Holds four motors' PWM [counts] for 1 ms, and what the sensors say then."""
        place = self.number % DRAWN
        if place == 0:
            key = jax.random.fold_in(self._key, self.number)
            self._noise = np.asarray(draw(key, DRAWN))
        self.number += 1
        posed = self.number % POSE_EVERY == 0
        self._state, readings = self._advance(self._state, pwm, self._noise[place], posed)
        self.readings = np.asarray(readings)
        return self.readings

    @property
    def state(self) -> State:
        """The true state now."""
        return self._state_of(self._state).state


def _in_one(readings: Readings) -> Float[Array, "17"]:
    return jnp.concatenate([jnp.ravel(part) for part in readings])


def find_plant(drone: str, seed: int, compensated: bool = True) -> Callable[[], RunningPlant]:
    """Returns what begins flights of a drone for a firmware that runs elsewhere.

    Args:
        drone: a drone's TOML file or name, or a virtual drone such as `virtual:7`.
        seed: of the noise.
        compensated: whether that firmware compensates for the battery, as today's does by the law
            of the 2.1+ propellers; else PWM is the thrust command.

    Raises:
        InputError: no such drone, or a reality that is no virtual drone or changes in the course of
            a flight.
    """
    reality = find_reality(drone, accept_bounds=True)
    virtual = must_be_virtual(reality, "Give a drone's TOML file, or virtual:SEED.")
    virtual.must_not_change()
    law = battery.PLUS if compensated and virtual.thrust_law is not None else None
    own = drone_of(drone)
    counts = full_scale_counts(own if Path(own).is_file() else "crazyflie") or battery.COUNTS
    return partial(RunningPlant, dataclasses.replace(virtual, thrust_law=law), seed, counts)
