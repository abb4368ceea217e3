import dataclasses
from typing import Any

import jax
import numpy as np
import pytest

from made_flights import calm
from maidenflight.errors import InputError
from maidenflight.experiments.transfer import activity, firmware_pilot, fly_firmware, transfer
from maidenflight.flying import engine
from maidenflight.flying.foreign_policy import foreign_policy
from maidenflight.parameters import crazyflie, replace
from maidenflight.policy import untrained_policy
from maidenflight.simulator.controllers.control import attitude, attitude_rate
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.realities.reality import reality as named
from maidenflight.simulator.realities.virtual_drone import VirtualDrone, virtual_drone
from maidenflight.simulator.tasks.look_ahead import NONE, LookAhead
from numpy_drone import TWIN, NumpyDrone

POLICIES = [untrained_policy(jax.random.key(number)) for number in range(2)]


def test_the_firmware_is_left_out_where_it_cannot_hold_the_drone() -> None:
    strong = VirtualDrone("strong", replace(crazyflie(), thrust_to_weight=20.0))
    tables, (note,) = fly_firmware(["pid"], [strong], 1, jax.random.key(0))
    assert tables == []
    assert note.startswith("the firmware's pid does not fly in strong: strong hovers at")


@pytest.mark.parametrize("counts", [60000.0, 65535.0])
def test_the_firmware_has_as_much_thrust_as_the_policies_beside_it(counts: float) -> None:
    assert firmware_pilot("pid", counts).full_scale_counts == counts


@pytest.mark.slow
def test_the_firmwares_pid_lags_behind_the_circle_but_flies_it() -> None:
    place, key = virtual_drone(7), jax.random.key(0)
    (flown,), notes = fly_firmware(["pid"], [place], 2, key, duration=6.0)
    assert notes == []
    assert flown["end_reason"].to_list() == ["time limit"] * 2
    assert 0.1 < min(flown["position_error"]) < max(flown["position_error"]) < 0.3
    assert max(flown["largest_tilt"]) < np.radians(15.0), "it starts without a jump"


@pytest.mark.slow
def test_every_policy_flies_every_reality_and_the_logs_match_the_table() -> None:
    realities = [virtual_drone(1), virtual_drone(2)]
    flown = transfer(POLICIES, realities, trials=2, key=jax.random.key(0), duration=0.6)
    again = transfer(POLICIES, realities, trials=2, key=jax.random.key(0), duration=0.6)
    assert flown.table.equals(again.table)
    assert repr(flown).startswith("<8 flights of 2 policies in 2 realities: ")
    assert flown.table.select("policy", "reality", "trial").rows() == [
        (policy, reality, trial)
        for reality in ("virtual:1", "virtual:2")
        for policy in ("policy_1", "policy_2")
        for trial in (1, 2)
    ]
    assert flown.table["flight"].to_list() == list(range(1, 9))
    for flight, duration, reality in zip(
        flown.flights, flown.table["duration"], flown.table["reality"], strict=True
    ):
        assert flight.duration == pytest.approx(duration)
        assert flight.zero_order_hold
        assert flight.simulated == reality
        assert np.isfinite(flight.position).all()
    assert not np.array_equal(flown.flights[0].position[0], flown.flights[1].position[0])


@pytest.mark.slow
def test_a_flight_is_the_same_until_its_drone_changes() -> None:
    names = ("virtual:1", "virtual:1+yaw20000@0.2", "virtual:1+payload15@0.1+weak10@0.1")
    program: Any = engine._simulate
    flown, programs = [], []
    for name in names:
        given = transfer(POLICIES, named(name), 2, jax.random.key(0), duration=0.6)
        flown.append(given.flights)
        programs.append(program._cache_size())
    assert programs[2] == programs[1], "jumps share a program"
    for plain, *others in zip(*flown, strict=True):
        for other, name, rows in zip(others, names[1:], (20, 10), strict=True):
            assert other.simulated == name
            # A row is measured before its period, in which the change acts first.
            before, length = rows + 1, min(len(plain), len(other))
            for group in ("position", "body_rates", "command"):
                here, there = (getattr(one, group) for one in (plain, other))
                np.testing.assert_allclose(there[:before], here[:before], rtol=0, atol=1e-5)
            turned = np.abs(other.body_rates[before:length] - plain.body_rates[before:length])
            assert turned.max() > 1e-3
            assert turned[0].max() > 1e-4, "the first row that it can be seen in"


def test_a_change_in_flight_is_refused_for_policies_that_fly_alone() -> None:
    pid = foreign_policy("pid")
    assert pid is not None
    with pytest.raises(InputError, match=r"virtual:1\+yaw4000@5"):
        transfer([*POLICIES, pid], named("virtual:1+yaw4000@5"), duration=0.1)


@pytest.mark.slow
def test_an_untrained_policy_ends_by_a_guard() -> None:
    table = transfer(POLICIES, [virtual_drone(1)], trials=1, duration=2.0).table
    assert set(table["end_reason"]) <= {"tilt", "position error", "body rate"}
    assert (table["duration"] < 2.0).all()
    assert (table["position_error"] < 0.3).all()


@pytest.mark.slow
def test_policies_of_one_control_structure_fly_together_whatever_their_counts() -> None:
    counts = dataclasses.replace(POLICIES[1].interface, full_scale_counts=65535.0)
    identified = dataclasses.replace(POLICIES[1], interface=counts)
    flown = transfer([POLICIES[0], identified], [virtual_drone(1)], 1, 0, duration=0.1)
    assert flown.table["policy"].to_list() == ["policy_1", "policy_2"]
    assert flown.table["position_error"].n_unique() == 2


def test_other_control_structures_and_empty_lists_are_refused() -> None:
    other = untrained_policy(jax.random.key(0), attitude().interface)
    with pytest.raises(InputError, match="attitude and pwm"):
        transfer([POLICIES[0], other], [virtual_drone(1)])
    with pytest.raises(InputError, match="at least one"):
        transfer([], [virtual_drone(1)])


@pytest.mark.parametrize(
    ("policies", "realities", "given"),
    [
        (
            ["policy_1.json"],
            [virtual_drone(1)],
            "policy_1.json",
        ),
        (
            POLICIES[0],
            ["virtul:7"],
            "virtual:7",
        ),
        (POLICIES, [crazyflie()], "Parameters"),
    ],
    ids=["policy", "reality", "parameters"],
)
def test_what_is_no_policy_or_no_reality_is_refused(policies, realities, given: str) -> None:
    with pytest.raises(InputError, match=given):
        transfer(policies, realities)


@pytest.mark.slow
def test_one_policy_and_one_reality_need_no_list() -> None:
    alone = transfer(POLICIES[0], virtual_drone(1), trials=4, duration=0.6).table
    assert alone["policy"].to_list() == ["policy_1"] * 4


def test_a_controller_of_another_interface_is_refused() -> None:
    with pytest.raises(
        InputError,
        match=r"name='pwm'.*attitude_rate",
    ):
        transfer(POLICIES, [virtual_drone(1)], controller=attitude_rate())


@pytest.mark.slow
@pytest.mark.parametrize("controller", [None, attitude_rate()], ids=["pwm", "attitude_rate"])
def test_a_reality_in_numpy_is_flown_as_the_same_drone_in_jax(controller) -> None:
    """To 1 mm over 0.4 s, with motor commands held for 10 ms, by policies that look ahead, and with
    PIDs at 500 Hz."""
    policies = [
        untrained_policy(
            jax.random.key(number),
            controller and controller.interface,
            PolicySpec(look_ahead=NONE if controller else LookAhead(2, 0.4)),
        )
        for number in range(2)
    ]
    # Points ahead weigh so much that those of another period would be noticed.
    policies = [
        dataclasses.replace(one, observation_std=one.observation_std.at[40:].mul(0.1))
        for one in policies
    ]
    drone = NumpyDrone()
    flown = transfer(policies, [drone, TWIN], trials=1, duration=0.4)
    again = transfer(policies, [TWIN, drone], trials=1, duration=0.4)
    for here, there in zip(flown.flights[:2], again.flights[:2], strict=True):
        assert (here.simulated, there.simulated) == ("numpy", "jax")
        assert (here.zero_order_hold, len(here)) == (there.zero_order_hold, len(there))
        np.testing.assert_allclose(here.position, there.position, atol=1e-3)
        np.testing.assert_allclose(here.command, there.command, atol=1e-3)


def test_a_foreign_reality_is_flown_no_further_than_a_guard_trips() -> None:
    drone = NumpyDrone()
    table = transfer(POLICIES[0], drone, trials=1, duration=3.0).table
    assert table["end_reason"][0] != "time limit"
    assert drone.commands == round(table["duration"][0] * drone.rate)


class Commanded(NumpyDrone):
    """Keeps what it is commanded, as a drone whose own PIDs follow it."""

    def reset(self, position, seed) -> None:
        super().reset(position, seed)
        self.given: list[np.ndarray] = []

    def step(self, command) -> None:
        self.given.append(command)
        super().step(np.full(4, self.hover))


def test_a_reality_with_the_policies_own_controller_is_given_its_commands() -> None:
    drone = Commanded(takes="attitude_rate", rate=100)
    controller = attitude_rate()
    policy = untrained_policy(jax.random.key(0), interface=controller.interface)
    (flight,) = transfer(policy, drone, trials=1, duration=0.2).flights
    given = np.array(drone.given)
    assert (len(given), len(flight), flight.zero_order_hold) == (20, 10, False)
    np.testing.assert_array_equal(given[::2], given[1::2])
    assert ((given[:, 0] > 0) & (given[:, 0] < 1)).all()
    assert 0 < np.abs(given[:, 1:]).max() <= np.radians(60.0) + 1e-6


def test_a_reality_that_takes_something_else_is_refused() -> None:
    with pytest.raises(InputError, match="attitude"):
        transfer(POLICIES, NumpyDrone(takes="attitude"), trials=1, duration=0.2)


def test_activity_is_the_change_of_commands_in_10_ms_and_their_share_at_limits():
    def flight(low, high, period):
        logged = calm(100, command=np.tile(np.array([[low] * 4, [high] * 4], np.float32), (50, 1)))
        return dataclasses.replace(logged, period=period)

    assert activity(flight(0.5, 0.7, 0.01)) == {
        "command_change": pytest.approx(0.2, abs=1e-5),
        "at_limits": 0.0,
    }
    assert activity(flight(0.5, 0.7, 0.02))["command_change"] == pytest.approx(0.1, abs=1e-5)
    assert activity(flight(0.0, 1.2, 0.01))["at_limits"] == 1.0
