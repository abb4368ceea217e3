"""One drone doing one task: observations in, actions out.

`reset` and `stepping.step` are pure functions of one drone; `jax.vmap` makes many. An `Environment`
is the part that shapes the compiled program; everything physical is in `Parameters` and is traced.
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from maidenflight.errors import InputError
from maidenflight.parameters import Parameters
from maidenflight.simulator.controllers import control
from maidenflight.simulator.controllers.control import Controller
from maidenflight.simulator.physics import actuators, disturbance, dynamics, latency, sensors
from maidenflight.simulator.physics.actuators import Actuators
from maidenflight.simulator.physics.battery import MOST_COUNTS, PLUS, Supply, ThrustLaw
from maidenflight.simulator.physics.disturbance import draw_disturbance
from maidenflight.simulator.physics.dynamics import Integrator, State
from maidenflight.simulator.physics.sensors import Measurement
from maidenflight.simulator.policy_spec import OBSERVATION_SIZE, PolicySpec, observe
from maidenflight.simulator.tasks import tasks
from maidenflight.simulator.tasks.tasks import Task


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
    thrust_law: ThrustLaw | None = None
    """By which the firmware compensates for the battery; see `Supply`."""
    battery: bool = False
    """Whether commands pass through that law, 8-bit PWM and a battery that sags."""
    estimate_rate: int = 100
    """Estimates of position, velocity and attitude a second [Hz]; the gyro is read for every
    command (Crazyflie: 100 Hz, 500 Hz)."""
    estimator_memory: int = 0
    """Estimates that a late estimator remembers; 0: the estimator is not late."""
    disturbed: bool = False
    """Whether torques and forces that change slowly act, of `disturbance_torque` and so on."""
    spec: PolicySpec = PolicySpec()
    """What the policy sees and remembers."""

    def __post_init__(self) -> None:
        if self.battery and self.thrust_law is None:
            raise InputError(
                "battery = True without a thrust law. Give one of simulator.physics.battery.LAWS, "
                "such as thrust_law=battery.FIRMWARE_2021."
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
        """Makes an environment whose commands hold for a controller's period.

        Args:
            parameters: one drone; its `time_step` must divide the period between two commands.
            task: the paper's circle by default.
            controller: PWM by default; the firmware's PIDs mix for the drone's frame.
            settings: further fields. The thrust law is today's firmware's, by default, where a
                command of 1 is full PWM, and else none. Disturbances act on drones that have some.

        Raises:
            InputError: the time step does not divide the period.
        """
        task, controller = task or tasks.circle(), (controller or control.pwm()).on(parameters)
        if controller.interface.full_scale_counts == MOST_COUNTS:
            settings = {"thrust_law": PLUS, **settings}
        settings = {"disturbed": disturbance.is_disturbed(parameters), **settings}
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
    def disturbance_size(self) -> int:
        """Numbers of a disturbance: none where nothing disturbs, so that it costs nothing."""
        return disturbance.SIZE if self.disturbed else 0

    @property
    def commands_per_action(self) -> int:
        """Commands of the controller an action: 1 where the policy commands the motors itself."""
        return self.controller.command_rate // self.controller.interface.rate

    @property
    def estimates_per_action(self) -> int:
        """Estimates an action; 1 also where an estimate serves several actions."""
        return max(1, self.estimate_rate // self.controller.interface.rate)

    def command_period(self, parameters: Parameters) -> Float[Array, ""]:
        """Returns the time for which a command holds [s]."""
        return self.steps_per_command * parameters.time_step

    def control_period(self, parameters: Parameters) -> Float[Array, ""]:
        """Returns the time for which an action holds [s]."""
        return self.commands_per_action * self.command_period(parameters)


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
    gyro_noise: Float[Array, "3"]
    """Of its last reading [rad/s]."""
    estimator: Float[Array, "memory 10"]
    drift: Float[Array, "6"]
    """Errors of the estimated position [m] and velocity [m/s]."""
    disturbance: Float[Array, "D"]
    """See `disturbance.SIZE`; empty where nothing disturbs."""
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

    @property
    def apparent_state(self) -> State:
        """The true state, but where the estimates say: of their drift nothing tells a drone."""
        return self.state._replace(position=self.state.position + self.drift[:3])


def observation(environment: Environment, env_state: EnvState) -> Float[Array, "20H+3K+M"]:
    """Returns the policy's input.

    It is the last H instants, oldest first, the K points of a look-ahead, and what it remembers.
    """
    spec = environment.spec
    points = spec.points(environment.task.reference, env_state.time)
    position, memory = env_state.measurement.position, env_state.memory
    return spec.observation(env_state.history, points, position, memory)


def begin(
    environment: Environment,
    state: State,
    time: Float[Array, ""],
    parameters: Parameters,
    key: Array,
) -> EnvState:
    """Returns an episode that starts in some state.

    Its delay line holds the task's first command.

    Args:
        environment: what is simulated.
        state: first state.
        time: the reference's clock [s].
        parameters: the drone.
        key: random key for bias and sensor noise.

    Raises:
        InputError: the state holds a number that is not finite (raised outside compiled functions
            only).
    """
    state = dynamics.check_state(state)
    read_size = 3 + sensors.NORMALS + 3
    normal, uniform = sensors.draw_noise(
        key, read_size + environment.disturbance_size, sensors.UNIFORMS
    )
    command = environment.task.first_command(parameters)
    bias = sensors.turn_on_bias(parameters, normal[:3])
    estimator = jnp.zeros((environment.estimator_memory, 10))
    for _ in range(environment.estimator_memory):
        estimator = sensors.remember(estimator, state)
    gyro_noise = parameters.gyro_noise * normal[3 + sensors.NORMALS : read_size]
    read = state._replace(body_rates=state.body_rates + bias + gyro_noise)
    measurement = sensors.measure(read, parameters, normal[3 : 3 + sensors.NORMALS], uniform)
    action = environment.controller.interface.level(command)
    instant = observe(measurement, environment.task.reference(time), action)
    return EnvState(
        state=state,
        delay_line=jnp.broadcast_to(
            actuators.rotor_speed_command(command),
            (latency.slots(1.0 / environment.controller.command_rate), 4),
        ),
        actuators=actuators.switched_on(command, parameters, environment.supply),
        controller=environment.controller.init(),
        gyro=state.body_rates,
        gyro_bias=bias,
        gyro_noise=gyro_noise,
        estimator=estimator,
        drift=jnp.zeros(6),
        disturbance=draw_disturbance(
            jnp.zeros(environment.disturbance_size), jnp.inf, parameters, normal[read_size:]
        ),
        measurement=measurement,
        history=jnp.broadcast_to(instant, (environment.spec.history, OBSERVATION_SIZE)),
        action=action,
        memory=jnp.zeros(environment.spec.memory),
        time=jnp.asarray(time, jnp.float32),
        elapsed=jnp.zeros(()),
    )


def reset(environment: Environment, parameters: Parameters, key: Array) -> EnvState:
    """Returns an episode that starts where the task starts it."""
    task_key, key = jax.random.split(key)
    state, time = environment.task.reset(parameters, task_key)
    return begin(environment, state, time, parameters, key)
