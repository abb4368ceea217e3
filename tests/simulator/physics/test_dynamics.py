"""Laws of the rigid body and its motors."""

from functools import partial

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from jax import lax
from scipy.spatial.transform import Rotation

from arrays import float32, float64
from maidenflight.errors import InputError
from maidenflight.parameters import crazyflie, replace
from maidenflight.simulator import environment
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics, motion, rotations
from maidenflight.simulator.physics.dynamics import State

PAPER = crazyflie()
INTEGRATORS = [dynamics.euler, dynamics.midpoint, dynamics.rk4]
FURTHER = replace(
    PAPER,
    flapping_moment=(1e-4, 2e-4),
    rotational_damping=2e-5,
    rotor_momentum=3e-5,
    torque_bias=(2e-5, -3e-5, 1e-5),
)
"""A drone with all that turns it and is not in the paper's model, several times as strong as in a
Crazyflie."""
angular_acceleration = jax.jit(dynamics.angular_acceleration)
linear_acceleration = jax.jit(dynamics.linear_acceleration)
torque = jax.jit(dynamics.torque)
HOVER_FORCES = jnp.full(4, float(PAPER.mass * PAPER.gravity) / 4)


@given(st.floats(0.01, 0.2), st.floats(0.2, 5.0))
def test_equivalent_lag_does_not_depend_on_what_is_called_up(lag, ratio):
    other = dynamics.equivalent_lag(lag * ratio, 1 / ratio)
    assert dynamics.equivalent_lag(lag, ratio) == pytest.approx(other, rel=1e-9)
    assert dynamics.equivalent_lag(lag, 1.0) == pytest.approx(lag, rel=1e-12)


@pytest.mark.parametrize("ratio", [0.4, 1.6, 2.5])
def test_two_lags_answer_noise_as_the_equivalent_one(ratio):
    """The gain by instruments, of motors that follow the two lags in small steps."""
    up, step, generator = 0.05, 2e-3, np.random.default_rng(0)
    command, speed = np.zeros(300), np.zeros(300)
    sums = np.zeros(2)
    for row in range(2500):
        command += -step / 0.03 * command + np.sqrt(step) * generator.standard_normal(300)
        change = command - speed
        rate = change / np.where(change > 0, up, up * ratio)
        if row > 500:
            sums += np.cov(np.stack([change, rate, command]))[2, :2]
        speed = speed + step * rate
    found = sums[0] / sums[1]
    assert found == pytest.approx(dynamics.equivalent_lag(up, ratio), rel=0.015)
    assert abs(found / (up * (1 + ratio) / 2) - 1) > 0.015


@jax.jit
def further_torque(state, change, parameters, forces=HOVER_FORCES):
    return dynamics.further_torque(state, forces, change, parameters)


spin_up = jax.jit(dynamics.spin_up)
motor_derivative = jax.jit(dynamics.motor_derivative)
from_attitude = jax.jit(rotations.from_attitude)

vectors = st.tuples(*[st.floats(-10, 10, width=16)] * 3).map(float32)
attitudes = st.tuples(*[st.floats(-1.5, 1.5, width=16)] * 3).map(float32)
speeds = st.tuples(*[st.floats(0, 1, width=16)] * 4).map(float32)


@partial(jax.jit, static_argnums=0)
def fly(integrator, state, command, parameters, steps):
    """`steps` physics steps with a held rotor speed command; traced, so that one compilation serves
    all lengths."""
    return lax.fori_loop(0, steps, lambda _, state: integrator(state, command, parameters), state)


def drone(
    position=(0, 0, 1),
    velocity=(0, 0, 0),
    attitude=(0, 0, 0),
    body_rates=(0, 0, 0),
    rotor_speed=(0, 0, 0, 0),
):
    vectors = (
        float32(part)
        for part in (position, velocity, from_attitude(float32(attitude)), body_rates, rotor_speed)
    )
    return State(*vectors)


def in_float64(integrator, state, command, parameters, steps):
    """The same flight in float64, so that rounding does not hide what the integrator does."""
    with jax.enable_x64(True):
        state, parameters = jax.tree.map(float64, (state, parameters))
        state = state._replace(quaternion=state.quaternion / np.linalg.norm(state.quaternion))
        return jax.tree.map(np.asarray, fly(integrator, state, float64(command), parameters, steps))


OFF = STILL = np.zeros(4, np.float32)


@pytest.mark.parametrize(
    ("integrator", "lateness"),
    [(dynamics.euler, 0.5), (dynamics.midpoint, 0.0), (dynamics.rk4, 0.0)],
)
def test_a_drone_with_its_motors_off_falls_on_a_parabola(integrator, lateness):
    """RK4 and the midpoint are exact; semi-implicit Euler falls half a step's speed deeper, g t dt
    / 2."""
    state = fly(integrator, drone(velocity=(1, -2, 3)), OFF, PAPER, 200)
    np.testing.assert_allclose(state.velocity, [1, -2, 3 - 9.81], atol=1e-4)
    np.testing.assert_allclose(
        state.position, [1, -2, 1 + 3 - 9.81 / 2 - lateness * 9.81 * 0.005], atol=1e-4
    )


@pytest.mark.parametrize("integrator", INTEGRATORS)
@given(yaw=st.floats(-3, 3, width=16), ratio=st.floats(1.25, 4, width=16))
def test_a_hovering_drone_stays_where_it_is(integrator, yaw, ratio):
    parameters = replace(PAPER, thrust_to_weight=ratio)
    hover = dynamics.at_hover(jnp.array([0.1, -0.2, 1.0]), parameters)
    hover = hover._replace(quaternion=from_attitude(float32([0, 0, yaw])))
    speed = jnp.broadcast_to(jnp.sqrt(dynamics.hover_command(parameters)), (4,))
    for before, after in zip(hover, fly(integrator, hover, speed, parameters, 200), strict=True):
        np.testing.assert_allclose(after, before, atol=1e-4)


def test_free_rotation_keeps_kinetic_energy_and_angular_momentum():
    parameters = replace(PAPER, inertia=(1.3e-5, 2.0e-5, 2.9e-5), time_step=0.001)
    inertia = float64(parameters.inertia)

    def energy_and_momentum(state):
        spin = float64(state.body_rates)
        with jax.enable_x64(True):
            return inertia * spin @ spin / 2, np.asarray(
                rotations.to_matrix(float64(state.quaternion)) @ (inertia * spin)
            )

    first = drone(attitude=(0.3, -0.4, 1.0), body_rates=(7, 5, -6))
    last = in_float64(dynamics.rk4, first, OFF, parameters, 1000)
    assert np.abs(last.body_rates - first.body_rates).max() > 1, "the rotation changes its axis"
    (energy, momentum), (energy_after, momentum_after) = (
        energy_and_momentum(first),
        energy_and_momentum(last),
    )
    np.testing.assert_allclose(energy_after, energy, rtol=1e-8)
    np.testing.assert_allclose(
        momentum_after, momentum, atol=1e-6 * float(np.linalg.norm(momentum))
    )


@given(vectors, speeds)
def test_only_the_rotors_torque_does_work_the_gyroscopic_one_none(rates, rotor_speed):
    state = drone(body_rates=rates, rotor_speed=rotor_speed)
    rotors = torque(dynamics.rotor_forces(rotor_speed, PAPER), PAPER)
    power = rates @ np.asarray(PAPER.inertia * angular_acceleration(state, STILL, PAPER))
    rounding = 1e-7 + 8e-12 * float(np.linalg.norm(rates)) ** 3
    np.testing.assert_allclose(power, rates @ np.asarray(rotors), rtol=1e-3, atol=rounding)


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize(
    ("rotors", "axis"),
    [
        pytest.param([3, 2, 1, 0], 1, id="left and right"),
        pytest.param([1, 0, 3, 2], 0, id="front and back"),
    ],
)
@given(attitude=attitudes, velocity=vectors, rates=vectors, rotor_speed=speeds, command=speeds)
def test_a_mirrored_command_gives_a_mirrored_motion(
    integrator, rotors, axis, attitude, velocity, rates, rotor_speed, command
):
    mirror = np.ones(3, np.float32)
    mirror[axis] = -1
    turn = -mirror  # A mirror keeps the turn about its normal and reverses the two others.

    def mirrored(state):
        quaternion = np.append(turn, float32(1)) * state.quaternion
        return State(
            mirror * state.position,
            mirror * state.velocity,
            quaternion,
            turn * state.body_rates,
            state.rotor_speed[np.array(rotors)],
        )

    parameters = replace(FURTHER, drag=(0.3, 0.2, 0.1), spin_down_ratio=1.5)
    turned_bias = replace(parameters, torque_bias=turn * parameters.torque_bias)
    start = State(*map(jnp.asarray, drone((0.1, 0.2, 1), velocity, attitude, rates, rotor_speed)))
    expected = mirrored(fly(integrator, start, command, parameters, 20))
    found = fly(integrator, mirrored(start), command[rotors], turned_bias, 20)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-3)


def test_torque_of_four_forces_by_hand():
    lever = 0.0396 / np.sqrt(2)
    expected = [
        lever * (-0.1 - 0.2 + 0.3 + 0.5),
        lever * (-0.1 + 0.2 + 0.3 - 0.5),
        5.96e-3 * (-0.1 + 0.2 - 0.3 + 0.5),
    ]
    np.testing.assert_allclose(
        torque(float32([0.1, 0.2, 0.3, 0.5]), PAPER), expected, rtol=1e-5, atol=1e-9
    )


@given(speeds)
def test_the_constant_part_of_the_rotor_torque_has_no_effect(rotor_speed):
    forces = dynamics.rotor_forces(rotor_speed, PAPER)
    without, much = (torque(forces, replace(PAPER, torque_offset=offset)) for offset in (0.0, 1e-3))
    np.testing.assert_allclose(much, without, atol=1e-9)


UNDER_WAY = drone(
    (0, 0, 1), (0.5, -0.3, 0.2), (0.2, -0.1, 0.4), (1, -2, 0.5), (0.7, 0.75, 0.8, 0.72)
)
TRIM = float32([0.74, 0.76, 0.75, 0.755])


def flown(integrator, parameters, steps):
    """Where 0.4 s of flight end, in float64: position, velocity, quaternion, body rates and rotor
    speeds in one row."""
    return np.concatenate(
        in_float64(
            integrator,
            UNDER_WAY,
            TRIM,
            replace(parameters, time_step=np.asarray(0.4 / steps)),
            steps,
        )
    )


def orders(integrator, parameters):
    truth = flown(dynamics.rk4, parameters, 1600)
    errors = [
        np.linalg.norm(flown(integrator, parameters, steps) - truth) for steps in (40, 80, 160)
    ]
    return np.log2(np.divide(errors[:-1], errors[1:]))


@pytest.mark.parametrize(("integrator", "order"), [(dynamics.euler, 1), (dynamics.rk4, 4)])
def test_the_order_of_convergence(integrator, order):
    """Halving the step halves the error of Euler's method and divides that of RK4 by sixteen."""
    np.testing.assert_allclose(
        orders(integrator, replace(PAPER, drag=(0.3, 0.3, 0.1))), order, atol=0.1
    )
    np.testing.assert_allclose(
        orders(integrator, replace(FURTHER, drag=(0.3, 0.3, 0.1))), order, atol=0.15
    )


def test_the_midpoint_is_of_second_order_from_command_to_position():
    """A quarter of the error by half the step, where nothing but rotors and weight acts: a round
    body has no gyroscopic torque, and rotors without momentum do not precess."""
    round_body = replace(PAPER, inertia=(1.33e-5,) * 3, torque_bias=(2e-5, -3e-5, 1e-5))
    np.testing.assert_allclose(orders(dynamics.midpoint, round_body), 2, atol=0.1)
    np.testing.assert_allclose(orders(dynamics.euler, round_body), 1, atol=0.1)


@pytest.mark.parametrize(
    "parameters",
    [PAPER, replace(FURTHER, drag=(0.3, 0.3, 0.1), spin_down_ratio=1.5)],
    ids=["paper", "further"],
)
def test_the_midpoint_at_the_papers_step_is_several_times_closer_than_euler(parameters):
    """What is slow (gyroscopic torques, drag, flapping) it takes from a step's start; that costs
    little."""
    truth = flown(dynamics.rk4, parameters, 400)
    euler, midpoint = (
        np.abs(flown(integrator, parameters, 80) - truth)
        for integrator in (dynamics.euler, dynamics.midpoint)
    )
    assert np.linalg.norm(euler) > 4 * np.linalg.norm(midpoint)
    assert np.linalg.norm(midpoint[:3]) < 2e-3


@given(speeds, speeds, st.floats(0.001, 1), st.floats(0.125, 8), st.floats(1e-5, 0.02))
def test_the_trapezoidal_motor_never_moves_away_from_its_command(
    rotor_speed, command, lag, slowdown, step
):
    """By hand, (1 - x / 2) / (1 + x / 2) of the distance is left, x = dt / T: less than all of it
    however long the step."""
    parameters = replace(PAPER, motor_time_constant=lag, spin_down_ratio=slowdown, time_step=step)
    after = rotor_speed + step * float64(spin_up(rotor_speed, command, parameters))
    steps = step / np.where(command < rotor_speed, lag * slowdown, lag)
    left = (1 - steps / 2) / (1 + steps / 2) * (rotor_speed - command)
    np.testing.assert_allclose(after - command, left, atol=2e-6)
    assert (np.abs(after - command) <= np.abs(rotor_speed - command) + 2e-6).all()


@pytest.mark.parametrize("lag", [0.001, 0.0025, 0.01])
def test_at_long_steps_the_midpoints_motor_settles_where_eulers_diverges(lag):
    coarse, command = (
        replace(PAPER, motor_time_constant=lag, time_step=0.02),
        np.full(4, 0.8, np.float32),
    )
    settled = fly(
        dynamics.midpoint, drone(rotor_speed=(0.7,) * 4), command, coarse, 100
    ).rotor_speed
    np.testing.assert_allclose(settled, 0.8, atol=1e-4)
    if lag < 0.01:
        diverged = np.abs(
            fly(dynamics.euler, drone(rotor_speed=(0.7,) * 4), command, coarse, 20).rotor_speed
        )
        assert not (diverged <= 10).any()


@given(attitudes, vectors, vectors, st.tuples(*[st.floats(-10, 10, width=16)] * 4).map(float32))
def test_the_papers_crazyflie_has_no_further_torque(attitude, velocity, rates, change):
    state = drone(velocity=velocity, attitude=attitude, body_rates=rates)
    np.testing.assert_array_equal(np.asarray(further_torque(state, change, PAPER)), 0.0)


@given(attitudes, vectors, vectors)
def test_flapping_torque_is_the_moment_against_the_flights_direction(attitude, velocity, rates):
    """-z x v times c_f by hand, v in the body's axes: it does not turn about z, and where both
    moments are one not about the direction of flight."""
    state = drone(velocity=velocity, attitude=attitude, body_rates=rates)
    in_body = Rotation.from_quat(np.asarray(state.quaternion)).inv().apply(velocity)
    for rolling in (1e-4, 2e-4):
        flapping = replace(PAPER, flapping_moment=(rolling, 1e-4))
        found = float64(further_torque(state, STILL, flapping))
        expected = -np.cross([0, 0, 1], np.array([1e-4, rolling, 0.0]) * in_body)
        np.testing.assert_allclose(found, expected, atol=1e-8)


@pytest.mark.parametrize(("velocity", "axis"), [((2, 0, 0), 0), ((0, 2, 0), 1), ((-2, 0, 0), 0)])
def test_flapping_lifts_the_side_that_flies_ahead(velocity, axis):
    """Forward flight pitches the nose up, which is a negative torque about y."""
    parameters = replace(PAPER, flapping_moment=(1e-4, 1e-4), gravity=9.81)
    hover = dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), parameters)
    moving = hover._replace(velocity=float32(velocity))
    if velocity[0] > 0:
        assert further_torque(moving, STILL, parameters)[1] == pytest.approx(-2e-4)
    for integrator in INTEGRATORS:
        end = fly(integrator, moving, hover.rotor_speed, parameters, 10)
        ahead = Rotation.from_quat(np.asarray(end.quaternion)).apply(np.sign(velocity))
        assert ahead[2] > 0.005


def test_a_rotor_that_spins_up_turns_the_body_as_its_drag_does():
    parameters = replace(PAPER, rotor_momentum=3e-5)
    for rotor in range(4):
        alone = np.eye(4, dtype=np.float32)[rotor]
        reaction, drag = further_torque(drone(), 5.0 * alone, parameters), torque(alone, PAPER)
        np.testing.assert_allclose(reaction, [0, 0, 3e-5 * 5.0 * np.sign(drag[2])], atol=1e-10)
        np.testing.assert_allclose(
            further_torque(drone(), -5.0 * alone, parameters), -np.asarray(reaction), atol=1e-10
        )


NO_OUTER_TORQUE = replace(
    PAPER,
    torque_to_thrust=0.0,
    rotor_momentum=3e-5,
    rotor_x=np.zeros(4, np.float32),
    rotor_y=np.zeros(4, np.float32),
    spin_down_ratio=1.5,
)


def angular_momentum(state):
    """In the world, of the body and of rotors 1 and 3, which turn as r counts, 2 and 4, which do
    not."""
    body = np.asarray(PAPER.inertia, np.float64) * float64(state.body_rates)
    rotors = np.array([0.0, 0.0, 3e-5 * float64(state.rotor_speed) @ [1, -1, 1, -1]])
    return Rotation.from_quat(state.quaternion).apply(body + rotors)


@pytest.mark.parametrize("integrator", INTEGRATORS)
@given(command=speeds, rotor_speed=speeds)
def test_without_air_drag_rotors_and_body_keep_their_angular_momentum_about_z(
    integrator, command, rotor_speed
):
    start = drone(rotor_speed=rotor_speed, body_rates=(0, 0, 3))
    end = fly(integrator, start, command, NO_OUTER_TORQUE, 20)
    np.testing.assert_allclose(angular_momentum(end), angular_momentum(start), atol=1e-9)
    np.testing.assert_allclose(end.body_rates[:2], 0, atol=1e-6)


@pytest.mark.parametrize(("integrator", "share"), [(dynamics.midpoint, 0.01), (dynamics.rk4, 1e-5)])
@given(speeds, speeds, vectors)
def test_a_body_that_turns_about_all_axes_keeps_its_angular_momentum_while_rotors_precess(
    integrator, share, command, rotor_speed, rates
):
    """Of 0.1 s by steps of 1 ms; without the precession up to a third is lost."""
    parameters = replace(NO_OUTER_TORQUE, time_step=1e-3)
    start = drone(rotor_speed=rotor_speed, body_rates=rates, attitude=(0.3, -0.2, 0.5))
    end = in_float64(integrator, start, command, parameters, 100)
    before, after = angular_momentum(start), angular_momentum(end)
    size = float(np.linalg.norm(before)) + 1e-5
    np.testing.assert_allclose(after, before, atol=share * size)


@given(attitudes, vectors, vectors)
def test_damping_opposes_roll_and_pitch_rate_only(attitude, velocity, rates):
    state = drone(velocity=velocity, attitude=attitude, body_rates=rates)
    found = further_torque(state, STILL, replace(PAPER, rotational_damping=2e-5))
    np.testing.assert_allclose(found, -2e-5 * rates * [1, 1, 0], rtol=1e-5, atol=1e-12)


@given(attitudes, vectors, vectors, st.tuples(*[st.floats(-10, 10, width=16)] * 4).map(float32))
def test_a_torque_bias_grows_with_the_thrust_in_every_state_of_flight(
    attitude, velocity, rates, change
):
    state = drone(velocity=velocity, attitude=attitude, body_rates=rates)
    biased = replace(PAPER, torque_bias=(2e-5, -3e-5, 1e-5))
    for share in (0.0, 1.0, 1.5):
        found = further_torque(state, change, biased, np.float32(share) * HOVER_FORCES)
        np.testing.assert_allclose(found, share * np.array([2e-5, -3e-5, 1e-5]), rtol=1e-5)


def test_a_torque_bias_alone_spins_the_body_up_by_its_share_of_inertia():
    """A tenth of a second of roll by b t / I at hover, none without thrust."""
    parameters = replace(PAPER, torque_bias=(2e-5, 0.0, 0.0))
    hover = dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), parameters)
    for start, expected in ((hover, 0.1 * 2e-5 / 1.33e-5), (drone(), 0.0)):
        end = fly(dynamics.midpoint, start, start.rotor_speed, parameters, 20)
        np.testing.assert_allclose(end.body_rates, [expected, 0, 0], rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("steps", [1, 7, 18, 60])
def test_the_motor_follows_a_step_exponentially(steps):
    state = fly(dynamics.rk4, drone(), np.full(4, 0.8, np.float32), PAPER, steps)
    np.testing.assert_allclose(
        state.rotor_speed, 0.8 * (1 - np.exp(-steps * 0.005 / 0.088)), rtol=1e-5
    )


def test_slowdown_makes_only_the_falling_motor_slower():
    lazy, half = replace(PAPER, spin_down_ratio=1.5), drone(rotor_speed=(0.5, 0.5, 0.5, 0.5))
    found = fly(dynamics.rk4, half, float32([0.9, 0.6, 0.4, 0.1]), lazy, 20).rotor_speed
    rising, falling = np.exp(-0.1 / 0.088), np.exp(-0.1 / (1.5 * 0.088))
    expected = [0.9 - 0.4 * rising, 0.6 - 0.1 * rising, 0.4 + 0.1 * falling, 0.1 + 0.4 * falling]
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def drag_acceleration(state, drag):
    with_drag, without = replace(PAPER, drag=drag), replace(PAPER, drag=(0.0, 0.0, 0.0))
    return np.asarray(linear_acceleration(state, with_drag)) - np.asarray(
        linear_acceleration(state, without)
    )


@given(attitudes, vectors, st.tuples(*[st.floats(0, 2, width=16)] * 3))
def test_drag_never_accelerates(attitude, velocity, drag):
    power = velocity @ drag_acceleration(drone(velocity=velocity, attitude=attitude), drag)
    square = float(velocity @ velocity)
    assert -max(drag) * square - 1e-3 <= power <= -min(drag) * square + 1e-3


@given(st.floats(-3, 3, width=16), st.floats(-3, 3, width=16))
def test_equal_drag_in_the_plane_slows_every_heading_and_yaw_alike(heading, yaw):
    velocity = float32([2 * np.cos(heading), 2 * np.sin(heading), 1])
    found = drag_acceleration(drone(velocity=velocity, attitude=(0, 0, yaw)), (0.3, 0.3, 0.1))
    np.testing.assert_allclose(found, -float32([0.3, 0.3, 0.1]) * velocity, atol=1e-5)


def test_drag_along_the_nose_acts_along_the_nose_alone():
    nose, velocity = np.array([np.cos(0.5), np.sin(0.5), 0.0]), np.array([1.0, 0.2, 0.0])
    found = drag_acceleration(drone(velocity=velocity, attitude=(0, 0, 0.5)), (0.5, 0.0, 0.0))
    np.testing.assert_allclose(found, -0.5 * (nose @ velocity) * nose, atol=1e-5)


@given(attitudes, vectors, vectors, vectors)
def test_in_wind_the_air_is_the_frame_that_matters(attitude, velocity, rates, wind):
    """A drone in wind is pushed and turned as one in calm air with the velocity through the air."""
    blown = replace(FURTHER, drag=(0.3, 0.2, 0.1), wind=wind)
    calm = replace(blown, wind=(0.0, 0.0, 0.0))
    speed = (0.7, 0.75, 0.8, 0.72)
    moving, through = (
        drone(velocity=each, attitude=attitude, body_rates=rates, rotor_speed=speed)
        for each in (velocity, velocity - wind)
    )
    np.testing.assert_allclose(
        linear_acceleration(moving, blown), linear_acceleration(through, calm), atol=1e-4
    )
    np.testing.assert_allclose(
        angular_acceleration(moving, jnp.zeros(4), blown),
        angular_acceleration(through, jnp.zeros(4), calm),
        rtol=1e-4,
        atol=1e-3,
    )


@pytest.mark.parametrize("rotor", range(4))
def test_a_damaged_propeller_loses_its_share_of_thrust_and_of_torque(rotor):
    """By hand: a tenth less of one of four equal forces f takes 0.1 f of lift, and turns the drone
    about x and y by 0.1 f L / sqrt(2) towards that rotor."""
    share = np.ones(4, np.float32)
    share[rotor] = 0.9
    damaged = replace(PAPER, rotor_thrust=share)
    sound = dynamics.rotor_forces(jnp.full(4, 0.8), PAPER)
    forces = dynamics.rotor_forces(jnp.full(4, 0.8), damaged)
    np.testing.assert_allclose(forces, sound * share, rtol=1e-6)
    about_x, about_y, _ = torque(forces, damaged)
    arm = 0.1 * float(sound[0]) * 0.0396 / np.sqrt(2.0)
    signs = dynamics.torque(jnp.asarray(share) - 1.0, replace(PAPER, torque_offset=0.0))
    assert float(about_x) == pytest.approx(np.sign(float(signs[0])) * arm, rel=1e-4)
    assert float(about_y) == pytest.approx(np.sign(float(signs[1])) * arm, rel=1e-4)


@given(
    st.floats(-0.25, 0.125, width=16), st.floats(-0.25, 1.0, width=16), st.floats(1.25, 4, width=16)
)
def test_an_affine_quadratic_thrust_curve_keeps_full_thrust_and_hovers_where_it_says(
    offset, linear, ratio
):
    parameters = replace(PAPER, thrust_offset=offset, thrust_linear=linear, thrust_to_weight=ratio)
    full = np.asarray(dynamics.rotor_forces(jnp.ones(4), parameters))
    np.testing.assert_allclose(full.sum(), 0.028 * 9.81 * ratio, rtol=1e-5)
    trimmed = dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), parameters)
    lift = np.asarray(dynamics.rotor_forces(trimmed.rotor_speed, parameters)).sum()
    np.testing.assert_allclose(lift, 0.028 * 9.81, rtol=2e-4)


def test_a_thrust_curve_is_the_polynomial_of_its_coefficients():
    parameters = replace(PAPER, thrust_offset=0.05, thrust_linear=0.3)
    speed = float32([0.1, 0.4, 0.7, 0.9])
    expected = 0.028 * 9.81 / 4 * 1.725 * np.polyval([0.65, 0.3, 0.05], speed)
    np.testing.assert_allclose(dynamics.rotor_forces(speed, parameters), expected, rtol=1e-5)


def test_thrust_grows_near_the_ground_by_the_cited_formula_and_no_more_than_its_limit():
    heights = np.array([0.012, 0.05, 0.1, 1.0], np.float32)
    gain = (
        jax.vmap(lambda height: motion.near_ground(PAPER, height).thrust_to_weight)(heights) / 1.725
        - 1
    )
    radius = 0.0231348
    expected = np.minimum(11.36859 * (radius / (4 * heights)) ** 2, 4 / 15)
    np.testing.assert_allclose(gain, expected, rtol=2e-3, atol=1e-6)
    assert expected[0] == 4 / 15, "the limit is reached on the ground"


def test_a_state_with_a_number_that_is_not_finite_is_refused_by_name():
    with pytest.raises(InputError, match=r"state: velocity = \[0.0, nan, 0.0\] is not finite"):
        dynamics.check_state(drone(velocity=(0, np.nan, 0)))
    with pytest.raises(InputError, match="state: position"):
        environment.begin(
            Environment(), drone(position=(np.inf, 0, 1)), jnp.float32(0), PAPER, jax.random.key(0)
        )


COASTING = replace(PAPER, motor_time_constant=0.05, spin_down_ratio=1.5, motor_coasting=0.12)


@pytest.mark.parametrize(
    ("integrator", "atol"),
    [(dynamics.rk4, 2e-6), (dynamics.midpoint, 2e-4), (dynamics.euler, 6e-3)],
)
def test_a_motor_without_command_coasts(integrator, atol):
    """By hand, with sqrt(u) = 0 the motor's equation separates: t = T_m s ln(nu_0 / nu) + T_c (1 /
    nu - 1 / nu_0)."""
    for steps in (20, 60):
        speed = float64(
            fly(
                integrator, drone(rotor_speed=(1.0, 0.8, 0.6, 0.4)), OFF, COASTING, steps
            ).rotor_speed
        )
        began = np.array([1.0, 0.8, 0.6, 0.4])
        np.testing.assert_allclose(
            0.075 * np.log(began / speed) + 0.12 * (1 / speed - 1 / began),
            steps * 0.005,
            atol=atol / speed.min() ** 2,
        )


def test_the_steps_of_a_coasting_motor_are_of_second_order():
    """Half the step, a quarter of the error; towards a command, where no closed form is known."""
    command, start = (
        np.array([0.2, 0.4, 0.6, 0.75], np.float32),
        drone(rotor_speed=(0.9, 0.85, 0.8, 0.95)),
    )

    def end(integrator, every):
        return in_float64(
            integrator,
            start,
            command,
            replace(COASTING, time_step=np.float64(0.02 / every)),
            4 * every,
        ).rotor_speed

    exact = end(dynamics.rk4, 64)
    coarse, fine = (np.abs(end(dynamics.midpoint, every) - exact) for every in (2, 4))
    assert (coarse > 1e-7).all()
    np.testing.assert_allclose(coarse / fine, 4, rtol=0.15)


@given(speeds, speeds, st.floats(0.001, 1), st.floats(0, 1), st.floats(1e-5, 0.02))
def test_a_coasting_motor_slows_down_more_lazily_and_never_past_its_command(
    rotor_speed, command, lag, coasting, step
):
    parameters = replace(PAPER, motor_time_constant=lag, time_step=step)
    plain = float64(spin_up(rotor_speed, command, parameters))
    lazy = float64(spin_up(rotor_speed, command, replace(parameters, motor_coasting=coasting)))
    up = command >= rotor_speed
    np.testing.assert_allclose(lazy[up], plain[up], rtol=1e-6)
    slow = float64(
        motor_derivative(rotor_speed, command, replace(parameters, motor_coasting=coasting))
    )
    assert (slow[~up] <= 0).all()
    assert (
        slow[~up] >= float64(motor_derivative(rotor_speed, command, parameters))[~up] * (1 + 1e-5)
    ).all()
    assert (
        np.abs(rotor_speed + step * lazy - command) <= np.abs(rotor_speed - command) + 2e-6
    ).all()
