"""The likelihood of one-step errors, against regressions by NumPy and differences of the value."""

from functools import partial
from typing import Any

import jax
import numpy as np
import pytest
from scipy.stats import norm

import planted
from maidenflight import compiler
from maidenflight.flights.windows import LEAD_IN, Windows, windows
from maidenflight.identification.likelihood import compiling, one_step_errors
from maidenflight.identification.likelihood.observation import BALANCED, noise_model
from maidenflight.identification.likelihood.one_step import LEAST_NOISE, LENGTH, OneStep
from maidenflight.identification.likelihood.one_step_errors import COLUMNS, ORDER, TURNING, errors
from maidenflight.parameters import component, replace

TRUTH = planted.drone(1.9, 0.06, 0.012)
NAMES = ("thrust_to_weight", "motor_time_constant", "latency", "inertia_x")
STEPS = 2
"""Physics steps a row, as many as the planted flights have."""
many_errors = jax.jit(jax.vmap(partial(errors, steps=STEPS), (0, None)))


def cut(flights):
    return windows(flights, LENGTH, every=LENGTH)


@pytest.fixture(scope="module")
def flights():
    return planted.logs(TRUTH)


@pytest.fixture(scope="module")
def exact(flights):
    return OneStep(cut(flights), 0.01, STEPS)


@pytest.fixture(scope="module")
def noisy_windows(flights):
    return cut(planted.with_noise(flights, seed=1))


@pytest.fixture(scope="module")
def noisy(noisy_windows):
    return OneStep(noisy_windows, 0.01, STEPS)


def autoregression(generator, weights, deviation, rows):
    """A column of numbers that hang on those before."""
    found = np.zeros(rows)
    fresh = deviation * generator.normal(size=rows)
    for row in range(len(weights), rows):
        found[row] = fresh[row] + sum(
            weight * found[row - lag] for lag, weight in enumerate(weights, 1)
        )
    return found


def test_an_autoregressions_weights_and_deviation_are_recovered():
    generator, rows = np.random.default_rng(0), 40_000
    planted_weights = [
        (),
        (0.8,),
        (-0.5,),
        (0.5, 0.3),
        (1.2, -0.4, 0.1),
        (0.2, 0.0, 0.0, 0.0, 0.0, 0.4),
    ]
    deviations = [0.1, 0.02, 3.0, 1e-3, 0.5, 0.2]
    columns = [
        autoregression(generator, *each, rows)
        for each in zip(planted_weights, deviations, strict=True)
    ]
    late = np.array(
        [[column[ORDER - lag : rows - lag] for lag in range(ORDER + 1)] for column in columns]
    )
    found = noise_model(np.einsum("cit,cjt->cij", late, late) / (rows - ORDER))
    for weights, row in zip(planted_weights, found.coefficients, strict=True):
        np.testing.assert_allclose(row, np.pad(weights, (0, ORDER - len(weights))), atol=0.025)
    np.testing.assert_allclose(found.deviation, deviations, rtol=0.015)


def regressions(wrong):
    """Each column's least-squares autoregression over all windows with the least noise of a sensor
    besides, and the deviation of what is new."""
    weights, deviations = [], []
    for column in COLUMNS:
        series = wrong[..., column].astype(float)
        rows = np.stack(
            [series[:, ORDER - lag : LENGTH - lag] for lag in range(ORDER + 1)], axis=-1
        )
        rows = rows.reshape(-1, ORDER + 1)
        # As many rows more, each of one past error alone, are white noise in the mean.
        noise = LEAST_NOISE * np.sqrt(len(rows)) * np.eye(ORDER + 1)
        rows = np.vstack([rows, noise])
        weights.append(np.linalg.lstsq(rows[:, 1:], rows[:, 0], rcond=None)[0])
        left = rows[:, 0] - rows[:, 1:] @ weights[-1]
        deviations.append(np.sqrt((left**2).sum() / (len(rows) - ORDER - 1)))
    return np.array(weights), np.array(deviations)


@pytest.mark.slow
def test_the_value_is_the_gaussian_log_likelihood_of_what_is_new(noisy, noisy_windows):
    wrong = np.asarray(many_errors(noisy_windows, TRUTH))
    weights, deviation = regressions(wrong)
    rows = wrong.shape[0] * (LENGTH - ORDER)
    # At its own deviation a normal density's mean logarithm needs no data.
    expected = (0.5 + 0.5 * np.log(2 * np.pi) + np.log(deviation)).sum()
    found = noisy.noise_model(TRUTH)
    np.testing.assert_allclose(found.coefficients, weights, atol=2e-3)
    np.testing.assert_allclose(found.deviation, deviation, rtol=1e-4)
    assert noisy(TRUTH) == pytest.approx(expected, abs=1e-3)
    assert noisy.rows == rows


@pytest.mark.slow
def test_noise_of_the_velocity_does_not_pass_for_drag(flights):
    """White noise returns to its mean as if by drag, by far more than a row's integration errs."""
    drag = ("drag_x", "drag_y")
    steps, shares = [], []
    for seed in range(3):
        noisy = planted.with_noise(flights, seed, velocity=0.3, rates=0.0)
        model = OneStep(cut(noisy), 0.01, STEPS)
        _, scores, curvatures = model.derivatives(TRUTH, drag)
        curvature = curvatures.sum(axis=0)
        steps.append(-np.linalg.solve(curvature, scores.sum(axis=0)))
        # What is taken from the slopes is the half of a row that is noise.
        shares.append(np.linalg.solve(curvature, np.full(2, 0.5 * 0.01)))
    corrected, bias = np.mean(steps), np.mean(shares)
    assert bias > 0.2
    assert abs(corrected) < bias / 2


def test_noise_is_what_errors_differ_by_from_the_mean_of_their_segment(noisy, noisy_windows):
    """A trim that another segment does not have moves all its errors alike, but for the thrust that
    it grows with, and is no noise."""
    drone = replace(TRUTH, torque_bias=(3e-4, 0.0, 0.0), time_step=np.float32(0.01 / STEPS))
    wrong = np.asarray(many_errors(noisy_windows, drone), np.float64)[:, ORDER:]
    segments = [wrong[noisy_windows.segment == one] for one in range(noisy.segments)]
    rows = [one.reshape(-1, 12) for one in segments]
    within = sum(((one - one.mean(axis=0)) ** 2).sum(axis=0) for one in rows) / noisy.rows
    about_means = noisy.products_about_means(drone)
    np.testing.assert_allclose(about_means[:, 0, 0], within, rtol=2e-3)
    plain = noisy.products_about_means(replace(drone, torque_bias=(0.0, 0.0, 0.0)))
    np.testing.assert_allclose(about_means[9, 0], plain[9, 0], atol=0.1 * plain[9, 0, 0])
    assert noisy.mean_products(drone)[9, 0, 0] > 2 * about_means[9, 0, 0]


def test_flights_without_noise_have_the_least_that_sensors_have(exact):
    """What rounding leaves is no noise that an autoregression may foretell."""
    model = exact.noise_model(TRUTH)
    np.testing.assert_allclose(model.deviation, LEAST_NOISE, rtol=1e-2)
    assert np.abs(model.coefficients).max() < 0.02


def test_a_stretch_is_judged_by_a_noise_model_found_elsewhere(noisy, noisy_windows, exact):
    """The Gaussian log likelihood of each stretch and of the least noise, by hand, under weights
    and deviations that do not fit it."""
    model = noisy.noise_model(replace(TRUTH, thrust_to_weight=1.8))._replace(
        deviation=np.array([0.02, 0.03, 0.02, 0.1, 0.2, 0.1])
    )
    wrong = np.asarray(many_errors(noisy_windows, TRUTH))[..., np.array(COLUMNS)].astype(float)
    new = wrong[:, ORDER:] - sum(
        model.coefficients[:, lag - 1] * wrong[:, ORDER - lag : LENGTH - lag]
        for lag in range(1, ORDER + 1)
    )
    expected = -norm.logpdf(new, scale=model.deviation).sum(axis=(1, 2))
    least = LEAST_NOISE**2 * (1 + (model.coefficients**2).sum(axis=1)) / model.deviation**2
    expected += 0.5 * new.shape[1] * least.sum()
    np.testing.assert_allclose(noisy.per_segment(TRUTH, model), expected, rtol=1e-5)


NEAR: Any = dict(zip(NAMES, (0.003, 5e-4, 1.5e-4, 1e-7), strict=True))
"""Steps for differences at the truth."""


def beside(name, side):
    middle = TRUTH.inertia[0] if name == "inertia_x" else getattr(TRUTH, name)
    return replace(TRUTH, **{name: np.float32(middle + side * NEAR[name])})


@pytest.fixture(scope="module")
def long():
    """Enough flight for what is uncorrelated to be so."""
    return OneStep(cut(planted.with_noise(planted.logs(TRUTH, count=64), seed=1)), 0.01, STEPS)


@pytest.mark.slow
def test_gradient_and_curvature_are_differences_of_the_value_whose_noise_model_is_fitted_anew(long):
    equations = long.normal_equations(TRUTH, NAMES)
    assert equations.loss == long(TRUTH)
    for place, name in enumerate(NAMES):
        above, below = (long(beside(name, side)) for side in (1, -1))
        bent = above + below - 2 * equations.loss
        assert NEAR[name] * equations.gradient[place] == pytest.approx(
            (above - below) / 2, abs=0.02 * bent
        ), name
        assert NEAR[name] ** 2 * equations.curvature[place, place] == pytest.approx(
            bent, rel=0.12
        ), name


@pytest.mark.slow
def test_each_segments_gradient_is_the_slope_of_its_value_with_the_autoregression_fitted_again(
    long,
):
    model = long.noise_model(TRUTH)
    _, scores, curvatures = long.derivatives(TRUTH, NAMES)
    assert scores.shape == (64, 4)
    assert curvatures.shape == (64, 4, 4)
    for place, name in enumerate(NAMES):
        drones = beside(name, 1), beside(name, -1)
        above, below = (
            long.per_segment(
                drone, model._replace(coefficients=long.noise_model(drone).coefficients)
            )
            for drone in drones
        )
        slopes = (above - below) / (2 * NEAR[name]) / long.rows
        np.testing.assert_allclose(
            scores[:, place], slopes, atol=0.15 * np.abs(slopes).max(), err_msg=name
        )


def test_one_step_of_a_constant_torque_leaves_no_mean_error(noisy, noisy_windows):
    """An error is linear in it, and its likelihood has no say; nor does it change what is found of
    the others."""
    biased, names = replace(TRUTH, torque_bias=(0.0, 0.0, 3e-5)), (*NAMES, "torque_bias_z")
    equations, others = noisy.normal_equations(biased, names), noisy.normal_equations(biased, NAMES)
    np.testing.assert_allclose(equations.curvature[:-1, -1], 0)
    np.testing.assert_allclose(
        equations.gradient[:-1],
        others.gradient,
        rtol=1e-3,
        atol=1e-5 * np.abs(others.gradient).max(),
    )
    by = -equations.gradient[-1] / equations.curvature[-1, -1]
    before, after = (
        np.asarray(
            many_errors(
                noisy_windows, replace(biased, torque_bias=(0.0, 0.0, np.float32(3e-5 + more)))
            )
        )[:, ORDER:, 11].mean()
        for more in (0.0, by)
    )
    assert abs(before) > 5e-3, "rad/s"
    assert abs(after) < 0.01 * abs(before)


@pytest.mark.slow
def test_neither_cores_nor_chunks_change_what_comes_out(noisy_windows, noisy, monkeypatch):
    """Twenty copies of the flights fill two chunks; each copy has the products that the flights
    have alone."""
    copies = [np.tile(array, (20, *[1] * (array.ndim - 1))) for array in noisy_windows]
    long = Windows(*copies)._replace(segment=np.arange(20 * planted.FLIGHTS))
    together = OneStep(long, 0.01, STEPS)
    found = []
    for count in (1, 2):
        monkeypatch.setattr(compiler, "count_cores", lambda count=count: count)
        found.append(together.products(TRUTH))
    np.testing.assert_array_equal(*found)
    alone = noisy.products(TRUTH)
    for copy in found[0].reshape(20, *alone.shape):
        np.testing.assert_allclose(copy, alone, rtol=1e-5, atol=1e-6 * np.abs(alone).max())


@pytest.mark.slow
def test_the_thrust_that_hovering_takes_is_the_planted_one(noisy_windows):
    objective = OneStep(noisy_windows, 0.01, STEPS)
    heavier = replace(TRUTH, thrust_to_weight=np.float32(1.5))
    value, per_block = objective.balance(heavier)["thrust_to_weight"], objective.hovering(heavier)
    planted_value = float(TRUTH.thrust_to_weight)
    assert value == pytest.approx(planted_value, rel=0.01)
    assert len(per_block) == objective.segments
    assert np.average(per_block, weights=objective.rows_per_segment) == pytest.approx(
        value, rel=1e-2
    )
    # Errors are linear, so that where the slope was taken does not count.
    assert objective.balance(TRUTH)["thrust_to_weight"] == pytest.approx(value, rel=1e-3)


@pytest.mark.slow
def test_constant_torques_that_balance_mean_errors_are_the_planted_ones(noisy_windows):
    objective, names = OneStep(noisy_windows, 0.01, STEPS), BALANCED[1:]
    turned = replace(
        TRUTH, torque_bias=np.array([2e-5, -3e-5, 1e-5], np.float32), inertia=1.2 * TRUTH.inertia
    )
    lighter = replace(turned, inertia=TRUTH.inertia)
    balanced = [objective.balance(one) for one in (turned, lighter, TRUTH)]
    planted_torques = [float(component(TRUTH, name)) for name in names]
    for values in balanced[1:]:
        np.testing.assert_allclose([values[name] for name in names], planted_torques, atol=4e-6)
    there = replace(turned, **{name: np.float32(value) for name, value in balanced[0].items()})
    rest = objective.sums(there)[:, TURNING].sum(axis=0)
    assert np.all(np.abs(rest) < 0.02 * np.abs(objective.sums(turned)[:, TURNING].sum(axis=0)))


def test_programs_for_flights_alike_are_begun_once_whoever_asks(flights, monkeypatch):
    begun = []
    monkeypatch.setattr(compiling, "_programs", lambda *sizes: [lambda: begun.append(sizes)] * 2)
    compiling._start_threads.cache_clear()
    for flight, lead_in in ((0, LEAD_IN), (1, LEAD_IN), (1, 5), (0, 5)):
        for thread in compiling.start_compiling(flights[flight], lead_in):
            thread.join()
    compiling._start_threads.cache_clear()
    assert begun == [(1, LEAD_IN)] * 2 + [(1, 5)] * 2


def test_after_compiling_all_programs_nothing_is_compiled_for_other_parameters_or_steps(
    noisy, flights
):
    compiling._start_threads.cache_clear()
    for thread in compiling.start_compiling(flights[0], LEAD_IN):
        thread.join()
    programs = (
        one_step_errors.derivatives,
        one_step_errors.slopes,
        one_step_errors.spins,
        one_step_errors.errors_of_chunk,
    )
    before = [program._cache_size() for program in programs]  # type: ignore[attr-defined]
    noisy.derivatives(replace(TRUTH, latency=0.011), NAMES)
    noisy.derivatives(
        TRUTH, (*NAMES, *(f"torque_bias_{axis}" for axis in "xyz"), "drag_x", "drag_y")
    )
    noisy.hovering(TRUTH)
    noisy.steps = STEPS + 1
    noisy.products(TRUTH)
    noisy.steps = STEPS
    after = [program._cache_size() for program in programs]  # type: ignore[attr-defined]
    assert after == before
