"""Rows of a flight: where guards end it, and the log that is made of it."""

from typing import Any

import numpy as np
import pytest

from maidenflight.flying.rows import Rows, SimulatedFlight
from maidenflight.simulator.physics.battery import Supply
from maidenflight.simulator.tasks.failures import BACKUP, END_REASONS, LOST, ZERO_SHOT, Guard


def rows(**changes: tuple[int, Any, Any]) -> Rows:
    """A perfect flight of 100 periods but for entries (from row, column, value) of named fields."""
    length, widths = 100, {"ratio": (4,), "battery": ()}
    fields = {
        name: np.zeros((length, *widths.get(name, (3,))), np.float32) for name in Rows._fields
    }
    for name, (start, column, value) in changes.items():
        fields[name][start:, column] = value
    return Rows(**fields)  # type: ignore[arg-type]


def ended(flown: Rows, guard: Guard = ZERO_SHOT) -> tuple[int, str]:
    steps, reason = flown.end(guard)
    return int(steps), END_REASONS[int(reason)]


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("true_position", 0.26, "position error"),
        ("true_position", np.nan, "not finite"),
        ("true_attitude", np.radians(31.0), "tilt"),
        ("true_attitude", -np.radians(31.0), "tilt"),
        ("true_body_rates", np.radians(-801.0), "body rate"),
    ],
)
def test_each_guard_ends_the_flight_in_the_period_it_trips(
    field: str, value: float, reason: str
) -> None:
    assert ended(rows(**{field: (40, 1, value)})) == (41, reason)


def test_within_the_guards_a_flight_lasts_to_the_time_limit() -> None:
    """Whatever its yaw."""
    within = rows(
        true_position=(0, 0, 0.249),
        true_attitude=(0, slice(0, 3), np.radians([29.0, -29.0, 170.0])),
        true_body_rates=(0, slice(0, 3), np.radians([-799.0, 799.0, 900.0])),
    )
    assert ended(within) == (100, "time limit")


def test_the_first_guard_to_trip_is_the_reason_and_each_looks_at_its_own_limits() -> None:
    flown = rows(true_attitude=(30, 0, 1.0), true_position=(20, 0, 1.0))
    assert ended(flown) == (21, "position error")
    assert ended(flown, LOST) == (21, "position error")
    assert ended(flown, BACKUP) == (31, "tilt")
    together = rows(true_attitude=(20, 0, 1.0), true_position=(20, 0, 1.0))
    assert ended(together) == (21, "tilt")


def test_without_a_battery_the_logged_command_is_the_ratio_and_positions_are_those_of_the_rows():
    flown = rows(ratio=(0, slice(None), 0.625), true_position=(1, 0, 0.5))
    flown = flown._replace(battery=np.full(100, 3.5), true_velocity=flown.true_velocity + 2.0)
    whole = SimulatedFlight(flown, 50, zero_order_hold=True, supply=Supply(), reality="x")
    assert (whole.duration, whole.end_reason, whole.drone) == (2.0, "time limit", None)
    flight = whole.to_flight("made")
    np.testing.assert_array_equal(flight.command, flown.ratio)
    assert (flight.name, flight.zero_order_hold, flight.simulated) == ("made", True, "x")
    assert (flight.period, flight.full_scale_counts) == (0.02, 60000.0)
    true = flight.true_position
    assert true is not None
    np.testing.assert_allclose(true[:4, 0], [-0.04, 0.0, 0.5, 0.5], atol=1e-7)
