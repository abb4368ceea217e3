"""Many drones at once as a `gymnasium.vector.VectorEnv`: one compiled step for all of them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool, Float

from maidenflight.errors import InputError
from maidenflight.integrations.gym import flying
from maidenflight.integrations.gym.drawing import Scene, View
from maidenflight.integrations.gym.single import QuadrotorEnv
from maidenflight.simulator.tasks.failures import TIME_LIMIT

Steps = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]


class QuadrotorVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Drones that do one task.

    With seed s, drone i flies the episodes of a `QuadrotorEnv` with seed s + i. As in Gymnasium's
    own vector environments, the step after an episode's end begins the next episode: its action is
    ignored and its reward is 0.
    """

    metadata = {**QuadrotorEnv.metadata, "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(self, num_envs: int = 1, **arguments: Any) -> None:
        """Checks the arguments, which besides `num_envs` are those of `QuadrotorEnv`.

        Raises:
            InputError: an argument is not what it should be.
        """
        if isinstance(num_envs, bool) or not isinstance(num_envs, int) or num_envs < 1:
            raise InputError(
                f"num_envs = {num_envs!r}; expected a whole number of drones, 1 or more."
            )
        env = QuadrotorEnv(**arguments)
        self.num_envs, self.render_mode = num_envs, env.render_mode
        self.metadata = {**self.metadata, **env.metadata}
        self.single_observation_space = env.observation_space
        self.single_action_space = env.action_space
        self.observation_space = batch_space(env.observation_space, num_envs)
        self.action_space = batch_space(env.action_space, num_envs)
        self._make_scene, self._program, self._drones = env.make_scene, env.program, env.drones
        self._keys = np.zeros((num_envs, 2), np.uint32)
        self._ready = np.zeros(num_envs, bool)
        self._ahead: tuple[Any, Any] = ((), ())
        self._numbers = np.zeros(num_envs, np.uint32)
        self._over = np.zeros(num_envs, bool)
        self._groups: flying.Groups | None = None
        self._scenes: list[Scene] = []

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins an episode of every drone.

        Args:
            seed: drone i gets this plus i, or the i-th of a list; `None`: the next episodes.
            options: none are known.

        Returns:
            The first observations, and an empty `info`.
        """
        seeds = (
            [seed + i for i in range(self.num_envs)]
            if isinstance(seed, int)
            else seed or [None] * self.num_envs
        )
        if len(seeds) != self.num_envs:
            raise InputError(
                f"{len(seeds)} seeds for {self.num_envs} drones; expected one each. Give one "
                "number for all."
            )
        super().reset(seed=seeds[0])
        for i, env_seed in enumerate(seeds):
            if env_seed is not None or self._groups is None:
                generator = self.np_random if env_seed is None else seeding.np_random(env_seed)[0]
                self._keys[i] = flying.first_key(generator)
                self._numbers[i], self._ready[i] = 0, False
        self._over = np.zeros(self.num_envs, bool)
        return self._begin(np.ones(self.num_envs, bool), self._groups), {}

    def step(self, actions: Float[np.ndarray, "n 4"]) -> Steps:
        """Holds each drone's action for one control period.

        Where an episode is over, the next one begins instead.

        Raises:
            InputError: no episode has begun, or there are not four numbers for each drone.
        """
        commands = np.asarray(actions, np.float32)
        flying.check_step(self._groups, commands.shape, self.action_space.shape)
        self._groups, rows = self._program.step_all(self._groups, commands)
        rows = np.array(rows)
        observations = rows[:, : -flying.STATISTICS].copy()
        rewards, reasons, errors, durations = rows[:, -flying.STATISTICS :].T
        if np.isnan(rewards).any() and not np.isfinite(commands).all():
            raise InputError(
                "step: an action is not finite, expected finite numbers. Has the policy diverged?"
            )
        if self._over.any():
            first = self._begin(self._over, self._groups)
            observations[self._over] = first[self._over]
            rewards[self._over] = reasons[self._over] = 0.0
        self._over, truncated = reasons > 0, reasons == TIME_LIMIT
        infos: dict[str, Any] = {}
        for i in np.flatnonzero(self._over):
            episode = flying.statistics(reasons[i], errors[i], durations[i])
            infos = self._add_info(infos, episode, int(i))
        return observations, rewards.astype(np.float64), self._over & ~truncated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Returns a picture of each drone, as of `QuadrotorEnv`."""
        if self.render_mode is None:
            return None
        groups = flying.check_begun(self._groups, "render")
        if not self._scenes:
            self._scenes = [self._make_scene() for _ in range(self.num_envs)]
        parts = [np.asarray(part) for part in self._program.view_all(groups)]
        return tuple(
            scene.draw(View(*(part[i] for part in parts))) for i, scene in enumerate(self._scenes)
        )

    def _begin(self, is_reset: Bool[np.ndarray, "n"], groups: flying.Groups | None) -> np.ndarray:
        """Begins the next episode of some drones; returns first observations of all."""
        if np.any(is_reset & ~self._ready):
            # Copies, since JAX may read its arguments after it has returned.
            self._ahead = self._program.launch_all(
                self._drones, self._keys.copy(), self._numbers.copy()
            )
            self._ready[:] = True
        new, observations = self._ahead
        # Prepared ones stay, since a step takes over its arguments' arrays.
        old = jax.tree.map(jnp.copy, new) if groups is None else groups
        self._groups = self._program.choose(is_reset, new, old)
        self._numbers += is_reset
        self._ready &= ~is_reset
        for i in np.flatnonzero(is_reset) if self._scenes else ():
            self._scenes[i].begin()
        return np.array(observations)
