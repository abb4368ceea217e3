"""One drone as a `gymnasium.Env`."""

import os
from typing import Any

import gymnasium
import jax
import numpy as np
from gymnasium.spaces import Box
from jaxtyping import Float

from maidenflight.errors import InputError
from maidenflight.integrations.gym import arguments, flying
from maidenflight.integrations.gym.drawing import Scene, View
from maidenflight.simulator.controllers.interface import NOTE, ControlInterface
from maidenflight.simulator.policy_spec import ACTION_SIZE, PolicySpec
from maidenflight.simulator.tasks.failures import TIME_LIMIT

# A step takes less time than to hand it to another thread, which JAX does on a CPU unless it is
# configured before its first use.
if "JAX_CPU_ENABLE_ASYNC_DISPATCH" not in os.environ:
    jax.config.update("jax_cpu_enable_async_dispatch", False)

AHEAD = 64
"""Episodes that are prepared at once, which costs hardly more than one."""
_LARGEST = np.finfo(np.float32).max

Step = tuple[np.ndarray, float, bool, bool, dict[str, Any]]


def spaces(interface: ControlInterface, spec: PolicySpec) -> tuple[Box, Box]:
    """Observations, which have no bounds but those of float32, and actions.

    What an observation is stands in the first of them, which learners keep beside their policies.
    """
    observations = Box(-_LARGEST, _LARGEST, (spec.size,), np.float32)
    fields = {name: value for name, value in spec.to_dict().items() if name in PolicySpec.OBSERVED}
    vars(observations)[NOTE] = {"control": interface.name, "rate": interface.rate, **fields}
    return observations, Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)


class QuadrotorEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One drone that does one task.

    An episode ends with `terminated` if the drone fails and with `truncated` if time is up. `info`
    is then `end_reason`, the mean `position_error` [m] and `duration` [s]. A seed gives the same
    episodes on the same machine; without one, `reset` goes on.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 100}

    def __init__(
        self,
        task: str = "circle",
        control: str = "pwm",
        parameters: arguments.Drones = None,
        firmware: str = "2026.08",
        spec: PolicySpec = PolicySpec(),
        reward: str = "task",
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        """Checks the arguments; compiles at the first reset.

        Args:
            task: what to do.
            control: `"pwm"` (100 Hz), `"attitude_rate"` (50 Hz) or `"attitude"` (25 Hz).
            parameters: see `arguments.Drones`; a box is drawn from anew for each episode.
            firmware: generation of the PIDs.
            spec: what is observed: instants, and points of the reference ahead of time. The
                learner's networks are its own.
            reward: `"task"`, the task's own, or `"shaped"`, with which methods such as PPO learn;
                see `rewards.shaped`.
            render_mode: `"rgb_array"`, or none.
            options: arguments of the task: height, diameter, period [m, s]; for tracking,
                trajectory, waypoints and others.

        Raises:
            InputError: an argument is not what it should be.
        """
        self.render_mode = arguments.checked_render_mode(render_mode)
        self._env, self.drones = arguments.world(
            task, control, parameters, firmware, spec, reward, options
        )
        self.metadata = {**self.metadata, "render_fps": self._env.controller.interface.rate}
        self.observation_space, self.action_space = spaces(self._env.controller.interface, spec)
        self.program = flying.program(self._env)
        self._key: np.ndarray | None = None
        self._number = 0
        self._ahead: tuple[Any, np.ndarray] = ((), np.empty(0))
        self._groups: flying.Groups | None = None
        self._scene: Scene | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins an episode.

        Args:
            seed: the first of the episodes of this seed; `None`: the next one.
            options: none are known.

        Returns:
            The first observation, and an empty `info`.
        """
        super().reset(seed=seed)
        if seed is not None or self._key is None:
            self._key, self._number = flying.first_key(self.np_random), 0
        turn = self._number % AHEAD
        if turn == 0:
            numbers = np.arange(self._number, self._number + AHEAD, dtype=np.uint32)
            keys = np.broadcast_to(self._key, (AHEAD, 2))
            self._ahead = jax.tree.map(
                np.asarray, self.program.launch_all(self.drones, keys, numbers)
            )
        groups, observations = self._ahead
        self._groups = tuple(jax.device_put(group[turn]) for group in groups)
        self._number += 1
        if self._scene is not None:
            self._scene.begin()
        return observations[turn].copy(), {}

    def step(self, action: Float[np.ndarray, "4"]) -> Step:
        """Holds an action for one control period.

        Args:
            action: in [-1, 1]; the task sees what is beyond, the drone does not.

        Returns:
            Observation, reward, whether the drone has failed, whether time is up, and `info`.

        Raises:
            InputError: no episode has begun, or the action has not four numbers.
        """
        command = np.asarray(action, np.float32)
        flying.check_step(self._groups, command.shape, (ACTION_SIZE,))
        self._groups, row = self.program.step(self._groups, command)
        numbers = np.array(row)
        observation = numbers[: -flying.STATISTICS]
        reward, reason, error, duration = numbers[-flying.STATISTICS :].tolist()
        if reward != reward and not np.isfinite(command).all():
            raise InputError(
                f"step: the action is {command}, expected four finite numbers. Has the policy "
                "diverged?"
            )
        if not reason:
            return observation, reward, False, False, {}
        truncated, episode = reason == TIME_LIMIT, flying.statistics(reason, error, duration)
        return observation, reward, not truncated, truncated, episode

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Returns a picture, (480, 640, 3) uint8; `None` without a `render_mode`."""
        if self.render_mode is None:
            return None
        groups = flying.check_begun(self._groups, "render")
        if self._scene is None:
            self._scene = self.make_scene()
        return self._scene.draw(View(*map(np.asarray, self.program.view(groups))))

    def make_scene(self) -> Scene:
        """Returns the task before a camera, for the pictures of a drone."""
        return Scene(self._env.task, self.drones.centre)
