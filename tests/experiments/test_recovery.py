"""Recovery from a change of the drone: times and counts of made-up flights."""

import numpy as np
import polars
import pytest

from maidenflight.experiments.recovery import of_flights, recovery, summary
from maidenflight.flights.log import Flight


def flight(*distances: tuple[float, float], duration: float = 4.0) -> Flight:
    """A flight whose distance from the set-point changes: (from when on [s], distance [m])."""
    time = np.arange(0, duration, 0.01)
    position, still = np.zeros((len(time), 3)), np.zeros((len(time), 3))
    for start, distance in distances:
        position[time > start - 1e-9, 0] = distance
    command, battery = np.full((len(time), 4), 0.55), np.full(len(time), 4.0)
    logged = (position, still, still, still, command, battery, still)
    return Flight("made", 0.01, *logged, zero_order_hold=True, simulated="made")


def table(*rows: tuple[str, str, str]) -> polars.DataFrame:
    return polars.DataFrame(rows, ["policy", "reality", "end_reason"], orient="row")


def test_a_flight_is_back_from_when_on_it_stays_within_the_distance() -> None:
    errors = np.full((5, 10), 0.02)
    errors[0, :5] = 0.2  # before the change only
    errors[1, 5:7] = 0.06
    errors[2, [5, 8]] = 0.06  # back, and away again
    errors[3, 9] = 0.06
    errors[4, 6] = np.nan
    expected = [0.0, 0.2, 0.4, np.inf, 0.2]
    np.testing.assert_allclose(recovery(errors, 10, 0.5), expected)
    assert recovery(errors, 10, 3.0).tolist() == [np.inf] * 5


def test_rows_are_of_the_flights_whose_drone_changes() -> None:
    flights = [
        flight((1.0, 0.1), (2.5, 0.01)),
        flight((1.0, 0.1)),
        flight((1.0, 0.1), (3.5, 0.01)),
        flight((1.0, 0.01), duration=2.0),
        flight(),
        flight(duration=0.5),
    ]
    jumps = "virtual:3+payload15@1"
    given = table(
        *(("one", jumps, "time limit"),) * 3,
        ("two", jumps, "tilt"),
        ("two", "virtual:3+payload15", "time limit"),
        ("two", "virtual:3+yaw4000@1.5", "time limit"),
    )
    found = of_flights(given, flights)
    assert found["place"].to_list() == [0, 1, 2, 3], "the last ends before its drone changes"
    assert found["recovery"].to_list() == pytest.approx([1.5, np.inf, 2.5, np.inf])
    assert found["lasts"].to_list() == [True, True, True, False]
    assert summary(found).rows() == [
        (jumps, "one", 1.0, 3, 3, 1, pytest.approx(2.5)),
        (jumps, "two", 1.0, 1, 0, 0, np.inf),
    ]


def test_where_no_drone_changes_there_are_no_rows() -> None:
    assert of_flights(table(("one", "virtual:3", "time limit")), [flight()]).height == 0
