"""Flights at the end of training."""

from collections.abc import Sequence
from typing import Any

import jax
import pytest

from flying_policy import flying_policy
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator.controllers import control
from maidenflight.simulator.physics.battery import COUNTS, FIRMWARE_2021
from maidenflight.simulator.realities.virtual_drone import VARIANTS, VirtualDrone
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.failures import BACKUP
from maidenflight.training.final_flights import (
    FLIGHT_S,
    ITSELF,
    SEEDS,
    FinalFlight,
    describe_flights,
    describe_lack,
    find_drones,
    find_falls,
    fly_drones,
    train_until_sound,
)

DRONE = replace(crazyflie(), latency=0.005, motor_time_constant=0.04)


@pytest.mark.slow
def test_flights_tell_a_policy_that_falls_from_one_that_flies(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The one that flies is made by hand, and wanders."""
    monkeypatch.setattr("maidenflight.training.final_flights.ZERO_SHOT", BACKUP)
    policies = [flying_policy(DRONE), flying_policy(DRONE, gain=0.0)]
    one = replace(DRONE, time_step=0.001)
    drones = [VirtualDrone(name, one, thrust_law=None) for name in ("mine", "near:7", "far:7")]
    good, bad = fly_drones(drones, policies, tasks.hover(), control.pwm(), jax.random.key(0))
    assert [flight.kind for flight in good] == [ITSELF, "near", "far"]
    assert all((flight.lasts, flight.seconds) == (True, FLIGHT_S) for flight in good)
    assert all(0.0 < flight.position_error < 1.0 for flight in good)
    assert not any(flight.lasts for flight in bad)
    assert all(0.1 < flight.seconds < 5.0 for flight in bad)
    assert bad[0].is_fault
    falls = find_falls([good, bad], "mine")
    assert falls.keys() == {2}
    assert describe_flights([good, bad], "mine")[1:] == list(falls.values())


def test_a_drone_flies_behind_the_firmware_of_those_about_it() -> None:
    drones = find_drones("mine", DRONE, COUNTS)
    assert [drone.name for drone in drones[:2]] == ["mine", f"near:{SEEDS[0]}"]
    assert len(drones) == 1 + len(VARIANTS) * len(SEEDS)
    assert {drone.thrust_law for drone in drones} == {FIRMWARE_2021}
    assert len({float(drone.parameters.mass) for drone in drones}) > len(SEEDS)


def test_a_drone_that_hangs_on_its_last_thrust_or_whose_loop_turns_over_lacks_something() -> None:
    assert describe_lack(DRONE, control.attitude_rate()) == ""
    weak = replace(DRONE, thrust_to_weight=1.05)
    assert "0.95" in describe_lack(weak, control.pwm())
    late = replace(DRONE, latency=0.04)
    assert "deg" in describe_lack(late, control.attitude_rate())
    assert describe_lack(late, control.pwm()) == "", "it commands no loop"


def flight(lasts: bool, lack: str = "") -> FinalFlight:
    return FinalFlight("far", "far:7", 9.0, "time limit" if lasts else "tilt", 0.01, lack)


@pytest.mark.parametrize(
    ("second", "most", "calls"),
    [
        (flight(True), 10, [(4, None)]),
        (flight(False), 10, [(4, None), (10, [1])]),
        (flight(False), 4, [(4, None)]),
        (flight(False, "no thrust"), 10, [(4, None)]),
    ],
)
def test_only_what_falls_on_a_drone_that_lacks_nothing_is_trained_on(
    second: FinalFlight, most: int, calls: list[Any]
) -> None:
    asked: list[Any] = []

    def train(updates: int, members: Sequence[int] | None) -> tuple[Any, ...]:
        asked.append((updates, members))
        return "sound", updates

    flown: Any = [[flight(True)], [second]]
    policies, flights = train_until_sound(train, lambda _: flown, 4, most)
    assert asked == calls
    assert policies == ("sound", calls[-1][0])
    assert flights is flown


def test_a_sentence_says_where_how_many_and_what_a_drone_lacks() -> None:
    (sentence,) = find_falls([[flight(True), flight(False, "no thrust")]], "mine").values()
    for part in ("policy_1", "far, 1 of 2", "tilt after 9.0 s", "far:7: no thrust"):
        assert part in sentence
