"""Realities by name, and what counts as one."""

import sys
from pathlib import Path

import numpy as np
import pytest

from maidenflight import parameters
from maidenflight.errors import InputError
from maidenflight.registry import REALITIES
from maidenflight.simulator.realities.reality import MOTORS, check_reality, reality
from maidenflight.simulator.realities.virtual_drone import VARIANTS, VirtualDrone
from numpy_drone import NumpyDrone

MODULE = """
from numpy_drone import NumpyDrone

def mine():
    return NumpyDrone(name="mine")

def nothing():
    return 7

constant = 3
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module of one's own in the working folder."""
    (tmp_path / "own_simulator.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", list(sys.path))
    return "own_simulator"


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_seed_makes_a_registered_reality(variant: str) -> None:
    made = reality(f"{variant}:12")
    assert isinstance(made, VirtualDrone)
    assert made.name == f"{variant}:12"


def test_a_reality_is_added_by_one_entry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(REALITIES.own, "numpy", lambda seed: NumpyDrone(name=f"numpy-{seed}"))
    assert reality("numpy:3").name == "numpy-3"
    with pytest.raises(InputError, match="numpy:7"):
        reality("nunpy:7")


def test_a_drones_file_and_a_named_drone_are_realities_at_1_khz(tmp_path: Path) -> None:
    heavy = parameters.replace(parameters.crazyflie(), mass=0.031)
    parameters.write_drone(tmp_path / "heavy.toml", heavy, {})
    made = reality(str(tmp_path / "heavy.toml"))
    assert isinstance(made, VirtualDrone)
    assert made.name == "heavy"
    assert made.parameters.mass == np.float32(0.031)
    assert made.parameters.time_step == np.float32(0.001)
    assert reality("crazyflie").name == "crazyflie"


def test_a_factory_in_the_working_folder_makes_a_reality(module: str) -> None:
    assert reality(f"{module}:mine").name == "mine"


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("virtual:x", "virtual:7"),
        ("virtual:", "virtual:7"),
        ("virtul:5", "virtual:5"),
        ("crazyfly", "crazyflie"),
        ("crazyflo:cf2x_L250", "crazyflow:cf2x_L250"),
        ("virtul:drone", "virtual"),
        ("no_such_module:drone", "no_such_module"),
        ("own_simulator:yours", "yours"),
        ("own_simulator:constant", "constant"),
        ("own_simulator:nothing", "7"),
        ("nothing.toml", "nothing.toml"),
    ],
)
def test_what_is_no_reality_is_refused_and_what_was_meant_is_named(
    module: str, name: str, meant: str
) -> None:
    with pytest.raises(InputError, match=meant):
        reality(name)


@pytest.mark.parametrize("given", [7, "virtul:7", NumpyDrone, VirtualDrone, parameters.crazyflie()])
def test_what_lacks_the_protocol_is_no_reality(given: object) -> None:
    with pytest.raises(InputError):
        check_reality(given)


def test_what_has_the_protocol_is_a_reality() -> None:
    drone = NumpyDrone()
    assert check_reality(drone) is drone
    assert drone.takes == MOTORS
