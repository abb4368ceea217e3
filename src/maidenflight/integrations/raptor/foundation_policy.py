"""`Raptor`, the foundation policy for quadrotors, as its package gives it.

`foundation-policy` is installed from PyPI (extra `raptor`) and imported when first needed; its own
code reads the checkpoint and checks it against the checkpoint's example.

It sees 22 numbers: position less set-point (world), rotation matrix row by row, velocity less the
set-point's (world), body rates and its last action, in our axes and order of motors; as on PX4 the
error of position is clipped to 0.5 m and that of velocity to 1 m/s. Its four actions are rotor
speeds in [-1, 1], so a thrust command u is ((a + 1) / 2)^2. It was trained at 100 Hz. On drones its
makers run it faster: between two steps of 10 ms it is evaluated anew with what it remembered at the
last, so that the gyro acts at once while its memory advances at 100 Hz. The last action that it
sees is then that of 2 ms before; with that of the last 10 ms it fails on some virtual drones.

Source: Eschmann et al. 2025, RAPTOR; foundation-policy 1.0.2, README and PX4's mc_raptor.
"""

import importlib
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from maidenflight.errors import InputError, optional
from maidenflight.flying.foreign_policy import reference_velocity
from maidenflight.flying.pilots import Fly
from maidenflight.integrations.raptor.form import MAX_POSITION_ERROR_M, MAX_VELOCITY_ERROR_M_S
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.tasks.tasks import Task

RATES = {"raptor": 100, "raptor:500hz": 500}
"""Commands a second [Hz] by name."""
MEMORY_RATE = 100
"""Steps of its memory a second [Hz]."""


class Raptor:
    """RAPTOR; follows the `ForeignPolicy` protocol."""

    rate = MEMORY_RATE

    def __init__(self, name: str = "raptor") -> None:
        """Reads it.

        Args:
            name: a key of `RATES`.

        Raises:
            InputError: there is no such name, or its package is not installed.
        """
        if name not in RATES:
            raise InputError(f"{name}: no such policy. Expected {' or '.join(RATES)}.")
        self.name, self.command_rate = name, RATES[name]
        self._network = _network()

    def begin(self, hover: float, task: Task) -> Fly:
        """Begins a flight with an empty memory, its last action that of hover."""
        network, velocity_at = self._network, reference_velocity(task)
        network.reset()
        (memory,) = [layer for layer in network.layers if hasattr(layer, "state")]
        remembered, calls, every = None, 0, self.command_rate // self.rate
        last = np.full(4, 2.0 * np.sqrt(hover) - 1.0)

        def fly(
            measurement: Measurement, setpoint: Float[np.ndarray, "3"]
        ) -> Float[np.ndarray, "4"]:
            nonlocal remembered, calls, last
            feedforward = velocity_at(calls // every / self.rate)
            memory.state = remembered
            action = network.evaluate_step(
                observed(measurement, setpoint, feedforward, last)[None]
            )[0]
            if calls % every == 0:
                remembered = memory.state
            last, calls = action, calls + 1
            return ((np.clip(action, -1.0, 1.0) + 1.0) / 2.0) ** 2

        return fly


def observed(
    measurement: Measurement,
    setpoint: Float[np.ndarray, "3"],
    velocity: Float[np.ndarray, "3"],
    last_action: Float[np.ndarray, "4"],
) -> Float[np.ndarray, "22"]:
    """Returns what it sees.

    Args:
        measurement: what is known of the drone.
        setpoint: [m].
        velocity: of the set-point [m/s].
        last_action: in [-1, 1].
    """
    position, speed, quaternion, rates = (np.asarray(part, np.float64) for part in measurement)
    far = np.clip(position - setpoint, -MAX_POSITION_ERROR_M, MAX_POSITION_ERROR_M)
    fast = np.clip(speed - velocity, -MAX_VELOCITY_ERROR_M_S, MAX_VELOCITY_ERROR_M_S)
    turned = Rotation.from_quat(quaternion).as_matrix().ravel()
    return np.concatenate([far, turned, fast, rates, np.clip(last_action, -1.0, 1.0)])


@lru_cache(maxsize=1)
def _network() -> Any:
    """The network, read when first needed."""
    with optional("foundation_policy", "raptor", "RAPTOR"):
        package: Any = importlib.import_module("foundation_policy")
    return package.Raptor()
