"""Logs of two drones in one folder are named; flights of one drone are not."""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
import pytest

import planted
from maidenflight.flights.log import Flight
from maidenflight.flights.windows import segment_names, windows
from maidenflight.flying import recording
from maidenflight.identification.identify import identify
from maidenflight.identification.likelihood import one_step
from maidenflight.identification.likelihood.flight_differences import _groups
from maidenflight.identification.methods import Likelihood
from maidenflight.simulator.realities.virtual_drone import virtual_drone

OVER = ("thrust_to_weight", "motor_time_constant", "latency")


def test_the_best_cut_of_flights_of_one_drone_is_hardly_ever_called_two() -> None:
    """Thrust differs by 2 % from flight to flight, of which 1 % is noise."""
    generator = np.random.default_rng(0)
    called = 0
    for _ in range(500):
        count = int(generator.integers(2, 30))
        names = [f"flight_{number}" for number in range(count)]
        means = 0.02 * generator.standard_normal(count)
        called += _groups(names, means, np.full(count, 0.01), 0.06) is not None
    assert called <= 5


def test_two_groups_are_told_whatever_their_order() -> None:
    means = np.array([0.0, 0.5, 0.01, 0.49, -0.01])
    found = _groups(list("abcde"), means, np.full(5, 0.01), 0.06)
    assert found is not None
    assert found[1:3] == (("a", "c", "e"), ("b", "d"))
    assert found[3] == pytest.approx(np.exp(0.495))


def test_a_difference_below_what_one_drone_shows_is_none() -> None:
    assert _groups(["a", "b"], np.array([0.0, 0.05]), np.full(2, 1e-4), 0.06) is None
    assert _groups(["a"], np.array([0.0]), np.full(1, 1e-4), 0.06) is None


def test_segments_are_named_in_the_order_of_their_windows() -> None:
    logs = planted.logs(planted.drone(1.9, 0.06, 0.012), 3)
    names = segment_names(logs, one_step.LENGTH)
    assert len(names) == windows(logs, one_step.LENGTH, one_step.LENGTH).segment.max() + 1
    assert list(dict.fromkeys(names)) == [log.name for log in logs]


@pytest.mark.night
def test_logs_of_two_drones_in_one_folder_are_named() -> None:
    logs = [
        dataclasses.replace(log, name=f"{drone.name}/{log.name}")
        for drone in (virtual_drone(7), virtual_drone(3, "far"))
        for log in recording.record(drone, jax.random.key(0), 2, 12.0, 0.06)
    ]

    def said(flights: Sequence[Flight]) -> list[str]:
        found = identify(flights, Likelihood(trials=1), over=OVER, key=jax.random.key(0))
        return [note for note in found.notes if "thrust_to_weight" in note and "virtual:7" in note]

    (note,) = said(logs)
    assert "far:3" in note
    assert said(logs[:2]) == []
