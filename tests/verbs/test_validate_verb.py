"""`Validate` judges a drone beside the baseline and another drone; `identify` notes odd thrust."""

from types import SimpleNamespace
from typing import Any

import pytest

from maidenflight.flights.checkup.result import PASSES, CheckResult
from maidenflight.verbs import logs_output, validate


def errors(**degrees: float) -> list[dict[str, Any]]:
    """Errors of attitude of models after two horizons, SI units."""
    return [
        {"model": model, "horizon": horizon, "attitude": value * 0.0175, "body_rates": 1.0}
        for model, value in degrees.items()
        for horizon in (0.1, 1.0)
    ]


@pytest.mark.parametrize(
    ("own", "likelihood", "doubts"),
    [(0.5, 14.0, 0), (6.2, 14.0, 1), (0.5, 13.0, 1), (6.2, 13.0, 2)],
    ids=["sound", "worse than the baseline", "less likely", "both"],
)
def test_a_drone_is_doubted_where_it_predicts_worse(
    own: float, likelihood: float, doubts: int
) -> None:
    likelihoods = {"mine": likelihood, "other": 13.4}
    said = validate._compare("mine", likelihoods, errors(mine=own, persistence=0.71))
    assert len(said) == doubts


def test_each_flights_own_trim_is_judged_apart_and_no_rival() -> None:
    trimmed = validate._TRIMMED.format("mine")
    table = errors(**{"mine": 6.2, trimmed: 0.5, "persistence": 0.71})
    assert len(validate._compare("mine", {"mine": 14.0}, table)) == 1
    assert validate._compare("mine", {"mine": 14.0}, table, trimmed) == []
    assert len(validate._compare("p", {"p": 14.0}, errors(p=6.2, persistence=0.71))) == 1


@pytest.mark.parametrize(("logged", "notes"), [(1.5, 0), (1.9, 0), (2.98, 1), (1.0, 1)])
def test_thrust_far_from_the_starts_is_noted(logged: float, notes: int) -> None:
    check = CheckResult("thrust to weight", PASSES, "hovering", logged, "above 1.02")
    flights: Any = SimpleNamespace(checks={"log": [check]})
    assert len(logs_output.note_thrust(flights, "crazyflie", 1.72)) == notes
    assert logs_output.note_thrust(SimpleNamespace(checks={}), "crazyflie", 1.72) == []  # type: ignore[arg-type]
