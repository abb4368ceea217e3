"""What makes an identified drone doubtful is said, and how far thrust is searched for."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from made_flights import calm
from maidenflight.identification.drone_file import GroupGain
from maidenflight.identification.outcome.estimates import (
    note_gains_lost,
    note_worse_than_start,
)
from maidenflight.identification.outcome.plausible import is_identifiable
from maidenflight.identification.outcome.problem import Problem
from maidenflight.identification.unknowns import physical_bounds
from maidenflight.parameters.named import racer_5_inch


@pytest.mark.parametrize(
    ("objective", "value", "start", "notes"),
    [
        ("likelihood", -22.34, -22.39, 0),
        ("likelihood", -22.30, -22.39, 1),
        ("likelihood", -23.0, -22.39, 0),
        ("replay", 0.0206, 0.02, 0),
        ("replay", 0.022, 0.02, 1),
    ],
)
def test_a_drone_that_explains_less_than_the_start_is_noted(
    objective: str, value: float, start: float, notes: int
) -> None:
    assert len(note_worse_than_start(value, start, objective)) == notes


def test_a_gain_that_is_lost_to_a_search_bound_is_said() -> None:
    bound = "inertia_y at a search bound"
    gains = [
        GroupGain("inertia", 0.6, 0.01, False, bound),
        GroupGain("drag", 0.002, 0.001, False, bound),
        GroupGain("rotor_momentum", 0.6, 0.4, False, "below 2 standard errors"),
        GroupGain("flapping_moment", 0.6, 0.01, True, None),
    ]
    notes = note_gains_lost(gains)
    assert len(notes) == 1
    assert "inertia_y" in notes[0]
    assert "0.6 nats" in notes[0]


@pytest.mark.parametrize(("start", "share", "most"), [(None, 1.0, 8.0), (None, 0.15, 20.0)])
def test_thrust_is_searched_as_far_as_flights_show(start: Any, share: float, most: float) -> None:
    """A hover at a seventh of full thrust is that of a racing quadrotor."""
    flight = calm(rows=300)
    flight = replace(flight, command=(share * flight.command).astype(np.float32))
    problem = Problem.of([flight], start)
    bounds = {**physical_bounds(problem.start), **problem.bounds}["thrust_to_weight"]
    assert bounds == (1.01, most)
    assert physical_bounds(racer_5_inch())["thrust_to_weight"] == (1.01, 15.0)
    own = Problem.of([flight], start, bounds={"thrust_to_weight": (2.0, 5.0)})
    assert own.bounds["thrust_to_weight"] == (2.0, 5.0)


def test_what_flights_did_not_change_is_told_from_what_they_did() -> None:
    """A latency anywhere in its range is no finding; one known to a fifth of it is."""
    generator = np.random.default_rng(0)
    priors = {"latency": (0.0, 0.02), "drag_z": (0.0, 0.5), "spin_down_ratio": (0.7, 2.5)}
    samples = {
        "latency": generator.uniform(0.0, 0.018, 500),
        "drag_z": generator.normal(0.3, 0.05, 500),
        "spin_down_ratio": generator.normal(1.0, 0.45, 500),
    }
    told = [n for n in priors if is_identifiable(float(np.std(samples[n])), priors[n])]
    assert told == ["drag_z"]
    ratio = float(np.std(samples["spin_down_ratio"]))
    assert is_identifiable(ratio, priors["spin_down_ratio"], share=1.0)
