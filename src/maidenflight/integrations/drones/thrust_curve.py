"""What an autopilot must know of a drone's thrust: over its output to an ESC, and at hover.

A command u is the square of an ESC's input x, as rotor speed follows that input. Then thrust is the
share c_0 + c_1 x + c_2 x^2 of full thrust.

Source: `dynamics.rotor_forces`; docs/flight-log.md, how commands of each autopilot are read.
"""

import numpy as np
from jaxtyping import Float

from maidenflight.parameters import QUANTITIES, Parameters, replace

INPUTS = np.linspace(0.05, 1.0, 96)
"""Of the ESC, over which curves are fitted, chosen: rotors of an armed drone turn."""


def share(drone: Parameters, inputs: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
    """Returns shares of full thrust of inputs to an ESC."""
    offset, linear = float(drone.thrust_offset), float(drone.thrust_linear)
    return offset + linear * inputs + (1.0 - offset - linear) * inputs**2


def factor(drone: Parameters) -> float:
    """Returns the factor f, in [0, 1], of the curve (1 - f) x + f x^2 nearest to the drone's.

    By least squares; PX4's THR_MDL_FAC and ArduPilot's MOT_THST_EXPO are this f.
    """
    bend, excess = INPUTS**2 - INPUTS, share(drone, INPUTS) - INPUTS
    return float(np.clip(bend @ excess / (bend @ bend), 0.0, 1.0))


def only(drone: Parameters, *names: str) -> Parameters:
    """Returns a drone of which an autopilot holds some quantities; the others are NaN.

    Thrust at hover is held always, and the curve as far as `factor` has it.
    """
    known = {*names, "thrust_to_weight", "gravity"}
    bend = np.float32(factor(drone))
    lost = {
        name: np.full(np.shape(getattr(drone, name)), np.nan, np.float32)
        for name in QUANTITIES
        if name not in known
    }
    curve = {"thrust_offset": np.float32(0.0), "thrust_linear": np.float32(1.0) - bend}
    return replace(drone, **{**lost, **curve})
