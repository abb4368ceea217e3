"""The firmware's cascaded PID against recordings of the real firmware, and its laws one by one."""

from functools import cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from maidenflight.parameters import crazyflie
from maidenflight.simulator.controllers import firmware, rate_loops
from maidenflight.simulator.controllers.firmware import ABSOLUTE, VELOCITY, Setpoint, StateEstimate
from maidenflight.simulator.physics import dynamics

TRACES = Path(__file__).parents[4] / "shared" / "data" / "firmware" / "pid_trace.npz"
GENERATIONS = ("2021.10", "2026.08")
SCENARIOS = (
    "circle_closed",
    "square_closed_yaw",
    "velocity",
    "rate",
    "rate_closed",
    "attitude",
    "random_open",
)
FLIP = np.array([1, -1, 1], np.float32)
"""The firmware's pitch is positive nose up."""


def replay(setpoints, states, ticks, generation):
    """Motor commands [counts] of recorded inputs, tick by tick."""

    def one(memory, now):
        setpoint, state, number = now
        return firmware.tick(memory, setpoint, state, generation, number % 10 == 0, number % 2 == 0)

    return jax.lax.scan(
        one, jax.tree.map(jnp.asarray, firmware.switched_on()), (setpoints, states, ticks)
    )[1]


batch = jax.vmap(replay, in_axes=(0, 0, 0, None))
COMPILED = {
    "as written": jax.jit(
        batch, static_argnums=3, compiler_options={"xla_disable_hlo_passes": "fusion,algsimp"}
    ),
    "optimized": jax.jit(batch, static_argnums=3),
}
"""XLA fuses products and sums and divides by multiplying, which rounds otherwise than the recorded
firmware does."""


@cache
def recorded(generation):
    """Inputs and the real firmware's motor commands [counts], (scenario, tick, ...)."""
    if not TRACES.exists():
        pytest.skip(f"{TRACES}: recordings of the real firmware are not here")
    with np.load(TRACES) as traces:
        parts: Any = (
            np.stack([traces[f"{name}/{part}"] for name in SCENARIOS])
            for part in ("state", "gyro", "setpoint", "setpoint_mode", "velocity_body", "tick")
        )
        state, gyro, asked, mode, body, ticks = parts
        place = {"2021.10": "fw2021/{}/motor_power", "2026.08": "{}/motor_uncapped"}[generation]
        real = np.stack([traces[place.format(name)] for name in SCENARIOS]).astype(np.float32)
        real = np.maximum(real, 0)
    turned = (asked[..., 6:9] * FLIP, asked[..., 9:12] * FLIP)
    setpoint = Setpoint(
        asked[..., :3],
        asked[..., 3:6],
        *turned,
        asked[..., 12],
        mode[..., :6].astype(np.int32),
        body,
    )
    return (
        setpoint,
        StateEstimate(state[..., :3], state[..., 3:6], state[..., 6:] * FLIP, gyro),
        ticks.astype(np.int32),
    ), real


@cache
def difference(generation, compiled):
    """Largest difference of a motor's command from the real firmware's [counts], by scenario and
    tick."""
    inputs, real = recorded(generation)
    ours = np.asarray(COMPILED[compiled](*inputs, generation))
    return dict(zip(SCENARIOS, np.abs(ours - real).max(axis=-1), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("generation", GENERATIONS)
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_motor_commands_are_the_real_firmwares_to_the_count(scenario, generation):
    counts = difference(generation, "as written")[scenario]
    assert counts.max() <= 1, "the last bit of a sine may differ between machines"
    assert np.mean(counts == 0) >= 0.995


@pytest.mark.parametrize("generation", GENERATIONS)
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_optimized_they_are_a_count_or_two_off_at_times(scenario, generation):
    counts = difference(generation, "optimized")[scenario]
    assert counts.max() <= 2
    assert np.mean(counts <= 1) >= 0.995


@pytest.mark.parametrize("generation", GENERATIONS)
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_mixer_turns_the_drone_the_way_it_was_told(axis, sign, generation):
    mixed = mix(30000, sign * 5000 * np.eye(3)[axis], generation)
    np.testing.assert_allclose(mixed.mean(), 30000)
    found = np.asarray(dynamics.torque(jnp.asarray(mixed / 60000, jnp.float32), crazyflie()))
    assert sign * found[axis] > 1e-5
    np.testing.assert_allclose(np.delete(found, axis), 0, atol=1e-8)


def test_above_full_thrust_2021_clips_each_motor_and_2026_leaves_that_to_the_cap_on_pwm():
    np.testing.assert_array_equal(
        mix(60000, [20000, 0, 0], "2021.10"), [50000, 50000, 65535, 65535]
    )
    np.testing.assert_array_equal(
        mix(60000, [20000, 0, 0], "2026.08"), [50000, 50000, 70000, 70000]
    )


def test_counts_are_cut_off_like_integers_and_pass_a_derivative():
    np.testing.assert_array_equal(mix(30000.7, [3, -3, 0], "2026.08"), [30000, 29998, 30000, 30002])
    slope = jax.grad(
        lambda thrust: firmware.mix(thrust, jnp.array([100.5, 0.0, 0.0]), "2026.08").sum()
    )(30000.5)
    assert slope == 4.0


@pytest.mark.parametrize("generation", GENERATIONS)
def test_thrust_zero_stops_the_motors_and_forgets(generation):
    memory, motors = flown(generation, hand(thrust=40000, attitude=[5, 0, 0]))
    assert motors.min() > 0
    assert np.abs(memory.attitude.integral[0]) > 0
    memory, motors = flown(generation, hand(thrust=0, attitude=[5, 0, 0]), memory, state(yaw=33.0))
    np.testing.assert_array_equal(motors, 0)
    np.testing.assert_array_equal(memory.attitude.integral, 0)
    np.testing.assert_array_equal(memory.rate.integral, 0)
    assert memory.desired[2] == 33.0


def test_in_rate_mode_the_attitude_pid_is_reset_in_2021_and_runs_on_in_2026():
    for generation, runs in zip(GENERATIONS, (False, True), strict=True):
        memory, _ = flown(generation, hand(thrust=40000, mode=VELOCITY), seen=state(roll=5.0))
        assert (memory.attitude.integral[0] != 0) == runs


def test_another_mode_starts_the_pids_anew_only_in_2026():
    for generation, kept in zip(GENERATIONS, (True, False), strict=True):
        memory, _ = flown(generation, hand(thrust=40000, attitude=[0, 0, 50]))
        before = float(memory.attitude.integral[2])
        memory, _ = flown(
            generation, hand(thrust=40000, attitude=[0, 0, 50], mode=VELOCITY), memory, times=1
        )
        assert (abs(float(memory.attitude.integral[2])) > before / 2) == kept


def test_a_disabled_yaw_is_the_given_one_in_2021_and_the_one_before_in_2026():
    """By reading: no trace of the real firmware disables yaw."""
    for generation, kept in zip(GENERATIONS, (12.0, 50.0), strict=True):
        turned = hand(thrust=40000, attitude=[0, 0, 50])
        memory, _ = flown(generation, turned)
        assert memory.desired[2] == 50.0
        disabled = hand(thrust=40000, attitude=[0, 0, 12])
        disabled = disabled._replace(mode=disabled.mode.at[5].set(firmware.DISABLE))
        memory, motors = flown(generation, disabled, memory)
        assert memory.desired[2] == kept
        as_told, _ = flown(generation, hand(thrust=40000, attitude=[0, 0, kept]), memory)
        assert as_told.desired[2] == kept
        assert np.ptp(motors) > 0


@pytest.mark.parametrize("generation", GENERATIONS)
def test_forward_in_the_bodys_axes_is_left_in_the_worlds_at_a_quarter_turn(generation):
    mode = jnp.array([VELOCITY, VELOCITY, ABSOLUTE, 0, 0, ABSOLUTE])
    wanted = hand(attitude=[0, 0, 90])._replace(mode=mode)
    body = wanted._replace(velocity=jnp.array([0.3, 0.1, 0.0]), velocity_body=jnp.array(True))
    world = wanted._replace(velocity=jnp.array([-0.1, 0.3, 0.0]))
    first, second = (flown(generation, asked, seen=state(yaw=90.0))[0] for asked in (body, world))
    np.testing.assert_allclose(first.desired, second.desired, atol=1e-3)
    np.testing.assert_allclose(first.desired[:2], [-2.5, 7.5], rtol=0.02)


def mix(thrust, torque, generation):
    return np.asarray(
        firmware.mix(jnp.float32(thrust), jnp.asarray(torque, jnp.float32), generation)
    )


def state(roll=0.0, yaw=0.0):
    return StateEstimate(jnp.zeros(3), jnp.zeros(3), jnp.array([roll, 0.0, yaw]), jnp.zeros(3))


def hand(thrust=0.0, attitude=(0, 0, 0), mode=ABSOLUTE):
    """A set-point of thrust and attitude, or of body rates 0."""
    modes = jnp.array([0, 0, 0, mode, mode, mode])
    return Setpoint(
        jnp.zeros(3),
        jnp.zeros(3),
        jnp.asarray(attitude, jnp.float32),
        jnp.zeros(3),
        jnp.float32(thrust),
        modes,
        jnp.array(False),
    )


@partial(jax.jit, static_argnums=0)
def tick(generation, memory, setpoint, seen):
    return firmware.tick(memory, setpoint, seen, generation, position_due=True)


def flown(generation, setpoint, memory=None, seen=None, times=5):
    """Memory and motor commands after some ticks in which nothing changes."""
    memory, motors = memory or jax.tree.map(jnp.asarray, firmware.switched_on()), np.zeros(4)
    for _ in range(times):
        memory, motors = tick(generation, memory, setpoint, seen or state())
    return memory, np.asarray(motors)


def inputs(seed, ticks=300):
    """Attitude and rates [deg, deg/s], set-points and thrusts of a wild flight, its motors off now
    and then."""
    generator = np.random.default_rng(seed)
    attitude = np.cumsum(generator.normal(0, 2, (ticks, 3)), axis=0).astype(np.float32)
    attitude[:, 2] = (attitude[:, 2] * 4 + 180) % 360 - 180
    rates = np.cumsum(generator.normal(0, 20, (ticks, 3)), axis=0).astype(np.float32)
    wanted = np.repeat(generator.uniform(-60, 60, (ticks // 10, 3)), 10, axis=0).astype(np.float32)
    thrust = np.repeat(
        generator.choice([0, 20000, 40000, 60000], ticks // 10, p=[0.1, 0.3, 0.3, 0.3]), 10
    ).astype(np.float32)
    return attitude, rates, wanted, thrust


def ticked(memory, mode, by_rate, seed, generation):
    """Motor commands of `tick` [counts] on those inputs."""
    nothing = jnp.zeros(3)

    def one(memory, now):
        attitude, rates, wanted, thrust = now
        asked = (nothing, wanted) if by_rate else (wanted / 6, nothing)
        setpoint = Setpoint(nothing, nothing, *asked, thrust, mode, jnp.array(False))
        return firmware.tick(
            memory, setpoint, StateEstimate(nothing, nothing, attitude, rates), generation, False
        )

    return jax.jit(
        lambda numbers: jax.lax.scan(one, jax.tree.map(jnp.asarray, memory), numbers)[1]
    )(inputs(seed))


@pytest.mark.parametrize("generation", GENERATIONS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_rates_alone_are_held_as_by_the_whole_cascade(generation, seed):
    mode = np.array([0, 0, 0, VELOCITY, VELOCITY, VELOCITY], np.int32)
    whole = ticked(firmware.switched_on(), jnp.asarray(mode), True, seed, generation)

    def one(memory, now):
        attitude, rates, wanted, thrust = now
        return rate_loops.rate_tick(memory, thrust, wanted, attitude[2], rates, generation)

    first = jax.tree.map(jnp.asarray, rate_loops.rates_switched_on())
    alone = jax.jit(lambda numbers: jax.lax.scan(one, first, numbers)[1])(inputs(seed))
    difference = np.abs(np.asarray(alone) - np.asarray(whole))
    assert difference.max() <= 2, "XLA rounds the two alike but for the last count"
    assert np.mean(difference == 0) > 0.99
    assert np.std(whole) > 5000, "the flight moves the motors"


@pytest.mark.parametrize("generation", GENERATIONS)
def test_a_mode_that_never_changes_is_a_mode_that_does_not_change(generation):
    mode = np.array([0, 0, 0, ABSOLUTE, ABSOLUTE, ABSOLUTE], np.int32)
    whole = ticked(firmware.switched_on(), jnp.asarray(mode), False, 5, generation)
    fixed = ticked(firmware.switched_on(fixed=True), mode, False, 5, generation)
    difference = np.abs(np.asarray(fixed) - np.asarray(whole))
    assert difference.max() <= 2
    assert np.mean(difference == 0) > 0.99


def test_integrals_hold_no_more_than_their_limits():
    held = rate_loops.balancing(jnp.array([0.0, 60000.0, 0.0, 60000.0])).integral
    np.testing.assert_allclose(held, [0.0, 0.0, firmware.USUAL.rate.integral_limit[2]], atol=1e-3)
