"""One drone doing one task: observations in, actions out.

`reset`, `step` and `rollout` are pure functions of one drone; `jax.vmap` makes many. An `Environment` is the part that shapes
the compiled program; everything physical is in `Parameters` and is traced.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax, tree
from jaxtyping import Array, Bool, Float

from maidenflight.parameters import Parameters
from maidenflight.simulator import actuators, control, dynamics, latency, sensors, tasks
from maidenflight.simulator.actuators import Actuators
from maidenflight.simulator.control import Controller
from maidenflight.simulator.dynamics import Integrator, State
from maidenflight.simulator.sensors import Measurement
from maidenflight.simulator.tasks import Task

ACTION_SIZE = 4
OBSERVATION_SIZE = 20
"""Size of one instant's observation: position 3, quaternion 4, velocity 3, body rates 3, position error 3, last action 4."""


@dataclass(frozen=True)
class Environment:
    """What is simulated: a task, a control structure and how finely time is cut. Hashable, for use as a static argument."""

    task: Task = field(default_factory=tasks.circle)
    controller: Controller = field(default_factory=control.pwm)
    integrator: Integrator = dynamics.euler
    steps_per_command: int = 2
    """Physics steps a command: the command period is `steps_per_command` x `time_step`, 10 ms by default."""
    history: int = 2
    """H, instants in an observation (Gronauer et al. 2022, sec. Simulation Environment)."""
    battery: bool = False
    """Whether commands pass through battery compensation, 8-bit PWM and a battery that sags."""
    estimator_memory: int = 0
    """Control periods of state that a late estimator remembers; 0: the estimator is not late."""

    @property
    def commands_per_action(self) -> int:
        """Commands of the controller an action: 1 where the policy commands the motors itself."""
        return self.controller.rate // self.controller.action_rate

    def command_period(self, parameters: Parameters) -> Float[Array, ""]:
        """Time for which a command holds [s]."""
        return self.steps_per_command * parameters.time_step

    def control_period(self, parameters: Parameters) -> Float[Array, ""]:
        """Time for which an action holds [s]."""
        return self.commands_per_action * self.command_period(parameters)

    def delay_slots(self) -> int:
        """Length of the delay line, from the controller's nominal rate."""
        return latency.slots(1.0 / self.controller.rate)


class Episode(NamedTuple):
    """All that changes while a drone flies."""

    state: State
    delay_line: Float[Array, "slots 4"]
    """Rotor speed commands sqrt(u) on their way to the motors, newest first."""
    actuators: Actuators
    controller: Any
    gyro_bias: Float[Array, "3"]
    estimator: Float[Array, "memory 10"]
    measurement: Measurement
    """What the sensors say now."""
    history: Float[Array, "H 20"]
    """Observed instants, oldest first."""
    action: Float[Array, "4"]
    """a_{t-1}."""
    time: Float[Array, ""]
    """The reference's clock [s]."""
    elapsed: Float[Array, ""]
    """Time since the episode began [s]."""


class Outcome(NamedTuple):
    """What one step gave."""

    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    """The drone failed."""
    truncated: Bool[Array, ""]
    """Time was up; the drone had not failed."""
    setpoint: Float[Array, "3"]
    """[m], at the end of the step."""


def observe(measurement: Measurement, setpoint: Float[Array, "3"], action: Float[Array, "4"]) -> Float[Array, "20"]:
    """One instant as the policy sees it: position, quaternion, velocity, body rates, set-point minus position, last action.

    Source: Gronauer et al. 2022, sec. Simulation Environment; the order and the sign of the error are those of the authors'
    code and firmware (the paper writes e = r - t).
    """
    error = setpoint - measurement.position
    seen = (measurement.position, measurement.quaternion, measurement.velocity, measurement.body_rates)
    return jnp.concatenate([*seen, error, action])


def observation(episode: Episode) -> Float[Array, "20H"]:
    """The policy's input: the last H instants, oldest first."""
    return episode.history.reshape(-1)


def begin(environment: Environment, state: State, time: Float[Array, ""], parameters: Parameters, key: Array) -> Episode:
    """An episode that starts in a given state, its command path filled with the task's first command.

    Args:
        environment: what is simulated.
        state: first state.
        time: the reference's clock [s].
        parameters: the drone.
        key: random key for bias and sensor noise.
    """
    bias_key, sensor_key = jax.random.split(key)
    command = environment.task.first_command(parameters)
    bias = sensors.turn_on_bias(parameters, bias_key)
    estimator = jnp.zeros((environment.estimator_memory, 10))
    for _ in range(environment.estimator_memory):
        estimator = sensors.remember(estimator, state)
    measurement = sensors.measure(state, bias, parameters, sensor_key)
    action = jnp.broadcast_to(2.0 * command - 1.0, (ACTION_SIZE,))
    instant = observe(measurement, environment.task.reference(time), action)
    return Episode(
        state=state,
        delay_line=jnp.broadcast_to(actuators.rotor_speed_command(command), (environment.delay_slots(), 4)),
        actuators=actuators.switched_on(command, parameters, environment.battery),
        controller=environment.controller.init(),
        gyro_bias=bias,
        estimator=estimator,
        measurement=measurement,
        history=jnp.broadcast_to(instant, (environment.history, OBSERVATION_SIZE)),
        action=action,
        time=jnp.asarray(time, jnp.float32),
        elapsed=jnp.zeros(()),
    )


def reset(environment: Environment, parameters: Parameters, key: Array) -> Episode:
    """An episode that starts where the task starts it."""
    task_key, key = jax.random.split(key)
    state, time = environment.task.reset(parameters, task_key)
    return begin(environment, state, time, parameters, key)


def step(
    environment: Environment, episode: Episode, action: Float[Array, "4"], parameters: Parameters, key: Array
) -> tuple[Episode, Outcome]:
    """Holds an action for one control period.

    Args:
        environment: what is simulated.
        episode: the drone before.
        action: the policy's output; not clipped here, the controller does that.
        parameters: the drone; its `time_step` sets the control period.
        key: random key.

    Returns:
        The drone after, and what the step gave. A finished episode is not reset.
    """
    sensor_key, bias_key, command_key = jax.random.split(key, 3)
    setpoint = environment.task.reference(episode.time)

    def hold(episode: Episode, now: tuple[Array, Array]) -> tuple[Episode, None]:
        number, key = now
        # Between two estimates only the gyro is read anew, as on the drone.
        gyro_key, key = jax.random.split(key)
        rates = sensors.gyro(episode.state.body_rates, episode.gyro_bias, parameters, gyro_key)
        rates = jnp.where(number > 0, rates, episode.measurement.body_rates)
        episode = episode._replace(measurement=episode.measurement._replace(body_rates=rates))
        return _hold_command(environment, episode, action, setpoint, parameters, key), None

    if environment.commands_per_action == 1:
        episode = _hold_command(environment, episode, action, setpoint, parameters, command_key)
    else:
        count = environment.commands_per_action
        episode, _ = lax.scan(hold, episode, (jnp.arange(count), jax.random.split(command_key, count)))

    period = environment.control_period(parameters)
    time, elapsed = episode.time + period, episode.elapsed + period
    setpoint = environment.task.reference(time)
    bias = sensors.walk_bias(episode.gyro_bias, period, parameters, bias_key)
    seen, estimator = episode.state, episode.estimator
    if environment.estimator_memory > 0:
        estimator = sensors.remember(estimator, episode.state)
        seen = sensors.delayed(estimator, episode.state, period, parameters)
    measurement = sensors.measure(seen, bias, parameters, sensor_key)
    instant = observe(measurement, setpoint, action)
    terminated = environment.task.terminated(episode.state, setpoint)
    outcome = Outcome(
        reward=environment.task.reward(episode.state, setpoint, action, episode.action),
        terminated=terminated,
        truncated=~terminated & (elapsed > environment.task.duration - period / 2),
        setpoint=setpoint,
    )
    history = jnp.concatenate([episode.history[1:], instant[None]])
    episode = episode._replace(
        gyro_bias=bias, estimator=estimator, measurement=measurement, history=history, action=action, time=time, elapsed=elapsed
    )
    return episode, outcome


def _hold_command(
    environment: Environment, episode: Episode, action: Float[Array, "4"], setpoint: Float[Array, "3"], parameters: Parameters, key: Array
) -> Episode:
    """Asks the controller for one command and integrates the physics over its period."""
    memory, command = environment.controller.command(episode.controller, action, episode.measurement, setpoint)
    period = environment.command_period(parameters)
    motors, speed_command = actuators.actuate(episode.actuators, command, period, parameters, key, environment.battery)
    line = latency.push(episode.delay_line, speed_command)
    state = drive(environment.integrator, episode.state, line, environment.steps_per_command, parameters, environment.task.floor)
    return episode._replace(state=state, delay_line=line, actuators=motors, controller=memory)


def drive(
    integrator: Integrator,
    state: State,
    line: Float[Array, "slots 4"],
    steps: int,
    parameters: Parameters,
    floor: float | None = None,
) -> State:
    """Integrates the physics over one command period.

    Args:
        integrator: `dynamics.euler` or `dynamics.rk4`.
        state: the drone when the newest command is given.
        line: rotor speed commands, newest first.
        steps: physics steps in the period.
        parameters: the drone.
        floor: height at which the drone stands [m], if there is a floor.
    """
    delayed = latency.weights(parameters, steps, line.shape[0]) @ line
    # Two Euler steps compile quickly and run faster unrolled; RK4 is four times as much to compile.
    unroll = steps if integrator is dynamics.euler and steps <= 2 else 1

    def advance(state: State, speed: Float[Array, "4"]) -> tuple[State, None]:
        after = integrator(state, speed, parameters)
        return after if floor is None else dynamics.held_by_floor(after, floor), None

    return lax.scan(advance, state, delayed, unroll=unroll)[0]


PolicyFunction = Callable[[Float[Array, "20H"]], Float[Array, "4"]]


def rollout(
    environment: Environment,
    policy: PolicyFunction,
    episode: Episode,
    parameters: Parameters,
    key: Array,
    steps: int,
    fresh: Callable[[Array], Episode] | None = None,
) -> tuple[Episode, tuple[Episode, Outcome]]:
    """Flies a policy for a number of control periods.

    Args:
        environment: what is simulated.
        policy: observation to action.
        episode: where to begin.
        parameters: the drone.
        key: random key.
        steps: control periods; static.
        fresh: makes the episode that follows a finished one; without it a finished episode goes on.

    Returns:
        The last episode state, and each period's episode (before it) and outcome, stacked along a first axis of `steps`.
    """

    def one(episode: Episode, key: Array) -> tuple[Episode, tuple[Episode, Outcome]]:
        step_key, fresh_key = jax.random.split(key)
        after, outcome = step(environment, episode, policy(observation(episode)), parameters, step_key)
        if fresh is not None:
            over = outcome.terminated | outcome.truncated
            new = fresh(fresh_key)
            after = tree.map(lambda old, new: jnp.where(over, new, old), after, new)
        return after, (episode, outcome)

    return lax.scan(one, episode, jax.random.split(key, steps))
