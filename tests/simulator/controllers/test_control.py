"""Control structures: the policy's four actions, and the firmware's PID, which must fly as the
firmware does."""

from functools import cache, partial

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given

from arrays import float32
from maidenflight.errors import InputError
from maidenflight.parameters import crazyflie, frames, noiseless, replace
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.firmware import USUAL
from maidenflight.simulator.controllers.position_pid import position_pid
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics, rotations, vectors
from maidenflight.simulator.physics.balance import balanced_command
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.physics.vectors import Entries
from maidenflight.simulator.stepping import rollout
from maidenflight.simulator.tasks import tasks

PAPER = crazyflie()
QUICK = replace(noiseless(PAPER), latency=0.005, time_step=0.002)
"""The paper's drone with the short latency that the firmware's PID bears."""
WEAK = replace(QUICK, motor_time_constant=0.06, thrust_to_weight=1.6)
"""A drone that the least thrust of the attitude structure does not lift: 35000 of 60000 counts
hover a thrust-to-weight of 1.714."""
FIRMWARES = ("2021.10", "2026.08")
LEVEL = float(2 * dynamics.hover_command(WEAK) - 1)
"""Action whose collective thrust is u = hover in 30000 + 30000 a counts."""
LEVEL_ATTITUDE = 3 * LEVEL - 1.5
"""The same in 45000 + 10000 a counts."""


@partial(jax.jit, static_argnums=2)
def fly_pid(radius, parameters, seconds):
    """Positions [m] at 100 Hz of the position PID on a circle whose radius is traced; radius 0 is
    hovering."""
    unit = tasks.paper_circle(diameter=2.0, height=0.0)
    task = unit._replace(
        reference=lambda time: radius * unit.reference(time) + jnp.array([0.0, 0.0, 1.0])
    )
    env = Environment(task=task, controller=position_pid(), steps_per_command=1)
    start = dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), parameters)
    env_state = environment.begin(env, start, jnp.float32(0.0), parameters, jax.random.key(0))
    _, (flown, _) = rollout(
        env, lambda _: jnp.zeros(4), env_state, parameters, jax.random.key(1), 500 * seconds
    )
    return jax.tree.map(lambda values: values[4::5], flown.state)


ASKED = np.array(
    [
        *(sign * np.eye(3)[axis] for axis in range(3) for sign in (0.5, -0.5)),
        [0.5, 0.3, 0.2],
        [-0.5, 0.3, -0.2],
    ],
    np.float32,
)
"""What is asked of roll, pitch and yaw: each alone, both ways; then all, and all mirrored at the
x-z plane."""


@cache
def fly_action(controller, level):
    """State of two seconds [action, time, ...] in which an action holds: those of ASKED, then more
    and less thrust."""
    env = Environment(controller=controller, steps_per_command=1)
    actions = np.zeros((len(ASKED) + 2, 4), np.float32)
    actions[:, 0], actions[: len(ASKED), 1:] = level, ASKED
    actions[len(ASKED) :, 0] += np.array([0.1, -0.1], np.float32)

    def fly(action):
        start = dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), WEAK)
        env_state = environment.begin(env, start, jnp.float32(0.0), WEAK, jax.random.key(0))
        steps = 2 * controller.interface.rate
        return rollout(env, lambda _: action, env_state, WEAK, jax.random.key(1), steps)[1][0].state

    return jax.tree.map(np.asarray, jax.jit(jax.vmap(fly))(actions))


def attitude_of(state):
    return np.degrees(
        jax.jit(jax.vmap(jax.vmap(rotations.to_attitude)))(jnp.asarray(state.quaternion))
    )


@given(st.tuples(*[st.floats(-3, 3, width=16)] * 4).map(float32))
def test_pwm_maps_actions_from_minus_one_to_one_onto_thrust(action):
    _, command = control.pwm().command(None, jnp.asarray(action), None, None)  # type: ignore[arg-type]
    np.testing.assert_allclose(command, (np.clip(action, -1, 1) + 1) / 2, atol=1e-6)


def test_the_position_pid_holds_hover():
    flown = fly_pid(jnp.float32(0.0), QUICK, 12)
    np.testing.assert_allclose(flown.position, np.tile([0, 0, 1], (1200, 1)), atol=0.02)
    np.testing.assert_allclose(flown.position[-100:], np.tile([0, 0, 1], (100, 1)), atol=0.003)
    np.testing.assert_allclose(flown.velocity[-100:], 0, atol=0.005)


def test_the_position_pid_flies_the_circle_as_small_and_as_late_as_the_firmware():
    """Measured of the stock firmware: radius 0.237 to 0.25 m, 57 deg = 0.48 s behind (crazyflie.md,
    section 2)."""
    position = np.asarray(fly_pid(jnp.float32(0.25), QUICK, 12).position)[600:]
    time = 0.01 * np.arange(600, 1200)
    first_harmonic = np.mean(
        (position[:, 0] + 1j * position[:, 1]) * np.exp(2j * np.pi * time / 3.0)
    )
    lag = np.angle(-first_harmonic) * 3.0 / (2 * np.pi)  # The reference is r - r exp(-i w t).
    assert 0.23 < abs(first_harmonic) < 0.25
    assert 0.45 < lag < 0.51
    np.testing.assert_allclose(position.mean(axis=0), [0.25, 0, 1], atol=0.02)
    np.testing.assert_allclose(position[:, 2], 1, atol=0.03)


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_an_action_is_added_to_the_position_pids_commands(firmware):
    controller = position_pid(firmware)
    plain, excited = (
        first_command(controller, action) for action in (np.zeros(4), [0.1, -0.1, 0.05, 0.0])
    )
    np.testing.assert_allclose(excited - plain, [0.1, -0.1, 0.05, 0.0], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("firmware", FIRMWARES)
def test_body_rates_are_reached_and_attitudes_held(firmware):
    flown = fly_action(control.attitude_rate(firmware), LEVEL)
    reached = np.degrees(flown.body_rates[:6, 60:80].mean(axis=1))
    np.testing.assert_allclose(reached, 60 * ASKED[:6], atol=3.0)
    flown = fly_action(control.attitude(firmware), LEVEL_ATTITUDE)
    held = attitude_of(flown)[:6, 40:].mean(axis=1)
    np.testing.assert_allclose(held, 10 * ASKED[:6], atol=0.7)


def test_a_wider_range_of_rates_is_asked_for_by_smaller_actions():
    wide, narrow = control.attitude_rate(highest_rate=360), control.attitude_rate()
    np.testing.assert_allclose(
        first_command(wide, [0.1, 0.1, -0.1, 0.05]),
        first_command(narrow, [0.1, 0.6, -0.6, 0.3]),
        atol=1e-6,
    )
    assert wide is control.attitude_rate(highest_rate=360.0), "nothing compiles twice"
    assert narrow is control.attitude_rate(highest_rate=60.0)
    for wrong in (0.0, -60.0, np.inf, np.nan):
        with pytest.raises(InputError, match="expected a positive number"):
            control.attitude_rate(highest_rate=wrong)


@pytest.mark.parametrize(
    ("factory", "level"), [(control.attitude_rate, LEVEL), (control.attitude, LEVEL_ATTITUDE)]
)
@pytest.mark.parametrize("firmware", [pytest.param("2021.10", marks=pytest.mark.slow), "2026.08"])
def test_a_mirrored_command_is_a_mirrored_motion(factory, level, firmware):
    flown, there, mirrored = fly_action(factory(firmware), level), 6, 7
    np.testing.assert_allclose(
        flown.position[mirrored] * [1, -1, 1], flown.position[there], atol=2e-3
    )
    np.testing.assert_allclose(
        flown.body_rates[mirrored] * [-1, 1, -1], flown.body_rates[there], atol=2e-2
    )
    assert np.abs(flown.position[there, -1, :2]).min() > 0.1


@pytest.mark.parametrize(
    ("factory", "level"), [(control.attitude_rate, LEVEL), (control.attitude, LEVEL_ATTITUDE)]
)
def test_the_first_action_climbs_and_sinks(factory, level):
    flown = fly_action(factory(), level)
    assert flown.velocity[-2, -1, 2] > 0.2
    assert flown.velocity[-1, -1, 2] < -0.2


@pytest.mark.parametrize("firmware", FIRMWARES)
@given(st.tuples(*[st.floats(-3, 3, width=16)] * 4).map(float32))
def test_actions_are_clipped(firmware, action):
    for controller in (control.attitude_rate(firmware), control.attitude(firmware)):
        np.testing.assert_array_equal(
            first_command(controller, action), first_command(controller, np.clip(action, -1, 1))
        )


@pytest.mark.parametrize(
    ("factory", "least", "most"),
    [(control.attitude_rate, 0.0, 1.0), (control.attitude, 35 / 60, 55 / 60)],
)
def test_the_first_action_is_collective_thrust(factory, least, most):
    for action, thrust in ((-1.0, least), (0.0, (least + most) / 2), (1.0, most)):
        np.testing.assert_allclose(first_command(factory(), [action, 0, 0, 0]), thrust, atol=2e-5)


@pytest.mark.parametrize(
    ("factory", "rate"), [(control.pwm, 100), (control.attitude_rate, 50), (control.attitude, 25)]
)
def test_the_policys_rates_are_the_papers(factory, rate):
    assert factory().interface.rate == rate
    assert factory().command_rate % rate == 0


def test_a_new_rate_kicks_in_2021_and_not_in_2026():
    """2021.10: K_d times the step of the error over 2 ms saturates; 2026.08: only K_p times the
    error, 250 x 60 = 15000 counts."""
    spread = {}
    for firmware in FIRMWARES:
        controller = control.attitude_rate(firmware)
        memory, _ = command(controller, jax.tree.map(jnp.asarray, controller.init()), np.zeros(4))
        _, motors = command(controller, memory, [0, 1, 0, 0])
        spread[firmware] = float(np.asarray(motors).max() - np.asarray(motors).min()) * 60000
    assert spread["2021.10"] == pytest.approx(32766, abs=2)
    assert spread["2026.08"] == pytest.approx(15000 + 500 * 60 / 500, abs=4)


@pytest.mark.parametrize("factory", [control.attitude_rate, control.attitude, position_pid])
def test_an_unknown_firmware_is_refused(factory):
    with pytest.raises(InputError, match=r"2021\.10, 2026\.08"):
        factory("2024.01")


@pytest.mark.parametrize("factory", [control.attitude_rate, control.attitude, position_pid])
def test_the_same_controller_is_the_same_object_so_that_nothing_is_compiled_twice(factory):
    assert factory("2021.10") is factory(firmware="2021.10")
    assert factory("2021.10") is not factory("2026.08")


@partial(jax.jit, static_argnums=0)
def command_at_hover(controller, memory, action):
    state = dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), QUICK)
    return controller.command(memory, action, environment.Measurement(*state[:4]), state.position)


def command(controller, memory, action):
    return command_at_hover(controller, memory, jnp.asarray(action, jnp.float32))


def first_command(controller, action):
    return np.asarray(command(controller, jax.tree.map(jnp.asarray, controller.init()), action)[1])


@pytest.mark.parametrize("name", control.CONTROLLERS)
@pytest.mark.parametrize("firmware", FIRMWARES)
def test_the_level_action_gives_a_level_drone_the_command_that_it_names(name, firmware):
    controller = control.CONTROLLERS[name](**({} if name == "pwm" else {"firmware": firmware}))
    still = Measurement(jnp.zeros(3), jnp.zeros(3), jnp.array([0.0, 0.0, 0.0, 1.0]), jnp.zeros(3))
    action = controller.interface.level(jnp.float32(0.65))
    _, command = jax.jit(controller.command)(controller.init(), action, still, jnp.zeros(3))
    np.testing.assert_allclose(command, 0.65, atol=1e-4)


@pytest.mark.parametrize("name", ["attitude_rate", "attitude"])
def test_pids_that_hovered_a_trimmed_drone_go_on_to_hover_it(name):
    bias = np.array([8e-5, -1e-4, 3e-5], np.float32)
    trimmed = replace(crazyflie(), torque_bias=bias, thrust_to_weight=1.6)
    controller = control.CONTROLLERS[name](firmware="2021.10")
    hovers = balanced_command(trimmed)
    assert np.ptp(hovers) > 0.02
    still = Measurement(jnp.zeros(3), jnp.zeros(3), jnp.array([0.0, 0, 0, 1]), jnp.zeros(3))
    level = controller.interface.level(jnp.mean(hovers))
    assert controller.taking_over is not None
    memory = controller.taking_over(hovers, still)
    _, command = jax.jit(controller.command)(memory, level, still, jnp.zeros(3))
    np.testing.assert_allclose(command, hovers, atol=3 / 65535)
    # Switched on they ask for the same of all motors.
    _, fresh = jax.jit(controller.command)(controller.init(), level, still, jnp.zeros(3))
    assert np.ptp(fresh) == 0.0


def test_pids_begin_anew_where_the_firmware_resets_them():
    for name in ("attitude_rate", "attitude"):
        assert control.CONTROLLERS[name](firmware="2026.08").taking_over is None


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("mixer", [None, frames.CRAZYFLIE])
def test_rate_pids_of_entries_are_those_of_arrays(firmware, mixer):
    """Over ticks with rates, yaws and, now and then, no thrust."""
    controller = control.attitude_rate(firmware)
    if mixer is not None:
        assert controller.fitted is not None
        controller = controller.fitted(mixer, USUAL)
    action, rates, yaw = jax.random.uniform(jax.random.key(0), (3, 50, 4), minval=-1.0)
    action = action.at[10::10, 0].set(-1.0)

    def tick(memory, given, form):
        action, rates, attitude = given
        nothing = form(jnp.zeros(3))
        measured = Measurement(nothing, nothing, form(attitude), form(rates))
        memory, command = controller.command(memory, action, measured, jnp.zeros(3))
        return memory, (jnp.stack(list(command)), isinstance(command, Entries))

    @partial(jax.jit, static_argnums=0)
    def ticked(form):
        memory = jax.tree.map(jnp.asarray, controller.init())
        memory = vectors.entries(memory) if form is Entries else memory
        attitudes = jax.jit(jax.vmap(rotations.from_attitude))(
            yaw[:, :3] * jnp.array([[0.3, 0.3, 3.0]])
        )
        return jax.lax.scan(
            partial(tick, form=form), memory, (action, 2.0 * rates[:, :3], attitudes)
        )

    (memory, (found, by_entries)), (_, (expected, by_array)) = ticked(Entries), ticked(jnp.asarray)
    assert by_entries.all()
    assert not by_array.any()
    assert isinstance(memory.rate.integral, Entries)
    assert np.ptp(expected, axis=0).min() > 0.1
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_an_action_rate_is_chosen_or_refused():
    assert control.attitude(action_rate=100).interface.rate == 100
    assert control.attitude_rate("2021.10", 25) is control.attitude_rate(
        "2021.10", action_rate=25
    ), "nothing compiles twice"
    with pytest.raises(
        InputError, match=r"action_rate = 60 Hz does not divide the PIDs' 500 Hz\. Give"
    ):
        control.attitude(action_rate=60)


@pytest.mark.parametrize(
    ("controller", "longest", "step"),
    [("pwm", 0.005, 0.005), ("attitude", 0.005, 0.002), ("attitude", 0.0015, 0.001)],
)
def test_the_longest_step_that_divides_the_command_period(controller, longest, step):
    assert control.time_step(control.CONTROLLERS[controller](), longest) == pytest.approx(step)
