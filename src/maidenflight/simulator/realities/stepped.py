"""`Stepped`, a virtual drone by the `Reality` protocol, for what is not written in JAX."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.parameters import Parameters
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.controllers import control
from maidenflight.simulator.environment import Environment, EnvState
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.realities.reality import MOTORS, Truth
from maidenflight.simulator.realities.virtual_drone import VirtualDrone
from maidenflight.simulator.tasks import tasks


class Stepped:
    """A virtual drone with all its effects, one command of 2 ms at a time."""

    rate = 500
    takes = MOTORS

    def __init__(self, drone: VirtualDrone) -> None:
        """Makes one that hovers at the origin."""
        self.name, self.parameters = drone.name, drone.parameters
        self.hover = float(dynamics.hover_command(drone.parameters))
        whole = drone.environment(tasks.circle(), control.pwm(action_rate=self.rate))
        self._environment = whole
        self.reset(np.zeros(3), 0)

    def reset(self, position: Float[np.ndarray, "3"], seed: int) -> None:
        """Resets to hover, level and at rest at a position [m], with the noise of a seed."""
        self._key, self._steps = jax.random.key(seed), 0
        start = jnp.asarray(position, jnp.float32)
        self._state: EnvState = _begin(self._environment, start, self.parameters, self._key)
        self._command = np.full(4, self.hover)

    def step(self, command: Float[np.ndarray, "4"]) -> None:
        """Holds thrust commands for 2 ms."""
        self._steps += 1
        self._command = np.asarray(command, np.float64)
        motor_command: Any = self._command.astype(np.float32)
        world = self._environment, self._state, motor_command, self.parameters
        self._state = _step(*world, self._key, self._steps)

    def observe(self) -> Measurement:
        """Returns what its sensors say."""
        return self._state.measurement

    def truth(self) -> Truth:
        """Returns the true state and the last commands."""
        state: Any = self._state.state
        return Truth(state.position, state.quaternion, state.body_rates, self._command)


@partial(jax.jit, static_argnums=0)
def _begin(
    env: Environment, position: Float[Array, "3"], drone: Parameters, key: Array
) -> EnvState:
    state = dynamics.at_hover(position, drone)
    return environment.begin(env, state, jnp.zeros(()), drone, jax.random.fold_in(key, 0))


@partial(jax.jit, static_argnums=0)
def _step(
    env: Environment,
    state: EnvState,
    command: Float[Array, "4"],
    drone: Parameters,
    key: Array,
    number: Any,
) -> EnvState:
    key = jax.random.fold_in(key, number)
    return stepping.step(env, state, 2.0 * command - 1.0, drone, key)[0]
