"""PX4's control allocation, against its mixer of a quadrotor in X and by what must hold for any."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from maidenflight.integrations.logs.px4_allocation import (
    ROLL_PITCH_AIRMODE,
    YAW_AIRMODE,
    Rotor,
    effectiveness,
    mix,
    motors,
)

HALF = math.sqrt(0.5)
X = (
    Rotor(0.2, 0.2),
    Rotor(-0.2, -0.2),
    Rotor(0.2, -0.2, moment=-0.05),
    Rotor(-0.2, 0.2, moment=-0.05),
)
MIXER = np.array(
    [
        [-HALF, HALF, 1.0, -1.0],
        [HALF, -HALF, 1.0, -1.0],
        [HALF, HALF, -1.0, -1.0],
        [-HALF, -HALF, -1.0, -1.0],
    ]
)
"""Roll, pitch, yaw, and thrust of a quadrotor in X, as PX4 1.12's geometry quad_x has it."""
arm = st.floats(0.05, 1.0)


@st.composite
def quadrotors(draw: st.DrawFn) -> tuple[Rotor, ...]:
    """Four rotors in the corners, each at a place of its own."""
    return tuple(
        Rotor(forward * draw(arm), right * draw(arm), 6.5, moment)
        for forward, right, moment in ((1, 1, 0.05), (-1, -1, 0.05), (1, -1, -0.05), (-1, 1, -0.05))
    )


def test_four_equal_arms_are_px4s_mixer_of_an_x() -> None:
    assert_allclose(mix(X), MIXER, atol=1e-6)


@given(size=st.floats(0.03, 3.0), thrust=st.floats(0.1, 50.0), moment=st.floats(0.005, 0.2))
def test_size_thrust_and_moment_do_not_change_it(size: float, thrust: float, moment: float) -> None:
    scaled = tuple(
        Rotor(one.forward * size, one.right * size, thrust, np.copysign(moment, one.moment))
        for one in X
    )
    assert_allclose(mix(scaled), MIXER, atol=1e-6)


@given(rotors=quadrotors(), asked=st.lists(st.floats(-0.02, 0.02), min_size=3, max_size=3))
def test_an_axis_gets_what_is_asked_of_it_up_to_scale(
    rotors: tuple[Rotor, ...], asked: list[float]
) -> None:
    setpoints = np.array([[*asked, -0.5]])
    free = setpoints @ mix(rotors).T
    assume((free > 0.0).all() and (free < 1.0).all())
    scales = effectiveness(rotors) @ mix(rotors)
    assert_allclose(scales, np.diag(np.diag(scales)), atol=5e-3 * np.abs(scales).max())
    assert_allclose(motors(setpoints, rotors), free, atol=1e-12)


@given(
    rotors=quadrotors(),
    asked=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    thrust=st.floats(0.0, 1.0),
    airmode=st.sampled_from([0, ROLL_PITCH_AIRMODE, YAW_AIRMODE]),
)
def test_commands_stay_in_their_range(
    rotors: tuple[Rotor, ...], asked: list[float], thrust: float, airmode: int
) -> None:
    commands = motors(np.array([[*asked, -thrust]]), rotors, airmode)
    assert (commands >= 0.0).all()
    assert (commands <= 1.0).all()


@pytest.mark.parametrize(
    ("setpoint", "airmode", "expected"),
    [
        # Without airmode thrust does not rise for roll, which is cut to what idle motors leave.
        ((0.4, 0.0, 0.0, -0.1), 0, (0.0, 0.2, 0.2, 0.0)),
        # With it thrust rises until no motor is below idle.
        ((0.4, 0.0, 0.0, -0.1), ROLL_PITCH_AIRMODE, (0.0, 0.8 * HALF, 0.8 * HALF, 0.0)),
        # At full throttle thrust falls for roll.
        ((0.2, 0.0, 0.0, -1.0), 0, (1 - 0.4 * HALF, 1.0, 1.0, 1 - 0.4 * HALF)),
        # Yaw is cut where motors are idle, and may take thrust only in its own airmode.
        ((0.0, 0.0, 0.3, -0.1), 0, (0.2, 0.2, 0.0, 0.0)),
        ((0.0, 0.0, 0.3, -0.1), YAW_AIRMODE, (0.6, 0.6, 0.0, 0.0)),
    ],
)
def test_saturated_axes_yield_in_px4s_order(
    setpoint: tuple[float, ...], airmode: int, expected: tuple[float, ...]
) -> None:
    assert_allclose(motors(np.array([setpoint]), X, airmode)[0], expected, atol=1e-6)
