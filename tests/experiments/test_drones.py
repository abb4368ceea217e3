"""Drones by the words of a command."""

from pathlib import Path

import numpy as np
import pytest

from made_flights import calm
from maidenflight.errors import InputError
from maidenflight.experiments.drones import distribution_of, possible_drones
from maidenflight.flights import flight_csv
from maidenflight.identification.drone_file import DroneFile, Estimate
from maidenflight.names import ANY, ANY_DAY, POSTERIOR, TRIMS
from maidenflight.parameters import crazyflie
from maidenflight.simulator.any_drone import DayToDay, GenericQuadrotor
from maidenflight.simulator.controllers import control


def test_drones_of_any_make_are_about_the_named_drone() -> None:
    drones = distribution_of("crazyflie", ANY, control.pwm())
    assert isinstance(drones, GenericQuadrotor)
    assert float(drones.centre.mass) == pytest.approx(float(crazyflie().mass))
    assert isinstance(distribution_of("crazyflie", ANY_DAY, control.pwm()), DayToDay)


def test_a_log_of_the_day_tells_the_trims_and_nothing_else(tmp_path: Path) -> None:
    file = DroneFile(
        crazyflie(), {"torque_bias_z": Estimate(0.0, (-1e-4, 1e-4), (0.0,), 4e-5)}, name="mine"
    )
    noise = 0.01 * np.random.default_rng(0).standard_normal((300, 4))
    flight = calm(300, command=np.float32(noise + np.array([0.5, 0.54, 0.5, 0.54])))
    today = flight_csv.write(tmp_path / "today.csv", flight)
    drones = possible_drones(file, TRIMS, 0, today)
    assert np.mean(drones.torque_bias[:, 2]) < -1e-5
    assert np.ptp(drones.latency) == 0.0
    point = possible_drones(file, 0.0, 0, today)
    assert float(point.torque_bias[2]) == pytest.approx(np.mean(drones.torque_bias[:, 2]), rel=0.02)
    with pytest.raises(InputError, match="posterior"):
        possible_drones(file, POSTERIOR, 0, today)
