"""`Identify`: what its record says of the logs, and the drone that it starts with."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest

from made_flights import calm
from maidenflight.flights.checkup.result import LogWarning
from maidenflight.flights.reading import Flights
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import DroneFile, Estimate, Source
from maidenflight.identification.likelihood.selection import FIRST, WITH_KNOWN_LAG
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.outcome.narrowing import advise
from maidenflight.identification.posterior import Posterior
from maidenflight.identification.start import note_mass, read_start
from maidenflight.parameters import crazyflie
from maidenflight.verbs.identify import Identify
from maidenflight.verbs.parts import estimates_output

NOTHING = Identification(
    *(crazyflie(), {}, "likelihood", 0.0, 0.0, 1),
    *(Source(1, 9.0, True, "subsampled", 65535.0), 1),
    *(polars.DataFrame({"trial": [1], "objective": [0.0]}), Posterior({}), ()),
)
"""What an identification found that identified nothing."""


def test_how_logs_were_read_stands_in_the_drone_file_s_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[tuple[Any, ...], dict[str, Any]]] = []

    def read(*arguments: Any, **settings: Any) -> Flights:
        calls.append((arguments, settings))
        return Flights((), (), ())

    monkeypatch.setattr("maidenflight.flights.reading.read_flights", read)
    monkeypatch.setattr("maidenflight.identification.identify.identify", lambda *_, **__: NOTHING)
    monkeypatch.setattr("maidenflight.reporting.figures.picture.svg", lambda *_: "")
    reading: dict[str, Any] = {
        "most_seconds": 60.0,
        "commands": "subsampled",
        "battery_law": "legacy propellers",
        "ignore": ("rotor_speed",),
    }
    place = tmp_path / "drone.toml"
    Identify(logs=tmp_path, **reading).run(place)
    arguments, settings = calls[0]
    assert arguments[2:4] == (60.0, 100)
    others = {name: value for name, value in reading.items() if name != "most_seconds"}
    assert settings == others | {"faulty": "refuse", "drone": "crazyflie"}
    made = drone_file.read(place).record["settings"]
    assert {name: made[name] for name in reading} == reading | {"ignore": ["rotor_speed"]}
    Identify(logs=tmp_path).run(place)
    made = drone_file.read(place).record["settings"]
    assert not {"commands", "battery_law", "ignore"} & set(made)


def test_what_is_wrong_with_logs_is_printed_and_stays_with_the_drone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong = LogWarning("thrust curve", "one.csv", "It is curved.", "", 0.5, "0.58 .. 1.35")

    def read(*_: Any, **__: Any) -> Flights:
        return Flights((), (), (), warnings=(wrong,))

    monkeypatch.setattr("maidenflight.flights.reading.read_flights", read)
    monkeypatch.setattr("maidenflight.identification.identify.identify", lambda *_, **__: NOTHING)
    monkeypatch.setattr("maidenflight.reporting.figures.picture.svg", lambda *_: "")
    result = Identify(logs=tmp_path).run(tmp_path / "drone.toml")
    assert str(wrong) in result.notes
    assert result.content["flights"]["warnings"] == [dataclasses.asdict(wrong)]
    assert wrong in drone_file.read(tmp_path / "drone.toml").warnings


@pytest.mark.parametrize(
    ("objective", "expected"), [("likelihood", [(120, 100), (130, 100)]), ("replay", [])]
)
def test_flights_with_a_state_have_their_programs_compiled_while_others_are_read(
    objective: str, expected: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[tuple[int, int]] = []
    bare = calm(
        rows=90, position=np.full((90, 3), np.nan), accelerometer=np.tile([0.0, 0.0, 9.81], (90, 1))
    )

    def read(logs: Any, on_file: Any, most: float, lead_in: int, on_flight: Any, **_: Any) -> Any:
        for flight in (bare, calm(rows=120), calm(rows=130)):
            on_flight(flight)
        return Flights((), (), ())

    def start(flight: Any, lead_in: int) -> None:
        begun.append((len(flight), lead_in))

    likelihood = "maidenflight.identification.likelihood"
    monkeypatch.setattr("maidenflight.flights.reading.read_flights", read)
    monkeypatch.setattr(f"{likelihood}.compiling.start_compiling", start)
    monkeypatch.setattr("maidenflight.identification.identify.identify", lambda *_, **__: NOTHING)
    monkeypatch.setattr("maidenflight.reporting.figures.picture.svg", lambda *_: "")
    Identify(logs=tmp_path, objective=objective).run(tmp_path / "drone.toml")
    assert begun == expected


def test_the_mass_is_asked_for_where_nobody_gave_it(tmp_path: Path) -> None:
    real, simulated = (Flights((calm(simulated=name),), (), ()) for name in ("", "virtual drone 7"))
    DroneFile(crazyflie()).write(tmp_path / "mine.toml")
    mine = str(tmp_path / "mine.toml")
    assert "27 g" in note_mass("crazyflie_2.0", None, real)[0]
    for drone, grams, flights in (
        ("crazyflie_2.0", None, simulated),
        ("crazyflie_2.0", 30.0, real),
        ("crazyflie_bolt", 100.0, real),
        (mine, None, real),
    ):
        assert note_mass(drone, grams, flights) == []
    assert float(read_start(mine, 31.0).parameters.mass) == np.float32(0.031)
    assert float(read_start("crazyflie", 31.0).parameters.mass) == np.float32(0.031)


def test_what_flights_hardly_determine_has_a_flight_that_does() -> None:
    """A lag known within a factor of two, no drag; inertia known within a tenth needs nothing."""
    estimates = {
        "motor_time_constant": Estimate(0.07, (0.05, 0.1), (0.07,), 0.0),
        "inertia_x": Estimate(2e-5, (1.9e-5, 2.1e-5), (2e-5,), 0.0),
    }
    unidentified = dict.fromkeys(("drag_x", "drag_y", "drag_z"), (0.0, 0.5))
    found = dataclasses.replace(
        NOTHING,
        estimates=estimates,
        unidentified=unidentified,
        advice=advise(estimates, unidentified, {}, None),
    )
    lines = estimates_output.describe_advice(found)
    assert lines[-1] == "narrow drag_z, 0 .. 0.5 1/s: climb and sink"
    (advice,) = (line for line in estimates_output.summarize(found) if "to narrow" in line)
    assert "1 m/s along x and y (drag_x, drag_y)" in advice
    assert "climb and sink (drag_z)" in advice
    assert "250 Hz" in advice
    assert "inertia" not in advice


def test_every_parameter_that_is_chosen_has_a_flight_that_determines_it() -> None:
    names = [name for group in WITH_KNOWN_LAG.values() for name in group]
    for name in {*FIRST, *names} - {"thrust_to_weight", "rotational_damping"}:
        assert advise({}, (name,), {}, None)[0].parameter == name
