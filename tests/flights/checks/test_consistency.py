"""Consistency: contradictions are found in any motion, and what is merely quiet, short or noisy
raises no alarm."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from made_flights import calm, driven
from maidenflight.flights.checks import consistency
from maidenflight.flights.reading import read_flights


@given(seed=st.integers(0, 10**6), rows=st.integers(2, 1500))
def test_a_true_flight_contradicts_nothing(seed, rows):
    assert consistency.contradictions([calm(rows, seed)]) == []


@given(
    seed=st.integers(0, 10**6),
    group=st.sampled_from(["velocity", "attitude", "body_rates"]),
    axis=st.integers(0, 2),
)
def test_a_turned_sign_is_found(seed, group, axis):
    signs = np.ones(3, np.float32)
    signs[axis] = -1
    flight = calm(900, seed)
    wrong = replace(flight, **{group: getattr(flight, group) * signs})
    said = consistency.contradictions([wrong])
    assert said
    assert all("opposite signs" in sentence for sentence in said)


@given(seed=st.integers(0, 10**6), order=st.permutations(range(4)))
def test_motors_in_another_order_are_found_and_the_right_order_is_told(seed, order):
    flight = driven(900, seed)
    said = consistency.contradictions([replace(flight, command=flight.command[:, order])])
    if list(order) == [0, 1, 2, 3]:
        assert said == []
    else:
        right = ", ".join(f"command_{order.index(motor) + 1}" for motor in range(4))
        assert f"in the order {right} they" in said[0]


def scaled(**factors):
    """What a flight becomes in which some signals have the wrong scale."""
    return lambda flight: replace(
        flight,
        **{group: getattr(flight, group) * np.float32(by) for group, by in factors.items()},
    )


def yaw_in_degrees(flight):
    roll, pitch, yaw = flight.attitude.T
    return replace(flight, attitude=np.stack([roll, pitch, np.degrees(yaw)], axis=1))


@given(seed=st.integers(0, 10**6))
@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        (scaled(body_rates=0.5), "body_rate is 0.5 "),
        (scaled(velocity=0.3), "velocity is 0.3 "),
        (scaled(position=1 / 0.3048), "position is 3.28 "),
        (lambda flight: replace(flight, period=2 * flight.period), "time is 2 "),
        (lambda flight: replace(flight, period=0.5 * flight.period), "time is 0.5 "),
    ],
)
def test_a_wrong_scale_is_found_and_its_signal_and_factor_are_named(wrong, named, seed):
    (sentence,) = consistency.contradictions([wrong(calm(900, seed))])
    assert sentence.startswith(named)


@given(seed=st.integers(0, 10**6))
def test_yaw_in_degrees_is_found(seed):
    assert consistency.contradictions([yaw_in_degrees(calm(900, seed))])


@given(seed=st.integers(0, 10**6), noise=st.floats(0.0, 1.5))
def test_noise_as_large_as_a_signal_is_no_wrong_scale(seed, noise):
    generator = np.random.default_rng(seed)
    flight = calm(900, seed)
    rates = flight.body_rates + noise * flight.body_rates.std() * generator.normal(size=(900, 3))
    assert consistency.contradictions([replace(flight, body_rates=np.float32(rates))]) == []


@pytest.mark.parametrize(("rows", "named"), [(-16, True), (0, False), (10, True)])
def test_commands_shifted_in_time_are_not_taken_for_permuted_motors(rows, named):
    generator = np.random.default_rng(3)
    command = np.repeat(generator.uniform(0.4, 0.8, (300, 4)), 4, axis=0)
    torque = command @ np.array([[-1, -1, 1, 1], [-1, 1, 1, -1], [-1, 1, -1, 1]]).T
    rates = np.cumsum(np.roll(torque - torque.mean(axis=0), 4, axis=0), axis=0)
    flight = calm(1200, command=np.roll(command, rows, axis=0), body_rates=rates)
    sentences = consistency.motor_contradictions([flight.part(20, 1180)])
    assert ["clock" in sentence for sentence in sentences] == [True] * named


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_scale_errors_of_a_real_flight_are_found(shared_data, factor):
    read = read_flights(shared_data / "nanobench/B2_circle_fast_rep1.csv.gz")
    wrong = [scaled(body_rates=factor)(flight) for flight in read.flights]
    assert any("body_rate is" in sentence for sentence in consistency.contradictions(wrong))


@given(seed=st.integers(0, 10**6))
def test_noise_alone_is_no_contradiction(seed):
    generator = np.random.default_rng(seed)
    groups = ("position", "velocity", "attitude", "body_rates")
    noise: dict[str, Any] = {
        group: generator.normal(0, 0.3, (900, 3)).astype(np.float32) for group in groups
    }
    assert consistency.contradictions([calm(900, **noise)]) == []


def test_a_hover_is_too_quiet_to_judge():
    flight = calm(900)
    still = {
        group: getattr(flight, group) * np.float32(-0.01)
        for group in ("velocity", "attitude", "body_rates")
    }
    assert (
        consistency.contradictions([replace(flight, position=0.01 * flight.position + 1, **still)])
        == []
    )


def test_pieces_are_judged_together_but_not_across_their_gaps():
    parts = [calm(200, seed, position=calm(200, seed).position + 10 * seed) for seed in range(5)]
    assert consistency.contradictions(parts) == []
    turned = [replace(part, body_rates=-part.body_rates) for part in parts]
    assert len(consistency.contradictions(turned)) == 4


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["authors/flights/attitude", "authors/flights/attitude_rate"])
def test_no_real_flight_is_refused(shared_data, folder):
    read = read_flights(shared_data / folder)
    assert read.refused == ()
    assert len(read.paths) == 54
