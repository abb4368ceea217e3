"""Policy files for an exporter: what is written must fly the frame that they were trained for."""

import numpy as np

from maidenflight.errors import InputError
from maidenflight.inputs import StrPath
from maidenflight.parameters import Parameters, check, crazyflie, read_drone, replace
from maidenflight.parameters.frames import mixer_of
from maidenflight.policy_file import PolicyFile, read_policy
from maidenflight.simulator.controllers.interface import ControlInterface


def read_for(path: StrPath, to: str, control: str | None = None) -> PolicyFile:
    """Reads a policy file for an exporter.

    Args:
        path: the file.
        to: a name in `registry.EXPORTERS`.
        control: see `policy_file.read_policy`.

    Raises:
        InputError: it is no policy, or what is written would not fly the frame of its drone.
    """
    file = read_policy(path, control)
    if file.rotors is not None:
        drone = replace(crazyflie(), **file.rotors)
        check_frame(to, file.interface, check(drone, str(path)))
    return file


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
