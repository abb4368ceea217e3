"""The page on other programs: its commands and Python run, and its table is what is measured."""

import dataclasses
import re
import shlex
from pathlib import Path

import jax
import numpy as np
import pytest

import maidenflight as mf
from maidenflight import cli, parameters, policy_file
from maidenflight.flights import flight_csv
from maidenflight.flights.trims import rotors
from maidenflight.identification.drone_file import DroneFile
from maidenflight.identification.posterior import Posterior
from maidenflight.policy import untrained_policy
from maidenflight.registry import DRONE_FORMATS
from pages import blocks, run_snippet, section

PAGE = "docs/simulators.md"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def commands(title: str | None = None) -> list[list[str]]:
    """The page's commands of maidenflight."""
    lines = "".join(blocks(PAGE, "sh", title)).splitlines()
    words = [shlex.split(line, comments=True) for line in lines]
    return [line[1:] for line in words if line[:1] == ["maidenflight"]]


def write_own_drone() -> None:
    """A drone with a posterior, and a log of it with measured rotor speeds."""
    drone = mf.drone("crazyflie_2.0")
    posterior = {"latency": np.linspace(0.003, 0.005, 100)}
    DroneFile(drone, posterior=Posterior(posterior)).write("drone.toml")
    (flight,) = mf.record(mf.virtual_drone(7), jax.random.key(0), flights=1, duration=4.0)
    share = rotors(flight, drone).speed
    speed = 2300.0 * np.concatenate([share[:1], share[:-1]])
    flight_csv.write("logs/flight.csv", dataclasses.replace(flight, rotor_speed=speed))


@pytest.mark.slow
def test_drones_are_written_as_the_page_says() -> None:
    write_own_drone()
    written = [line for line in commands() if line[0] == "drone"]
    assert len(written) >= 5
    for line in written:
        cli.commands(line, standalone_mode=False)
        assert Path(line[line.index("-o") + 1]).exists()
    assert len(list(Path("drones").iterdir())) == 100


def test_the_hour_in_mujoco() -> None:
    pytest.importorskip("mujoco", reason="not installed (extra [mujoco])")
    (snippet,) = blocks(PAGE, "python", "MuJoCo")
    data = run_snippet(snippet, PAGE)["data"]
    assert data.sensor("body_rates").data[0] > 0.1
    assert np.abs(data.sensor("position").data[[0, 2]]).max() < 1e-3


@pytest.mark.slow
def test_policies_fly_in_mujoco_as_the_page_says() -> None:
    pytest.importorskip("mujoco", reason="not installed (extra [mujoco])")
    parameters.write_drone("drone.toml", mf.drone("crazyflie_2.0"))
    policy_file.write_policy("policies/policy_1.json", untrained_policy(jax.random.key(0)))
    (line,) = [line for line in commands("MuJoCo") if line[0] == "transfer"]
    cli.commands([*line, "--trials", "1", "--duration", "0.5"], standalone_mode=False)
    flights = Path("transfer/flights.csv").read_text()
    assert "mujoco:drone" in flights
    assert "mujoco:crazyflie+sensors" in flights


def test_the_hour_in_gym_pybullet_drones() -> None:
    pytest.importorskip("pybullet", reason="not installed (extra [pybullet])")
    for line in commands("gym-pybullet-drones"):
        cli.commands(line, standalone_mode=False)
    (snippet,) = blocks(PAGE, "python", "gym-pybullet-drones")
    position = np.array(run_snippet(snippet, PAGE)["position"])
    np.testing.assert_allclose(position, 0.0, atol=1e-3)


def test_the_table_has_every_format_once() -> None:
    rows = re.findall(r"^\|[^|]+\| `(\w[\w-]*)` \|", section(PAGE, "Where it flies"), re.MULTILINE)
    assert rows[: len(DRONE_FORMATS.own)] == list(DRONE_FORMATS.own)
    assert set(rows[len(DRONE_FORMATS.own) :]) == {"raptor", "px4"}
