"""`Validate` judges a drone beside the baseline and another drone; `identify` notes odd thrust."""

from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest

from made_flights import calm
from maidenflight import run_folder
from maidenflight.disturbances import horizons
from maidenflight.disturbances.horizons import PERSISTENCE, SUMS, WITH_DISTURBANCES
from maidenflight.disturbances.kalman import Filtered
from maidenflight.flights.checkup.result import PASSES, CheckResult
from maidenflight.flights.reading import Flights
from maidenflight.identification.drone_file import DroneFile
from maidenflight.parameters import QUANTITIES, crazyflie
from maidenflight.run_folder import ERROR_UNITS
from maidenflight.verb import Progress
from maidenflight.verbs import validate
from maidenflight.verbs.parts import logs_output


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
    plain, square = calm(4), calm(4, square_since="THR_MDL_FAC is 0")
    said = [
        logs_output.note_thrust(Flights((one,), (), (), (), {"log": checks}), "crazyflie", 1.72)
        for one, checks in ((plain, (check,)), (square, (check,)), (plain, ()))
    ]
    assert list(map(len, said)) == [notes, notes, 0]
    assert any("THR_MDL_FAC is 0" in one for one in said[1]) is (logged > 2.9)


def ahead_rows() -> list[dict[str, Any]]:
    """Errors after two times and their sums, of the model and of persistence."""
    return [
        {"model": model, "horizon": horizon, "windows": 9}
        | dict.fromkeys(ERROR_UNITS, 0.1 * (1 + number))
        | {
            f"{name}_within_{share}": float("nan") if number else share / 100
            for name in ERROR_UNITS
            for share in (80, 95)
        }
        for horizon in (0.02, 0.33, SUMS)
        for number, model in enumerate((WITH_DISTURBANCES, PERSISTENCE))
    ]


def filtered() -> Filtered:
    """A flight on which a torque about x sways."""
    none = np.zeros((400, 3))
    torque = none + np.sin(np.arange(400)[:, None] / 50.0) * np.array([2e-4, 0.0, 0.0])
    small = 1e-12 * np.eye(3)
    return Filtered(none, none, np.zeros((400, 4)), none, torque, none, small, small, 0.01)


def test_predictions_with_disturbances_are_written_whole_and_shown_in_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = polars.DataFrame(ahead_rows())
    monkeypatch.setattr(horizons, "cross_validate", lambda *_: (table, [filtered()]))
    verb = validate.Validate(drone="crazyflie", logs=tmp_path, disturbances=True)
    places = verb.places(tmp_path / "mine.csv")
    file = DroneFile(crazyflie(), record={"seed": 1})
    rows = verb._predict_ahead([], file, places, {"seed": 2}, Progress())
    assert [one.name for one in places[2:]] == ["mine_ahead.csv", "crazyflie_disturbed.toml"]
    disturbed = DroneFile.read(places[3])
    assert disturbed.record == {"seed": 1, "disturbances": {"seed": 2}}
    assert disturbed.parameters.disturbance_torque[0] > 1e-4
    same = [name for name in QUANTITIES if QUANTITIES[name].table != "disturbance"]
    for name in same:
        before, after = (getattr(one.parameters, name) for one in (file, disturbed))
        np.testing.assert_array_equal(before, after)
    assert len(run_folder.AHEAD.read(places[2])[0]) == 6
    assert {row["horizon"] for row in rows} == {0.02, 0.33, SUMS}
    printed = validate._tabulate_ahead(rows)
    assert len(printed[0].rows) == 6  # type: ignore[union-attr]
    assert "(80/95)" in printed[0].rows[0]["attitude"]  # type: ignore[union-attr]
    plain = validate.Validate(drone="crazyflie", logs=tmp_path)
    assert plain._predict_ahead([], file, places, {}, Progress()) == []
    assert len(plain.places(tmp_path / "mine.csv")) == 2
    assert validate._tabulate_ahead([]) == []


def test_errors_are_written_beside_the_drone(tmp_path: Path) -> None:
    drone = tmp_path / "mine.toml"
    drone.write_text("")
    for calibration, name in ((False, "validation.csv"), (True, "calibration.csv")):
        verb = validate.Validate(drone=str(drone), logs=tmp_path, calibration=calibration)
        assert verb.choose_output(None) == tmp_path / name
        assert verb.choose_output("other.csv") == Path("other.csv")
    named = validate.Validate(drone="crazyflie", logs=tmp_path)
    assert named.choose_output(None) == Path("validation.csv")
