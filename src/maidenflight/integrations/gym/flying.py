"""One step of one drone as a compiled function of few small arrays.

Calling a compiled function costs about a microsecond for each array passed in or out, and XLA on a
CPU runs a program without waiting threads only where no array is larger than 512 bytes. So the
drone's state and parameters are packed into groups of at most 128 numbers, and a step returns one
row.
"""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax, tree
from jaxtyping import Array, Bool, Float, UInt32

from maidenflight.errors import InputError
from maidenflight.parameters import crazyflie
from maidenflight.simulator import environment, stepping
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import rotations
from maidenflight.simulator.randomization import Distribution, relative_box
from maidenflight.simulator.stepping import EnvInstance, randomized_reset
from maidenflight.simulator.tasks.failures import END_REASONS

GROUP = 128
"""Most float32 numbers of an array of 512 bytes."""
RANDOM = "threefry2x32"
"""The kind of random keys, which draws the same numbers for one drone and for many."""

Groups = tuple[Float[Array, "..."], ...]
"""A flight, packed."""


class Flight(NamedTuple):
    """A drone that flies an episode, and what is counted of it."""

    drone: EnvInstance
    key: UInt32[Array, "2"]
    """Of the noise to come."""
    error: Float[Array, ""]
    """Sum of the distances from the set-point after each step [m]."""
    steps: Float[Array, ""]


def check_begun(groups: Groups | None, call: str) -> Groups:
    """Returns the flight that a call is about.

    Raises:
        InputError: no episode has begun.
    """
    if groups is None:
        raise InputError(f"{call}: no episode has begun. Call reset() first.")
    return groups


def check_step(groups: Groups | None, shape: tuple[int, ...], expected: Any) -> None:
    """Refuses a step before an episode has begun, and actions of another shape than expected.

    Raises:
        InputError: which of both.
    """
    check_begun(groups, "step")
    if shape != expected:
        raise InputError(f"step: actions of shape {shape}, expected {expected}.")


STATISTICS = 4
"""Numbers behind the observation in the row that a step gives: reward, index of `END_REASONS`, mean
position error [m], duration [s]."""


def statistics(reason: float, error: float, duration: float) -> dict[str, Any]:
    """Makes an episode's `info`: reason, mean distance from the set-point [m], length [s]."""
    return {
        "end_reason": END_REASONS[int(reason)],
        "position_error": float(error),
        "duration": float(duration),
    }


class Program:
    """The compiled functions of an environment; `program` gives equal environments the same."""

    def __init__(self, env: Environment) -> None:
        """Compiles nothing yet."""
        self._env = env
        shapes = jax.eval_shape(
            self._launch, relative_box(crazyflie(), 0.0), jax.ShapeDtypeStruct((2,), np.uint32)
        )
        self._leaves, self._structure = tree.flatten(shapes)
        self._sizes = _grouped([leaf.size for leaf in self._leaves])
        self.step = jax.jit(self._step, donate_argnums=0)
        """(groups, action) to the groups after, and a row."""
        self.step_all = jax.jit(jax.vmap(self._step), donate_argnums=0)
        # Optimised, its draws take three seconds to compile and, 64 at a time, hardly less to run.
        quick = {"xla_backend_optimization_level": 0}
        self.launch_all = jax.jit(
            jax.vmap(self._packed_launch, in_axes=(None, 0, 0)), compiler_options=quick
        )
        """(distribution, keys, number of the episode) to groups, and the first observations."""
        self.choose = jax.jit(_choose, donate_argnums=2)
        """(whose, new groups, old groups) to new groups for some and the old ones for the rest."""
        self.view = jax.jit(self._view)
        """Groups to the parts of a `drawing.View`."""
        self.view_all = jax.jit(jax.vmap(self._view))

    def _launch(self, distribution: Distribution, key: UInt32[Array, "2"]) -> Flight:
        drone_key, noise_key = jax.random.split(jax.random.wrap_key_data(key, impl=RANDOM))
        drone = randomized_reset(self._env, distribution, drone_key)
        drone = tree.map(lambda leaf: jnp.asarray(leaf), drone)
        return Flight(drone, jax.random.key_data(noise_key), jnp.zeros(()), jnp.zeros(()))

    def _packed_launch(
        self, distribution: Distribution, key: UInt32[Array, "2"], number: Array
    ) -> tuple[Groups, Float[Array, "20H+3K"]]:
        own_key = jax.random.fold_in(jax.random.wrap_key_data(key, impl=RANDOM), number)
        flight = self._launch(distribution, jax.random.key_data(own_key))
        return self._pack(flight), environment.observation(self._env, flight.drone.env_state)

    def _step(self, groups: Groups, action: Float[Array, "4"]) -> tuple[Groups, Float[Array, "n"]]:
        flight = self._unpack(groups)
        step_key, next_key = jax.random.split(jax.random.wrap_key_data(flight.key, impl=RANDOM))
        env_state, step_result = stepping.step(
            self._env, flight.drone.env_state, action, flight.drone.parameters, step_key
        )
        error, steps = flight.error + step_result.position_error, flight.steps + 1.0
        numbers = [
            step_result.reward,
            step_result.end_reason.astype(jnp.float32),
            error / steps,
            env_state.elapsed,
        ]
        row = jnp.concatenate([environment.observation(self._env, env_state), jnp.stack(numbers)])
        drone = EnvInstance(env_state, flight.drone.parameters)
        after = Flight(drone, jax.random.key_data(next_key), error, steps)
        return self._pack(after), row

    def _view(self, groups: Groups) -> tuple[Array, Array, Array, Array]:
        env_state = self._unpack(groups).drone.env_state
        state = env_state.state
        return (
            state.position,
            rotations.to_matrix(state.quaternion),
            state.rotor_speed,
            self._env.task.reference(env_state.time),
        )

    def _pack(self, flight: Flight) -> Groups:
        leaves = [_as_float(leaf).reshape(-1) for leaf in tree.leaves(flight)]
        return tuple(jnp.concatenate([leaves[i] for i in group]) for group in self._sizes)

    def _unpack(self, groups: Groups) -> Flight:
        leaves: list[Any] = [None] * len(self._leaves)
        for group, members in zip(groups, self._sizes, strict=True):
            start = 0
            for i in members:
                known = self._leaves[i]
                flat = group[start : start + known.size]
                leaves[i] = _from_float(flat, known.dtype).reshape(known.shape)
                start += known.size
        return tree.unflatten(self._structure, leaves)


def _as_float(leaf: Array) -> Float[Array, "..."]:
    """The same 32 bits as a float32, or a truth value as 0 or 1."""
    is_truth = leaf.dtype == bool
    return leaf.astype(np.float32) if is_truth else lax.bitcast_convert_type(leaf, np.float32)


def _from_float(flat: Float[Array, "n"], dtype: np.dtype) -> Array:
    return flat != 0 if dtype.kind == "b" else lax.bitcast_convert_type(flat, dtype)


def _choose(is_reset: Bool[Array, "n"], new: Groups, old: Groups) -> Groups:
    return tree.map(lambda new, old: jnp.where(is_reset[:, None], new, old), new, old)


def _grouped(sizes: list[int]) -> list[list[int]]:
    """Numbers of the leaves that share an array: as many as fit, the large ones first."""
    groups: list[list[int]] = []
    for i in sorted(range(len(sizes)), key=lambda i: -sizes[i]):
        fitting = [group for group in groups if sum(sizes[j] for j in group) + sizes[i] <= GROUP]
        fitting[0].append(i) if fitting else groups.append([i])
    return groups


@cache
def program(env: Environment) -> Program:
    """Returns the compiled functions of an environment."""
    return Program(env)


def first_key(generator: np.random.Generator) -> UInt32[np.ndarray, "2"]:
    """Returns the key of all episodes that follow a seed; episode n has this key folded with n."""
    return generator.integers(0, 2**32, 2, dtype=np.uint32)
