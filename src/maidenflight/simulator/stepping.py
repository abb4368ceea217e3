"""A step of an episode, and many: an action lasts one control period.

Within it the controller commands the motors, the physics goes on and the sensors are read. Pure
functions of one drone; `jax.vmap` batches them.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax, tree
from jaxtyping import Array, Bool, Float, Int

from maidenflight.parameters import Parameters
from maidenflight.simulator.environment import Environment, EnvState, observation, reset
from maidenflight.simulator.physics import actuators, latency, motion, sensors, vectors
from maidenflight.simulator.physics.disturbance import draw_disturbance, kick
from maidenflight.simulator.physics.latency import DelayLine
from maidenflight.simulator.policy_spec import ACTION_SIZE, observe, remember
from maidenflight.simulator.randomization import Distribution
from maidenflight.simulator.tasks import failures

PolicyFunction = Callable[[Float[Array, "20H+3K"]], Float[Array, "4"]]


class EnvInstance(NamedTuple):
    """An environment's state, and the parameters of the drone that flies in it."""

    env_state: EnvState
    parameters: Parameters


class StepResult(NamedTuple):
    """What one step gave."""

    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    """The drone failed."""
    truncated: Bool[Array, ""]
    """Time was up; the drone had not failed."""
    setpoint: Float[Array, "3"]
    """[m], at the end of the step."""
    position_error: Float[Array, ""]
    """Distance from the set-point at the end of the step, by estimates without noise [m]."""
    end_reason: Int[Array, ""]
    """Which of `failures.END_REASONS` ends the episode; 0: it goes on."""


class Noise(NamedTuple):
    """Random numbers of one step, E estimates of K commands each."""

    command: Float[Array, "E K 7"]
    """Standard normal: of the four actuators and of the gyro."""
    estimate: Float[Array, "E 18"]
    """Standard normal: of the estimate's drift, the gyro's bias, a measurement and the gyro."""
    disturbance: Float[Array, "E D"]
    """Standard normal."""
    uniform: Float[Array, "E 6"]
    """Uniform on [-1, 1]: of a measurement."""


def draw(environment: Environment, key: Array) -> Noise:
    """Returns the random numbers of one step."""
    estimates = environment.estimates_per_action
    commands = environment.commands_per_action // estimates
    read = commands * 7 + sensors.DRIFT_NORMALS + 3 + sensors.NORMALS + 3
    size = read + environment.disturbance_size
    normal, uniform = sensors.draw_noise(key, estimates * size, estimates * sensors.UNIFORMS)
    normal = normal.reshape(estimates, size)
    return Noise(
        command=normal[:, : commands * 7].reshape(estimates, commands, 7),
        estimate=normal[:, commands * 7 : read],
        disturbance=normal[:, read:],
        uniform=uniform.reshape(estimates, sensors.UNIFORMS),
    )


def step(
    environment: Environment,
    env_state: EnvState,
    action: Float[Array, "4+M"],
    parameters: Parameters,
    key: Array,
) -> tuple[EnvState, StepResult]:
    """Holds an action for one control period.

    For each command the gyro is read, the controller commands the motors, and the physics goes on
    between two halves of the disturbance's push; for each estimate the sensors are read. At the end
    come set-point, failure or time limit, reward, and what the policy observes next.

    Args:
        environment: what is simulated.
        env_state: the drone before.
        action: the policy's output, its next memory included; not clipped here, the controller
            does that.
        parameters: the drone; its `time_step` sets the control period.
        key: random key.

    Returns:
        The drone after, and what the step gave. A finished episode is not reset.
    """
    drawn = draw(environment, key)
    # A weakly typed action, as of `jnp.full(4, 0.2)`, would have the next step compiled anew.
    action = jnp.asarray(action, jnp.float32)
    action, memory = action[:ACTION_SIZE], action[ACTION_SIZE:]
    setpoint = environment.task.reference(env_state.time)
    period = environment.control_period(parameters)
    actions = jnp.round(env_state.elapsed / period) + 1.0

    def until_estimate(before: EnvState, drawn: Noise) -> tuple[EnvState, None]:
        def hold(env_state: EnvState, now: tuple[Array, Array]) -> tuple[EnvState, None]:
            number, normal = now
            # Between two estimates only the gyro is read anew, as on the drone.
            shaken = sensors.gyro_noise(
                env_state.gyro_noise, environment.command_period(parameters), parameters, normal[4:]
            )
            shaken = jnp.where(number > 0, shaken, before.gyro_noise)
            rates = env_state.gyro + env_state.gyro_bias + shaken
            env_state = env_state._replace(
                gyro_noise=shaken, measurement=env_state.measurement._replace(body_rates=rates)
            )
            return _hold_command(
                environment,
                env_state,
                action,
                setpoint,
                parameters,
                normal[:4],
                number,
            ), None

        commands = drawn.command.shape[0]
        if commands == 1:
            env_state = _hold_command(
                environment, before, action, setpoint, parameters, drawn.command[0, :4]
            )
        else:
            env_state, _ = lax.scan(hold, before, (jnp.arange(commands), drawn.command))
            line = latency.in_front(env_state.delay_line, commands)
            env_state = env_state._replace(delay_line=line)
        return _estimate(
            environment,
            env_state,
            actions,
            period / environment.estimates_per_action,
            parameters,
            drawn,
        ), None

    if environment.estimates_per_action == 1:
        after, _ = until_estimate(env_state, tree.map(lambda numbers: numbers[0], drawn))
    else:
        # A gradient computes the PIDs' 500 Hz loop once more instead of keeping all of it, which is
        # faster (paper/notes/roofline.md) and changes nothing else.
        again = jax.checkpoint(until_estimate, prevent_cse=False)
        after, _ = lax.scan(again, env_state, drawn)

    time, elapsed = env_state.time + period, env_state.elapsed + period
    setpoint, apparent = environment.task.reference(time), after.apparent_state
    failure = environment.task.failure(apparent, setpoint)
    finite = jnp.isfinite(vectors.norm(apparent.position)) & jnp.isfinite(vectors.norm(action))
    failure = jnp.where(finite, failure, failures.NOT_FINITE)
    terminated = failure > 0
    truncated = ~terminated & (elapsed > environment.task.duration - period / 2)
    step_result = StepResult(
        reward=environment.task.reward(apparent, setpoint, action, env_state.action),
        terminated=terminated,
        truncated=truncated,
        setpoint=setpoint,
        position_error=vectors.norm(setpoint - apparent.position),
        end_reason=jnp.where(truncated, failures.TIME_LIMIT, failure),
    )
    history = remember(env_state.history, observe(after.measurement, setpoint, action))
    after = after._replace(
        history=history, action=action, memory=memory, time=time, elapsed=elapsed
    )
    return after, step_result


def rollout(
    environment: Environment,
    policy: PolicyFunction,
    env_state: EnvState,
    parameters: Parameters,
    key: Array,
    steps: int,
) -> tuple[EnvState, tuple[EnvState, StepResult]]:
    """Flies a policy for a number of control periods; a finished episode goes on.

    Args:
        environment: what is simulated.
        policy: observation to action.
        env_state: where to begin.
        parameters: the drone.
        key: random key.
        steps: control periods; static.

    Returns:
        The last state, and the state before and the result of each period, stacked along a first
        axis of `steps`.
    """

    def advance(env_state: EnvState, key: Array) -> tuple[EnvState, tuple[EnvState, StepResult]]:
        after, step_result = step(
            environment, env_state, policy(observation(environment, env_state)), parameters, key
        )
        return after, (env_state, step_result)

    return lax.scan(advance, env_state, jax.random.split(key, steps))


def randomized_reset(
    environment: Environment, distribution: Distribution, key: Array
) -> EnvInstance:
    """Draws a drone's parameters and resets its episode."""
    drone_key, reset_key = jax.random.split(key)
    parameters = distribution.draw(drone_key)
    return EnvInstance(reset(environment, parameters, reset_key), parameters)


def _hold_command(
    environment: Environment,
    env_state: EnvState,
    action: Float[Array, "4"],
    setpoint: Float[Array, "3"],
    parameters: Parameters,
    normal: Float[Array, "4"],
    number: Int[Array, ""] | None = None,
) -> EnvState:
    """Asks the controller for one command and integrates the physics over its period.

    If it is one of several, `number` 0 first, the delay line is a ring.
    """
    memory, command = environment.controller.command(
        env_state.controller, action, env_state.measurement, setpoint
    )
    period = environment.command_period(parameters)
    motors, speed_command = actuators.actuate(
        env_state.actuators, command, period, parameters, normal, environment.supply
    )
    if number is None:
        line = DelayLine(latency.push(env_state.delay_line, speed_command))
    else:
        line = latency.put(env_state.delay_line, speed_command, number)
    kicked = env_state.disturbance, 0.5 * period, parameters
    state = motion.drive(
        environment.integrator,
        kick(env_state.state, *kicked),
        line,
        environment.steps_per_command,
        parameters,
        environment.task.floor,
    )
    state = kick(state, *kicked)
    gyro = sensors.low_pass(
        env_state.gyro, env_state.state.body_rates, state.body_rates, period, parameters
    )
    return env_state._replace(
        state=state, delay_line=line.commands, actuators=motors, controller=memory, gyro=gyro
    )


def _estimate(
    environment: Environment,
    env_state: EnvState,
    actions: Float[Array, ""],
    period: Float[Array, ""],
    parameters: Parameters,
    drawn: Noise,
) -> EnvState:
    """Reads the sensors; all but the gyro only where an estimate is due after so many actions."""
    walk, turn, normal, shaking = jnp.split(
        drawn.estimate, np.cumsum((sensors.DRIFT_NORMALS, 3, sensors.NORMALS)).tolist()
    )
    shaken = sensors.gyro_noise(
        env_state.gyro_noise, environment.command_period(parameters), parameters, shaking
    )
    bias = sensors.walk_bias(env_state.gyro_bias, period, parameters, turn)
    drift = sensors.walk_estimate(env_state.drift, period, parameters, walk, env_state.state)
    estimate, estimator = env_state.state, env_state.estimator
    every = max(1, environment.controller.interface.rate // environment.estimate_rate)
    if environment.estimator_memory > 0:
        estimator = sensors.remember(estimator, env_state.state)
        estimate = sensors.delayed(estimator, env_state.state, every * period, parameters)
    estimate = sensors.add_drift(estimate, drift, parameters, env_state.state)
    estimate = estimate._replace(body_rates=env_state.gyro + bias + shaken)
    fresh = sensors.measure(estimate, parameters, normal, drawn.uniform)
    if every > 1:
        due = actions % every == 0
        old = env_state.measurement._replace(body_rates=fresh.body_rates)
        fresh, estimator = tree.map(
            lambda new, old: jnp.where(due, new, old),
            (fresh, estimator),
            (old, env_state.estimator),
        )
    return env_state._replace(
        gyro_bias=bias,
        gyro_noise=shaken,
        estimator=estimator,
        drift=drift,
        disturbance=draw_disturbance(env_state.disturbance, period, parameters, drawn.disturbance),
        measurement=fresh,
    )
