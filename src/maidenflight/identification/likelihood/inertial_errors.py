"""What accelerometer and gyro measure: no state is needed.

The specific force along z is the rotors' thrust and the drag against climbing, the change of the
body rates the rotors' torque. The mean force of each segment of flight is known within `LEVEL`; the
constant torques make the mean errors of the body rates zero.

Source: Eschmann, Albani and Loianno 2024, Data-driven system identification of quadrotors subject
to motor delays (accelerometer and gyro against commands).
"""

import numpy as np
from jaxtyping import Float

from maidenflight.identification.likelihood.sensor_errors import SensorErrors
from maidenflight.identification.likelihood.sensor_signals import (
    Rotors,
    Sensor,
    angular_acceleration,
    low_pass,
    mean_force,
)
from maidenflight.parameters import Parameters, levers

LEVEL = 0.02 * 9.81
"""Standard deviation of a segment's mean specific force from the model's [m/s2]: battery, climb,
the sensor's scale."""


class AccelerometerErrors(SensorErrors):
    """The specific force along z, the source's eq:motor-force as a mean over a step."""

    sensor = Sensor(0.010, mean_force)
    levels = {0: LEVEL}

    def predicted(self, drone: Parameters, rotors: Rotors) -> Float[np.ndarray, "M S 1"]:
        """Returns thrust less drag, each over the mass.

        Source: Gronauer et al. 2022, eq:motor-force.
        """
        drag = float(drone.drag[2]) * self.signals.climb
        force = _thrust(drone, rotors).sum(axis=-1) - drag
        late = self.signals.filter_delay
        return (low_pass(force, late, self.signals.step) if late else force)[..., None]


class GyroErrors(SensorErrors):
    """The angular acceleration about each axis.

    In steps of 10 ms, within which a fast controller answers, inertia comes out up to a quarter too
    large where only its own noise moves the drone.
    """

    sensor = Sensor(0.006, angular_acceleration)

    def predicted(self, drone: Parameters, rotors: Rotors) -> Float[np.ndarray, "M S 3"]:
        """Returns the torques over the inertia, means over a step.

        Source: Gronauer et al. 2022, eq:torque, eq:motor-torque and eq:angular-acceleration.
        """
        thrust, arms, rates = _thrust(drone, rotors), levers(drone), self.signals.body_rates
        turned = arms * [1.0, 1.0, float(drone.torque_to_thrust)]
        inertia, bias = np.asarray(drone.inertia, float), np.asarray(drone.torque_bias, float)
        lift = thrust.sum(axis=-1) / float(drone.gravity)
        parts = []
        for axis, second, other in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            torque = bias[axis] * lift + float(drone.mass) * (thrust @ turned[:, axis])
            if axis == 2:
                spin_up = rotors.change @ arms[:, axis] / self.signals.step
                torque += float(drone.rotor_momentum) * spin_up
            else:
                torque -= float(drone.rotational_damping) * rates[..., axis]
            torque -= (inertia[other] - inertia[second]) * rates[..., second] * rates[..., other]
            parts.append(torque / inertia[axis])
        return np.stack(parts, axis=-1)


def _thrust(drone: Parameters, rotors: Rotors) -> Float[np.ndarray, "M S 4"]:
    """Mean thrust of each rotor over the drone's mass [m/s2]."""
    offset, linear = float(drone.thrust_offset), float(drone.thrust_linear)
    share = offset + linear * rotors.mean + (1 - offset - linear) * rotors.square
    return float(drone.gravity * drone.thrust_to_weight) / 4 * share
