"""`validate --calibration` repeats the identification that the drone's record describes."""

from pathlib import Path

import numpy as np
import pytest

from maidenflight import results
from maidenflight.errors import InputError
from maidenflight.identification.drone_file import DroneFile, GroupGain, Search, Source
from maidenflight.identification.posterior import Posterior
from maidenflight.parameters import crazyflie
from maidenflight.verbs.parts import calibration
from maidenflight.verbs.validate import Validate


def drone(place: Path, start: str = "crazyflie", inputs: tuple[Path, ...] = ()) -> Path:
    settings = {"objective": "likelihood", "start": start, "mass": 31.0, "over": ["latency"]}
    record = results.record(seed=3, inputs=inputs, settings=settings | {"physics_step": 0.001})
    file = DroneFile(
        crazyflie(),
        posterior=Posterior({"latency": np.array([0.01, 0.02])}),
        source=Source(1, 9.0, True, "subsampled", 65535.0),
        search=Search("likelihood", -15.0, 1, 1),
        gains=(GroupGain("drag", 0.1, None, True),),
        record=record,
    )
    return file.write(place)


def test_an_identification_is_repeated_by_the_record(tmp_path: Path) -> None:
    file, verb = calibration.identification_of(drone(tmp_path / "drone.toml"), tmp_path)
    assert (verb.seed, verb.mass, verb.over, verb.logs) == (3, 31.0, "auto", tmp_path)
    assert list(file.posterior) == ["latency"]


def test_the_file_that_it_began_with_is_looked_for_beside_it(tmp_path: Path) -> None:
    begin = drone(tmp_path / "begin.toml")
    _, verb = calibration.identification_of(
        drone(tmp_path / "drone.toml", "begin.toml", (begin,)), tmp_path
    )
    assert Path(verb.start) == begin
    begin.write_text(begin.read_text() + "# other\n")
    with pytest.raises(InputError, match="which is neither here"):
        calibration.identification_of(tmp_path / "drone.toml", tmp_path)


def test_a_drone_without_a_record_is_refused(tmp_path: Path) -> None:
    DroneFile(crazyflie()).write(tmp_path / "drone.toml")
    with pytest.raises(InputError, match="does not say how"):
        Validate(drone=str(tmp_path / "drone.toml"), logs=tmp_path, calibration=True).run()


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ({"in_model": 0}, "not in the model"),
        ({"ranks": [4, 4, 4, 4, 4]}, ""),
        ({"ranks": [0, 0, 20, 0, 0], "uniform": False}, "wider than needed"),
        (
            {"ranks": [18, 2, 0, 0, 0], "uniform": False, "enough": False},
            "too narrow, found too high",
        ),
    ],
)
def test_what_is_wrong_is_said_in_words(row: dict, words: str) -> None:
    assert calibration._verdict({"in_model": 20, "enough": True, "uniform": True, **row}) == words


def test_drones_are_begun_while_there_is_time(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(calibration.time, "monotonic", lambda: now[0])
    clock, count = calibration._Clock(None), 0
    while True:
        now[0] += 60.0 if not count else 10.0
        count += 1
        if clock.count(is_lost=False):
            break
    assert (count, now[0]) == (23, 280.0)
    assert clock.share == pytest.approx(1.0)
    lost = calibration._Clock(None)
    assert [lost.count(is_lost=True) for _ in range(5)] == [False] * 4 + [True]
