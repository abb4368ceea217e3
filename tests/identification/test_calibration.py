"""Calibration: what is counted of intervals, and the regulator of flights along logged paths."""

import numpy as np
import polars
import pytest
from hypothesis import given
from hypothesis import strategies as st

from maidenflight.identification import calibration, path_flights
from maidenflight.parameters import crazyflie, replace


def table(truths: list[float | None]) -> polars.DataFrame:
    """Drones whose interval is [0, 1] and whose posterior is uniform in it."""
    rows = [
        {"draw": number, "parameter": "latency", "truth": truth or 0.0}
        | (
            {"low": 0.0, "high": 1.0, "rank": min(max(truth, 0.0), 1.0)}
            if truth is not None
            else {}
        )
        | ({"width_ratio": 1.5} if truth is not None else {})
        for number, truth in enumerate(truths)
    ]
    return polars.DataFrame(rows, infer_schema_length=None)


def test_a_summary_counts_intervals_that_hold_and_ranks() -> None:
    (one,) = calibration.summarize(table([*np.linspace(0.01, 0.99, 20), None]))
    assert (one["draws"], one["in_model"], one["held"]) == (21, 20, 20)
    assert one["ranks"] == [4, 4, 4, 4, 4]
    assert (one["width_ratio"], one["enough"], one["uniform"]) == (1.5, True, True)


def test_narrow_intervals_and_a_bias_are_noticed() -> None:
    (narrow,) = calibration.summarize(table(list(np.linspace(-1.0, 2.0, 20))))
    assert (narrow["held"], narrow["enough"]) == (6, False)
    (biased,) = calibration.summarize(table([0.9] * 20))
    assert (biased["enough"], biased["uniform"]) == (True, False)


@given(st.integers(2, 500))
def test_the_band_holds_the_mean_count(count: int) -> None:
    low, high = calibration.uniform_band(count)
    assert low <= count / calibration.BINS <= high <= count


def test_lag_and_latency_are_also_taken_together() -> None:
    assert calibration.with_total({"motor_time_constant": 0.05, "latency": 0.01}) == pytest.approx(
        {"motor_time_constant": 0.05, "latency": 0.01, calibration.TOTAL: 0.06}
    )
    assert calibration.with_total({"latency": 0.01}) == {"latency": 0.01}


@pytest.mark.parametrize("flapping", [0.0, 3e-4])
def test_the_regulator_pushes_back(flapping: float) -> None:
    # Beside, ahead or above: it leans back or gives less thrust; turned or turning, it turns back.
    drone = replace(crazyflie(), flapping_moment=np.full(2, flapping, np.float32))
    gain = path_flights._gain(drone, 500, 0.03)
    command = -gain  # of a deviation of one, by column
    assert (command[:, [2, 5]] < 0).all()
    levers = np.asarray(crazyflie().rotor_y)
    for column in (6, 9):
        assert levers @ command[:, column] < 0
    assert np.allclose(command[:, [2, 5]].std(axis=0), 0.0, atol=1e-3)
