"""Consistency: contradictions are found in any motion, and what is merely quiet, short or noisy
raises no alarm."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_flights import calm, driven

from maidenflight.flights import consistency
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
    assert len(consistency.contradictions(turned)) == 3


@pytest.mark.parametrize("folder", ["authors/flights/attitude", "authors/flights/attitude_rate"])
def test_no_real_flight_is_refused(shared_data, folder):
    read = read_flights(shared_data / folder)
    assert read.refused == ()
    assert len(read.paths) == 54
