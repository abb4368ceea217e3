"""`MuJoCo`: a drone as MuJoCo flies it, from the very MJCF that `maidenflight drone` writes.

`mujoco-core` is installed from PyPI (extra `mujoco`). MuJoCo does all of the physics: body, motors'
lag and latency. What MJCF does not hold, such as unequal lags up and down, is not simulated:
`drone --to mjcf` writes it as comments. A command u becomes the thrust that our model gives at rest
after it.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from maidenflight import parameters
from maidenflight.deployment.drone_format import drone_text
from maidenflight.errors import imported
from maidenflight.integrations.drones import mjcf
from maidenflight.parameters import Parameters, noiseless, replace
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.realities.reality import MOTORS, Truth


class MuJoCo:
    """A drone in MuJoCo; follows the `Reality` protocol."""

    rate = round(1.0 / mjcf.STEP_S)
    takes = MOTORS

    def __init__(self, drone: str) -> None:
        """Makes its world.

        Args:
            drone: TOML file, or a name in `parameters.DRONES`.

        Raises:
            InputError: no such drone, or MuJoCo is not installed.
        """
        mujoco = imported("mujoco", "mujoco", "this drone")
        name, self._original = parameters.name_of(drone), parameters.read_drone(drone)
        self.name = f"mujoco:{name}"
        self.parameters = _nearest(self._original)
        """The nearest drone of our model."""
        self.hover = float(dynamics.hover_command(self._original))
        self._mujoco = mujoco
        self._model: Any = mujoco.MjModel.from_xml_string(drone_text(self._original, "mjcf", name))
        self._data: Any = mujoco.MjData(self._model)
        self._full = np.asarray(self._model.actuator_ctrlrange)[:, 1]
        self.reset(np.zeros(3), 0)

    def reset(self, position: Float[np.ndarray, "3"], seed: int) -> None:
        """Resets to hover, level and at rest at a position [m]; nothing here is random."""
        mujoco, data = self._mujoco, self._data
        mujoco.mj_resetData(self._model, data)
        self._command = np.full(4, self.hover)
        hover = self._thrust(self._command)
        for motor in range(4):
            if self._model.actuator_delay[motor] > 0.0:
                self._fill(motor, float(hover[motor]))
        data.act[:] = data.ctrl[:] = hover
        data.qpos[:3], data.qpos[3:] = np.asarray(position, np.float64), [1.0, 0.0, 0.0, 0.0]
        mujoco.mj_forward(self._model, data)

    def step(self, command: Float[np.ndarray, "4"]) -> None:
        """Holds thrust commands for 2 ms."""
        self._command = np.clip(np.asarray(command, np.float64), 0.0, None)
        self._data.ctrl[:] = self._thrust(self._command)
        self._mujoco.mj_step(self._model, self._data)

    def observe(self) -> Measurement:
        """Returns the true state."""
        data = self._data
        parts: Any = (
            np.array(data.qpos[:3]),
            np.array(data.qvel[:3]),
            np.roll(data.qpos[3:], -1),
            np.array(data.qvel[3:]),
        )
        return Measurement(*parts)

    def truth(self) -> Truth:
        """Returns the true state and the last commands."""
        state: Any = self.observe()
        return Truth(state.position, state.quaternion, state.body_rates, self._command)

    def _thrust(self, command: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4"]:
        """Thrust [N] of rotors that have followed a command."""
        drone = self._original
        offset, linear = float(drone.thrust_offset), float(drone.thrust_linear)
        return self._full * (offset + linear * np.sqrt(command) + (1.0 - offset - linear) * command)

    def _fill(self, motor: int, thrust: float) -> None:
        """Fills what is on its way to a motor with a thrust [N]."""
        count = int(self._model.actuator_history[motor][0])
        times = mjcf.STEP_S * np.arange(-count, 0.0)
        self._mujoco.mj_initCtrlHistory(
            self._model, self._data, motor, times, np.full(count, thrust)
        )


def _nearest(drone: Parameters) -> Parameters:
    """The drone that MuJoCo flies, under commands u and with the thrust curve of the original."""
    curve = {name: getattr(drone, name) for name in ("thrust_offset", "thrust_linear")}
    return replace(noiseless(mjcf.nearest_mjcf(drone)), **curve, time_step=np.float32(0.001))
