"""`Parameters`, the physical constants of a quadrotor, and what is known of each.

`Parameters` is flat, frozen and a JAX pytree, and all of it but the platform is traced: one
compilation serves every drone of a platform. A *point* is one drone; a batch of points (leaves with
a leading axis) is domain randomization, an ensemble or a lattice. The fields that the paper's model
lacks, such as drag and unequal motor lag, are neutral at zero or one, which each says; but the
ground effect, which acts in tasks that have a floor.
"""

import dataclasses
import math
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import jax
import numpy as np

from maidenflight.parameters.platforms import CRAZYFLIE
from maidenflight.parameters.quantity import Quantity, quantity

_PAPER = "Gronauer et al. 2022"
_THRUST_CURVE = "affine-quadratic curves fitted to load cells by others, such as crazyflow's"
_AUTHORS = "the authors' code (phoenix-drone-simulation c5d6907)"
_ARM = 0.0396 / math.sqrt(2.0)
_motors, _body, _air = (partial(quantity, table) for table in ("motors", "body", "air"))
_sensors, _battery, _disturbance = (
    partial(quantity, table) for table in ("sensors", "battery", "disturbance")
)
_SLOW = "measured from flights, by validate --disturbances"


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Parameters:
    """The constants of one quadrotor, in SI units.

    Leaves are floats, or arrays with any leading batch axes; vectors have a last axis of 3, and
    those of rotors (`rotor_thrust`, `rotor_x`, `rotor_y`, `rotor_direction`) of 4. `QUANTITIES`
    gives each field's unit, symbol, bounds, meaning and source.
    """

    thrust_to_weight: Any = _motors(
        "k_F [-]",
        1.725,
        (1.0, 20.0),
        "thrust of all motors at full speed over weight",
        f"{_PAPER}, eq:motor-force",
    )
    thrust_offset: Any = _motors(
        "c_0 [-]",
        0.0,
        (-0.5, 0.5),
        "share of full thrust that does not depend on rotor speed; 0 in the paper's model",
        _THRUST_CURVE,
    )
    thrust_linear: Any = _motors(
        "c_1 [-]",
        0.0,
        (-1.0, 2.0),
        "share of full thrust that grows with rotor speed itself; 0 in the paper's model",
        _THRUST_CURVE,
    )
    motor_time_constant: Any = _motors(
        "T_m [s]", 0.088, (0.001, 1.0), "lag of the rotor speeds", f"{_PAPER}, eq:motor-dynamics"
    )
    spin_down_ratio: Any = _motors(
        "T_down/T_up [-]",
        1.0,
        (0.1, 10.0),
        "lag while slowing down over lag while speeding up; 1 in the paper's model",
        "measured on load cells and from flights by others, 0.8 to 4.5",
    )
    motor_coasting: Any = _motors(
        "T_c [s]",
        0.0,
        (0.0, 1.0),
        "lag of a rotor that only the air slows down, at full speed; 0 in the paper's model",
        "identified from the authors' flights of a Crazyflie: 0.12 s",
    )
    latency: Any = _motors(
        "Delta [s]",
        0.018,
        (0.0, 0.05),
        "delay from command to motor",
        f"{_PAPER}, sec. Motor Model; bounds of its search",
    )
    rotor_thrust: Any = _motors(
        "s [-]",
        (1.0, 1.0, 1.0, 1.0),
        (0.0, 1.5),
        "thrust of each rotor as a share of a sound one's; all 1 in the paper's model",
        "a damaged propeller; rotors in the order of the motors",
    )
    torque_to_thrust: Any = _motors(
        "k_M1 [m]",
        5.96e-3,
        (0.0, 0.3),
        "reaction torque of a rotor per thrust",
        f"{_PAPER}, eq:motor-torque",
    )
    torque_offset: Any = _motors(
        "k_M2 [N m]",
        1.56e-5,
        (0.0, 1e-3),
        "constant part of that torque; cancels over four rotors",
        f"{_PAPER}, eq:motor-torque",
    )
    rotor_momentum: Any = _motors(
        "J_r Omega [N m s]",
        0.0,
        (0.0, 1.0),
        "angular momentum of a rotor at full speed, whose change turns the body; 0 in the paper's "
        "model",
        "Bouabdallah 2007, sec. 2.4",
    )
    actuator_noise: Any = _motors(
        "sigma_u [-]",
        0.019,
        (0.0, 0.5),
        "standard deviation of the Ornstein-Uhlenbeck noise added to the thrust commands",
        f"{_AUTHORS}: 0.01/sqrt(1 - 0.85^2)",
    )
    actuator_noise_rate: Any = _motors(
        "theta_u [1/s]",
        32.5,
        (0.0, 1e4),
        "how fast that noise forgets",
        f"{_AUTHORS}: -ln(0.85)/5 ms",
    )
    mass: Any = _body(
        "m [kg]", 0.028, (0.005, 5.0), "mass, battery included", f"{_PAPER}, table:drone-parameters"
    )
    inertia: Any = _body(
        "I [kg m2]",
        (1.33e-5, 1.33e-5, 2.64e-5),
        (1e-7, 1.0),
        "diagonal of the inertia matrix: x, y, z",
        f"{_PAPER}, table:drone-parameters",
    )
    rotor_x: Any = _body(
        "x_i [m]",
        (_ARM, -_ARM, -_ARM, _ARM),
        (-1.0, 1.0),
        "place of each rotor forward of the centre of mass, in the order of the motors",
        f"{_PAPER}, table:drone-parameters: 39.6 mm from the centre, in an X",
    )
    rotor_y: Any = _body(
        "y_i [m]",
        (-_ARM, -_ARM, _ARM, _ARM),
        (-1.0, 1.0),
        "place of each rotor left of the centre of mass",
        f"{_PAPER}, table:drone-parameters: 39.6 mm from the centre, in an X",
    )
    rotor_direction: Any = _body(
        "d_i [-]",
        (-1.0, 1.0, -1.0, 1.0),
        (-1.0, 1.0),
        "sign of each rotor's reaction torque: 1 turns the body left, the rotor clockwise from "
        "above; -1 the other way",
        f"{_PAPER}, eq:torque",
    )
    drag: Any = _body(
        "d [1/s]",
        (0.0, 0.0, 0.0),
        (0.0, 10.0),
        "rotor drag per mass along body x, y, z; 0 in the paper's model",
        "Faessler, Franchi and Scaramuzza 2018, eq. 1",
    )
    flapping_moment: Any = _body(
        "c_f [N s]",
        (0.0, 0.0),
        (-1.0, 1.0),
        "moment about body x and y against a velocity along the other; 0 in the paper's model",
        "Hoffmann et al. 2007, eq. 7-10",
    )
    rotational_damping: Any = _body(
        "c_w [N m s]",
        0.0,
        (0.0, 1.0),
        "torque against roll and pitch rate per rate; 0 in the paper's model",
        "not identified from flights",
    )
    torque_bias: Any = _body(
        "b [N m]",
        (0.0, 0.0, 0.0),
        (-1.0, 1.0),
        "torque at hover, as of an off-centre battery or unequal motors; grows with the thrust; "
        "0 in the paper's model",
        "measured from flights",
    )
    gravity: Any = _body(
        "g [m/s2]",
        9.81,
        (0.1, 30.0),
        "gravitational acceleration",
        f"{_PAPER}, table:drone-parameters",
    )
    ground_effect: Any = _body(
        "c_g [m2]",
        3.8e-4,
        (0.0, 0.1),
        "gain of thrust near the ground times height squared; acts in tasks that have a floor",
        "gym-pybullet-drones: 11.37 (r/4)^2 with a propeller of r = 23.1 mm",
    )
    wind: Any = _air(
        "w [m/s]",
        (0.0, 0.0, 0.0),
        (-30.0, 30.0),
        "velocity of the air, world; 0 in the paper's model",
        "rotor drag and flapping follow the velocity through the air",
    )
    position_noise: Any = _sensors(
        "sigma_r [m]", 0.002, (0.0, 1.0), "Gaussian noise of the position", _AUTHORS
    )
    position_noise_uniform: Any = _sensors(
        "b_r [m]", 0.001, (0.0, 1.0), "half width of its uniform noise", _AUTHORS
    )
    velocity_noise: Any = _sensors(
        "sigma_v [m/s]", 0.01, (0.0, 1.0), "Gaussian noise of the velocity", _AUTHORS
    )
    position_walk: Any = _sensors(
        "w_r [m/sqrt(s)]",
        0.0,
        (0.0, 1.0),
        "random walk of the estimated horizontal position, as of optical flow; 0 in the paper's "
        "model",
        "measured from flights: 0.075 for a Crazyflie's flow deck",
    )
    height_walk: Any = _sensors(
        "w_z [m/sqrt(s)]",
        0.0,
        (0.0, 1.0),
        "random walk of the estimated height, as of a ranger; 0 in the paper's model",
        "measured from flights: 0.011 for a Crazyflie's flow deck",
    )
    velocity_walk: Any = _sensors(
        "w_v [m/s/sqrt(s)]",
        0.0,
        (0.0, 5.0),
        "random walk of the estimated velocity, forgotten within a second; 0 in the paper's model",
        "measured from flights: 0.083 for a Crazyflie's flow deck",
    )
    turn_drift: Any = _sensors(
        "w_t [m/rad]",
        0.0,
        (-2.0, 2.0),
        "way of the estimated horizontal position as the drone tilts by a radian, as of a flow "
        "deck that takes too much of a turn off; 0 in the paper's model",
        "measured from flights: 0.2 for a Crazyflie's flow deck",
    )
    attitude_noise: Any = _sensors(
        "sigma_phi [rad]",
        math.radians(0.1),
        (0.0, 1.0),
        "Gaussian noise of roll, pitch, yaw",
        f"{_AUTHORS}: 0.1 deg",
    )
    attitude_noise_uniform: Any = _sensors(
        "b_phi [rad]",
        math.radians(0.05),
        (0.0, 1.0),
        "half width of its uniform noise",
        f"{_AUTHORS}: 0.05 deg",
    )
    gyro_noise: Any = _sensors(
        "sigma_omega [rad/s]",
        0.051,
        (0.0, 5.0),
        "noise of a reading of the body rates",
        f"{_AUTHORS}: 0.088 rad/s before, 0.051 after its low-pass filter",
    )
    gyro_cutoff: Any = _sensors(
        "f_g [Hz]",
        80.0,
        (0.0, 1000.0),
        "cut-off of the gyro's low-pass filter, through which that noise has gone; 0: white noise",
        "Crazyflie firmware, sensors_bmi088_bmp3xx.c: 80 Hz, Butterworth of second order",
    )
    gyro_time_constant: Any = _sensors(
        "tau_g [s]",
        0.0,
        (0.0, 0.05),
        "lag of the gyro's low-pass filter; 0 in the paper's model",
        "Crazyflie firmware: 80 Hz Butterworth, 2.8 ms",
    )
    gyro_turn_on_bias: Any = _sensors(
        "b_0 [rad/s]",
        math.radians(0.5),
        (0.0, 1.0),
        "standard deviation of the bias at power-on",
        "Furrer et al. 2016 (RotorS), gyroscope_turn_on_bias_sigma: 0.5 deg/s",
    )
    gyro_bias_walk: Any = _sensors(
        "sigma_b [rad/s2/sqrt(Hz)]",
        1.75e-4,
        (0.0, 1.0),
        "random walk of the bias",
        "Furrer et al. 2016 (RotorS); value from the authors' code",
    )
    gyro_bias_time: Any = _sensors(
        "tau_b [s]",
        1000.0,
        (0.1, 1e5),
        "correlation time of the bias",
        "Furrer et al. 2016 (RotorS): 1000 s",
    )
    estimator_delay: Any = _sensors(
        "Delta_e [s]",
        0.0,
        (0.0, 0.05),
        "age of the estimated position, velocity and attitude; 0 in the paper's model",
        "a Kalman filter's lag; 5.6 to 9.4 ms in the authors' flights",
    )
    battery_voltage: Any = _battery(
        "V_0 [V]",
        4.2,
        (2.0, 60.0),
        "open-circuit voltage when the flight starts",
        "LiPo cell, full",
    )
    battery_resistance: Any = _battery(
        "R_V [V]", 0.0, (0.0, 10.0), "sag with all motors at full ratio; 0: no sag", "not measured"
    )
    battery_discharge: Any = _battery(
        "dV/dt [V/s]",
        0.0,
        (0.0, 1.0),
        "fall of the open-circuit voltage with all motors at full ratio; 0: none",
        "not measured",
    )
    time_step: Any = quantity(
        "simulation",
        "dt [s]",
        0.005,
        (1e-5, 0.02),
        "mean physics step",
        f"{_PAPER}, sec. Simulation Environment: 200 Hz",
    )
    disturbance_torque: Any = _disturbance(
        "sigma_tau [N m]",
        (0.0, 0.0, 0.0),
        (0.0, 1.0),
        "standard deviation of torques on the body about x, y, z that change slowly; 0 in the "
        "paper's model",
        _SLOW,
    )
    disturbance_torque_time: Any = _disturbance(
        "tau_tau [s]", 0.6, (1e-3, 1e3), "correlation time of those torques", _SLOW
    )
    disturbance_force: Any = _disturbance(
        "sigma_F [N]",
        (0.0, 0.0, 0.0),
        (0.0, 50.0),
        "the same of forces along body x, y, z; 0 in the paper's model",
        _SLOW,
    )
    disturbance_force_time: Any = _disturbance(
        "tau_F [s]", 0.35, (1e-3, 1e3), "correlation time of those forces", _SLOW
    )
    platform: str = field(default=CRAZYFLIE, metadata={"static": True})
    """Whose gains the firmware's inner loops have, a name of `platforms.PLATFORMS`."""

    def __post_init__(self) -> None:
        # Numbers of people become float32 once, here, so that every compiled function sees
        # one dtype.
        for name in QUANTITIES:
            value = getattr(self, name)
            if isinstance(value, float | int | tuple | list):
                object.__setattr__(self, name, np.asarray(value, dtype=np.float32))

    def __repr__(self) -> str:
        """Returns the paper's three and the mass: all of them would fill a screen."""
        names = ("mass", "thrust_to_weight", "motor_time_constant", "latency")
        if shape := np.shape(self.mass):
            return f"<Parameters of {' x '.join(map(str, shape))} drones>"
        return f"Parameters({', '.join(f'{name}={getattr(self, name)!s}' for name in names)}, ...)"


QUANTITIES: dict[str, Quantity] = {
    entry.name: entry.metadata["quantity"]
    for entry in dataclasses.fields(Parameters)
    if "quantity" in entry.metadata
}
"""Unit, symbol, bounds, meaning and source of every number of `Parameters`, in order."""
