"""The rate loop's phase margin against its poles, a formula and the simulated drone."""

import re
from functools import partial

import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings

from maidenflight.parameters import crazyflie, drone, noiseless, replace
from maidenflight.simulator import environment
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.phase_margin import (
    PERIOD,
    describe_rate_loop,
    most_latency,
    phase_margin,
    rate_loop,
    rate_margin,
)
from maidenflight.simulator.environment import Environment
from maidenflight.simulator.physics import dynamics
from maidenflight.simulator.stepping import rollout
from maidenflight.simulator.tasks import tasks

BRUSHLESS = drone("crazyflie_brushless")


@settings(deadline=None, max_examples=40)
@given(
    st.floats(0.01, 0.15), st.floats(0.0, 0.04), st.floats(1.3, 6.0), st.floats(0.3, 3.0),
    st.floats(0.0, 0.01), st.sampled_from([0, 1]),
)  # fmt: skip
def test_phase_is_left_where_all_poles_lie_within_the_unit_circle(
    lag, latency, thrust, heavier, filtering, axis
):
    body = replace(
        crazyflie(),
        motor_time_constant=lag,
        latency=latency,
        thrust_to_weight=thrust,
        inertia=heavier * np.asarray(crazyflie().inertia),
        gyro_time_constant=filtering,
    )
    loop = rate_loop(body, axis)
    margin = phase_margin(loop).phase
    assume(abs(margin) > 0.01)
    assert loop.is_stable() == (margin > 0.0)


def test_of_a_pure_gain_the_phase_is_that_of_the_hold_the_delay_and_the_lags():
    lag, filtering, latency = 1e-3, 2e-3, 0.0073
    body = replace(
        BRUSHLESS, motor_time_constant=lag, gyro_time_constant=filtering, latency=latency
    )
    loop = rate_loop(body, 0)
    kp = 0.5 * loop.gains[0]
    phase, crossover = phase_margin(loop._replace(gains=(kp, 0.0, 0.0)))
    late = crossover * (latency + PERIOD / 2)
    lags = np.arctan(crossover * lag) + np.arctan(crossover * filtering)
    assert phase == pytest.approx(np.pi / 2 - late - lags, abs=2e-3)


@partial(jax.jit, static_argnums=0)
def rolling(env, body):
    """Roll rates [rad/s] of a second after a push of 2 deg/s; the policy asks for none."""
    start = dynamics.at_hover(jnp.array([0.0, 0.0, 1.0]), body)
    start = start._replace(body_rates=jnp.radians(jnp.array([2.0, 0.0, 0.0])))
    state = environment.begin(env, start, jnp.float32(0.0), body, jax.random.key(0))
    hover = env.controller.interface.level(dynamics.hover_command(body))
    _, (moved, _) = rollout(env, lambda _: hover, state, body, jax.random.key(1), 60)
    return moved.state.body_rates[:, 0]


def test_the_simulated_drone_oscillates_ever_more_beyond_the_latency_that_its_loop_bears():
    body = replace(noiseless(BRUSHLESS), time_step=0.001)
    env = Environment.matching(body, tasks.hover(), control.attitude_rate())
    most = most_latency(body)
    assert most == pytest.approx(0.0121, abs=5e-4)
    for later, is_calm in ((most - 0.002, True), (most + 0.002, False)):
        late = replace(body, latency=float(body.latency) + later)
        rates = np.abs(np.asarray(rolling(env, late)))
        assert (rates[40:].max() < 0.5 * rates[5:15].max()) == is_calm
        assert (rates[40:].max() > 1.5 * rates[5:15].max()) != is_calm


def test_each_millisecond_costs_the_crossovers_phase_and_own_gains_leave_more():
    now, then = (rate_margin(BRUSHLESS, later=later) for later in (0.0, 0.01))
    assert now.phase - then.phase == pytest.approx(0.01 * now.crossover, rel=1e-3)
    as_2_1 = replace(BRUSHLESS, platform="crazyflie")
    assert rate_margin(as_2_1).phase < rate_margin(BRUSHLESS).phase
    assert rate_margin(replace(BRUSHLESS, latency=0.05)).phase < 0.0


def test_what_cannot_be_held_is_said_with_gains_that_can():
    assert "%" not in describe_rate_loop("mine", BRUSHLESS)
    late = replace(BRUSHLESS, latency=0.015)
    sentence = describe_rate_loop("mine", late)
    (percent,) = re.findall(r"(\d+)%", sentence)
    assert "pwm" in sentence
    assert rate_margin(late, later=0.01).phase < 0.0
    assert rate_margin(late, later=0.01, share=int(percent) / 100).phase > np.radians(20.0)
