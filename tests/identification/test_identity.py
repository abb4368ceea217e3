"""A policy knows its drone, and another drone is refused before it flies."""

from pathlib import Path

import jax
import pytest

from maidenflight import names, policy_file
from maidenflight.errors import InputError
from maidenflight.identification import drone_file
from maidenflight.identification.drone_file import DroneFile, Source
from maidenflight.identification.identity import (
    check_same_drone,
    describe_other_counts,
    identity_of,
    propellers_of,
)
from maidenflight.parameters import crazyflie
from maidenflight.policy import untrained_policy
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.verbs.export import Export

OURS = {"name": "ours", "mass": 0.03, "battery_law": names.LEGACY_PROPELLERS}


@pytest.mark.parametrize(
    ("other", "words"),
    [
        ({"mass": 0.0316}, "of 30.0 g, but theirs has 31.6 g"),
        ({"battery_law": names.PLUS_PROPELLERS}, "legacy propellers.*2.1"),
    ],
)
def test_another_mass_or_battery_law_is_refused(other: dict[str, object], words: str) -> None:
    theirs = {**OURS, "name": "theirs"}
    check_same_drone("policy", OURS, {**theirs, "mass": 0.0314})
    with pytest.raises(InputError, match=words):
        check_same_drone("policy", OURS, {**theirs, **other})


def test_a_policy_that_names_no_drone_cannot_be_compared() -> None:
    with pytest.raises(InputError, match="names no mass of its drone"):
        check_same_drone("policy", {}, OURS)


def test_an_app_gets_the_propellers_of_its_policy_s_drone(tmp_path: Path) -> None:
    policy = untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(8,)))
    path = policy_file.write_policy(tmp_path / "policy.json", policy, {"drone": OURS})
    assert policy_file.read_policy(path).identity == OURS
    Export(policy=path, to="crazyflie").run(tmp_path / "app")
    assert "LEGACY_PROPELLERS=y" in (tmp_path / "app/app-config").read_text()
    with pytest.raises(InputError, match=r"--propellers 2\.1\+.*identified with legacy"):
        Export(policy=path, to="crazyflie", propellers="2.1+").run(tmp_path / "other")


def test_identity_of_a_named_drone_is_its_mass() -> None:
    identity = identity_of(drone_file.read("crazyflie_2.1+"))
    assert identity["name"] == "crazyflie_2.1+"
    assert identity["mass"] == pytest.approx(0.029, abs=0.002)
    assert propellers_of(identity) == ""
    assert propellers_of(OURS) == "legacy"


@pytest.mark.parametrize(("own", "words"), [(60000.0, "9% too strong"), (65535.0, "")])
def test_simulated_thrust_is_off_where_full_commands_are_other_counts(
    own: float, words: str
) -> None:
    """Full PWM of 65,535 counts is 9 % more than 60,000."""
    flights = Source(1, 9.0, True, "subsampled", 65535.0)
    drone = DroneFile(crazyflie(), name="mine.toml", source=flights)
    difference = describe_other_counts(own, drone)
    assert words in difference
    assert bool(difference) == bool(words)
