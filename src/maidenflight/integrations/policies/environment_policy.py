"""`EnvironmentPolicy`, a policy of Stable-Baselines3 that our Gymnasium environments trained."""

from collections import deque
from pathlib import Path

import numpy as np
from jaxtyping import Float

from maidenflight.errors import InputError
from maidenflight.flying.pilots import Fly
from maidenflight.inputs import StrPath
from maidenflight.integrations.policies import stable_baselines
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import points_at
from maidenflight.simulator.tasks.tasks import Task


class EnvironmentPolicy:
    """A network and what it observes; follows the `ForeignPolicy` protocol."""

    def __init__(self, path: StrPath) -> None:
        """Reads its file.

        The file `vecnormalize.pkl` beside it is its scaling of observations where it is there;
        tables then call the policy by both names.

        Args:
            path: `model.zip`.

        Raises:
            InputError: a package is not installed, or the file is another environment's.
        """
        scaling = Path(path).parent / stable_baselines.SCALING
        has_scaling = scaling.is_file()
        self._path = path
        self._model = stable_baselines.read_model(path, scaling if has_scaling else None)
        self.name = Path(path).stem + (f"+{scaling.stem}" if has_scaling else "")
        self.rate, self._spec = stable_baselines.environment_of(path, self._model)
        self.command_rate = self.rate

    def begin(self, hover: float, task: Task) -> Fly:
        """Begins a flight; its last action is that of hover."""
        action, calls = np.full(4, 2 * hover - 1), 0
        history: deque[np.ndarray] = deque(maxlen=self._spec.history)

        def fly(
            measurement: Measurement, setpoint: Float[np.ndarray, "3"]
        ) -> Float[np.ndarray, "4"]:
            nonlocal action, calls
            position, velocity, quaternion, rates = (
                np.asarray(part, np.float64) for part in measurement
            )
            # The order of `policy_spec.observe`.
            instant = np.concatenate(
                [position, quaternion, velocity, rates, setpoint - position, action]
            )
            history.extend([instant] * (1 if history else self._spec.history))
            points = np.asarray(points_at(self._spec, task.reference, calls / self.rate))
            action = self._act(np.concatenate([*history, np.ravel(points - position)]))
            calls += 1
            return (np.clip(action, -1.0, 1.0) + 1) / 2

        return fly

    def _act(self, observation: Float[np.ndarray, "N"]) -> Float[np.ndarray, "4"]:
        try:
            action = self._model.act(observation)
        except ValueError as error:
            raise InputError(
                f"{self._path}: its environment has observations of {len(observation)} numbers, "
                f"but {error}. Give the file as Stable-Baselines3 saved it."
            ) from error
        if not np.isfinite(action).all():
            raise InputError(f"{self._path}: an action of {action}; expected four finite numbers.")
        return action.astype(np.float64)
