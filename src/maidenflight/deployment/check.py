"""Checks before a training, and before an export, that what is written flies the drone."""

from tempfile import TemporaryDirectory

import jax
import numpy as np

from maidenflight.deployment import export
from maidenflight.errors import InputError
from maidenflight.parameters import Parameters, read_drone
from maidenflight.parameters.frames import mixer_of
from maidenflight.policy import untrained_policy
from maidenflight.simulator.controllers.interface import ControlInterface
from maidenflight.simulator.policy_spec import PolicySpec


def check_frame(to: str, interface: ControlInterface, drone: Parameters) -> None:
    """Refuses a policy whose commands the Crazyflie's firmware would mix for another frame.

    And one for the Brushless, which is another platform of the firmware.

    Raises:
        InputError: as above.
    """
    brushless = read_drone("crazyflie_brushless")
    if to == "crazyflie" and np.allclose(np.abs(drone.rotor_x), np.abs(brushless.rotor_x), 0.01):
        raise InputError(
            "policy: of a drone with the frame of the Crazyflie 2.1 Brushless (platform cf21bl). "
            "The app is built and tested for brushed Crazyflies (cf2), and compensates for the "
            "battery as these do: the Brushless would get another thrust. Export to c, and drive "
            "its motors by your own firmware."
        )
    if to == "crazyflie" and interface.name != "pwm" and mixer_of(drone) is not None:
        raise InputError(
            f"policy: {interface.name} control of rotors at x = {drone.rotor_x.tolist()} m, y = "
            f"{drone.rotor_y.tolist()} m with directions {drone.rotor_direction.tolist()}, but the "
            "Crazyflie's firmware mixes for an X whose front right rotor turns counter-clockwise. "
            "Train PWM control, which commands the motors themselves, or export to c or onnx."
        )


def check_export(to: str, interface: ControlInterface, spec: PolicySpec, drone: Parameters) -> None:
    """Checks before a training that its policies can be exported: exports an untrained one.

    Raises:
        InputError: what is written could not hold them, or not fly the drone.
    """
    check_frame(to, interface, drone)
    with TemporaryDirectory() as folder:
        policy = untrained_policy(jax.random.key(0), interface, spec)
        export(policy, folder, to, name="policy", seed=0)
