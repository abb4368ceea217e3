import dataclasses

import jax
import numpy as np
import pytest

from flying_policy import flown, flying_policy
from made_flights import calm
from maidenflight.errors import InputError
from maidenflight.flights.log import Flight
from maidenflight.identification.behaviour import (
    BEHAVIOUR,
    attitude_delay,
    behaviour,
    flights_of_policies,
    mean_behaviour,
)
from maidenflight.parameters import crazyflie
from maidenflight.policy import Policy, untrained_policy
from maidenflight.simulator.controllers import control
from maidenflight.simulator.policy_spec import PolicySpec
from maidenflight.simulator.tasks.look_ahead import LookAhead

pytestmark = pytest.mark.slow

POLICIES = {
    "soft": flying_policy(crazyflie(), 0.7),
    "stiff": flying_policy(crazyflie(), 1.6),
}


def test_a_log_tells_which_policy_flew_it() -> None:
    flights = [
        flown(POLICIES["soft"], 1),
        flown(POLICIES["stiff"], 2),
        calm(30, 4),
        calm(30, 5, period=0.02),
        calm(10, 6),
    ]
    found = flights_of_policies(flights, POLICIES)
    names = {name: [flight.name for flight in own] for name, own in found.items()}
    assert names == {"soft": ["flight 1"], "stiff": ["flight 2"]}
    # A last action is all that history holds of what the log does not.
    random = untrained_policy(jax.random.key(1), spec=PolicySpec(history=3, memory=4, hidden=(16,)))
    random = random.with_network(
        ((random.weights[0], 5.0 * random.weights[1]), random.biases, random.gru)
    )
    other = untrained_policy(jax.random.key(2), spec=PolicySpec(history=3, memory=4, hidden=(16,)))
    assert list(flights_of_policies([flown(random, 1)], {"other": other, "own": random})) == ["own"]


@pytest.mark.parametrize(
    ("policies", "words"),
    [
        ({"a": untrained_policy(jax.random.key(0), interface=control.attitude().interface)}, "pwm"),
        (
            {"a": untrained_policy(jax.random.key(0), spec=PolicySpec(look_ahead=LookAhead(2)))},
            "look",
        ),
        (
            {
                "a": untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(8,))),
                "b": untrained_policy(jax.random.key(0), spec=PolicySpec(hidden=(9,))),
            },
            "different",
        ),
    ],
)
def test_only_policies_of_one_kind_that_command_motors_are_compared(
    policies: dict[str, Policy], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        flights_of_policies([calm(60)], policies)


def test_behaviour_is_the_standard_deviations_of_what_a_loop_does() -> None:
    rows, period = 400, 0.01
    time = period * np.arange(rows)[:, None]
    swing = np.sin(2 * np.pi * 2.0 * time)  # whole swings between what is left out
    command = 0.5 + 0.1 * swing * np.array([[-1.0, -1.0, 1.0, 1.0]])
    still = np.zeros((rows, 3))
    found = behaviour(
        still, 3.0 * swing * np.ones(3), 0.2 * swing * np.ones(3), swing * np.ones(3), command,
        crazyflie(), period,
    )  # fmt: skip
    assert found is not None
    told = dict(zip(BEHAVIOUR, np.exp(found), strict=True))
    assert told["body rates"] == pytest.approx(np.sqrt(0.5), rel=0.02)
    assert told["tilt"] == pytest.approx(0.2 * np.sqrt(0.5), rel=0.02)
    assert told["change of velocity"] == pytest.approx(
        3.0 * 2 * np.pi * 2.0 * period * np.sqrt(0.5), rel=0.02
    )
    # Roll alone, of four rotors 28 mm from the axis; two axes share the standard deviation.
    assert told["torques"] == pytest.approx(0.4 * 0.028 * np.sqrt(0.25), rel=0.02)
    assert told["change of position"] < 1e-6


def test_attitude_tells_how_far_it_is_behind_the_gyro() -> None:
    time = 0.01 * np.arange(600)

    def late(delay: float) -> Flight:
        angles = [
            sum(size * np.sin(2 * np.pi * hertz * (time - by)) for size, hertz in swings)
            for by in (delay, 0.0)
            for swings in (((0.10, 2.7), (0.03, 5.1)), ((0.08, 3.4), (0.02, 6.2)))
        ]
        attitude, true = (np.stack([*pair, 0 * time], axis=1) for pair in (angles[:2], angles[2:]))
        rates = np.gradient(true, 0.01, axis=0)
        return dataclasses.replace(calm(600), attitude=attitude, body_rates=rates)

    told = attitude_delay([late(0.007), late(0.008), late(0.009), calm(140)])
    assert told is not None
    assert told[0] == pytest.approx(0.008, abs=2e-4)
    assert told[1] == pytest.approx(0.001 * np.sqrt(np.pi / 6), rel=0.1)
    assert attitude_delay([late(0.008), calm(140)]) is None


def test_short_flights_tell_nothing_and_the_longest_part_counts() -> None:
    drone = crazyflie()
    assert mean_behaviour([calm(70), calm(30)], drone) is None
    long, longer = calm(700), calm(1500)
    found = [
        mean_behaviour(flights, drone)
        for flights in ([long, calm(30)], [long], [longer], [longer.part(0, 640)])
    ]
    known = [one for one in found if one is not None]
    assert len(known) == 4
    np.testing.assert_array_equal(known[0], known[1])
    np.testing.assert_allclose(known[2], known[3], rtol=1e-5)
