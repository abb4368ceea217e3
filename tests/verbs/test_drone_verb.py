"""`drone --to` writes other programs' files, from a name, a file, logs and a posterior."""

import dataclasses
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import jax
import numpy as np
import pytest

import maidenflight as mf
from commands import Command
from made_flights import calm
from maidenflight import parameters
from maidenflight.deployment.drone_format import DroneFormat
from maidenflight.errors import InputError
from maidenflight.flights import flight_csv
from maidenflight.flights.full_speed import full_speed
from maidenflight.flights.trims import rotors
from maidenflight.identification.drone_file import DroneFile
from maidenflight.identification.posterior import Posterior
from maidenflight.registry import DRONE_FORMATS
from maidenflight.verbs.drone import Drone

RPM = 21000.0


def test_every_format_is_printed_and_written_the_same(command: Command, tmp_path: Path) -> None:
    for to in DRONE_FORMATS:
        words = f"drone x500 --to {to} --full-speed {RPM:g}"
        code, printed, _ = command(words)
        assert code == 0
        assert command(f"{words} -o {tmp_path}/{to}")[0] == 0
        assert (tmp_path / to).read_text().split() == printed.split()
        (only,) = json.loads(command(f"{words} -o {tmp_path}/{to}2 --json")[1])["files"]
        assert only == f"{tmp_path}/{to}2"


def test_a_speed_is_asked_for_where_the_format_has_rotor_speeds() -> None:
    lacking = [to for to in DRONE_FORMATS if DRONE_FORMATS[to].needs_speed]
    assert lacking == ["urdf", "sdf", "rotorpy", "crazyflow", "isaac-lab"]
    for to in lacking:
        with pytest.raises(InputError, match="--full-speed RPM"):
            Drone(drone="x500", to=to).run()
    with pytest.raises(InputError, match="100 to 200000 rpm"):
        Drone(drone="x500", to="sdf", full_speed="3").run()
    for name, value in (("full_speed", "9000"), ("samples", 3)):
        changes: dict[str, Any] = {name: value}
        with pytest.raises(InputError, match="without --to"):
            Drone(drone="x500", **changes).run()


@pytest.mark.slow
def test_the_speed_is_what_logs_measured(tmp_path: Path) -> None:
    """Rotors are simulated under the logged commands, with the lag and latency of the drone."""
    drone, full = mf.crazyflie(), 2300.0
    (flight,) = mf.record(mf.virtual_drone(7), jax.random.key(0), flights=1, duration=4.0)
    share = rotors(flight, drone).speed
    speed = full * np.concatenate([share[:1], share[:-1]])
    measured = dataclasses.replace(flight, rotor_speed=speed)
    assert full_speed([calm(50), measured], drone, "flights") == pytest.approx(full, rel=1e-5)
    flight_csv.write(tmp_path / "flight.csv", measured)
    text = Drone(drone="crazyflie", to="rotorpy", full_speed=str(tmp_path / "flight.csv")).run()
    names: dict[str, Any] = {}
    exec(text.value, names)
    assert names["quad_params"]["rotor_speed_max"] == pytest.approx(full, rel=1e-3)
    with pytest.raises(InputError, match="no log has measured rotor speeds"):
        full_speed([calm(50)], drone, "calm")


def identified(folder: Path) -> Path:
    """A drone's file with a posterior of two parameters."""
    random = np.random.default_rng(0)
    posterior = {
        "motor_time_constant": random.normal(0.06, 0.004, 100),
        "thrust_to_weight": random.normal(1.8, 0.02, 100),
    }
    drone = parameters.replace(mf.crazyflie(), motor_time_constant=0.06, thrust_to_weight=1.8)
    return DroneFile(drone, posterior=Posterior(posterior)).write(folder / "mine.toml")


def test_samples_are_drones_of_the_posterior(tmp_path: Path, command: Command) -> None:
    drone, output = identified(tmp_path), tmp_path / "drones"
    code, _, _ = command(f"drone {drone} --to mjcf --samples 5 -o {output}")
    assert code == 0
    files = sorted(output.iterdir())
    assert [file.name for file in files] == [f"mine_{n:03}.xml" for n in range(1, 6)]
    lags = [
        float(ElementTree.parse(file).getroot().findall("actuator/general")[0].attrib["dynprm"])
        for file in files
    ]
    expected = DroneFile.read(drone).posterior["motor_time_constant"][:5]
    np.testing.assert_allclose(lags, expected, rtol=1e-6)
    for words, cure in (("--samples 5", "-o FOLDER"), ("--samples 500 -o x", "fewer than 500")):
        code, _, err = command(f"drone {drone} --to mjcf {words}")
        assert code == 2
        assert cure in err
    assert "has 0 samples" in command("drone x500 --to mjcf --samples 1 -o x")[2]


def test_ranges_of_isaac_lab_are_the_middle_of_the_posterior(tmp_path: Path) -> None:
    drone = identified(tmp_path)
    text = Drone(drone=str(drone), to="isaac-lab", full_speed=f"{RPM}").run().value
    (line,) = [one for one in text.splitlines() if "tau_inc_range" in one]
    low, high = (float(value) for value in line.split("(")[1].split(")")[0].split(","))
    samples = DroneFile.read(drone).posterior["motor_time_constant"]
    np.testing.assert_allclose([low, high], np.quantile(samples, [0.05, 0.95]), rtol=1e-4)


def test_python_writes_the_same_file(tmp_path: Path) -> None:
    path = mf.export_drone(mf.drone("x500"), tmp_path / "x500.xml", "mjcf")
    assert path.read_text() == Drone(drone="x500", to="mjcf").run().value.replace(
        f"  record: {Drone(drone='x500', to='mjcf').make_record()}\n", ""
    )


def test_a_package_adds_a_format(monkeypatch: pytest.MonkeyPatch) -> None:
    kind = DroneFormat(".txt", lambda one: one, lambda model: "\n".join(model.comments()))
    monkeypatch.setitem(DRONE_FORMATS.own, "plain", kind)
    text = Drone(drone="x500", to="plain").run().value
    assert "does not hold" not in text
