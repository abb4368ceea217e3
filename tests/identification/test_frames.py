"""Drones of other frames than an X come back from flights of their own position PID."""

import jax
import numpy as np
import pytest

from maidenflight.flying.recording import record
from maidenflight.identification.identify import identify
from maidenflight.identification.methods import Likelihood
from maidenflight.parameters import component, crazyflie, noiseless, plus_frame, replace
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.realities.virtual_drone import VirtualDrone

FRAMES = {
    "+": plus_frame(0.05),
    "unequal": {
        "rotor_x": (0.045, -0.03, -0.03, 0.045),
        "rotor_y": (-0.05, -0.03, 0.03, 0.05),
        "rotor_direction": (1.0, -1.0, 1.0, -1.0),
    },
}
PLANTED = {
    "thrust_to_weight": 1.9,
    "motor_time_constant": 0.06,
    "inertia_x": 1.6e-5,
    "inertia_y": 1.8e-5,
    "torque_to_thrust": 7e-3,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FRAMES)
def test_what_was_planted_in_a_frame_comes_back(name: str) -> None:
    start = replace(noiseless(crazyflie()), **FRAMES[name], latency=0.006, time_step=0.002)
    truth = replace(start, **PLANTED)
    drone = VirtualDrone(name, truth, dynamics.midpoint, thrust_law=None)
    flights = record(drone, jax.random.key(1), 2, 8.0, excitation=0.08, rate=500)
    for flight in flights:
        assert np.abs(flight.position - flight.setpoint).max() < 0.3, "the PID flies it"
    found = identify(flights, Likelihood(trials=1), start=start, over=[*PLANTED])
    for one, value in PLANTED.items():
        error = abs(float(component(found.parameters, one)) / value - 1)
        assert error < 1e-3, (one, error)
