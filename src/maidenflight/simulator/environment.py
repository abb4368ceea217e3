"""One drone doing one task: observations in, actions out.

`reset` and `step` are pure functions of one drone; `jax.vmap` makes many. An `Environment` is the
part that shapes the compiled program; everything physical is in `Parameters` and is traced.
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax, tree
from jaxtyping import Array, Bool, Float, Int

from maidenflight.errors import InputError
from maidenflight.parameters import Parameters
from maidenflight.simulator import (
    actuators,
    control,
    dynamics,
    failures,
    latency,
    look_ahead,
    noise,
    sensors,
    tasks,
    vectors,
)
from maidenflight.simulator.actuators import Actuators
from maidenflight.simulator.battery import MOST_COUNTS, PLUS, Supply, ThrustLaw
from maidenflight.simulator.control import Controller
from maidenflight.simulator.dynamics import Integrator, State
from maidenflight.simulator.look_ahead import LookAhead
from maidenflight.simulator.sensors import Measurement
from maidenflight.simulator.tasks import Task

ACTION_SIZE = 4
OBSERVATION_SIZE = 20
"""Size of one instant's observation: position 3, quaternion 4, velocity 3, body rates 3, position
error 3, last action 4."""


@dataclass(frozen=True)
class Environment:
    """What is simulated: a task, a control structure and how finely time is cut.

    Hashable, for use as a static argument.
    """

    task: Task = field(default_factory=tasks.circle)
    controller: Controller = field(default_factory=control.pwm)
    integrator: Integrator = dynamics.midpoint
    steps_per_command: int = 2
    """Physics steps a command: the command period is `steps_per_command` x `time_step`, 10 ms by
    default."""
    history: int = 2
    """H, instants in an observation (Gronauer et al. 2022, sec. Simulation Environment)."""
    thrust_law: ThrustLaw | None = None
    """By which the firmware compensates for the battery; see `Supply`."""
    battery: bool = False
    """Whether commands pass through that law, 8-bit PWM and a battery that sags."""
    estimate_rate: int = 100
    """Estimates of position, velocity and attitude a second [Hz]; the gyro is read for every
    command (Crazyflie: 100 Hz, 500 Hz)."""
    estimator_memory: int = 0
    """Estimates that a late estimator remembers; 0: the estimator is not late."""
    look_ahead: LookAhead = look_ahead.NONE
    """Points of the reference ahead of time in an observation."""
    memory: int = 0
    """M, numbers that the policy remembers: an observation ends with them, and an action with what
    it remembers next."""

    def __post_init__(self) -> None:
        if self.battery and self.thrust_law is None:
            raise InputError(
                "battery = True without a thrust law. Give one of simulator.battery.LAWS, such as "
                "thrust_law=battery.FIRMWARE_2021."
            )
        rates = self.controller.command_rate, self.estimate_rate, self.controller.interface.rate
        if min(rates) < 1 or rates[0] % max(rates) or max(rates[1:]) % min(rates[1:]):
            raise InputError(
                f"{rates[0]} commands, {rates[1]} estimates and {rates[2]} actions a second: of "
                "estimates and actions one must divide "
                "the other, and both the commands. Change estimate_rate or the rate of the "
                "controller's interface."
            )

    @classmethod
    def matching(
        cls,
        parameters: Parameters,
        task: Task | None = None,
        controller: Controller | None = None,
        **settings: Any,
    ) -> Self:
        """An environment whose commands hold for the controller's period at a drone's time step.

        Args:
            parameters: one drone; its `time_step` must divide the period between two commands.
            task: the paper's circle unless given.
            controller: PWM unless given; the firmware's PIDs mix for the drone's frame.
            settings: further fields. The thrust law is today's firmware's, unless given, where a
                command of 1 is full PWM, and else none.

        Raises:
            InputError: the time step does not divide the period.
        """
        task, controller = task or tasks.circle(), (controller or control.pwm()).on(parameters)
        if controller.interface.full_scale_counts == MOST_COUNTS:
            settings = {"thrust_law": PLUS, **settings}
        step = float(np.asarray(parameters.time_step))
        steps = 1.0 / (controller.command_rate * step)
        if round(steps) < 1 or abs(steps - round(steps)) > 1e-3:
            fitting = control.time_step(controller, step)
            raise InputError(
                f"time_step = {step * 1e3:.4g} ms does not divide the "
                f"{1e3 / controller.command_rate:.4g} ms between two commands of "
                f"{controller.interface.name} control. Give one that does, such as "
                f"replace(parameters, time_step={fitting:.6g})."
            )
        return cls(task=task, controller=controller, steps_per_command=round(steps), **settings)

    @property
    def supply(self) -> Supply:
        """What becomes of thrust commands before the motors."""
        full = self.controller.interface.full_scale_counts
        return Supply(self.thrust_law, full, self.battery)

    @property
    def commands_per_action(self) -> int:
        """Commands of the controller an action: 1 where the policy commands the motors itself."""
        return self.controller.command_rate // self.controller.interface.rate

    @property
    def estimates_per_action(self) -> int:
        """Estimates an action; 1 also where an estimate serves several actions."""
        return max(1, self.estimate_rate // self.controller.interface.rate)

    def command_period(self, parameters: Parameters) -> Float[Array, ""]:
        """Time for which a command holds [s]."""
        return self.steps_per_command * parameters.time_step

    def control_period(self, parameters: Parameters) -> Float[Array, ""]:
        """Time for which an action holds [s]."""
        return self.commands_per_action * self.command_period(parameters)

    def delay_slots(self) -> int:
        """Length of the delay line, from the controller's nominal rate."""
        return latency.slots(1.0 / self.controller.command_rate)


class EnvState(NamedTuple):
    """All that changes while a drone flies."""

    state: State
    delay_line: Float[Array, "slots 4"]
    """Rotor speed commands sqrt(u) on their way to the motors, newest first."""
    actuators: Actuators
    controller: Any
    gyro: Float[Array, "3"]
    """Body rates behind the gyro's low-pass filter [rad/s]."""
    gyro_bias: Float[Array, "3"]
    estimator: Float[Array, "memory 10"]
    drift: Float[Array, "6"]
    """Errors of the estimated position [m] and velocity [m/s]."""
    measurement: Measurement
    """What the sensors say now."""
    history: Float[Array, "H 20"]
    """Observed instants, oldest first."""
    action: Float[Array, "4"]
    """a_{t-1}."""
    memory: Float[Array, "M"]
    """What the policy remembers."""
    time: Float[Array, ""]
    """The reference's clock [s]."""
    elapsed: Float[Array, ""]
    """Time since the episode began [s]."""


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
    """Distance from the set-point at the end of the step [m]."""
    end_reason: Int[Array, ""]
    """Which of `failures.END_REASONS` ends the episode; 0: it goes on."""


class Noise(NamedTuple):
    """Random numbers of one step, E estimates of K commands each."""

    command: Float[Array, "E K 7"]
    """Standard normal: of the four actuators and of the gyro."""
    estimate: Float[Array, "E 21"]
    """Standard normal: of the estimate's drift, of the gyro's bias and of a measurement."""
    uniform: Float[Array, "E 6"]
    """Uniform on [-1, 1]: of a measurement."""


def observe(
    measurement: Measurement, setpoint: Float[Array, "3"], action: Float[Array, "4"]
) -> Float[Array, "20"]:
    """One instant of an observation, in the order of `policy_file.INSTANT`.

    Source: Gronauer et al. 2022, sec. Simulation Environment; the order and the sign of the error
    are those of the authors' code and firmware (the paper writes e = r - t).
    """
    error = setpoint - measurement.position
    seen = (
        measurement.position,
        measurement.quaternion,
        measurement.velocity,
        measurement.body_rates,
    )
    return jnp.concatenate([*seen, error, action])


def remember(history: Float[Array, "H 20"], instant: Float[Array, "20"]) -> Float[Array, "H 20"]:
    """The history with one more instant and without its oldest."""
    return jnp.concatenate([history[1:], instant[None]])


def observation(environment: Environment, env_state: EnvState) -> Float[Array, "20H+3K+M"]:
    """The policy's input.

    The last H instants, oldest first, the K points of a look-ahead, and what it remembers.
    """
    seen = env_state.history.reshape(-1)
    if environment.look_ahead.points:
        ahead = environment.look_ahead.of(environment.task.reference, env_state.time)
        seen = look_ahead.joined(env_state.history, ahead, env_state.measurement.position)
    return jnp.concatenate([seen, env_state.memory]) if environment.memory else seen


def begin(
    environment: Environment,
    state: State,
    time: Float[Array, ""],
    parameters: Parameters,
    key: Array,
) -> EnvState:
    """An episode that starts in a given state; its delay line holds the task's first command.

    Args:
        environment: what is simulated.
        state: first state.
        time: the reference's clock [s].
        parameters: the drone.
        key: random key for bias and sensor noise.

    Raises:
        InputError: the state holds a number that is not finite (told outside compiled functions
            only).
    """
    state = dynamics.checked(state)
    normal, uniform = noise.draw(key, 3 + sensors.NORMALS, sensors.UNIFORMS)
    command = environment.task.first_command(parameters)
    bias = sensors.turn_on_bias(parameters, normal[:3])
    estimator = jnp.zeros((environment.estimator_memory, 10))
    for _ in range(environment.estimator_memory):
        estimator = sensors.remember(estimator, state)
    measurement = sensors.measure(state, bias, parameters, normal[3:], uniform)
    action = environment.controller.interface.level(command)
    instant = observe(measurement, environment.task.reference(time), action)
    return EnvState(
        state=state,
        delay_line=jnp.broadcast_to(
            actuators.rotor_speed_command(command), (environment.delay_slots(), 4)
        ),
        actuators=actuators.switched_on(command, parameters, environment.supply),
        controller=environment.controller.init(),
        gyro=state.body_rates,
        gyro_bias=bias,
        estimator=estimator,
        drift=jnp.zeros(6),
        measurement=measurement,
        history=jnp.broadcast_to(instant, (environment.history, OBSERVATION_SIZE)),
        action=action,
        memory=jnp.zeros(environment.memory),
        time=jnp.asarray(time, jnp.float32),
        elapsed=jnp.zeros(()),
    )


def reset(environment: Environment, parameters: Parameters, key: Array) -> EnvState:
    """An episode that starts where the task starts it."""
    task_key, key = jax.random.split(key)
    state, time = environment.task.reset(parameters, task_key)
    return begin(environment, state, time, parameters, key)


def draw(environment: Environment, key: Array) -> Noise:
    """The random numbers of one step."""
    estimates = environment.estimates_per_action
    commands = environment.commands_per_action // estimates
    size = commands * 7 + sensors.DRIFT_NORMALS + 3 + sensors.NORMALS
    normal, uniform = noise.draw(key, estimates * size, estimates * sensors.UNIFORMS)
    normal = normal.reshape(estimates, size)
    return Noise(
        command=normal[:, : commands * 7].reshape(estimates, commands, 7),
        estimate=normal[:, commands * 7 :],
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
    action, memory = action[:ACTION_SIZE], action[ACTION_SIZE:]
    setpoint = environment.task.reference(env_state.time)
    period = environment.control_period(parameters)
    actions = jnp.round(env_state.elapsed / period) + 1.0

    def until_estimate(before: EnvState, drawn: Noise) -> tuple[EnvState, None]:
        def hold(env_state: EnvState, now: tuple[Array, Array]) -> tuple[EnvState, None]:
            number, normal = now
            # Between two estimates only the gyro is read anew, as on the drone.
            rates = sensors.gyro(env_state.gyro, env_state.gyro_bias, parameters, normal[4:])
            rates = jnp.where(number > 0, rates, before.measurement.body_rates)
            env_state = env_state._replace(
                measurement=env_state.measurement._replace(body_rates=rates)
            )
            return _hold_command(
                environment,
                env_state,
                action,
                setpoint,
                parameters,
                normal[:4],
                commands - 1 - number,
            ), None

        commands = drawn.command.shape[0]
        if commands == 1:
            env_state = _hold_command(
                environment, before, action, setpoint, parameters, drawn.command[0, :4]
            )
        else:
            roomy = before._replace(delay_line=latency.with_room(before.delay_line, commands))
            env_state, _ = lax.scan(hold, roomy, (jnp.arange(commands), drawn.command))
            env_state = env_state._replace(
                delay_line=env_state.delay_line[: before.delay_line.shape[0]]
            )
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
        after, _ = lax.scan(until_estimate, env_state, drawn)

    time, elapsed = env_state.time + period, env_state.elapsed + period
    setpoint = environment.task.reference(time)
    failure = environment.task.failure(after.state, setpoint)
    finite = jnp.isfinite(vectors.norm(after.state.position)) & jnp.isfinite(vectors.norm(action))
    failure = jnp.where(finite, failure, failures.NOT_FINITE)
    terminated = failure > 0
    truncated = ~terminated & (elapsed > environment.task.duration - period / 2)
    step_result = StepResult(
        reward=environment.task.reward(after.state, setpoint, action, env_state.action),
        terminated=terminated,
        truncated=truncated,
        setpoint=setpoint,
        position_error=vectors.norm(setpoint - after.state.position),
        end_reason=jnp.where(truncated, failures.TIME_LIMIT, failure),
    )
    instant = observe(after.measurement, setpoint, action)
    history = remember(env_state.history, instant)
    after = after._replace(
        history=history, action=action, memory=memory, time=time, elapsed=elapsed
    )
    return after, step_result


def _hold_command(
    environment: Environment,
    env_state: EnvState,
    action: Float[Array, "4"],
    setpoint: Float[Array, "3"],
    parameters: Parameters,
    normal: Float[Array, "4"],
    place: Int[Array, ""] | None = None,
) -> EnvState:
    """Asks the controller for one command and integrates the physics over its period.

    The command goes to a place kept in the delay line, or in front.
    """
    memory, command = environment.controller.command(
        env_state.controller, action, env_state.measurement, setpoint
    )
    period = environment.command_period(parameters)
    motors, speed_command = actuators.actuate(
        env_state.actuators, command, period, parameters, normal, environment.supply
    )
    old, newest = env_state.delay_line, 0 if place is None else place
    line = (
        latency.push(old, speed_command)
        if place is None
        else latency.put(old, speed_command, place)
    )
    state = drive(
        environment.integrator,
        env_state.state,
        line,
        environment.steps_per_command,
        parameters,
        environment.task.floor,
        newest,
    )
    gyro = sensors.low_pass(
        env_state.gyro, env_state.state.body_rates, state.body_rates, period, parameters
    )
    return env_state._replace(
        state=state, delay_line=line, actuators=motors, controller=memory, gyro=gyro
    )


def _estimate(
    environment: Environment,
    env_state: EnvState,
    actions: Float[Array, ""],
    period: Float[Array, ""],
    parameters: Parameters,
    drawn: Noise,
) -> EnvState:
    """Reads the sensors.

    Position, velocity and attitude only where an estimate is due after so many actions.
    """
    walk, turn, normal = jnp.split(
        drawn.estimate, (sensors.DRIFT_NORMALS, sensors.DRIFT_NORMALS + 3)
    )
    bias = sensors.walk_bias(env_state.gyro_bias, period, parameters, turn)
    drift = sensors.walk_estimate(env_state.drift, period, parameters, walk)
    seen, estimator = env_state.state, env_state.estimator
    every = max(1, environment.controller.interface.rate // environment.estimate_rate)
    if environment.estimator_memory > 0:
        estimator = sensors.remember(estimator, env_state.state)
        seen = sensors.delayed(estimator, env_state.state, every * period, parameters)
    seen = seen._replace(
        position=seen.position + drift[:3],
        velocity=seen.velocity + drift[3:],
        body_rates=env_state.gyro,
    )
    fresh = sensors.measure(seen, bias, parameters, normal, drawn.uniform)
    if every > 1:
        due = actions % every == 0
        old = env_state.measurement._replace(body_rates=fresh.body_rates)
        fresh, estimator = tree.map(
            lambda new, old: jnp.where(due, new, old),
            (fresh, estimator),
            (old, env_state.estimator),
        )
    return env_state._replace(gyro_bias=bias, estimator=estimator, drift=drift, measurement=fresh)


def drive(
    integrator: Integrator,
    state: State,
    line: Float[Array, "slots 4"],
    steps: int,
    parameters: Parameters,
    floor: float | None = None,
    newest: Int[Array, ""] | int = 0,
) -> State:
    """Integrates the physics over one command period.

    Args:
        integrator: `dynamics.midpoint`, `dynamics.euler` or `dynamics.rk4`.
        state: the drone when the newest command is given.
        line: rotor speed commands, newest first.
        steps: physics steps in the period.
        parameters: the drone.
        floor: height at which the drone stands [m], if there is a floor; the ground is at height 0.
        newest: place of the newest command in the line.
    """
    delayed = latency.delayed(line, parameters, steps, newest)

    def advance(state: State, speed: Float[Array, "4"]) -> tuple[State, None]:
        if floor is None:
            return integrator(state, speed, parameters), None
        after = integrator(state, speed, dynamics.near_ground(parameters, state.position[2]))
        return dynamics.held_by_floor(after, floor), None

    return lax.scan(advance, state, delayed)[0]
