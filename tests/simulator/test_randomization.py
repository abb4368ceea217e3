"""Domain randomization draws inside its box, and only what it names."""

from typing import Any

import jax
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.parameters import QUANTITIES, crazyflie, replace
from maidenflight.simulator.randomization import (
    PAPER_FIELDS,
    WIDTHS,
    UniformBox,
    ensemble,
    randomize,
    relative_box,
    stacked,
    wide_box,
)

PAPER = crazyflie()
many = jax.jit(jax.vmap(randomize, (None, 0)))
KEYS = jax.random.split(jax.random.key(0), 2000)


@pytest.mark.parametrize(
    ("fraction", "fields"), [(0.1, PAPER_FIELDS), (0.3, ("latency", "inertia"))]
)
def test_named_fields_fill_their_box_and_others_do_not_change(fraction, fields):
    drawn = many(relative_box(PAPER, fraction, fields), KEYS)
    for name in QUANTITIES:
        nominal, values = np.asarray(getattr(PAPER, name)), np.asarray(getattr(drawn, name))
        if name not in fields:
            np.testing.assert_array_equal(
                values, np.broadcast_to(nominal, values.shape), err_msg=name
            )
            continue
        factors = values / nominal
        assert np.all((factors >= 1 - fraction - 1e-6) & (factors <= 1 + fraction + 1e-6)), name
        np.testing.assert_allclose(factors.min(axis=0), 1 - fraction, atol=0.02 * fraction)
        np.testing.assert_allclose(factors.max(axis=0), 1 + fraction, atol=0.02 * fraction)
        np.testing.assert_allclose(factors.mean(axis=0), 1, atol=0.05 * fraction)


def test_fields_and_components_are_drawn_independently():
    drawn = many(relative_box(PAPER), KEYS)
    columns = np.concatenate(
        [np.asarray(getattr(drawn, name)).reshape(len(KEYS), -1) for name in PAPER_FIELDS], axis=1
    )
    np.testing.assert_allclose(np.corrcoef(columns.T), np.eye(columns.shape[1]), atol=0.1)


def test_a_box_of_no_width_is_the_drone_itself():
    drawn = many(relative_box(PAPER, 0.0), KEYS[:3])
    jax.tree.map(
        lambda value, nominal: np.testing.assert_array_equal(
            value, np.broadcast_to(nominal, value.shape)
        ),
        drawn,
        PAPER,
    )


def test_a_box_reads_like_mathematics():
    text = str(relative_box(PAPER, 0.10))
    assert "mass ~ 0.028 U(0.9, 1.1) kg" in text.splitlines()
    assert "inertia ~ 1.33e-05 1.33e-05 2.64e-05 U(0.9, 1.1) kg m2" in text.splitlines()
    assert {line.split(" ~ ")[0] for line in text.splitlines()} == set(PAPER_FIELDS)


def test_a_wrong_box_is_refused():
    with pytest.raises(InputError, match="unknown parameter 'weight'"):
        relative_box(PAPER, 0.1, ("mass", "weight"))
    for fraction in (-0.1, 1.0, float("nan")):
        with pytest.raises(InputError, match=r"fraction = .*, expected a share"):
            relative_box(PAPER, fraction)


RANGES = {"latency": (0.0, 0.03), "battery_voltage": (3.4, 4.2), "inertia": (1e-5, 3e-5)}
BOX = UniformBox(
    *(
        replace(
            PAPER,
            **{
                name: np.full_like(getattr(PAPER, name), ends[side])
                for name, ends in RANGES.items()
            },
        )
        for side in (0, 1)
    )
)


def test_a_uniform_box_fills_its_ranges_and_changes_nothing_else():
    drawn = many(BOX, KEYS)
    for name in QUANTITIES:
        values = np.asarray(getattr(drawn, name))
        if name not in RANGES:
            np.testing.assert_array_equal(
                values, np.broadcast_to(getattr(PAPER, name), values.shape), err_msg=name
            )
        else:
            low, high = RANGES[name]
            assert np.all((values >= low) & (values <= np.float32(high)))
            np.testing.assert_allclose(values.min(axis=0), low, atol=0.01 * (high - low))
            np.testing.assert_allclose(values.max(axis=0), high, atol=0.01 * (high - low))
    inertia = np.asarray(drawn.inertia)
    np.testing.assert_allclose(np.corrcoef(inertia.T), np.eye(3), atol=0.1)


def test_a_uniform_box_reads_like_mathematics_and_has_a_middle():
    lines = str(BOX).splitlines()
    assert "latency ~ U(0, 0.03) s" in lines
    assert "inertia ~ U(1e-05, 3e-05) U(1e-05, 3e-05) U(1e-05, 3e-05) kg m2" in lines
    np.testing.assert_allclose(BOX.centre.latency, 0.015)
    assert relative_box(PAPER).centre is PAPER


def test_an_ensemble_draws_each_of_its_drones_whole_and_as_often():
    lags, latencies = (0.06, 0.07, 0.08, 0.09), (0.02, 0.015, 0.01, 0.005)
    drones = ensemble(
        [
            replace(PAPER, motor_time_constant=lag, latency=late)
            for lag, late in zip(lags, latencies, strict=True)
        ]
    )
    drawn = many(drones, KEYS)
    pairs, counts = np.unique(
        np.stack([drawn.motor_time_constant, drawn.latency], axis=1), axis=0, return_counts=True
    )
    np.testing.assert_allclose(pairs, np.stack([lags, latencies], axis=1), rtol=1e-6)
    np.testing.assert_allclose(counts, 500, atol=80)
    assert "latency ~ 0.0125 +- 0.0056 s, one of 4 drones" in str(drones).splitlines()
    assert len(str(drones).splitlines()) == 2, "only what differs is told"
    np.testing.assert_allclose(drones.centre.motor_time_constant, 0.075, rtol=1e-6)
    with pytest.raises(InputError, match="an ensemble of no drones"):
        ensemble([])


@pytest.mark.parametrize("structure", list(WIDTHS))
def test_a_wide_box_holds_the_drone_with_all_its_trims_and_what_published_drones_have(structure):
    drone, trims = replace(PAPER, torque_bias=(1e-5, -2e-5, 5e-5)), (3e-5, 1e-4, 4e-5)
    drawn = many(wide_box(drone, structure, trims), KEYS)
    away = np.abs(np.asarray(drawn.torque_bias) - drone.torque_bias) / trims
    assert np.all(away < 2.0 + 1e-4)
    assert np.all(away.max(axis=0) > 0.95)
    for name, (low, high) in WIDTHS[structure].items():
        if name == "latency":
            continue
        factors = np.asarray(getattr(drawn, name)) / getattr(drone, name)
        assert factors.min() == pytest.approx(low, abs=0.01), name
        assert factors.max() == pytest.approx(high, abs=0.01), name
    for name in ("flapping_moment", "gyro_noise"):
        np.testing.assert_array_equal(
            getattr(drawn, name), np.stack([getattr(drone, name)] * len(KEYS))
        )
    np.testing.assert_array_equal(
        many(wide_box(drone, structure), KEYS[:3]).torque_bias, [drone.torque_bias] * 3
    )


@pytest.mark.parametrize(("latency", "latest"), [(0.0, 0.015), (0.007, 0.022), (0.03, 0.048)])
def test_a_wide_box_is_milliseconds_wide_in_latency_even_where_none_was_identified(latency, latest):
    box = wide_box(replace(PAPER, latency=latency), "pwm")
    assert float(box.lower.latency) == pytest.approx(0.8 * latency)
    assert float(box.upper.latency) == pytest.approx(latest)


def test_a_drone_that_nobody_identified_may_be_as_quick_as_the_quickest_published() -> None:
    box = wide_box(PAPER, "pwm", identified=False)
    assert float(box.lower.motor_time_constant) < 0.055
    assert float(box.lower.latency) < 0.004
    assert float(box.upper.motor_time_constant) == pytest.approx(0.088 * 1.6)
    held = wide_box(PAPER, "attitude", identified=False)
    np.testing.assert_array_equal(held.lower.latency, wide_box(PAPER, "attitude").lower.latency)


def test_stacked_distributions_draw_what_each_draws() -> None:
    boxes = [relative_box(replace(PAPER, mass=mass), 0.1) for mass in (0.02, 0.04)]
    key = jax.random.key(3)
    drawn = jax.vmap(lambda box: box.draw(key))(stacked(boxes))
    for number, box in enumerate(boxes):
        for one, alone in zip(jax.tree.leaves(drawn), jax.tree.leaves(box.draw(key)), strict=True):
            np.testing.assert_array_equal(one[number], alone)


@pytest.mark.parametrize("other", [relative_box(PAPER), ensemble([PAPER] * 3)])
def test_distributions_of_different_kinds_or_sizes_are_not_stacked(other: Any) -> None:
    with pytest.raises(InputError, match="different kinds or sizes"):
        stacked([ensemble([PAPER] * 2), other])
