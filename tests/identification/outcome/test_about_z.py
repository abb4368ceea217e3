"""Torques about z and the inertia that they are shares of belong together."""

import numpy as np
import pytest

from maidenflight.identification.outcome.about_z import ABOUT_Z, RATIO_SD, with_inertia_z
from maidenflight.identification.uncertainty import RESAMPLES
from maidenflight.parameters import crazyflie, replace

START = crazyflie()


def samples(value: float) -> np.ndarray:
    return np.full(RESAMPLES, value)


def test_shares_of_the_inertia_stay_and_a_heavy_start_does_not_matter() -> None:
    """Found with 1.7 times the inertia about z, torques are 1.7 times as large."""
    drone = replace(START, torque_to_thrust=0.006)
    inertia = {"inertia_x": samples(1.33e-5), "inertia_y": samples(1.33e-5)}
    found = []
    for heavy in (1.0, 1.7):
        start = replace(START, inertia=heavy * np.asarray(START.inertia))
        here = replace(
            drone,
            torque_to_thrust=heavy * 0.006,
            inertia=np.array([1.33e-5, 1.33e-5, heavy * 2.64e-5], np.float32),
        )
        draws = inertia | {"torque_to_thrust": samples(heavy * 0.006)}
        about = with_inertia_z(start, here, draws, {}, (), np.random.default_rng(0))
        share = about.draws["torque_to_thrust"] / about.draws["inertia_z"]
        np.testing.assert_allclose(share, 0.006 / 2.64e-5, rtol=1e-5)
        assert len(about.notes) == 1
        found.append((float(about.drone.torque_to_thrust), float(about.drone.inertia[2])))
    np.testing.assert_allclose(*found, rtol=1e-5)
    np.testing.assert_allclose(found[0], (0.006, 2.64e-5), rtol=1e-5)


def test_the_ratios_doubt_is_that_of_published_drones() -> None:
    """A robust standard deviation of six drones from 27 g to 2 kg."""
    draws = {name: samples(1e-5) for name in (*ABOUT_Z, "inertia_x", "inertia_y")}
    about = with_inertia_z(START, START, draws, {}, (), np.random.default_rng(0))
    assert np.std(np.log(about.draws["inertia_z"])) == pytest.approx(RATIO_SD, rel=0.1)
    assert 0.1 < RATIO_SD < 0.2


def test_without_inertia_about_x_or_y_the_starts_is_kept() -> None:
    draws = {name: samples(1e-5) for name in ("torque_bias_z", "inertia_x")}
    about = with_inertia_z(START, START, draws, {}, ("inertia_x",), np.random.default_rng(0))
    assert about.drone is START
    assert about.draws == draws
    assert len(about.notes) == 1


def test_an_inertia_that_coupling_seemed_to_show_gives_way_to_the_ratio() -> None:
    """Flights tell shares: those of half the inertia are those of the whole."""
    rng = np.random.default_rng(1)
    wrong = 1.32e-5 * np.exp(0.05 * rng.standard_normal(RESAMPLES))
    here = replace(START, inertia_z=1.32e-5, torque_to_thrust=0.006, rotor_momentum=2e-5)
    level = {"inertia_x": samples(1.33e-5), "inertia_y": samples(1.33e-5)}
    draws = level | {"inertia_z": wrong, "rotor_momentum": wrong * 2e-5 / 1.32e-5}
    about = with_inertia_z(START, here, draws, {}, (), np.random.default_rng(0))
    assert float(about.drone.inertia[2]) == pytest.approx(2.64e-5, rel=1e-5)
    assert float(about.drone.rotor_momentum) == pytest.approx(4e-5, rel=1e-5)
    # A torque that yaw was not asked for is told as a share, too.
    assert float(about.drone.torque_to_thrust) == pytest.approx(0.012, rel=1e-5)
    ratio = about.draws["torque_to_thrust"] / about.draws["inertia_z"]
    np.testing.assert_allclose(ratio, 0.006 / wrong, rtol=1e-5)
    low, high = np.quantile(about.draws["inertia_z"], [0.025, 0.975])
    assert low < 2.64e-5 < high
    assert np.std(np.log(about.draws["inertia_z"])) == pytest.approx(RATIO_SD, rel=0.1)
    np.testing.assert_allclose(
        about.draws["rotor_momentum"] / about.draws["inertia_z"], 2e-5 / 1.32e-5, rtol=1e-5
    )
    assert len(about.notes) == 1


def test_without_inertia_about_x_or_y_a_fitted_one_gives_way_to_the_starts() -> None:
    here = replace(START, inertia_z=1.32e-5)
    about = with_inertia_z(
        START, here, {"inertia_z": samples(1.32e-5)}, {}, (), np.random.default_rng(0)
    )
    assert float(about.drone.inertia[2]) == pytest.approx(float(START.inertia[2]))
    assert np.std(np.log(about.draws["inertia_z"])) == pytest.approx(RATIO_SD, rel=0.1)


def test_nothing_changes_where_yaw_shows_nothing_or_the_inertia_is_plausible_alone() -> None:
    for draws, untold in (
        ({"latency": samples(0.005)}, ()),
        ({name: samples(1.0) for name in (*ABOUT_Z, "inertia_z")}, ("inertia_z",)),
    ):
        about = with_inertia_z(START, START, draws, {}, untold, np.random.default_rng(0))
        assert about.drone is START
        assert about.draws == draws
        assert about.notes == ()
