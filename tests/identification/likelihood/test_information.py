"""What flights can tell is known before they are fitted, and what they cannot is not claimed."""

import dataclasses
from typing import Any

import hypothesis.strategies as st
import jax
import numpy as np
import pytest
from hypothesis import given

import maidenflight as mf
import planted
from maidenflight.errors import InputError
from maidenflight.identification import drone_file
from maidenflight.identification.likelihood import information
from maidenflight.identification.methods import Likelihood
from maidenflight.identification.outcome.plausible import (
    HOVERING,
    OTHER_DAY,
    ExpectedInterval,
    is_identifiable,
    prior_ranges,
)
from maidenflight.identification.unknowns import physical_bounds
from maidenflight.parameters import component, crazyflie, replace, x_frame

pytestmark = pytest.mark.slow

ONCE = Likelihood(trials=1)
DRONE = replace(planted.drone(1.85, 0.06, 0.009), actuator_noise=0.005)
UNTOLD = "motor_time_constant"
SOME = ("thrust_to_weight", "drag_x", "motor_time_constant")


def flown(strength: float) -> list[mf.Flight]:
    logs = planted.logs(DRONE, 8, strength=strength)
    return planted.with_noise(logs, seed=2)


@pytest.fixture(scope="module")
def excited():
    return flown(1.0)


@pytest.fixture(scope="module")
def calm():
    return flown(0.0)


@pytest.fixture(scope="module")
def found(calm):
    return mf.identify(calm, ONCE, over=SOME, key=jax.random.key(3))


def curvature(seed: int, size: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(size, size + 2))
    return root @ root.T


APART = ((), (HOVERING,), ("latency",), (HOVERING, "latency"))


@given(st.integers(0, 1000), st.sampled_from(APART))
def test_of_what_the_likelihood_does_not_find_only_the_other_signals_variance_counts(seed, apart):
    names = (HOVERING, "motor_time_constant", "latency", "drag_x")
    climbs = np.random.default_rng(seed + 1).uniform(0.5, 2.0, 4)
    shown = {name: (np.eye(4)[names.index(name)], 0.1 + 0.2 * len(name)) for name in apart}
    if HOVERING in apart:
        shown[HOVERING] = climbs / climbs[0], 0.5
    matrix = information.information(curvature(seed, 4), names, shown)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-8 * np.abs(matrix).max())
    spread = np.linalg.inv(matrix)
    for row, variance in shown.values():
        assert row @ spread @ row == pytest.approx(variance, rel=1e-4)
    if not apart:
        np.testing.assert_allclose(matrix, curvature(seed, 4), rtol=1e-6, atol=1e-8)


@given(st.integers(0, 1000), st.floats(1e-6, 1e6))
def test_flights_never_widen_what_is_plausible_and_more_of_them_say_more(seed, much):
    widths = np.array([1.0, 1e-3, 2e-5])
    matrix = curvature(seed, 3) / np.outer(widths, widths)
    some, more = (
        np.diag(information.covariance(factor * matrix, widths)) for factor in (much, 2 * much)
    )
    assert (some <= widths**2 / 12 * (1 + 1e-9)).all()
    assert (more <= some * (1 + 1e-9)).all()


def test_plausible_ranges_hold_the_start_and_lie_within_the_bounds():
    heavy = replace(crazyflie(), mass=0.9, **x_frame(0.2), latency=0.04, inertia=(5e-3,) * 3)
    for start in (crazyflie(), heavy):
        bounds = physical_bounds(start)
        priors = prior_ranges(start, bounds)
        assert list(priors) == list(bounds)
        for name, (low, high) in priors.items():
            assert bounds[name][0] <= low < high <= bounds[name][1]
            assert low <= float(component(start, name)) <= high
    narrow = prior_ranges(crazyflie(), {"latency": (0.01, 0.02)})
    assert narrow == {"latency": (0.01, 0.02)}


def test_a_parameter_is_told_below_half_the_variance_that_its_range_has():
    deviation = float(np.std(np.random.default_rng(0).uniform(1.0, 3.0, 100_000)))
    assert is_identifiable(0.7 * deviation, (1.0, 3.0))
    assert not is_identifiable(0.72 * deviation, (1.0, 3.0))


def test_excited_flights_tell_what_calm_ones_do_not(excited, calm):
    tells = mf.expected_intervals(excited, ONCE, start=DRONE, over="motor_time_constant")
    hides = mf.expected_intervals(calm, ONCE, start=DRONE, over="motor_time_constant")

    def width(found: dict[str, ExpectedInterval]) -> float:
        return float(np.ptp(found["motor_time_constant"].interval))

    assert width(tells) < width(hides) / 3
    assert tells["motor_time_constant"].identifiable


def test_expected_intervals_are_about_as_wide_as_those_that_are_found(excited):
    over = ("thrust_to_weight", "motor_time_constant", "latency")
    foreseen = mf.expected_intervals(excited, ONCE, start=DRONE, over=over)
    found = mf.identify(excited, ONCE, over=over, key=jax.random.key(3))
    for name, estimate in found.estimates.items():
        ratio = np.ptp(estimate.interval) / np.ptp(foreseen[name].interval)
        assert 0.67 < ratio < 1.5, name


def test_what_calm_flights_do_not_tell_keeps_its_start_and_a_plausible_range(found, calm):
    told: list[Any] = []
    again = mf.identify(calm, ONCE, over=SOME, key=jax.random.key(3), on_progress=told.append)
    said = [now.expected for now in told if now.expected is not None]
    assert said == [again.expected] == [found.expected]
    assert list(found.estimates) == ["thrust_to_weight", "drag_x"]
    assert found.unidentified == {UNTOLD: found.expected[UNTOLD].prior}
    assert found.parameters.motor_time_constant == crazyflie().motor_time_constant
    low, high = found.unidentified[UNTOLD]
    draws = found.posterior[UNTOLD]
    assert low <= draws.min() < draws.max() <= high
    assert np.ptp(draws) > 0.9 * (high - low)
    assert UNTOLD in str(found)


def test_what_is_printed_as_found_the_flights_have_narrowed(found):
    """No posterior is its prior: the variance is below half of what was plausible."""
    assert found.estimates
    for name in found.estimates:
        assert is_identifiable(float(np.std(found.posterior[name])), found.expected[name].prior), (
            name
        )
    for name, (low, high) in found.unidentified.items():
        assert np.ptp(found.posterior[name]) > 0.8 * (high - low), name


def test_thrust_allows_for_the_air_of_another_day(found):
    least = 1.96 * OTHER_DAY * found.estimates[HOVERING].value
    for interval in (found.estimates[HOVERING].interval, found.expected[HOVERING].interval):
        assert np.ptp(interval) / 2 > 0.8 * least
    # It is no error of these flights, so nothing else follows it.
    assert abs(np.corrcoef(found.posterior[HOVERING], found.posterior["drag_x"])[0, 1]) < 0.3


def test_training_over_the_posterior_is_over_the_plausible_range(found, tmp_path):
    file = drone_file.read(found.write(tmp_path / "mine.toml"))
    assert file.unidentified[UNTOLD] == pytest.approx(found.unidentified[UNTOLD])
    drones = file.ensemble.drones
    assert np.ptp(drones.motor_time_constant) > 0.8 * np.ptp(file.unidentified[UNTOLD])
    assert np.ptp(drones.drag[:, 0]) > 0 == np.ptp(drones.drag[:, 1])


def test_what_is_found_as_wide_as_what_is_plausible_is_not_identified_either(calm, monkeypatch):
    def hopeful(*given: Any, **named: Any) -> dict[str, ExpectedInterval]:
        return {
            name: ExpectedInterval(one.prior, one.interval, True)
            for name, one in expected(*given, **named).items()
        }

    expected = information.expected_intervals
    monkeypatch.setattr(information, "expected_intervals", hopeful)
    found = mf.identify(calm, ONCE, over=SOME, key=jax.random.key(3))
    assert UNTOLD in found.unidentified


def test_what_a_start_hides_is_asked_for_again_about_the_drone_found(excited, monkeypatch):
    asked = list[mf.Parameters]()

    def hides(model: Any, drone: mf.Parameters, *given: Any, **named: Any) -> Any:
        asked.append(drone)
        result = expected(model, drone, *given, **named)
        hidden = dataclasses.replace(result[UNTOLD], identifiable=len(asked) > 1)
        return {**result, UNTOLD: hidden}

    expected = information.expected_intervals
    monkeypatch.setattr(information, "expected_intervals", hides)
    over = ("thrust_to_weight", UNTOLD, "latency")
    found = mf.identify(excited, ONCE, over=over, key=jax.random.key(3))
    assert len(asked) == 2
    assert found.estimates[UNTOLD].value == pytest.approx(0.06, abs=0.003)


def test_flights_that_tell_nothing_that_is_asked_for_are_refused(calm):
    with pytest.raises(InputError, match=UNTOLD):
        mf.identify(calm, ONCE, over=UNTOLD)
