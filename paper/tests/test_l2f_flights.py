"""Errors of real flights, and the star that they followed."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from scripts import script

l2f_flights = script("l2f_flights")


def test_an_error_is_a_constant_and_the_rest() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 1000, endpoint=False)
    round_it = 0.03 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    error = l2f_flights.error_of(round_it + np.array([0.0, 0.0, 0.04]))
    assert error == pytest.approx((5.0, 4.0, 3.0))


def test_a_log_gives_set_points_and_the_star_goes_through_them(tmp_path: Path) -> None:
    moments = np.arange(0.0, 4.0, 0.02)
    setpoints = np.stack([0.2 * moments, np.sin(moments), 0 * moments], axis=1)
    error = np.tile([0.01, -0.02, 0.03], (len(moments), 1))
    rows = np.c_[1000.0 * (7.0 + moments), np.ones(len(moments)), setpoints - error, error]
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,s,x,y,z,a,b,c", comments="")
    log = l2f_flights.read_log(tmp_path / "log.csv")
    np.testing.assert_allclose(log.time, moments, atol=1e-9)
    np.testing.assert_allclose(log.setpoint, setpoints, atol=1e-9)
    task = l2f_flights.star(log, tmp_path)
    for row in (0, 50, 100):
        place = np.asarray(task.reference(jnp.float32(moments[row])))
        np.testing.assert_allclose(place, setpoints[row] + [0.0, 0.0, 1.0], atol=0.01)
