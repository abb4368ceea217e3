"""Domain randomization draws inside its box, and only what it names."""

import jax
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.parameters import QUANTITIES, crazyflie
from maidenflight.simulator.randomization import PAPER_FIELDS, randomize, relative_box

PAPER = crazyflie()
many = jax.jit(jax.vmap(randomize, (None, 0)))
KEYS = jax.random.split(jax.random.key(0), 2000)


@pytest.mark.parametrize(("fraction", "fields"), [(0.1, PAPER_FIELDS), (0.3, ("latency", "inertia"))])
def test_named_fields_fill_their_box_and_others_do_not_change(fraction, fields):
    drawn = many(relative_box(PAPER, fraction, fields), KEYS)
    for name in QUANTITIES:
        nominal, values = np.asarray(getattr(PAPER, name)), np.asarray(getattr(drawn, name))
        if name not in fields:
            np.testing.assert_array_equal(values, np.broadcast_to(nominal, values.shape), err_msg=name)
            continue
        factors = values / nominal
        assert np.all((factors >= 1 - fraction - 1e-6) & (factors <= 1 + fraction + 1e-6)), name
        np.testing.assert_allclose(factors.min(axis=0), 1 - fraction, atol=0.02 * fraction)
        np.testing.assert_allclose(factors.max(axis=0), 1 + fraction, atol=0.02 * fraction)
        np.testing.assert_allclose(factors.mean(axis=0), 1, atol=0.05 * fraction)


def test_fields_and_components_are_drawn_independently():
    drawn = many(relative_box(PAPER), KEYS)
    columns = np.concatenate([np.asarray(getattr(drawn, name)).reshape(len(KEYS), -1) for name in PAPER_FIELDS], axis=1)
    np.testing.assert_allclose(np.corrcoef(columns.T), np.eye(columns.shape[1]), atol=0.1)


def test_a_box_of_no_width_is_the_drone_itself():
    drawn = many(relative_box(PAPER, 0.0), KEYS[:3])
    jax.tree.map(lambda value, nominal: np.testing.assert_array_equal(value, np.broadcast_to(nominal, value.shape)), drawn, PAPER)


def test_a_box_reads_like_mathematics():
    text = str(relative_box(PAPER, 0.10))
    assert "mass ~ 0.028 U(0.9, 1.1) kg" in text.splitlines()
    assert "inertia ~ 1.33e-05 1.33e-05 2.64e-05 U(0.9, 1.1) kg m2" in text.splitlines()
    assert {line.split(" ~ ")[0] for line in text.splitlines()} == set(PAPER_FIELDS)


def test_a_wrong_box_is_refused():
    with pytest.raises(InputError, match="unknown parameter 'weight'"):
        relative_box(PAPER, 0.1, ("mass", "weight"))
    for fraction in (-0.1, 1.0, float("nan")):
        with pytest.raises(ValueError, match=r"fraction = .*, expected a share"):
            relative_box(PAPER, fraction)
