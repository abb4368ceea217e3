"""Motor commands of a PX4 drone from the torque and thrust that its rate controller asks for.

PX4's default logging profile holds motors at 10 Hz, but torque and thrust set-points at 50 Hz. The
control allocation between them is known: the pseudo-inverse of the rotors' effectiveness, its
columns scaled, and where a motor saturates thrust, roll and pitch, and yaw give way in an order
that MC_AIRMODE states.

Source: PX4 v1.14, src/lib/control_allocation: ActuatorEffectivenessRotors.cpp
(computeEffectivenessMatrix), ControlAllocationPseudoInverse.cpp
(updateControlAllocationMatrixScale, normalizeControlAllocationMatrix),
ControlAllocationSequentialDesaturation.cpp.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

ROLL_PITCH_AIRMODE, YAW_AIRMODE = 1, 2
"""Values of MC_AIRMODE with which thrust may rise for roll and pitch, and for yaw as well."""
_WEAK = 0.2
"""Effect on an axis below which a motor's saturation does not count: see the source above."""
_SMALL = 1e-3
"""Entry of the mix that counts as zero."""
_YAW_MARGIN = 0.15
"""Share of the range above full throttle that yaw may ask for before thrust gives way (source:
ControlAllocationSequentialDesaturation.hpp)."""


class Rotor(NamedTuple):
    """A rotor that pushes upwards, as PX4's parameters CA_ROTORn_PX, PY, CT, KM describe it."""

    forward: float
    """[m]."""
    right: float
    """[m]."""
    thrust: float = 6.5
    """Thrust at full command; only its proportion to the other rotors' matters."""
    moment: float = 0.05
    """Torque about the vertical by thrust [m], positive of a rotor counter-clockwise from above."""


def effectiveness(rotors: tuple[Rotor, ...]) -> Float[np.ndarray, "4 M"]:
    """Returns torque and force along z of each rotor's full command, forward, right, down.

    Force a CT with a = (0, 0, -1); torque CT (r x a) - CT KM a.
    """
    return np.array(
        [
            [-rotor.thrust * rotor.right for rotor in rotors],
            [rotor.thrust * rotor.forward for rotor in rotors],
            [rotor.thrust * rotor.moment for rotor in rotors],
            [-rotor.thrust for rotor in rotors],
        ]
    )


def mix(rotors: tuple[Rotor, ...]) -> Float[np.ndarray, "M 4"]:
    """Returns each rotor's share of full thrust by normalised torque and thrust along z.

    The pseudo-inverse of `effectiveness`, roll and pitch scaled by the larger root mean square of
    their columns over half the rotors that turn them, yaw by its greatest entry, thrust by its
    mean.
    """
    inverse = np.linalg.pinv(effectiveness(rotors))
    turning = [np.count_nonzero(np.abs(column) > _SMALL) or np.inf for column in inverse.T[:2]]
    tilt = max(
        np.sqrt(np.sum(column**2) / (count / 2)) if np.isfinite(count) else 1.0
        for column, count in zip(inverse.T[:2], turning, strict=True)
    )
    scale = np.array([tilt, tilt, inverse[:, 2].max(), np.abs(inverse[:, 3]).mean()])
    scaled = inverse / np.where(scale > np.finfo(np.float32).eps, scale, 1.0)
    return np.where(np.abs(scaled) < _SMALL, 0.0, scaled)


def motors(
    setpoints: Float[np.ndarray, "N 4"], rotors: tuple[Rotor, ...], airmode: int = 0
) -> Float[np.ndarray, "N M"]:
    """Returns the motor commands in [0, 1], as `actuator_motors` holds them.

    Args:
        setpoints: normalised torque about x, y, z and thrust along z (negative is upwards),
            forward, right, down.
        rotors: in PX4's order.
        airmode: MC_AIRMODE.
    """
    by_axis = mix(rotors)
    roll, pitch, yaw, thrust = by_axis.T
    if airmode == YAW_AIRMODE:
        outputs = _yield(setpoints @ by_axis.T, thrust)
        return np.clip(_yield(outputs, yaw), 0.0, 1.0)
    outputs = setpoints[:, [0, 1, 3]] @ by_axis[:, [0, 1, 3]].T
    if airmode == ROLL_PITCH_AIRMODE:
        outputs = _yield(outputs, thrust)
    else:
        outputs = _yield(_yield(_yield(outputs, thrust, less=True), roll), pitch)
    outputs = _yield(outputs + setpoints[:, 2:3] * yaw, yaw, most=1.0 + _YAW_MARGIN)
    return np.clip(_yield(outputs, thrust, less=True), 0.0, 1.0)


def _yield(
    outputs: Float[np.ndarray, "N M"],
    along: Float[np.ndarray, "M"],
    most: float = 1.0,
    less: bool = False,
) -> Float[np.ndarray, "N M"]:
    """Commands moved along an axis of the mix, by what lessens their saturation.

    Args:
        outputs: commands, which may lie outside [0, `most`].
        along: the axis' column of the mix.
        most: the greatest command.
        less: whether to leave alone what would have to rise along thrust.
    """
    gain = _gain(outputs, along, most)
    again = np.ones(len(outputs), bool) if not less else gain >= 0.0
    outputs = outputs + np.where(again, gain, 0.0)[:, None] * along
    return outputs + np.where(again, 0.5 * _gain(outputs, along, most), 0.0)[:, None] * along


def _gain(
    outputs: Float[np.ndarray, "N M"], along: Float[np.ndarray, "M"], most: float
) -> np.ndarray:
    """By how much of an axis the worst saturations on both sides lessen."""
    strong = np.abs(along) >= _WEAK
    if not strong.any():
        return np.zeros(len(outputs))
    beyond = (np.clip(outputs, 0.0, most) - outputs)[:, strong] / along[strong]
    return np.minimum(beyond.min(axis=1), 0.0) + np.maximum(beyond.max(axis=1), 0.0)
