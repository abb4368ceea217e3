"""RAPTOR's form sees what RAPTOR sees, commands what it commands, and keeps every slope finite."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from maidenflight.errors import InputError
from maidenflight.integrations.raptor import form as raptor_form
from maidenflight.integrations.raptor.foundation_policy import observed as seen_by_raptor
from maidenflight.policy import untrained_policy
from maidenflight.simulator.controllers import interface
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import PolicySpec

OBSERVED = jax.jit(raptor_form.observed)
SLOPES = jax.jit(jax.jacobian(raptor_form.observed))
ACTION = jax.jit(raptor_form.action_of)
OUTPUT = jax.jit(raptor_form.output_of)


def numbers(size: int, most: float) -> Any:
    return st.lists(st.floats(-most, most, width=32), min_size=size, max_size=size).map(np.array)


@given(
    position=numbers(3, 2.0),
    turned=numbers(4, 1.0).filter(lambda quaternion: np.linalg.norm(quaternion) > 0.1),
    velocity=numbers(3, 4.0),
    rates=numbers(3, 16.0),
    setpoint=numbers(3, 2.0),
    moving=numbers(3, 2.0),
    output=numbers(4, 1.5),
)
def test_it_sees_what_raptor_sees(
    position: Any, turned: Any, velocity: Any, rates: Any, setpoint: Any, moving: Any, output: Any
) -> None:
    quaternion = turned / np.linalg.norm(turned)
    action = 2.0 * ((np.clip(output, -1.0, 1.0) + 1.0) / 2.0) ** 2 - 1.0
    error, ahead = setpoint - position, setpoint + 0.01 * moving - position
    parts = [position, quaternion, velocity, rates, error, action, ahead]
    found = OBSERVED(jnp.asarray(np.concatenate(parts), jnp.float32))
    measurement = Measurement(position, velocity, quaternion, rates)  # pyright: ignore
    expected = seen_by_raptor(measurement, setpoint, moving, output)
    # Velocities are differences over 10 ms; near -1 an action tells the root of its rounding.
    atol = np.repeat([2e-6, 1e-4, 2e-6, 4e-4], [12, 3, 3, 4])
    assert np.all(np.abs(np.asarray(found) - expected) <= atol)


@given(output=numbers(4, 3.0))
def test_an_output_commands_the_square_of_its_rotor_speeds_and_is_seen_again(output: Any) -> None:
    given_ = jnp.asarray(output, jnp.float32)
    action = ACTION(given_)
    share = interface.pwm().command(action)
    clipped = np.clip(output, -1.0, 1.0)
    np.testing.assert_allclose(share, ((clipped + 1.0) / 2.0) ** 2, atol=1e-6)
    np.testing.assert_allclose(OUTPUT(action), clipped, atol=4e-4)
    beyond = np.abs(output) > 1.0
    np.testing.assert_allclose(np.asarray(action)[beyond], output[beyond], rtol=1e-6)


@pytest.mark.parametrize("action", [-3.0, -1.0, np.nextafter(np.float32(-1), 0), 0.0, 1.0, 2.0])
def test_every_slope_is_finite_where_motors_stop_or_saturate(action: float) -> None:
    observation = jnp.full(23, 0.5).at[16:20].set(action)
    assert np.isfinite(SLOPES(observation)).all()
    slope = jax.grad(lambda output: jnp.sum(ACTION(output)))(jnp.full(4, action))
    assert np.isfinite(slope).all()
    if abs(action) > 1.0:
        np.testing.assert_array_equal(slope, 1.0)


@pytest.mark.parametrize("other", [interface.pwm(50), interface.attitude_rate(100)], ids=str)
def test_another_interface_is_refused(other: interface.ControlInterface) -> None:
    raptor_form.FORM.check(interface.pwm(), "policy")
    with pytest.raises(InputError, match=r"here: .* of the form raptor has pwm at 100 Hz"):
        raptor_form.FORM.check(other, "here")


@pytest.mark.parametrize(
    "other",
    [
        {"history": 2},
        {"look_ahead": {"points": 1, "spacing": 0.02}},
        {"hidden": [16, 16]},
        {"memory": 8},
    ],
    ids=str,
)
def test_a_record_of_any_other_combination_is_refused(other: dict[str, Any]) -> None:
    settled = PolicySpec(form="raptor")
    usual = {"history": 1, "memory": 16, "hidden": [16], "form": "raptor"}
    usual["look_ahead"] = {"points": 1, "spacing": 0.01}
    assert (settled.to_dict(), PolicySpec.from_dict(usual)) == (usual, settled)
    lacking = {name: value for name, value in usual.items() if name not in other}
    for wrong in (usual | other, lacking):
        with pytest.raises(InputError, match=r"a policy of the form raptor has "):
            PolicySpec.from_dict(wrong)


def test_a_policy_of_the_form_has_its_shape_whatever_the_arguments_say() -> None:
    made = untrained_policy(
        jax.random.key(0), spec=PolicySpec(history=2, hidden=(50, 50), form="raptor")
    )
    made.check()
    assert made.spec == PolicySpec(form="raptor")
    assert made.layer_sizes == (22, 16, 4)
    with pytest.raises(InputError, match="pwm at 100 Hz"):
        untrained_policy(jax.random.key(0), interface.attitude_rate(), PolicySpec(form="raptor"))
    with pytest.raises(InputError, match="form = 'foundation'"):
        untrained_policy(jax.random.key(0), spec=PolicySpec(form="foundation"))


def test_full_thrust_may_be_any_number_of_counts() -> None:
    full = interface.pwm(full_scale_counts=57_344.0)
    raptor_form.FORM.check(full, "policy")
