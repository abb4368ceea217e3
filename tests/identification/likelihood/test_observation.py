"""What noise of the velocity does to slopes is what a sum over noise finds."""

import numpy as np
import pytest

from maidenflight.identification.likelihood.observation import NoiseModel, noise_model, of_noise
from maidenflight.identification.likelihood.one_step_errors import ORDER, products
from maidenflight.parameters import crazyflie

PERIOD, ROWS, SIGMA = 0.01, 200_000, 0.015


def white(noise: NoiseModel, values: np.ndarray) -> np.ndarray:
    """Whitens C columns as their errors are."""
    filters = np.concatenate([np.ones((len(values), 1)), -noise.coefficients], axis=1)
    pairs = zip(values, filters, noise.deviation, strict=True)
    return np.stack([np.convolve(one, taps, "valid") / size for one, taps, size in pairs])


def test_noise_passes_for_drag_and_hides_flapping() -> None:
    random, drone = np.random.default_rng(0), crazyflie()
    read = SIGMA * random.standard_normal((3, ROWS + 1))
    before = read[:, :-1]
    velocity = read[:, 1:] - before + 0.004 * random.standard_normal((3, ROWS))
    rates = 0.05 * random.standard_normal((3, ROWS + 1))
    errors = np.concatenate([velocity, np.diff(rates, axis=1)])
    means = products(errors[None])[0] / (ROWS - ORDER)
    noise = noise_model(means)
    found = of_noise(means, noise, drone, PERIOD)
    # Slopes of errors by drag and by flapping, as far as noise is in them.
    by_drag = white(noise, errors)[:3] * white(noise, np.concatenate([PERIOD * before] * 2))[:3]
    assert -by_drag.mean() == pytest.approx(float(found.damping.mean()), rel=0.03)
    inertia = np.asarray(drone.inertia, float)[:2, None]
    moved = np.concatenate(
        [np.zeros((3, ROWS)), PERIOD * before[:2] / inertia, np.zeros((1, ROWS))]
    )
    by_flapping = white(noise, moved)[3:5] ** 2
    assert by_flapping.mean(axis=1) == pytest.approx(found.hidden, rel=0.03)


def test_a_smooth_estimate_has_nothing_to_correct() -> None:
    random = np.random.default_rng(1)
    errors = np.cumsum(random.standard_normal((1, 6, 4000)), axis=2)
    means = products(errors)[0] / (4000 - ORDER)
    found = of_noise(means, noise_model(means), crazyflie(), PERIOD)
    assert not found.damping.any()
    assert not found.hidden.any()
