"""A battery law that no log names: commands by other laws, and intervals that hold them."""

from dataclasses import replace

import numpy as np
import polars
import pytest

from made_flights import calm
from maidenflight.flights import compensation
from maidenflight.flights.compensation import BRUSHLESS, PLUS
from maidenflight.flights.log import Flight
from maidenflight.identification.drone_file import Estimate, Source
from maidenflight.identification.outcome.battery_laws import average_laws, law_chances
from maidenflight.identification.outcome.estimates import Identification
from maidenflight.identification.posterior import Posterior
from maidenflight.parameters import crazyflie
from maidenflight.simulator.physics.battery import LAWS, MOST_COUNTS

VOLTS = np.full(600, 3.7, np.float32)


@pytest.mark.parametrize("law", [*LAWS, BRUSHLESS])
@pytest.mark.parametrize("other", [PLUS, BRUSHLESS])
def test_commands_read_again_are_those_of_the_other_law(law: str, other: str) -> None:
    pwm = np.random.default_rng(0).uniform(0.3, 0.65, (600, 4)) * MOST_COUNTS
    read = compensation.thrust_command(pwm, VOLTS, law)
    wanted = compensation.thrust_command(pwm, VOLTS, other)
    np.testing.assert_allclose(compensation.reread(read, VOLTS, law, other), wanted, rtol=0.015)


def hover(ratio: float, law: str, named: bool = False) -> Flight:
    """A calm flight with the motors at a share of 3.7 V, read by a law."""
    pwm = MOST_COUNTS * (ratio + 0.03 * np.random.default_rng(1).normal(size=(600, 4)))
    command = compensation.thrust_command(pwm, VOLTS, law)
    flight = calm(rows=600, command=command, battery=VOLTS)
    return replace(flight, assumed_law=None if named else law)


def test_a_law_between_brushed_and_brushless_is_in_doubt() -> None:
    """At 2.0 V either may hover; at 2.5 V it is a brushed one, at 1.6 V a brushless one."""
    for volts, least, most in ((1.6, 0.97, 1.0), (2.0, 0.2, 0.9), (2.5, 0.0, 0.02)):
        chances = {one.law: one.probability for one in law_chances([hover(volts / 3.7, PLUS)])}
        assert least <= chances.get(BRUSHLESS, 0.0) <= most
    assert law_chances([hover(0.5, PLUS, named=True)]) == []


def test_intervals_hold_what_the_laws_say_and_values_stay() -> None:
    flight, generator = hover(2.0 / 3.7, PLUS), np.random.default_rng(0)
    thrust = 1.5 + 0.01 * generator.normal(size=500)
    found = Identification(
        crazyflie(),
        {"thrust_to_weight": Estimate(1.5, (1.48, 1.52), (1.5,), 0.0)},
        *("likelihood", 0.0, 0.0, 1, Source(1, 6.0, False, "subsampled", MOST_COUNTS), 1),
        *(polars.DataFrame(), Posterior({"thrust_to_weight": thrust}), ()),
    )
    averaged = average_laws(found, [flight], generator)
    assert "u = 1, 3.08 V at the motors, 83 % PWM at the flights' 3.70 V" in averaged.notes[0]
    low, high = averaged.estimates["thrust_to_weight"].interval
    for chance in law_chances([flight]):
        if chance.probability > 0.05:
            assert low - 0.02 <= 1.5 * chance.thrust <= high + 0.02
    assert averaged.estimates["thrust_to_weight"].value == 1.5
    assert averaged.notes
    named = hover(2.0 / 3.7, PLUS, named=True)
    assert average_laws(found, [named], generator) is found
