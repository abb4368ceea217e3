"""Drones with a name."""

import math

from maidenflight.parameters.quantities import Parameters


def crazyflie() -> Parameters:
    """The Crazyflie 2.1 as the paper models it.

    Body and torque constants are those of the paper's appendix (table:drone-parameters);
    thrust-to-weight ratio, motor time constant and latency those that its Bayesian optimisation
    found for T = 30 (table:results-sim-opt); noise is that of the authors' code.
    """
    return Parameters(
        thrust_to_weight=1.725,
        thrust_offset=0.0,
        thrust_linear=0.0,
        motor_time_constant=0.088,
        spin_down_ratio=1.0,
        motor_coasting=0.0,
        latency=0.018,
        torque_to_thrust=5.96e-3,
        torque_offset=1.56e-5,
        rotor_momentum=0.0,
        actuator_noise=0.019,
        actuator_noise_rate=32.5,
        mass=0.028,
        inertia=(1.33e-5, 1.33e-5, 2.64e-5),
        arm_length=0.0396,
        drag=(0.0, 0.0, 0.0),
        flapping_moment=0.0,
        rotational_damping=0.0,
        torque_bias=(0.0, 0.0, 0.0),
        gravity=9.81,
        ground_effect=3.8e-4,
        position_noise=0.002,
        position_noise_uniform=0.001,
        velocity_noise=0.01,
        position_walk=0.0,
        velocity_walk=0.0,
        attitude_noise=math.radians(0.1),
        attitude_noise_uniform=math.radians(0.05),
        gyro_noise=0.051,
        gyro_time_constant=0.0,
        gyro_turn_on_bias=math.radians(0.5),
        gyro_bias_walk=1.75e-4,
        gyro_bias_time=1000.0,
        estimator_delay=0.0,
        battery_voltage=4.2,
        battery_resistance=0.0,
        battery_discharge=0.0,
        time_step=0.005,
    )


DRONES = {"crazyflie": crazyflie}
"""Named drones, for the command line's `--drone NAME`."""
