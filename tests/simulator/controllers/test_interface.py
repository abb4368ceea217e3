"""A control interface says what outputs mean, and what makes no sense is refused."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.errors import InputError
from maidenflight.simulator.controllers import interface
from maidenflight.simulator.controllers.interface import THRUST, ControlInterface

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


@pytest.mark.parametrize(
    ("hover", "low", "high"),
    [(0.5, 0.25, 0.75), (0.1, 0.0, 0.35), (0.9, 0.65, 1.0), (1.0, 0.75, 1)],
)
def test_thrust_about_hovering_reaches_to_both_sides_and_never_below_none_or_above_all(
    hover, low, high
):
    one = interface.attitude(hover=hover)
    for action, share in ((-1.0, low), (1.0, high)):
        assert float(one.command(jnp.full(4, action))[0]) == pytest.approx(share, abs=1e-6)
    assert ControlInterface.from_dict(one.to_dict()) == one
    assert (one.centre[1:], one.span[1:]) == (
        interface.attitude().centre[1:],
        interface.attitude().span[1:],
    )


@pytest.mark.parametrize("wrong", [0.0, -0.1, 1.1, float("nan"), True, "half"])
def test_a_share_that_no_drone_hovers_at_is_refused(wrong):
    with pytest.raises(InputError, match="hover"):
        interface.attitude(hover=wrong)


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
