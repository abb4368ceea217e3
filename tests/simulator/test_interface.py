"""A control interface says what outputs mean, and what makes no sense is refused."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.simulator import interface
from maidenflight.simulator.interface import THRUST, ControlInterface

WINCH = ControlInterface(
    "winch", (0.4, 0.0, 1.0, -2.0), (0.2, 3.0, 0.5, 4.0), (THRUST, "N m", "rad", "m/s"), 40
)


def test_a_command_is_the_centre_and_the_span_of_the_clipped_action():
    command = WINCH.command(jnp.array([-3.0, 0.5, 1.0, 7.0]))
    np.testing.assert_allclose(command, [0.2, 1.5, 1.5, 2.0], rtol=1e-6)
    doubled = WINCH.command(jnp.array([-3.0, 0.5, 1.0, 7.0]), (2.0, 2.0, 1.0, 1.0))
    np.testing.assert_allclose(doubled, [0.4, 3.0, 1.5, 2.0], rtol=1e-6)
    np.testing.assert_allclose(WINCH.scaled(jnp.full(4, 2.0)), [0.8, 6.0, 2.0, 6.0], rtol=1e-6)


@pytest.mark.parametrize("one", [WINCH, *(make() for make in interface.INTERFACES.values())])
def test_the_level_action_commands_a_share_of_thrust_and_zero_of_the_rest(one):
    command = one.scaled(one.level(jnp.float32(0.55)))
    wanted = [0.55 if unit == THRUST else 0.0 for unit in one.units]
    np.testing.assert_allclose(command, wanted, atol=1e-6)


@pytest.mark.parametrize(
    ("make", "low", "high"),
    [
        (interface.pwm, [0] * 4, [1] * 4),
        (interface.attitude_rate, [0, *np.radians([-60] * 3)], [1, *np.radians([60] * 3)]),
        (interface.attitude, [7 / 12, *np.radians([-10] * 3)], [11 / 12, *np.radians([10] * 3)]),
    ],
)
def test_the_papers_scales(make, low, high):
    np.testing.assert_allclose(make().command(jnp.full(4, -1.0)), low, atol=1e-6)
    np.testing.assert_allclose(make().command(jnp.full(4, 1.0)), high, atol=1e-6)


def test_equal_interfaces_are_equal_whatever_their_numbers_were_written_as():
    lists = WINCH.to_dict() | {"centre": [0.4, 0, 1, -2], "units": list(WINCH.units)}
    assert ControlInterface.from_dict(lists) == WINCH
    assert len({ControlInterface.from_dict(lists), WINCH}) == 1


@pytest.mark.parametrize(
    ("field", "wrong"),
    [
        *(("name", wrong) for wrong in ("", "Winch", "a b", 'x"', "*/", 3, None)),
        *(("centre", wrong) for wrong in ((0,) * 3, None, (0, 0, 0, np.nan), 1.0, (True,) * 4)),
        *(("span", wrong) for wrong in ((0, 1, 1, 1), (1, 1, 1, -1), (1, 1, 1, np.inf), "span")),
        *(("units", wrong) for wrong in ("rad", (1,) * 4, ("*/",) * 4, ("rad",) * 3, ("",) * 4)),
        *(("rate", wrong) for wrong in (0, 1001, 50.0, True, None)),
        *(("full_scale_counts", wrong) for wrong in (0, 65536, np.nan, "60000", True)),
    ],
)
def test_a_field_that_makes_no_sense_is_refused(field, wrong):
    with pytest.raises(InputError, match=field):
        dataclasses.replace(WINCH, **{field: wrong})


def test_the_names_of_the_papers_structures_mean_nothing_else():
    with pytest.raises(InputError, match="attitude_rate"):
        dataclasses.replace(WINCH, name="attitude_rate")
