"""A policy of Stable-Baselines3 flies that an environment of others trained.

On the command line, beside other policies and in this folder, by
`maidenflight transfer own_sb3_policy:Theirs --reality virtual:7`. Policies that our own
environments trained fly by their file alone.
"""

import numpy as np
from scipy.spatial.transform import Rotation
from stable_baselines3 import PPO  # pyright: ignore[reportMissingImports]


class Theirs:
    """Errors of position and velocity, rotation matrix and body rates to rotor speeds in [0, 1]."""

    name, rate, command_rate = "theirs", 50, 50  # set-points and commands a second

    def __init__(self, file="theirs.zip"):
        """Reads the network."""
        self.model = PPO.load(file, device="cpu")

    def begin(self, hover, task):
        """Begins a flight."""

        def fly(measurement, setpoint):
            position, velocity, quaternion, rates = map(np.asarray, measurement)
            turned = Rotation.from_quat(quaternion).as_matrix().ravel()
            observation = np.concatenate([position - setpoint, turned, velocity, rates])
            speeds, _ = self.model.predict(observation.astype(np.float32), deterministic=True)
            return np.clip(speeds, 0, 1) ** 2  # thrust, as the square of rotor speed

        return fly
