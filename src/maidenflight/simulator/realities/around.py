"""Realities around others, which they change: late commands, uneven motors, sensors."""

from collections import deque
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight import parameters
from maidenflight.errors import InputError
from maidenflight.parameters import crazyflie, noiseless, replace
from maidenflight.simulator.controllers import interface as interfaces
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import sensors
from maidenflight.simulator.physics.dynamics import State
from maidenflight.simulator.physics.sensors import Measurement

SENSORS = MappingProxyType(
    {
        "position_noise": 0.003,
        "position_noise_uniform": 0.001,
        "velocity_noise": 0.015,
        "attitude_noise": float(np.radians(0.1)),
        "attitude_noise_uniform": float(np.radians(0.05)),
        "gyro_noise": 0.01,
        "gyro_cutoff": 80.0,
        "gyro_time_constant": 0.0028,
        "gyro_turn_on_bias": float(np.radians(0.5)),
        "estimator_delay": 0.005,
    }
)
"""What `+sensors` sets: the noise and delays of the middle one of the virtual drones."""


def milliseconds(seconds: float) -> str:
    """Formats a time as names of realities do: `10ms`."""
    return f"{1000 * seconds:g}ms"


class _Wrapper:
    """A reality around another, which it passes on."""

    def __init__(self, inner: Any, addition: str) -> None:
        self.inner = inner
        self.name = f"{inner.name}+{addition}"
        self.rate, self.takes, self.hover = inner.rate, inner.takes, inner.hover
        own = getattr(inner, "parameters", None)
        if own is not None:
            self.parameters = own

    def reset(self, position: Float[np.ndarray, "3"], seed: int) -> None:
        self.inner.reset(position, seed)

    def step(self, command: Float[np.ndarray, "4"]) -> None:
        self.inner.step(command)

    def observe(self) -> Measurement:
        return self.inner.observe()

    def truth(self) -> Any:
        return self.inner.truth()


class DelayWrapper(_Wrapper):
    """A reality whose commands act later; its truth and its log hold the original ones."""

    def __init__(self, inner: Any, seconds: float) -> None:
        """Wraps a reality of the protocol, commanded so much later [s].

        Raises:
            InputError: it is none.
        """
        super().__init__(inner, milliseconds(seconds))
        steps = seconds * inner.rate
        if abs(steps - round(steps)) > 1e-6:
            raise InputError(
                f"{self.name}: {inner.name} takes a command each {1000 / inner.rate:g} ms; "
                "expected a multiple of that."
            )
        self._steps = round(steps)
        if hasattr(self, "parameters"):
            later = float(self.parameters.latency) + seconds
            self.parameters = parameters.check(replace(self.parameters, latency=later), self.name)

    def reset(self, position: Float[np.ndarray, "3"], seed: int) -> None:
        """Begins a flight, with commands to hover on their way."""
        super().reset(position, seed)
        self._given: Any = np.full(4, self.hover)
        self._line = deque([self._given] * self._steps)

    def step(self, command: Float[np.ndarray, "4"]) -> None:
        """Sends the command of so long ago."""
        self._given = np.array(command, np.float64)
        self._line.append(self._given)
        super().step(self._line.popleft())

    def truth(self) -> Any:
        """Returns the true state, and the last command."""
        return super().truth()._replace(command=self._given)


class MotorBiasWrapper(_Wrapper):
    """A reality whose motors differ; its truth and its log hold the original commands."""

    def __init__(
        self,
        inner: Any,
        addition: str,
        more: Float[np.ndarray, "4"],
        shares: Float[np.ndarray, "4"] | float = 1.0,
    ) -> None:
        """Wraps a reality of the protocol that takes commands of motors in a Crazyflie's order.

        `more` are thrust commands to add, `shares` what of each motor's command acts.

        Raises:
            InputError: it takes others.
        """
        super().__init__(inner, addition)
        motors = interfaces.pwm().name
        if inner.takes != motors:
            raise InputError(
                f"{self.name}: {inner.name} takes {inner.takes!r}; expected {motors!r}."
            )
        self._more, self._shares = more, shares

    def reset(self, position: Float[np.ndarray, "3"], seed: int) -> None:
        """Begins a flight."""
        super().reset(position, seed)
        self._given: Any = np.full(4, self.hover)

    def step(self, command: Float[np.ndarray, "4"]) -> None:
        """Gives what the motors make of a command."""
        self._given = np.array(command, np.float64)
        super().step(np.clip(self._shares * (self._given + self._more), 0.0, 1.0))

    def truth(self) -> Any:
        """Returns the true state, and the last command."""
        return super().truth()._replace(command=self._given)


class SensorWrapper(_Wrapper):
    """A reality behind the sensors of `SENSORS`, as a virtual drone is.

    Position, velocity and attitude are estimated at 100 Hz and late; the gyro is read afresh,
    behind its filter, with a bias drawn for each flight.
    """

    def __init__(self, inner: Any) -> None:
        """Wraps a reality of the protocol."""
        super().__init__(inner, "sensors")
        if hasattr(self, "parameters"):
            self.parameters = replace(self.parameters, **SENSORS)
        self._every = max(1, round(inner.rate / Environment.estimate_rate))

    def reset(self, position: Float[np.ndarray, "3"], seed: int) -> None:
        """Begins a flight with noise of its own."""
        super().reset(position, seed)
        self._random = np.random.default_rng(seed)
        self._bias = np.float32(SENSORS["gyro_turn_on_bias"]) * self._normal(3)
        self._shaken: Any = np.float32(SENSORS["gyro_noise"]) * self._normal(3)
        state = self._state()
        self._before = self._filtered = state.body_rates
        memory = 2 + int(np.ceil(SENSORS["estimator_delay"] * Environment.estimate_rate))
        now = np.concatenate([state.position, state.velocity, state.quaternion])
        self._past: Any = np.tile(now, (memory, 1))
        self._steps = 0
        self._estimate(state)

    def step(self, command: Float[np.ndarray, "4"]) -> None:
        """Passes a command on, then reads the sensors."""
        super().step(command)
        self._steps += 1
        state, elapsed = self._state(), np.float32(1.0 / self.rate)
        self._filtered, self._shaken = _read_on(
            self._filtered,
            self._shaken,
            self._before,
            state.body_rates,
            elapsed,
            self._normal(3),
        )
        self._before = state.body_rates
        if self._steps % self._every == 0:
            self._past = np.concatenate([np.hstack(state[:3])[None], self._past[:-1]])
            self._estimate(state)

    def observe(self) -> Measurement:
        """Returns what the sensors say after the last step."""
        rates = np.asarray(self._filtered) + self._bias + np.asarray(self._shaken)
        return self._estimated._replace(body_rates=rates)  # pyright: ignore

    def _state(self) -> State:
        measured: Any = self.inner.observe()
        position, velocity, quaternion, rates = (np.asarray(part, np.float32) for part in measured)
        return State(position, velocity, quaternion, rates, np.zeros(4, np.float32))  # pyright: ignore

    def _normal(self, size: int) -> Any:
        return self._random.standard_normal(size).astype(np.float32)

    def _estimate(self, state: State) -> None:
        uniform = self._random.uniform(-1.0, 1.0, sensors.UNIFORMS).astype(np.float32)
        estimated = _estimated(self._past, state, self._normal(sensors.NORMALS), uniform)
        parts: Any = [np.asarray(part) for part in estimated]
        self._estimated = Measurement(*parts)


_MEASURED_BY: Any = replace(noiseless(crazyflie()), **SENSORS)


@jax.jit
def _read_on(
    filtered: Float[Array, "3"],
    shaken: Float[Array, "3"],
    before: Float[Array, "3"],
    after: Float[Array, "3"],
    elapsed: Float[Array, ""],
    normal: Float[Array, "3"],
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Body rates behind the gyro's filter, and its noise, after a step."""
    return (
        sensors.low_pass(filtered, before, after, elapsed, _MEASURED_BY),
        sensors.gyro_noise(shaken, elapsed, _MEASURED_BY, normal),
    )


@jax.jit
def _estimated(
    past: Float[Array, "memory 10"],
    state: State,
    normal: Float[Array, "9"],
    uniform: Float[Array, "6"],
) -> Measurement:
    """Position, velocity and attitude; the body rates of it are not used."""
    period = jnp.float32(1.0 / Environment.estimate_rate)
    late = sensors.delayed(past, state, period, _MEASURED_BY)
    return sensors.measure(late, _MEASURED_BY, normal, uniform)
